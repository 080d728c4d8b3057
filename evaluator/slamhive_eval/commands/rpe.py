# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval rpe``: relative pose errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive_eval import metrics, pairs
from slamhive_eval.commands import measuring
from slamhive_eval.commands.output import Measured
from slamhive_eval.errors import EvaluationError
from slamhive_eval.pairs import MIN_RANKED_PAIRS
from slamhive_eval.statistics import Statistics

if TYPE_CHECKING:
    import argparse

    from slamhive_eval.trajectory import Trajectory


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = "Relative pose error of estimates against ground truth."
    parser.epilog = "Example: slamhive-eval rpe groundtruth.txt trajectory.txt --delta 1 --unit m --all-pairs"
    measuring.add_pair(parser)
    parser.add_argument(
        "--delta", type=float, default=1.0, metavar="D", help="distance of a pair (default: 1)"
    )
    parser.add_argument(
        "--unit", choices=pairs.UNITS, default="frames", help="unit of delta (default: frames)"
    )
    parser.add_argument("--all-pairs", action="store_true", help="all pairs instead of consecutive ones")
    parser.add_argument(
        "--rel-tolerance",
        type=float,
        default=0.1,
        metavar="T",
        help="share of delta by which all pairs may miss it (default: 0.1)",
    )
    parser.add_argument(
        "--pairs-from-reference", action="store_true", help="choose pairs by the reference's path"
    )


def run(asked: argparse.Namespace) -> int:
    """Measure and print."""
    return measuring.measure(asked, _errors)


def _errors(
    asked: argparse.Namespace, name: str, reference: Trajectory, estimate: Trajectory, about: dict[str, Any]
) -> Measured:
    source = reference if asked.pairs_from_reference else estimate
    found = pairs.find_pairs(
        source, asked.delta, asked.unit, all_pairs=asked.all_pairs, rel_tolerance=asked.rel_tolerance
    )
    errors = metrics.rpe_errors(reference, estimate, found, asked.relation)
    statistics = Statistics.of(errors)
    if statistics is None:
        raise EvaluationError(
            f"{name}: none of the {len(reference)} associated poses form a pair "
            f"{asked.delta:g} {asked.unit} apart"
        )
    ranked = len(errors) >= MIN_RANKED_PAIRS
    if not ranked:
        about = {**about, "notes": [*about["notes"], f"{len(errors)} pairs say too little to rank by"]}
    asked_for = {"delta": asked.delta, "unit": asked.unit, "allPairs": asked.all_pairs}
    counts = {"pairs": len(errors), "ranked": ranked}
    result = {"relation": asked.relation, **statistics.as_dict(), **about, **counts, **asked_for}
    result["estimate"] = name
    return Measured("rpe", name, reference, estimate, errors, found, statistics, result)
