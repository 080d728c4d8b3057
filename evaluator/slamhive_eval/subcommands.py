# SPDX-License-Identifier: Apache-2.0
"""What ``slamhive-eval`` can do: absolute and relative errors of one estimate, errors over relations.

argparse, not typer: starting is what most of a small evaluation takes.
"""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from slamhive_eval import alignment, association, files, metrics, pairs, relations
from slamhive_eval.errors import EvaluationError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive_eval.trajectory import Trajectory


def run(arguments: Sequence[str] | None) -> str:
    """Parse the words of a command and do it.

    Args:
        arguments: Words after the program's name; None for those of the process.

    Returns:
        What to print: a table, or one JSON object.

    Raises:
        EvaluationError: Wrong input.
        SystemExit: 0 after ``--help``, 2 for words that don't fit.
    """
    asked = _parser().parse_args(arguments)
    result = asked.run(asked)
    return json.dumps(result, allow_nan=False) if asked.json else str(asked.show(result))


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="slamhive-eval",
        description="Measure estimated trajectories against ground truth.",
        epilog="Example: slamhive-eval ape groundtruth.txt trajectory.txt --align se3",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)
    ape = commands.add_parser(
        "ape",
        help="absolute pose error",
        description="Absolute pose error of an estimate against ground truth.",
        epilog="Example: slamhive-eval ape groundtruth.txt trajectory.txt --align sim3 --json",
    )
    _add_pair(ape)
    ape.set_defaults(run=_ape, show=_show_errors)
    rpe = commands.add_parser(
        "rpe",
        help="relative pose error",
        description="Relative pose error of an estimate against ground truth.",
        epilog="Example: slamhive-eval rpe groundtruth.txt trajectory.txt --delta 1 --unit m --all-pairs",
    )
    _add_pair(rpe)
    rpe.add_argument("--delta", type=float, default=1.0, metavar="D", help="distance of a pair (default: 1)")
    rpe.add_argument("--unit", choices=pairs.UNITS, default="frames", help="unit of delta (default: frames)")
    rpe.add_argument("--all-pairs", action="store_true", help="all pairs instead of consecutive ones")
    rpe.add_argument(
        "--rel-tolerance",
        type=float,
        default=0.1,
        metavar="T",
        help="share of delta by which all pairs may miss it (default: 0.1)",
    )
    rpe.add_argument(
        "--pairs-from-reference", action="store_true", help="choose pairs by the reference's path"
    )
    rpe.set_defaults(run=_rpe, show=_show_errors)
    _add_relations(commands)
    return parser


def _add_pair(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "reference", metavar="GT", help="ground truth: TUM, EuRoC csv or KITTI, may be .gz or .bz2"
    )
    parser.add_argument("estimate", metavar="EST", help="estimated trajectory")
    parser.add_argument(
        "--relation", choices=metrics.RELATIONS, default="trans_part", help="default: trans_part"
    )
    parser.add_argument("--align", choices=alignment.METHODS, default="none", help="default: none")
    parser.add_argument("--n-to-align", type=int, metavar="N", help="align with the first N poses only")
    parser.add_argument(
        "--times", metavar="FILE", help="stamps of KITTI poses; without it line k pairs with line k"
    )
    parser.add_argument("--offset", type=float, default=0.0, metavar="S", help="added to EST's stamps [s]")
    _add_common(parser)


