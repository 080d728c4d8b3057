# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval explain``: what is wrong with a pair of trajectories, and the flag that undoes it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.association import equal_stamps_notes
from slamhive_eval.commands import measuring, output
from slamhive_eval.errors import FileError
from slamhive_eval.measures.explaining import Explained, explain, times

if TYPE_CHECKING:
    import argparse


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Try what is often wrong with a pair of trajectories: clocks, inverse poses, the order of "
        "quaternions, turns and lever arms between the frames, scale. What makes it fit is named, with the "
        "flag of ape and rpe that undoes it."
    )
    parser.epilog = "Example: slamhive-eval explain groundtruth.txt trajectory.txt"
    parser.add_argument("reference", metavar="GT", help="ground truth; formats as for ape")
    parser.add_argument("estimates", metavar="EST", nargs="+", help="estimated trajectories")
    measuring.add_reading(parser)
    parser.add_argument(
        "--write-extrinsic", metavar="FILE", help="write the pose of EST's frame in the body, for --extrinsic"
    )
    output.add_json(parser)


def run(asked: argparse.Namespace) -> int:
    """Explain and print."""
    reference = measuring.read_reference(asked)
    results = []
    for name in asked.estimates:
        estimate = measuring.read_estimate(asked, name, reference)
        found = explain(reference, estimate)
        if asked.write_extrinsic is not None:
            _write(Path(asked.write_extrinsic), found)
        notes = [*estimate.notes, *equal_stamps_notes(estimate)]
        notes += [f"ground truth: {note}" for note in reference.notes]
        results.append({"estimate": name, **found.as_dict(), "notes": notes})
    result = results[0] if len(results) == 1 else {"results": results}
    output.emit(asked, result, lambda _: "\n\n".join(map(_show, results)))
    return 0


def _write(path: Path, found: Explained) -> None:
    try:
        np.savetxt(path, found.extrinsic, fmt="%.12g")
    except OSError as error:
        raise FileError(path, f"can't be written: {error.strerror or error}") from error


def _show(result: dict[str, Any]) -> str:
    lines = [f"{result['estimate']}: {_fit(result['before'])}"]
    for number, fault in enumerate(result["faults"], start=1):
        if math.isfinite(fault["better"]):
            lines.append(
                f"{number}. fits {times(fault['better'])} better if {fault['message']}: {fault['flag']}"
            )
        else:
            lines.append(f"{number}. fits only if {fault['message']}: {fault['flag']}")
    if result["faults"]:
        lines.append(f"with {'it' if len(result['faults']) == 1 else 'all'} undone: {_fit(result['after'])}")
    else:
        lines.append("nothing found: no fault that is known here makes it fit better")
    return "\n".join(lines + [f"note: {note}" for note in result["notes"]])


def _fit(fit: dict[str, Any] | None) -> str:
    if fit is None:
        return "no poses belong together"
    turned = "" if fit["rotationDeg"] is None else f" and {fit['rotationDeg']:.3f}°"
    return f"{fit['position']:.4f} m{turned} are left (rms of {fit['pairs']} poses, aligned)"
