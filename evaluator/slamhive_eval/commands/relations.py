# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval relations``: errors over pairwise ground truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.commands import measuring, output
from slamhive_eval.errors import EvaluationError
from slamhive_eval.formats import files
from slamhive_eval.measures import relations

if TYPE_CHECKING:
    import argparse


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Errors over pairwise ground truth (t1 t2 x y z roll pitch yaw), by time between poses."
    )
    parser.epilog = "Example: slamhive-eval relations intel.relations trajectory.txt"
    parser.add_argument("relations", metavar="FILE", help="the relations")
    parser.add_argument("estimate", metavar="EST", help="estimated trajectory")
    parser.add_argument(
        "--interpolate",
        type=float,
        metavar="S",
        help="interpolate between poses at most S seconds apart instead of taking the nearest",
    )
    measuring.add_matching(parser)
    output.add_json(parser)


def run(asked: argparse.Namespace) -> int:
    """Measure and print."""
    truth = relations.read_relations(asked.relations)
    estimate = files.read_trajectory(asked.estimate, unsorted="sort" if asked.sort else "error")
    found = relations.evaluate_relations(
        truth, estimate, max_difference_seconds=asked.max_diff, interpolate_gap_seconds=asked.interpolate
    )
    if not found.count:
        times = np.concatenate((truth.begin, truth.end))
        raise EvaluationError(
            f"none of the {found.relations} relations, {times.min():.3f} s to {times.max():.3f} s, has poses "
            f"of the estimate at both its times, {estimate.stamps[0]:.3f} s to {estimate.stamps[-1]:.3f} s"
        )
    output.emit(asked, found.as_dict(), _show)
    return 0


def _show(result: dict[str, Any]) -> str:
    head = f"{'seconds between':>16}  {'count':>6}"
    head += "".join(f"  {name:>10}" for name in ("rmse [m]", "mean [m]", "rmse [deg]", "mean [deg]"))
    lines = [f"{result['count']} of {result['relations']} relations, {result['missing']} without poses", head]
    for group in [*result["byTime"], {**result, "name": "all"}]:
        upper = group.get("toSeconds")
        name = group.get("name") or f"{group['fromSeconds']:g} … {'∞' if upper is None else f'{upper:g}'}"
        numbers = "".join(
            f"  {group[kind][key]:10.5f}" if group[kind] else f"  {'–':>10}"
            for kind in ("translation", "rotationDeg")
            for key in ("rmse", "mean")
        )
        lines.append(f"{name:>16}  {group['count']:>6}{numbers}")
    return "\n".join(lines)
