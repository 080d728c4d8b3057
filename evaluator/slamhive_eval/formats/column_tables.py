# SPDX-License-Identifier: Apache-2.0
"""Reader of tables whose columns are known beforehand; every reference in a table comes through it.

`slamhive_eval.formats.tables` reads those that name their columns themselves.
"""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import FileError, NoPosesError, OptionError
from slamhive_eval.formats.columns import ANGLES, MATRIX_COLUMNS, POSITION, QUATERNION
from slamhive_eval.formats.kitti_files import check_matrices
from slamhive_eval.formats.tables import cells
from slamhive_eval.formats.textfiles import (
    DECIMAL_COMMA,
    decode,
    has_decimal_comma,
    is_number,
    known_rows,
    lines_of,
    parse_table,
    read_bytes,
    shorten,
)
from slamhive_eval.trajectory import Trajectory, find_fault

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from slamhive_eval.formats.columns import TableFormat
    from slamhive_eval.rotation import FloatArray, IndexArray

_EXPONENTS = {"s": 0, "ms": -3, "us": -6, "ns": -9}
_LARGEST_ANGLE = 6.5
_NO_ROTATION = (0.0, 0.0, 0.0, 1.0)


def read_columns(path: str | Path, form: TableFormat, times: str | Path | None = None) -> Trajectory:
    """Read a table whose columns are known, plain or compressed.

    Stamps are exact: each is the float64 nearest to what is written, whether in s, in ns or as sec and nsec.

    Args:
        path: The file.
        form: What its columns mean.
        times: For frames: the file with the stamp of frame k in its line k, in s.

    Returns:
        The poses, or positions alone where no column is a rotation. Rows that hold NaN are left out.

    Raises:
        FileError: It is missing, empty, no text, or wrong in the line named.
        OptionError: Frames, but neither ``times`` nor a rate.
    """
    if form.by_frames and form.rate is None and times is None:
        raise OptionError("the columns have no time: name t or sec, or give the rate or the times of frames")
    rows = list(_rows(path, decode(read_bytes(path)), form))
    if not rows:
        raise NoPosesError(path)
    stamps = _stamps(path, rows, form, times)
    numbers = _numbers(path, rows, form)
    known = known_rows(path, stamps, *numbers.values())
    if known.left_out:
        rows = [rows[k] for k in known.rows]
        numbers, stamps = {name: one[known.rows] for name, one in numbers.items()}, stamps[known.rows]
    made = _trajectory(path, rows, numbers, stamps, form)
    if known.left_out:
        made = replace(made, notes=known.notes, nan_rows=known.left_out)
    return made.select(_kept(made.stamps, form.min_interval)) if form.min_interval else made


class _Row(NamedTuple):
    """The words of a line, and its number from 1."""

    number: int
    words: list[str]


def _rows(path: str | Path, text: str, form: TableFormat) -> Iterator[_Row]:
    """Lines with data, cut into columns.

    Raises:
        FileError: A line with too few columns.
    """
    width = form.width
    delimiter = form.delimiter
    for number, line in enumerate(lines_of(text), start=1):
        content = line.split("#", 1)[0].strip() if number > form.skip else ""
        if not content:
            continue
        if delimiter is None:
            delimiter = next((one for one in ";,\t" if one in content), " ")
        words = content.split() if delimiter == " " else _cut(content, delimiter)
        if len(words) < width:
            raise FileError(
                path, f"found {len(words)} columns of the {width} that {', '.join(form.columns)} need", number
            )
        yield _Row(number, words)


def _cut(content: str, delimiter: str) -> list[str]:
    words = cells(content, delimiter) if '"' in content else content.split(delimiter)
    return [word.strip() for word in words]


def _numbers(path: str | Path, rows: list[_Row], form: TableFormat) -> dict[str, FloatArray]:
    """Position and rotation by column, shape (n,) each; ``matrix`` of shape (n, 12)."""
    found: dict[str, FloatArray] = {}
    for name, place in form.places.items():
        if name in ("t", "sec", "nsec", "frame"):
            continue
        width = MATRIX_COLUMNS if name == "matrix" else 1
        try:
            table = np.array([row.words[place : place + width] for row in rows], dtype=np.float64)
        except ValueError:
            raise _no_number(path, rows, form, name, range(place, place + width)) from None
        found[name] = table if width > 1 else table[:, 0]
    return found


def _no_number(path: str | Path, rows: list[_Row], form: TableFormat, name: str, places: range) -> FileError:
    """The error for the first word of some columns that is no number."""
    row, word = next((row, row.words[k]) for row in rows for k in places if not is_number(row.words[k]))
    hint = f"; {DECIMAL_COMMA}" if has_decimal_comma(word) else ""
    if row is rows[0] and not hint:
        hint = f"; if the table begins with the names of its columns, skip {form.skip + 1}"
    return FileError(path, f"{shorten(word)} in the column {name} is no number{hint}", row.number)


