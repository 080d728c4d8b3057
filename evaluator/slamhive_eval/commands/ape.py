# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval ape``: absolute pose errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive_eval import metrics
from slamhive_eval.commands import measuring, tables
from slamhive_eval.commands.output import Measured
from slamhive_eval.statistics import Statistics

if TYPE_CHECKING:
    import argparse

    from slamhive_eval.trajectory import Trajectory


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = "Absolute pose error of estimates against ground truth."
    parser.epilog = "Example: slamhive-eval ape groundtruth.txt trajectory.txt --align sim3 --json"
    measuring.add_pair(parser)
    parser.add_argument(
        "--details", action="store_true", help="control points: print the error at each of them too"
    )


def run(asked: argparse.Namespace) -> int:
    """Measure and print."""
    if asked.reference_format == tables.CONTROL_POINTS:
        from slamhive_eval.commands import control_points  # noqa: PLC0415 - few ask for it

        return control_points.measure(asked)
    return measuring.measure(asked, _errors)


def _errors(
    asked: argparse.Namespace, name: str, reference: Trajectory, estimate: Trajectory, about: dict[str, Any]
) -> Measured:
    errors = metrics.ape_errors(reference, estimate, asked.relation)
    statistics = Statistics.of(errors)
    assert statistics is not None  # noqa: S101 - a pose is associated at least
    result = {"relation": asked.relation, **statistics.as_dict(), **about, "estimate": name}
    return Measured("ape", name, reference, estimate, errors, None, statistics, result)
