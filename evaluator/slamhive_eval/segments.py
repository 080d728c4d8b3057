# SPDX-License-Identifier: Apache-2.0
"""``segments.csv``: when an algorithm tracked without a break, in which of its maps.

::

    start,end,map,reason
    1403636580.86,1403636601.31,0,start
    1403636603.76,1403636644.91,1,lost
    1403636645.06,1403636659.21,0,merged

A line is a time in s, both ends included, in which poses follow one another. Pieces with the same map share a
frame. ``reason`` says why the piece began. ``map`` and ``reason`` may be left out: then each piece is a map.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval.errors import FileError, TrajectoryError
from slamhive_eval.textfiles import data_lines, decode, is_number, read_bytes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive_eval.rotation import IndexArray
    from slamhive_eval.trajectory import Trajectory

NAME = "segments.csv"
COLUMNS = ("start", "end", "map", "reason")
OUTSIDE = -1
"""Number of a pose that no segment holds."""


@dataclass(frozen=True)
class Piece:
    """A time without a break.

    Attributes:
        start: Of its first pose in s.
        end: Of its last pose in s.
        map: Name of the map its poses are in.
        reason: Why it began; empty where that isn't said.
    """

    start: float
    end: float
    map: str
    reason: str = ""


def read_segments(path: str | Path) -> list[Piece]:
    """Read a ``segments.csv``, plain or compressed.

    Raises:
        FileError: The file can't be read or is empty, its first line lacks ``start`` and ``end``, or a line
            is no piece or begins before the one above it has ended.
    """
    lines = list(data_lines(decode(read_bytes(path))))
    if not lines:
        raise FileError(path, f"is empty; its first line names the columns: {','.join(COLUMNS)}")
    number, first = lines[0]
    names = [name.strip().strip('"').lower() for name in first.split(",")]
    if not {"start", "end"} <= set(names) or len(set(names)) < len(names):
        raise FileError(path, f"the first line must name the columns, as in {','.join(COLUMNS)}", number)
    pieces: list[Piece] = []
    for number, content in lines[1:]:
        words = [word.strip() for word in next(csv.reader([content]))]
        if len(words) != len(names):
            raise FileError(path, f"found {len(words)} of {len(names)} columns", number)
        pieces.append(_piece(path, number, dict(zip(names, words, strict=True)), len(pieces)))
        if len(pieces) > 1 and pieces[-1].start < pieces[-2].end:
            raise FileError(path, "a segment begins before the one above it has ended", number)
    if not pieces:
        raise FileError(path, "holds no segments")
    return pieces


def beside(estimate: str | Path) -> Path | None:
    """The ``segments.csv`` in the folder of an estimate, where there is one."""
    path = Path(estimate).parent / NAME
    return path if path.is_file() else None


def number_poses(estimate: Trajectory, pieces: Sequence[Piece]) -> tuple[IndexArray, list[str]]:
    """The map that each pose is in.

    Args:
        estimate: n poses.
        pieces: Ascending in time, apart from one another.

    Returns:
        Number of each pose's map, shape (n,), −1 for poses outside of all pieces; and the maps' names by
        number.

    Raises:
        TrajectoryError: No pose is inside.
    """
    maps = list(dict.fromkeys(piece.map for piece in pieces))
    starts = np.array([piece.start for piece in pieces])
    ends = np.array([piece.end for piece in pieces])
    which = np.searchsorted(starts, estimate.stamps, side="right") - 1
    inside = (which >= 0) & (estimate.stamps <= ends[np.maximum(which, 0)])
    if not inside.any():
        raise TrajectoryError(
            f"none of the poses, {estimate.stamps[0]:.3f} s to {estimate.stamps[-1]:.3f} s, is in a segment; "
            f"those are from {starts[0]:.3f} s to {ends[-1]:.3f} s"
        )
    numbers = np.array([maps.index(piece.map) for piece in pieces], dtype=np.intp)
    return np.where(inside, numbers[np.maximum(which, 0)], OUTSIDE), maps


def _piece(path: str | Path, number: int, words: dict[str, str], count: int) -> Piece:
    for name in ("start", "end"):
        if not is_number(words[name]) or not np.isfinite(float(words[name])):
            raise FileError(path, f"{name} is {words[name][:30]!r}, which is no time in seconds", number)
    start, end = float(words["start"]), float(words["end"])
    if end < start:
        raise FileError(path, f"ends at {end:.3f} s before it starts at {start:.3f} s", number)
    return Piece(start, end, words.get("map") or f"piece {count}", words.get("reason", ""))
