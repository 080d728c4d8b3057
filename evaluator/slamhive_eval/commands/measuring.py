# SPDX-License-Identifier: Apache-2.0
"""Inputs, association, alignment and printed table of ``ape`` and ``rpe``.

Other commands that compare trajectories take their options from here.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from slamhive_eval import alignment, association, metrics, rotation
from slamhive_eval.commands import output, tables
from slamhive_eval.conventions import CONVENTIONS, read_as
from slamhive_eval.errors import AssociationError, OptionError
from slamhive_eval.formats import files
from slamhive_eval.formats.column_tables import read_columns
from slamhive_eval.preparing import Preparation, Prepared, prepare
from slamhive_eval.statistics import IN_UNIT, STATISTICS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from slamhive_eval.preparing import Clock
    from slamhive_eval.trajectory import Trajectory

_NEARLY_ALL = 0.9
"""Share of the poses that are compared, below which it is said."""
_FAR_OFF = 0.1
"""Errors by the spread of the ground truth, and the usual turn, from which on it is looked for why."""
_TURNED_RADIANS = 0.1
_LOOKED_AT = 1000
"""Poses that tell whether a pair fits badly: nearly all fit well, and each is asked."""


def add_pair(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for ground truth and estimates and how they are laid onto one another."""
    parser.add_argument(
        "reference",
        metavar="GT",
        help="ground truth: TUM, EuRoC csv, KITTI or a csv with named columns, may be .gz or .bz2; a topic "
        "of a bag or MCAP as in run.bag:/odom or run.bag:/tf:map.base_link",
    )
    parser.add_argument(
        "estimates", metavar="EST", nargs="+", help="estimated trajectories, the same formats"
    )
    parser.add_argument(
        "--relation", choices=metrics.RELATIONS, default="trans_part", help="default: trans_part"
    )
    add_reading(parser)
    add_preparation(parser)
    add_support(parser)
    output.add_json(parser)
    output.add_writers(parser)


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Add what decides how files are read."""
    group = parser.add_argument_group("reading")
    group.add_argument("--format", choices=files.FORMATS, help="format of the estimates (default: found out)")
    group.add_argument(
        "--reference-format",
        choices=(*files.FORMATS, *tables.FORMATS),
        help="format of the ground truth (default: found out); table: as --columns says; control-points: "
        "positions at instants, t x y z or as --columns says, which ape alone measures",
    )
    group.add_argument("--topic", metavar="TOPIC", help="topic of the estimates, for recordings")
    group.add_argument("--reference-topic", metavar="TOPIC", help="topic of the ground truth, for recordings")
    group.add_argument(
        "--times",
        metavar="FILE",
        help="stamps of KITTI poses; without it line k pairs with line k, or by the frame index "
        "where lines of 13 numbers begin with one",
    )
    tables.add(parser)
    add_by_index(group)
    group.add_argument(
        "--read-as",
        choices=CONVENTIONS,
        action="append",
        default=[],
        help="convention of EST where it isn't the usual one; `slamhive-eval explain` finds it",
    )
    group.add_argument(
        "--sort", action="store_true", help="sort the poses of EST by time instead of refusing"
    )


def add_by_index(parser: Any) -> None:
    """Add what pairs KITTI files of unequal length."""
    parser.add_argument(
        "--by-index",
        action="store_true",
        help="pair KITTI poses by index as far as both files go instead of refusing files of unequal length",
    )


def add_preparation(parser: argparse.ArgumentParser, *, several: bool = False) -> None:
    """Add what decides how poses are matched, moved and aligned, by one method or ``several``."""
    matching = parser.add_argument_group("matching")
    matching.add_argument(
        "--match",
        choices=association.MATCHINGS,
        default="nearest",
        help="by time: nearest as evo, unique as TUM and rpg, forward as OpenVINS, or interpolate the ground "
        "truth (default: nearest)",
    )
    add_max_diff(matching)
    matching.add_argument(
        "--max-gap",
        type=float,
        default=association.DEFAULT_GAP_SECONDS,
        metavar="S",
        help="interpolate between ground-truth poses at most this far apart [s] (default: 1)",
    )
    matching.add_argument(
        "--offset",
        type=_offset,
        default=0.0,
        metavar="S",
        help="added to EST's stamps [s]; auto or drift: found from how fast the body turns",
    )
    frame = parser.add_argument_group("frame and alignment")
    either = frame.add_mutually_exclusive_group()
    either.add_argument(
        "--extrinsic",
        metavar="FILE",
        help="pose of EST's sensor in the body whose ground truth this is; the ground truth is moved there",
    )
    either.add_argument("--hand-eye", action="store_true", help="find that pose from the motion")
    methods = (*alignment.METHODS, "auto")
    if several:
        frame.add_argument(
            "--align", nargs="+", choices=methods, default=["none"], help="one line for each (default: none)"
        )
    else:
        frame.add_argument("--align", choices=methods, default="none", help="default: none")
    frame.add_argument("--unscaled", action="store_true", help="auto: EST has no scale (monocular), so sim3")
    frame.add_argument(
        "--gravity-aligned", action="store_true", help="auto: both worlds have z upwards, so yaw"
    )
    frame.add_argument("--n-to-align", type=int, metavar="N", help="align with the first N poses only")
    frame.add_argument("--robust", choices=("huber", "trimmed"), help="align heeding outliers little or not")
    frame.add_argument(
        "--keep",
        type=float,
        default=0.75,
        metavar="SHARE",
        help="share of the poses that trimmed fits (default: 0.75)",
    )


def add_support(parser: argparse.ArgumentParser) -> None:
    """Add where several estimates are compared."""
    parser.add_argument(
        "--support",
        choices=("own", "common"),
        default="own",
        help="compare each estimate where it has poses, or only where all have (default: own)",
    )


def add_matching(parser: argparse.ArgumentParser) -> None:
    """Add what decides which poses are nearest in time."""
    add_max_diff(parser)
    parser.add_argument(
        "--sort", action="store_true", help="sort the poses of EST by time instead of refusing"
    )


def add_max_diff(parser: Any) -> None:
    """Add how far apart in time two poses may be that are compared."""
    parser.add_argument(
        "--max-diff",
        type=float,
        default=0.01,
        metavar="S",
        help="largest time difference [s] (default: 0.01)",
    )


def _offset(word: str) -> float | str:
    if word in ("auto", "drift"):
        return word
    try:
        return float(word)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{word!r} is neither a number of seconds, auto nor drift") from None


def preparation(asked: argparse.Namespace) -> Preparation:
    """Return the settings for matching and aligning estimates with the ground truth, as the options say."""
    clock: Clock = {"auto": "offset", "drift": "drift"}.get(asked.offset, "given")  # type: ignore[assignment]
    return Preparation(
        matching=asked.match,
        max_difference_seconds=asked.max_diff,
        max_gap_seconds=asked.max_gap,
        clock=clock,
        offset_seconds=asked.offset if clock == "given" else 0.0,
        extrinsic=None if asked.extrinsic is None else files.read_transform(asked.extrinsic),
        hand_eye=asked.hand_eye,
        alignment=alignment_method(asked, asked.align),
        first_poses=asked.n_to_align,
        robust=asked.robust,
        keep=asked.keep,
    )


def alignment_method(asked: argparse.Namespace, name: str) -> alignment.Method:
    """The method that a word of ``--align`` stands for."""
    if name == "auto":
        return "sim3" if asked.unscaled else "yaw" if asked.gravity_aligned else "se3"
    return cast("alignment.Method", name)


def read_reference(asked: argparse.Namespace) -> Trajectory:
    """The ground truth.

    Raises:
        OptionError: It is control points, or what is said of its columns doesn't fit.
        FileError: It can't be read.
    """
    form = tables.form(asked)
    if asked.reference_format == tables.CONTROL_POINTS:
        raise OptionError("control points are positions at a few instants: only ape measures against them")
    if form is not None:
        return read_columns(asked.reference, form, asked.times)
    return files.read_trajectory(
        asked.reference, asked.reference_format, times=asked.times, topic=asked.reference_topic
    )


def read_estimate(asked: argparse.Namespace, name: str, reference: Trajectory | None) -> Trajectory:
    """An estimate to pair with the ground truth, if any; KITTI's stamps belong to KITTI poses only."""
    times = asked.times
    if times is not None and (asked.format or files.detect_format(name)) != "kitti":
        times = None
    unsorted: files.Unsorted = "sort" if asked.sort else "error"
    how: Any = {"times": times, "topic": asked.topic, "unsorted": unsorted, "by_index": asked.by_index}
    if reference is None:
        found = files.read_trajectory(name, asked.format, **how)
    else:
        found = files.read_estimate(name, reference, asked.reference, asked.format, **how)
    for convention in asked.read_as:
        found = read_as(found, convention)
    return found


