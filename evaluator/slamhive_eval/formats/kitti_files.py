# SPDX-License-Identifier: Apache-2.0
"""Files of KITTI poses, a matrix a line, perhaps after its frame index; which lines of two belong together.

The benchmark's files have 12 numbers a line, and line k (from 0) is frame k. kitti-odom-eval and DF-VO write
13, the frame index first, so that frames may be missing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import FileError
from slamhive_eval.formats.textfiles import (
    data_lines,
    decode,
    fault_in_row,
    head,
    known_rows,
    parse_table,
    read_bytes,
    words_of,
)
from slamhive_eval.trajectory import LARGEST_METRES, LARGEST_STAMP_SECONDS, Fault, Trajectory, find_fault

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive_eval.rotation import FloatArray, IndexArray

COLUMNS = 12
MEANING = "the 3×4 pose matrix row by row"
_MEANING_INDEXED = f"the frame index and {MEANING}"


def parse_poses(
    path: str | Path,
    data: bytes,
    times: str | Path | None = None,
    *,
    sort: bool = False,
    by_index: bool = False,
) -> Trajectory:
    """The poses of a text.

    Args:
        path: Named in errors.
        data: The whole text, see read_bytes.
        times: File with the stamp of frame k in its line k, in s; None for frames as stamps.
        sort: Whether to sort poses by a frame index that decreases.
        by_index: Whether poses and stamps may differ in number: then what both have is taken, with a note.

    Returns:
        The poses in the order of their frames.

    Raises:
        FileError: A line that holds no pose or no frame index, or stamps that don't belong to the poses.
    """
    first = next(data_lines(head(data)), None)
    indexed = first is not None and len(words_of(first[1])) == COLUMNS + 1
    table = parse_table(path, data, COLUMNS + indexed, _MEANING_INDEXED if indexed else MEANING)
    known = known_rows(path, table[:, -COLUMNS:])
    _check_rows(path, data, table[:, -COLUMNS:], known.rows)
    order = np.arange(len(table))
    frames = table[:, 0] if indexed else order.astype(np.float64)
    if indexed:
        order = _order(path, data, frames, sort=sort)
    stamps, notes, matrices = frames[order], known.notes, table[order, -COLUMNS:].reshape(-1, 3, 4)
    if times is not None:
        stamps, unequal = _stamps(path, data, stamps, order, times, indexed=indexed, by_index=by_index)
        notes += unequal
        matrices = matrices[: len(stamps)]
    if known.left_out:
        kept = ~np.isnan(matrices).any(axis=(1, 2))
        stamps, matrices, indexed = stamps[kept], matrices[kept], True  # its lines aren't its poses any more
    rotations = matrices[:, :, :3]
    return Trajectory(
        stamps,
        matrices[:, :, 3],
        rotation.from_matrix(rotations),
        rotations=rotations,
        stamped_by="time" if times is not None else "frame" if indexed else "line",
        notes=notes,
        nan_rows=known.left_out,
    )


def check_pair(
    reference: Trajectory,
    estimate: Trajectory,
    reference_path: str | Path,
    path: str | Path,
    *,
    by_index: bool = False,
) -> Trajectory:
    """An estimate whose frames are those of the ground truth, where both are KITTI poses without times.

    Lines are frames only where both files have a line for each. A file that gives its frames may lack some.

    Args:
        reference: Ground truth, all of it.
        estimate: As it was read.
        reference_path: Of the ground truth, for errors.
        path: Of the estimate.
        by_index: Whether to pair them as far as both go, whatever their numbers.

    Returns:
        The estimate, with a note where it was paired as far as both go.

    Raises:
        FileError: Another number of lines, or a frame beyond the ground truth's.
    """
    last, true_last = float(estimate.stamps[-1]), float(reference.stamps[-1])
    stamped = "time" in (reference.stamped_by, estimate.stamped_by)
    if stamped or last == true_last or (last < true_last and estimate.stamped_by == "frame"):
        return estimate
    counts = f"has {_count(estimate)} and the ground truth {reference_path} {_count(reference)}"
    if by_index:
        return estimate.noted(f"{path} {counts}: they were paired by index as far as both go")
    if estimate.stamped_by == "frame":
        frame = float(estimate.stamps[np.searchsorted(estimate.stamps, true_last, side="right")])
        message = f"there is no frame {frame:.0f} in the ground truth {reference_path}, which ends with frame"
        raise FileError(path, f"{message} {true_last:.0f} (the first is 0)", _line_of(path, frame))
    raise FileError(
        path,
        f"{counts}, so that line k of one need not be line k of the other: write the frame index before the "
        "12 numbers of each line, or pair them by index as far as both go with --by-index",
    )


def _count(trajectory: Trajectory) -> str:
    frames = f" up to frame {trajectory.stamps[-1]:.0f}" if trajectory.stamped_by == "frame" else ""
    return f"{len(trajectory)} pose{'' if len(trajectory) == 1 else 's'}{frames}"


def _line_of(path: str | Path, frame: float) -> int | None:
    """Number of the line that gives a frame; None where the file can't be read again, as a pipe."""
    lines = data_lines(decode(read_bytes(path)))
    return next((number for number, text in lines if float(words_of(text)[0]) == frame), None)


