# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval kitti``: errors over segments of fixed lengths."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive_eval import alignment, association
from slamhive_eval.commands import inputs, measuring, output
from slamhive_eval.measures import kitti

if TYPE_CHECKING:
    import argparse

    from slamhive_eval.trajectory import Trajectory


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Translation and rotation errors over segments of fixed lengths, as the KITTI odometry benchmark "
        "defines them, by length and by speed."
    )
    parser.epilog = "Example: slamhive-eval kitti 00_gt.txt 00_estimate.txt --lengths 100 200 400 --json"
    inputs.add_inputs(parser)
    parser.add_argument(
        "--lengths",
        type=float,
        nargs="+",
        default=kitti.KITTI_LENGTHS,
        metavar="M",
        help="lengths of the segments [m] (default: 100 200 … 800)",
    )
    parser.add_argument(
        "--step",
        type=int,
        default=kitti.KITTI_STEP,
        metavar="N",
        help="a segment starts at every N-th frame (default: 10)",
    )
    parser.add_argument(
        "--scale", action="store_true", help="scale EST by its Sim(3) alignment first (monocular estimates)"
    )
    parser.add_argument(
        "--frame-seconds",
        type=float,
        metavar="S",
        help="duration of a frame, for speeds (default: by the stamps; 0.1 for poses without times)",
    )


def run(asked: argparse.Namespace) -> int:
    """Measure and print."""
    reference = measuring.read_reference(asked)
    results = []
    for name in asked.estimates:
        estimate = measuring.read_estimate(asked, name, reference)
        scale = _scale(asked, reference, estimate)
        found = kitti.kitti_errors(
            reference,
            estimate,
            lengths=tuple(asked.lengths),
            step=asked.step,
            max_difference_seconds=asked.max_diff,
            offset_seconds=asked.offset,
            scale=scale,
            frame_seconds=asked.frame_seconds,
        )
        results.append({**found.as_dict(), "scale": scale, "notes": list(estimate.notes), "estimate": name})
    result = results[0] if len(results) == 1 else {"results": results}
    output.emit(asked, result, lambda _: "\n\n".join(map(_show, results)))
    return 0


def _scale(asked: argparse.Namespace, reference: Trajectory, estimate: Trajectory) -> float:
    if not asked.scale:
        return 1.0
    matched = association.associate(reference, estimate, asked.max_diff, asked.offset)
    if not len(matched):
        return 1.0
    truth, found = reference.select(matched.reference), estimate.select(matched.estimate)
    return alignment.align(truth, found, "sim3").scale


def _show(result: dict[str, Any]) -> str:
    head = f"{result['estimate']}: {result['count']} segments"
    if result["missing"]:
        head += f", {result['missing']} without a pose at their begin or end"
    if result.get("missingFrames"):
        head += f"; {result['missingFrames']} frames of the ground truth have no pose"
    lines = [head, f"{'':>12}  {'count':>6}  {'t [%]':>9}  {'r [deg/m]':>11}", _line("all", result)]
    lines += [_line(f"{group['length']:g} m", group) for group in result["byLength"]]
    lines += [_line(f"{group['speed']:g} m/s", group) for group in result["bySpeed"]]
    return "\n".join(lines + [f"note: {note}" for note in result["notes"]])


def _line(name: str, group: dict[str, Any]) -> str:
    if not group["count"]:
        return f"{name:>12}  {0:>6}  {'–':>9}  {'–':>11}"
    translation, turn = group["translationPercent"], group["rotationDegPerM"]
    return f"{name:>12}  {group['count']:>6}  {translation:>9.4f}  {turn:>11.6f}"