def read_estimates(asked: argparse.Namespace, reference: Trajectory) -> Iterator[tuple[str, Trajectory]]:
    """Names and poses of the estimates, one after the other, on the support asked for."""
    if asked.support == "own":
        yield from ((name, read_estimate(asked, name, reference)) for name in asked.estimates)
        return
    from slamhive_eval.measures import support  # noqa: PLC0415 - few ask for it

    found = [read_estimate(asked, name, reference) for name in asked.estimates]
    spans = support.common_support(found)
    yield from ((name, support.within(one, spans)) for name, one in zip(asked.estimates, found, strict=True))


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
    how = preparation(asked)
    reference = read_reference(asked)
    measured = []
    for name, estimate in read_estimates(asked, reference):
        try:
            prepared = prepare(reference, estimate, how)
        except AssociationError as error:
            raise AssociationError(
                f"{error}; slamhive-eval explain looks for an offset, --match interpolate compares in between"
            ) from None
        about = prepared.as_dict()
        about["notes"] += [
            *(f"ground truth: {note}" for note in reference.notes),
            *_pairing(reference, estimate, prepared, how),
            *_hints(reference, estimate, prepared),
        ]
        measured.append(errors_of(asked, name, prepared.reference, prepared.estimate, about))
    output.write(asked, measured)
    results = [one.result for one in measured]
    if len(results) == 1:
        output.emit(asked, results[0], show)
    else:
        output.emit(asked, {"results": results}, lambda _: show_several(results))
    return 0


