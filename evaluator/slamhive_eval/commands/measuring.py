# SPDX-License-Identifier: Apache-2.0
"""What ``ape`` and ``rpe`` share: their inputs, association and alignment, and the table they print."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive_eval import alignment, association, files, metrics
from slamhive_eval.commands import output

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from slamhive_eval.trajectory import Trajectory


def add_pair(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for ground truth and estimates and how they are laid onto one another."""
    parser.add_argument(
        "reference", metavar="GT", help="ground truth: TUM, EuRoC csv or KITTI, may be .gz or .bz2"
    )
    parser.add_argument("estimates", metavar="EST", nargs="+", help="estimated trajectories")
    parser.add_argument(
        "--relation", choices=metrics.RELATIONS, default="trans_part", help="default: trans_part"
    )
    parser.add_argument("--align", choices=alignment.METHODS, default="none", help="default: none")
    parser.add_argument("--n-to-align", type=int, metavar="N", help="align with the first N poses only")
    parser.add_argument(
        "--times", metavar="FILE", help="stamps of KITTI poses; without it line k pairs with line k"
    )
    parser.add_argument("--offset", type=float, default=0.0, metavar="S", help="added to EST's stamps [s]")
    add_matching(parser)
    output.add_json(parser)
    output.add_writers(parser)


def add_matching(parser: argparse.ArgumentParser) -> None:
    """Add what decides how poses are found by time."""
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


def measure(
    asked: argparse.Namespace,
    errors_of: Callable[[argparse.Namespace, str, Trajectory, Trajectory, dict[str, Any]], output.Measured],
) -> int:
    """Measure every estimate, print the results and let the writers write.

    Args:
        asked: The command's options.
        errors_of: Makes the errors of an associated reference and aligned estimate, by the name.

    Returns:
        The exit code.
    """
    unsorted: files.Unsorted = "sort" if asked.sort else "error"
    reference = files.read_trajectory(asked.reference, times=asked.times)
    measured = []
    for name in asked.estimates:
        estimate = files.read_trajectory(name, times=asked.times, unsorted=unsorted)
        measured.append(errors_of(asked, name, *_aligned(asked, reference, estimate)))
    output.write(asked, measured)
    results = [one.result for one in measured]
    if len(results) == 1:
        output.emit(asked, results[0], show)
    else:
        output.emit(asked, {"results": results}, lambda _: show_several(results))
    return 0


def _aligned(
    asked: argparse.Namespace, reference: Trajectory, estimate: Trajectory
) -> tuple[Trajectory, Trajectory, dict[str, Any]]:
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


def show(result: dict[str, Any]) -> str:
    """The table of one estimate."""
    lines = [_head(result)]
    lines += [
        f"{name:>8}  {number(result[name])}"
        for name in ("rmse", "mean", "median", "std", "min", "max", "sse")
    ]
    lines += [f"{name:>8}  {result[name]}" for name in ("poses", "pairs") if name in result]
    lines.append(f"{'scale':>8}  {number(result['alignment']['scale'])}")
    return "\n".join(lines + [f"note: {note}" for note in result["notes"]])


def show_several(results: list[dict[str, Any]]) -> str:
    """One line for each estimate."""
    names = ("rmse", "mean", "median", "std", "min", "max")
    count = "pairs" if "pairs" in results[0] else "poses"
    width = max(len(result["estimate"]) for result in results)
    lines = [_head(results[0]), " " * width + "".join(f"  {name:>10}" for name in (*names, count, "scale"))]
    for result in results:
        numbers = "".join(f"  {number(result[name]):>10}" for name in names)
        scale = number(result["alignment"]["scale"])
        lines.append(f"{result['estimate']:<{width}}{numbers}  {result[count]:>10}  {scale:>10}")
    notes = [f"note: {result['estimate']}: {note}" for result in results for note in result["notes"]]
    return "\n".join(lines + notes)


def number(value: float | None) -> str:
    """A figure of a table; what JSON has no number for is infinite."""
    return "∞" if value is None else f"{value:.6f}"


def _head(result: dict[str, Any]) -> str:
    unit = metrics.RELATION_UNITS[result["relation"]]
    return f"{result['relation']}{f' [{unit}]' if unit else ''}, alignment {result['alignment']['method']}"
