# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval drift``: errors over sub-trajectories, scale drift, velocity, smoothness and gaps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive_eval.commands import measuring, output
from slamhive_eval.measures import motion, relative, support
from slamhive_eval.preparing import prepare
from slamhive_eval.statistics import Statistics

if TYPE_CHECKING:
    import argparse


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Relative errors over sub-trajectories with their yaw and gravity parts (Zhang and Scaramuzza 2018), "
        "scale drift, velocity errors, smoothness and gaps."
    )
    parser.epilog = "Example: slamhive-eval drift groundtruth.txt trajectory.txt --lengths 5 10 20"
    parser.add_argument("reference", metavar="GT", help="ground truth; z points up")
    parser.add_argument("estimate", metavar="EST", help="estimated trajectory")
    parser.add_argument(
        "--lengths",
        type=float,
        nargs="+",
        metavar="M",
        help="lengths of sub-trajectories [m] (default: 10, 20, 30, 40 and 50 %% of the path)",
    )
    measuring.add_reading(parser)
    measuring.add_preparation(parser)
    parser.set_defaults(align="se3")
    output.add_json(parser)


def run(asked: argparse.Namespace) -> int:
    """Measure and print."""
    reference = measuring.read_reference(asked)
    whole = measuring.read_estimate(asked, asked.estimate, reference)
    how = measuring.preparation(asked)
    prepared = prepare(reference, whole, how)
    truth, aligned = prepared.reference, prepared.estimate
    if prepared.clock is not None:
        whole = prepared.clock.apply(whole)
    elif how.offset_seconds:
        whole = whole.shifted(how.offset_seconds)
    lengths = tuple(asked.lengths) if asked.lengths else None
    # Where x and y point changes the parts of a rotation in second order; rpg splits before a yaw alignment.
    split = prepared.matched if prepared.alignment.method == "yaw" else aligned
    velocity = Statistics.of(motion.velocity_errors(truth, aligned))
    result = {
        **prepared.as_dict(),
        "subTrajectories": [one.as_dict() for one in relative.sub_trajectory_errors(truth, split, lengths)],
        "scaleDrift": relative.scale_drift(truth, aligned).as_dict(),
        "velocity": velocity.as_dict() if velocity else None,
        "smoothness": motion.smoothness(aligned).as_dict(),
        "referenceSmoothness": motion.smoothness(truth).as_dict(),
        **support.find_support(reference, whole).as_dict(),
    }
    output.emit(asked, result, _show)
    return 0


def _show(result: dict[str, Any]) -> str:
    kinds = ("translation", "translationPercent", "rotationDeg", "yawDeg", "gravityDeg", "rotationDegPerM")
    heads = ("t [m]", "t [%]", "r [deg]", "yaw [deg]", "grav. [deg]", "r [deg/m]")
    lines = [
        f"{result['poses']} poses, alignment {result['alignment']['method']}; means over sub-trajectories",
        f"{'length [m]':>11}  {'count':>6}" + "".join(f"  {head:>11}" for head in heads),
    ]
    for one in result["subTrajectories"]:
        means = [one[kind]["mean"] if one[kind] else None for kind in kinds]
        cells = "".join(f"  {_figure(mean):>11}" for mean in means)
        lines.append(f"{one['length']:>11.4g}  {one['count']:>6}{cells}")
    drift, velocity = result["scaleDrift"], result["velocity"] or {}
    smooth, true = result["smoothness"], result["referenceSmoothness"]
    lines += [
        (
            f"scale drift: {_figure(drift['percentPer100m'])} % per 100 m, largest by smallest scale "
            f"{_figure(drift['spread'])} in {drift['windows']} windows"
        ),
        f"velocity error: rmse {_figure(velocity.get('rmse'))} m/s",
        (
            f"acceleration: {_figure(smooth['acceleration'])} m/s² (ground truth "
            f"{_figure(true['acceleration'])}), jerk {_figure(smooth['jerk'])} m/s³ ({_figure(true['jerk'])})"
        ),
        (
            f"first pose after {result['secondsToFirstPose']:.3f} s, "
            f"last {result['secondsAfterLastPose']:.3f} s before the end, {len(result['gaps'])} gaps"
        ),
    ]
    lines += [f"gap: {gap['end'] - gap['begin']:.3f} s, {gap['metres']:.3f} m" for gap in result["gaps"]]
    return "\n".join(lines + [f"note: {note}" for note in result["notes"]])


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.5f}"