def _add_relations(commands: Any) -> None:
    parser = commands.add_parser(
        "relations",
        help="errors over pairwise relations",
        description="Errors over pairwise ground truth (t1 t2 x y z roll pitch yaw), by time between poses.",
        epilog="Example: slamhive-eval relations intel.relations trajectory.txt",
    )
    parser.add_argument("relations", metavar="FILE", help="the relations")
    parser.add_argument("estimate", metavar="EST", help="estimated trajectory")
    parser.add_argument(
        "--interpolate",
        type=float,
        metavar="S",
        help="interpolate between poses at most S seconds apart instead of taking the nearest",
    )
    _add_common(parser)
    parser.set_defaults(run=_relations, show=_show_relations)


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--max-diff",
        type=float,
        default=0.01,
        metavar="S",
        help="largest time difference [s] (default: 0.01)",
    )
    parser.add_argument(
        "--sort", action="store_true", help="sort the poses of EST by time instead of refusing"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _load(asked: argparse.Namespace) -> tuple[Trajectory, Trajectory]:
    unsorted: files.Unsorted = "sort" if asked.sort else "error"
    reference = files.read_trajectory(asked.reference, times=asked.times)
    return reference, files.read_trajectory(asked.estimate, times=asked.times, unsorted=unsorted)


def _aligned(asked: argparse.Namespace) -> tuple[Trajectory, Trajectory, dict[str, Any]]:
    reference, estimate = _load(asked)
    matched = association.associate(reference, estimate, asked.max_diff, asked.offset)
    if not len(matched):
        raise association.no_overlap(reference, estimate, asked.max_diff, asked.offset)
    reference, estimate = reference.select(matched.reference), estimate.select(matched.estimate)
    found = alignment.align(reference, estimate, asked.align, asked.n_to_align)
    about = {
        "poses": len(matched),
        "alignment": {"method": found.method, "transform": found.transform.tolist(), "scale": found.scale},
        "notes": list(found.notes),
    }
    return reference, found.apply(estimate), about


def _ape(asked: argparse.Namespace) -> dict[str, Any]:
    reference, estimate, about = _aligned(asked)
    errors = metrics.ape_errors(reference, estimate, asked.relation)
    return _result(asked, metrics.Statistics.of(errors), about)


def _rpe(asked: argparse.Namespace) -> dict[str, Any]:
    reference, estimate, about = _aligned(asked)
    source = reference if asked.pairs_from_reference else estimate
    found = pairs.find_pairs(
        source, asked.delta, asked.unit, all_pairs=asked.all_pairs, rel_tolerance=asked.rel_tolerance
    )
    errors = metrics.rpe_errors(reference, estimate, found, asked.relation)
    if not len(errors):
        raise EvaluationError(
            f"none of the {len(reference)} associated poses form a pair {asked.delta:g} {asked.unit} apart"
        )
    about |= {
        "pairs": len(errors),
        "delta": asked.delta,
        "unit": asked.unit,
        "allPairs": asked.all_pairs,
    }
    return _result(asked, metrics.Statistics.of(errors), about)


def _result(asked: argparse.Namespace, statistics: Any, about: dict[str, Any]) -> dict[str, Any]:
    return {"relation": asked.relation, **statistics.as_dict(), **about}


def _relations(asked: argparse.Namespace) -> dict[str, Any]:
    truth = relations.read_relations(asked.relations)
    estimate = files.read_trajectory(asked.estimate, unsorted="sort" if asked.sort else "error")
    found = relations.evaluate_relations(
        truth,
        estimate,
        max_difference_seconds=asked.max_diff,
        interpolate_gap_seconds=asked.interpolate,
    )
    if not found.count:
        times = np.concatenate((truth.begin, truth.end))
        raise EvaluationError(
            f"none of the {found.relations} relations, {times.min():.3f} s to {times.max():.3f} s, has poses "
            f"of the estimate at both its times, {estimate.stamps[0]:.3f} s to {estimate.stamps[-1]:.3f} s"
        )
    return found.as_dict()


def _show_errors(result: dict[str, Any]) -> str:
    unit = metrics.RELATION_UNITS[result["relation"]]
    lines = [f"{result['relation']}{f' [{unit}]' if unit else ''}, alignment {result['alignment']['method']}"]
    lines += [
        f"{name:>8}  {result[name]:.6f}" for name in ("rmse", "mean", "median", "std", "min", "max", "sse")
    ]
    lines += [f"{name:>8}  {result[name]}" for name in ("poses", "pairs") if name in result]
    lines.append(f"{'scale':>8}  {result['alignment']['scale']:.6f}")
    return "\n".join(lines + [f"note: {note}" for note in result["notes"]])


def _show_relations(result: dict[str, Any]) -> str:
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
