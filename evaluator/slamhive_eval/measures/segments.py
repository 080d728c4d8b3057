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
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.errors import FileError, TrajectoryError
from slamhive_eval.formats.textfiles import data_lines, decode, is_number, read_bytes
from slamhive_eval.measures.support import evaluate_segments

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive_eval.evaluation import Options
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
    """The ``segments.csv`` in the folder of an estimate, FILE or FILE:TOPIC, where there is one."""
    file = Path(estimate)
    path = (file if file.exists() else Path(str(estimate).split(":", 1)[0])).parent / NAME
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
    by_name = {name: number for number, name in enumerate(maps)}
    numbers = np.array([by_name[piece.map] for piece in pieces], dtype=np.intp)
    return np.where(inside, numbers[np.maximum(which, 0)], OUTSIDE), maps


def evaluate_pieces(
    reference: Trajectory,
    estimate: Trajectory,
    pieces: Sequence[Piece],
    options: Options | None = None,
    *,
    most: int | None = None,
) -> dict[str, Any]:
    """Measure an estimate map by map, see `slamhive_eval.evaluate_segments`.

    Args:
        reference: Ground truth.
        estimate: What an algorithm wrote.
        pieces: What its ``segments.csv`` says; poses outside of them are counted and left out.
        options: How to evaluate.
        most: Measure so many maps, those over the longest paths; None for all.

    Returns:
        Plain JSON data: `SegmentedEvaluation.as_dict`, each segment with its ``map`` and ``reason``, and
        ``posesOutside``.

    Raises:
        OptionError: Options that aren't allowed.
        TrajectoryError: No pose is in a piece.
    """
    numbers, maps = number_poses(estimate, pieces)
    reasons = {piece.map: piece.reason for piece in reversed(pieces)}
    kept = np.flatnonzero(numbers != OUTSIDE)
    found = evaluate_segments(reference, estimate.select(kept), numbers[kept], options, most=most).as_dict()
    for one in found["segments"]:
        one["map"] = maps[one["segment"]]
        one["reason"] = reasons[one["map"]]
    return {**found, "posesOutside": len(estimate) - len(kept)}


def _piece(path: str | Path, number: int, words: dict[str, str], count: int) -> Piece:
    for name in ("start", "end"):
        if not is_number(words[name]) or not np.isfinite(float(words[name])):
            raise FileError(path, f"{name} is {words[name][:30]!r}, which is no time in seconds", number)
    start, end = float(words["start"]), float(words["end"])
    if end < start:
        raise FileError(path, f"ends at {end:.3f} s before it starts at {start:.3f} s", number)
    return Piece(start, end, words.get("map") or f"piece {count}", words.get("reason", ""))