def _stamps(path: str | Path, rows: list[_Row], form: TableFormat, times: str | Path | None) -> FloatArray:
    if form.by_frames:
        return _stamps_of_frames(path, rows, form, times)
    places = form.places
    column = "t" if "t" in places else "sec"
    exponent = _EXPONENTS[form.time_unit] if column == "t" else 0
    found = _exact(path, rows, form, column, exponent)
    if "nsec" in places:
        rest = _exact(path, rows, form, "nsec", -9)
        found = [whole + part for whole, part in zip(found, rest, strict=True)]
    return np.array([float(one) for one in found])


def _exact(path: str | Path, rows: list[_Row], form: TableFormat, name: str, exponent: int) -> list[Decimal]:
    """Return a column's numbers times a power of ten, as decimals with all digits."""
    place = form.places[name]
    try:
        return [Decimal(row.words[place]).scaleb(exponent) for row in rows]
    except InvalidOperation:
        raise _no_number(path, rows, form, name, range(place, place + 1)) from None


def _stamps_of_frames(
    path: str | Path, rows: list[_Row], form: TableFormat, times: str | Path | None
) -> FloatArray:
    """Times of frames: those of a file, or by the rate."""
    frames = np.arange(len(rows), dtype=np.float64)
    if "frame" in form.places:
        frames = np.array([float(one) for one in _exact(path, rows, form, "frame", 0)])
        bad = np.flatnonzero(~((frames >= 0) & (frames == np.floor(frames)) & (frames < 2.0**53)))
        if bad.size:
            message = f"the frame index is {frames[bad[0]]:g}; it must be a whole number from 0"
            raise FileError(path, message, rows[bad[0]].number)
    if times is None:
        assert form.rate is not None  # noqa: S101 - read_columns has looked
        return form.start_time + frames / form.rate
    clock = parse_table(times, read_bytes(times), 1, "one time stamp in seconds")[:, 0]
    bad = np.flatnonzero(frames >= len(clock))
    if bad.size:
        message = f"frame {frames[bad[0]]:.0f} has no stamp; {times} has {len(clock)}, from frame 0 on"
        raise FileError(path, message, rows[bad[0]].number)
    return clock[frames.astype(np.intp)]


def _trajectory(
    path: str | Path, rows: list[_Row], numbers: dict[str, FloatArray], stamps: FloatArray, form: TableFormat
) -> Trajectory:
    """The checked poses.

    Raises:
        FileError: Something is wrong in the line named.
    """
    rotations = None
    if "matrix" in numbers:
        fault = check_matrices(numbers["matrix"])
        if fault is not None:
            raise FileError(path, fault.message, rows[fault.row].number)
        matrices = numbers["matrix"].reshape(-1, 3, 4)
        positions, rotations = matrices[:, :, 3], matrices[:, :, :3]
        quaternions = rotation.from_matrix(rotations)
    else:
        positions = np.column_stack([numbers[name] for name in POSITION])
        quaternions = _quaternions(path, rows, numbers, form)
    fault = find_fault(stamps, positions, quaternions)
    if fault is not None:
        raise FileError(path, fault.message, rows[fault.row].number)
    if form.rotation == "Inverse" and form.oriented:
        quaternions = rotation.conjugate(quaternions)
        rotations = None if rotations is None else rotations.transpose(0, 2, 1)
    return Trajectory(stamps, positions, quaternions, rotations, oriented=form.oriented)


def _quaternions(
    path: str | Path, rows: list[_Row], numbers: dict[str, FloatArray], form: TableFormat
) -> FloatArray:
    if "qw" in numbers:
        return np.column_stack([numbers[name] for name in QUATERNION])
    if "roll" not in numbers:
        return np.tile(_NO_ROTATION, (len(rows), 1))
    angles = np.column_stack([numbers[name] for name in ANGLES])
    if form.angle_unit == "deg":
        return rotation.from_roll_pitch_yaw(np.deg2rad(angles))
    bad = np.flatnonzero(~(np.abs(angles) <= _LARGEST_ANGLE).all(axis=1))
    if bad.size:
        largest = angles[bad[0]][np.argmax(np.abs(angles[bad[0]]))]
        message = f"an angle of {largest:g} rad is beyond a turn (degrees?)"
        raise FileError(path, message, rows[bad[0]].number)
    return rotation.from_roll_pitch_yaw(angles)


def _kept(stamps: FloatArray, interval: float) -> IndexArray:
    """Indices of the poses that are not too soon after the last one kept."""
    kept = []
    last = -np.inf
    for k, stamp in enumerate(stamps.tolist()):
        # Steps that are the interval itself but for rounding stay.
        if stamp - last >= interval * (1 - 1e-6):
            kept.append(k)
            last = stamp
    return np.array(kept, dtype=np.intp)