def _pairing(reference: Trajectory, estimate: Trajectory, prepared: Prepared, how: Preparation) -> list[str]:
    """Return notes on poses without a partner of their own, and on equal stamps."""
    stamps = (
        prepared.clock.corrected(estimate.stamps) if prepared.clock else estimate.stamps + how.offset_seconds
    )
    short, long = (stamps, reference.stamps) if len(stamps) <= len(reference) else (reference.stamps, stamps)
    limit = how.max_difference_seconds
    there = int(np.count_nonzero((short >= long[0] - limit) & (short <= long[-1] + limit)))
    paired, notes = len(prepared.reference), []
    if paired < _NEARLY_ALL * there:
        notes.append(
            f"{paired} of {there} poses have a partner of their own within {limit:g} s: the figures are "
            "theirs alone; --match interpolate compares all, --max-diff allows more"
        )
    return notes + association.equal_stamps_notes(estimate)


def _hints(reference: Trajectory, estimate: Trajectory, prepared: Prepared) -> list[str]:
    """Return notes on what would make a pair fit better, where it fits badly."""
    some = slice(None, None, max(1, len(prepared.reference) // _LOOKED_AT))
    truth, found = prepared.reference.positions[some], prepared.estimate.positions[some]
    spread = np.sqrt(np.mean((truth - truth.mean(axis=0)) ** 2))
    between = rotation.multiply(
        rotation.conjugate(prepared.reference.quaternions[some]), prepared.estimate.quaternions[some]
    )
    turned = reference.oriented and estimate.oriented and np.median(rotation.angle(between)) > _TURNED_RADIANS
    if np.sqrt(np.mean((found - truth) ** 2)) <= _FAR_OFF * spread and not turned:
        return []
    from slamhive_eval.measures.explaining import hints  # noqa: PLC0415 - few pairs fit so badly

    return hints(reference, estimate)


def show(result: dict[str, Any]) -> str:
    """The table of one estimate."""
    lines = [_head(result)]
    lines += [f"{name:>8}  {number(result[name])}" for name in STATISTICS]
    lines += [f"{name:>8}  {result[name]}" for name in ("poses", "pairs") if name in result]
    lines.append(f"{'scale':>8}  {number(result['alignment']['scale'])}")
    if "clock" in result:
        clock = result["clock"]
        drift = f", drift {clock['drift'] * 1e6:.1f} ppm" if clock["drift"] else ""
        lines.append(f"{'offset':>8}  {clock['offsetSeconds']:.6f} s{drift}")
    return "\n".join(lines + [f"note: {note}" for note in result["notes"]])


def show_several(results: list[dict[str, Any]]) -> str:
    """One line for each estimate."""
    count = "pairs" if "pairs" in results[0] else "poses"
    width = max(len(result["estimate"]) for result in results)
    lines = [_head(results[0]), " " * width + "".join(f"  {name:>10}" for name in (*IN_UNIT, count, "scale"))]
    for result in results:
        numbers = "".join(f"  {number(result[name]):>10}" for name in IN_UNIT)
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
