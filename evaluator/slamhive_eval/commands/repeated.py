# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval repeated``: several runs of one configuration together."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from slamhive_eval import evaluation
from slamhive_eval.commands import inputs, measuring, output
from slamhive_eval.measures import repeated

if TYPE_CHECKING:
    import argparse


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "ATE of several runs of one configuration: mean, std, median, range, an interval that fits their "
        "number, and success rates. Lost and diverged runs count as failures."
    )
    parser.epilog = (
        "Example: slamhive-eval repeated groundtruth.txt run-*/trajectory.txt --thresholds 0.05 0.1"
    )
    inputs.add_inputs(parser, "estimated trajectories, one a run")
    inputs.add_alignment(parser)
    parser.add_argument(
        "--thresholds",
        type=float,
        nargs="+",
        default=(),
        metavar="M",
        help="an ATE up to this is a success [m]",
    )


def run(asked: argparse.Namespace) -> int:
    """Measure and print."""
    options = replace(inputs.options(asked), rpe=())
    reference = measuring.read_reference(asked)
    runs: list[dict[str, Any]] = []
    for name in asked.estimates:
        estimate = measuring.read_estimate(asked, name, reference)
        found = evaluation.evaluate(reference, estimate, options)
        failed = found.outcome in (evaluation.Outcome.LOST, evaluation.Outcome.DIVERGED)
        runs.append(
            {
                "estimate": name,
                "outcome": found.outcome.value,
                "message": found.message,
                "coverage": found.coverage.share,
                "rmse": None if failed or found.ate is None else found.ate.rmse,
                "notes": list(estimate.notes),
            }
        )
    summary = repeated.summarize([run["rmse"] for run in runs], asked.thresholds)
    output.emit(asked, {**summary.as_dict(), "alignment": asked.align, "each": runs}, _show)
    return 0


def _show(result: dict[str, Any]) -> str:
    lines = [
        f"ATE [m] of {result['runs']} runs, {result['failures']} failed, alignment {result['alignment']}"
    ]
    width = max(len(run["estimate"]) for run in result["each"])
    lines += [
        f"{run['estimate']:<{width}}  {run['outcome']:<8}  coverage {run['coverage']:6.1%}  "
        f"{_figure(run['rmse'])}"
        for run in result["each"]
    ]
    lines += [f"{name:>8}  {_figure(result[name])}" for name in ("mean", "std", "median", "min", "max")]
    interval = result["interval"]
    if interval:
        ends = f"{_figure(interval['low'])} to {_figure(interval['high'])}"
        lines.append(f"95 % interval of the {interval['of']}: {ends} ({interval['method']})")
    lines += [
        f"within {rate['threshold']:g} m: {rate['count']} of {result['runs']} "
        f"(95 %: {rate['low']:.0%} to {rate['high']:.0%})"
        for rate in result["success"]
    ]
    return "\n".join(lines + [f"note: {note}" for run in result["each"] for note in run["notes"]])


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.6f}"