def check_matrices(table: FloatArray) -> Fault | None:
    """The first row of twelve numbers that is no pose, or None; shape (n, 12)."""
    bad = np.flatnonzero(~(np.abs(table) <= LARGEST_METRES).all(axis=1))
    if bad.size:
        return Fault(int(bad[0]), "every value must be a finite number")
    rotations = np.clip(table.reshape(-1, 3, 4)[:, :, :3], -2.0, 2.0)  # no rotation either way, no overflow
    gram = np.einsum("nij,nkj->nik", rotations, rotations)
    wrong = (np.abs(gram - np.eye(3)).max(axis=(1, 2)) > 1e-2) | (np.linalg.det(rotations) < 0)
    bad = np.flatnonzero(wrong)
    if bad.size:
        return Fault(int(bad[0]), "the left 3×3 part is no rotation (orthonormal, determinant 1)")
    return None


def _check_rows(path: str | Path, data: bytes, table: FloatArray, rows: IndexArray) -> None:
    fault = check_matrices(table[rows])
    if fault is not None:
        raise fault_in_row(path, data, int(rows[fault.row]), fault.message)


def _order(path: str | Path, data: bytes, frames: FloatArray, *, sort: bool) -> IndexArray:
    """The rows in the order of their checked frame indices, shape (n,)."""
    bad = np.flatnonzero(~((frames >= 0) & (frames <= LARGEST_STAMP_SECONDS) & (frames == np.floor(frames))))
    if bad.size:
        message = f"the frame index is {frames[bad[0]]:g}; it must be a whole number from 0"
        raise fault_in_row(path, data, int(bad[0]), message)
    order = np.argsort(frames, kind="stable") if sort else np.arange(len(frames))
    bad = np.flatnonzero(np.diff(frames[order]) <= 0)
    if bad.size:
        before, row = (int(order[bad[0] + k]) for k in (0, 1))
        message = f"frame {frames[row]:.0f} is there twice"
        if frames[row] < frames[before]:
            message = f"frame {frames[row]:.0f} comes after frame {frames[before]:.0f}; frames must ascend"
        raise fault_in_row(path, data, row, message)
    return order


def _stamps(
    path: str | Path,
    data: bytes,
    frames: FloatArray,
    order: IndexArray,
    times: str | Path,
    *,
    indexed: bool,
    by_index: bool,
) -> tuple[FloatArray, tuple[str, ...]]:
    """Times of the poses in s, of as many from the first as have one, and a note where these aren't all."""
    text = read_bytes(times)
    clock = parse_table(times, text, 1, "one time stamp in seconds")[:, 0]
    inside = int(np.searchsorted(frames, len(clock)))
    unequal = inside < len(frames) if indexed else len(clock) != len(frames)
    if unequal and not (by_index and inside):
        if not indexed:
            raise FileError(
                times,
                f"has {len(clock)} stamps for the {len(frames)} poses of {path}; there must be as many, "
                "unless each pose has its frame index before the 12 numbers",
            )
        message = f"frame {frames[inside]:.0f} has no stamp; {times} has {len(clock)}, from frame 0 on"
        raise fault_in_row(path, data, int(order[inside]), message)
    fault = find_fault(clock, np.zeros((len(clock), 3)), np.ones((len(clock), 4)))
    if fault is not None:
        raise fault_in_row(times, text, fault.row, fault.message)
    counts = f"{path} has {len(frames)} poses and {times} {len(clock)} stamps"
    notes = (f"{counts}: they were paired by index as far as both go",) if unequal else ()
    return clock[frames[:inside].astype(np.intp)], notes
