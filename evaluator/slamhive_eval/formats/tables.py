# SPDX-License-Identifier: Apache-2.0
"""Plain tables with named columns, as spreadsheets, ``rostopic echo -p`` and pandas write them.

Columns are known by their names: ``timestamp``, ``x`` or ``pose.position.x`` or ``p_RS_R_x [m]``, ``qw`` or
``orientation.w``, ``yaw_deg``. Others, numbers or not, are passed over. A table without z is flat, one
without orientation is of bare positions.
"""

from __future__ import annotations

import csv
import itertools
import re
import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import FileError
from slamhive_eval.formats import covariances
from slamhive_eval.formats.textfiles import DECIMAL_COMMA, has_decimal_comma, lines_of, shorten, words_of

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive_eval.rotation import FloatArray

T = TypeVar("T")

_POSITION = {"p", "pos", "position", "t", "trans", "translation", "pose", "point", "xyz", "location"}
_ORIENTATION = {"q", "quat", "quaternion", "orientation", "rot", "rotation", "ori"}
_OTHER = {
    *(
        "v",
        "vel",
        "velocity",
        "twist",
        "linear",
        "angular",
        "acc",
        "acceleration",
        "accel",
        "b",
        "bias",
        "gyro",
    ),
    *("cov", "covariance", "std", "sigma", "gravity"),
}
_COMPACT = re.compile(rf"({'|'.join(sorted(_POSITION | _ORIENTATION | {'o'}))})([xyzw])")
_TIMES = ("stamp", "timestamp", "time", "t", "stamps", "timestamps", "times")
_SECONDS, _NANOSECONDS = ("sec", "secs"), ("nsec", "nsecs", "nanosec", "nanosecs")
_ANGLES = {"roll": "roll", "pitch": "pitch", "yaw": "yaw", "theta": "yaw", "heading": "yaw"}
_UNITS = {
    **dict.fromkeys(("ns", "nanosecond", "nanoseconds", *_NANOSECONDS), 1e9),
    **dict.fromkeys(("us", "µs", "\u03bcs", "microsecond", "microseconds", "usec", "usecs"), 1e6),
    **dict.fromkeys(("ms", "millisecond", "milliseconds", "msec", "msecs"), 1e3),
    **dict.fromkeys(("s", "second", "seconds", *_SECONDS), 1.0),
}
_UNSAID = ("", "utc", "unix", "epoch")
_LENGTHS = {
    **dict.fromkeys(("", "m", "meter", "meters", "metre", "metres"), 1.0),
    "km": 1e3,
    "cm": 1e-2,
    "mm": 1e-3,
}
_ANGLE_UNITS = {
    **dict.fromkeys(("", "rad", "radian", "radians"), False),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), True),
}
"""Angles by their unit: whether they are degrees."""
_UNNAMED_QUATERNION = re.compile(r"(q|quat|quaternion|orientation)[^a-z0-9]*[0-3ijkr][^a-z0-9]*")
_PROSE = {"and", "are", "as", "at", "by", "for", "from", "in", "is", "of", "on", "the", "then", "to", "with"}
"""Words of remarks, which name no columns."""
_LARGEST_UNNAMED_ANGLE = 6.5


class Rows(NamedTuple):
    """Poses from the rows of a table, not checked yet.

    Attributes:
        stamps: In s, shape (n,).
        positions: In m, shape (n, 3).
        quaternions: xyzw, shape (n, 4); 0 0 0 1 where there are no orientations.
        oriented: Whether there are.
        covariances: As in Trajectory; None without columns of them.
    """

    stamps: FloatArray
    positions: FloatArray
    quaternions: FloatArray
    oriented: bool
    covariances: FloatArray | None


@dataclass(frozen=True)
class Header:
    """The line that names a table's columns.

    Attributes:
        line: Its number, from 1.
        delimiter: What separates columns; None for white space.
        columns: Column of each field that is known: time, or sec and nsec; x, y, z; qx to qw; roll, pitch,
            yaw.
        units: Of time and of angles where the names state them.
        count: Number of all columns.
        covariance: Column of each known entry of the covariance.
        covariance_of_body: Whether those of the rotation are about the body's axes.
        unnamed: Names of columns that are parts of a quaternion but don't say which, as ``q0`` and ``q[0]``.
    """

    line: int
    delimiter: str | None
    columns: dict[str, int]
    units: dict[str, str]
    count: int
    covariance: dict[covariances.Entry, int] = field(default_factory=dict)
    covariance_of_body: bool = False
    unnamed: tuple[str, ...] = ()

    @property
    def is_trajectory(self) -> bool:
        """True if the columns contain a time and a position."""
        return ("time" in self.columns or "sec" in self.columns) and {"x", "y"} <= self.columns.keys()

    def is_usual(self, order: tuple[str, ...], per_second: float) -> bool:
        """Tell whether the first columns are these fields, in m and such a part of a second."""
        fields = {k: name for name, k in self.columns.items()}
        time = self.units.get("time", "")
        return (
            tuple(fields.get(k, "") for k in range(len(order))) == order
            and (time in _UNSAID or _UNITS.get(time) == per_second)
            and all(_LENGTHS.get(self.units.get(axis, "")) == 1.0 for axis in "xyz")
        )


def find_header(path: str | Path, text: str, first: str | None = None) -> Header | None:
    """The names of a table's columns, in a comment (# or %) above the data or in the line without one.

    Args:
        path: Named in errors.
        text: The beginning of the file.
        first: The first line without a comment where that one holds numbers, not names; None where it
            doesn't.

    Returns:
        The header, None where no such line holds names of a time and a position.

    Raises:
        FileError: Two columns could be the same, or the time has no name beside those of poses.
    """
    for number, line in enumerate(lines_of(text), start=1):
        content = line.strip().lstrip("#%/ \t")
        comment = line.lstrip().startswith(("#", "%", "//"))
        if not content:
            continue
        if not comment and first is not None:
            return None
        header = _header(path, number, content, first, comment=comment)
        if header is not None or not comment:
            return header
    return None


def _header(
    path: str | Path, number: int, content: str, first: str | None, *, comment: bool
) -> Header | None:
    """The header that a line is; None where it is a remark, or names no time and position."""
    delimiter = next((one for one in ",;\t" if one in content), None)
    # Where spaces are between names, one before a bracket is none: "x [mm] y [mm]".
    names = cells(content, delimiter) if delimiter else re.sub(r"\s+(?=[\[(])", "", content).split()
    if comment and _PROSE.intersection(content.lower().split()):
        return None
    columns, units, clash = _columns(names)
    if first is not None:
        # Numbers may be separated otherwise than the names in a comment above them.
        delimiter = next((one for one in ",;" if one in first), None)
        if len(names) not in {len(words_of(first)), len(cells(first, delimiter)) if delimiter else 0}:
            return None
        if {"x", "y", "qw"} <= columns.keys() and not {"time", "sec", 0} & {*columns, *columns.values()}:
            columns["time"] = 0  # whatever it is called
    entries, of_body = covariances.find_columns(names)
    if clash and comment:
        return None  # a remark, not the names of columns
    if clash:
        raise FileError(path, clash, number)
    unnamed = tuple(one for one in names if _UNNAMED_QUATERNION.fullmatch(one.strip("\"' ").lower()))
    header = Header(number, delimiter, columns, units, len(names), entries, of_body, unnamed)
    if {"x", "y", "qw"} <= columns.keys() and not header.is_trajectory:
        raise FileError(path, "no column is named time, as timestamp, time, t or sec are", number)
    return header if header.is_trajectory else None


def read_table(path: str | Path, text: str, header: Header) -> Rows:
    """Numbers of the columns that a header names.

    Raises:
        FileError: No lines, one with too few columns or no number in one, some but not all parts of a
            quaternion, or angles whose unit isn't known.
    """
    fields = list(header.columns)
    index = [header.columns[name] for name in fields] + list(header.covariance.values())
    lines = list(itertools.islice(lines_of(text), header.line, None))
    if header.delimiter == "," and lines and has_decimal_comma(lines[0], header.count):
        # Columns by their number would be read all the same, each of another column's halves.
        raise FileError(path, DECIMAL_COMMA, header.line + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            numbers: FloatArray = np.loadtxt(
                lines, delimiter=header.delimiter, usecols=index, ndmin=2, quotechar='"'
            )
    except ValueError:
        shown = [*fields, *(f"covariance {row + 1}, {column + 1}" for row, column in header.covariance)]
        numbers = _line_by_line(path, lines, header, dict(zip(shown, index, strict=True)))
    if not len(numbers):
        raise FileError(path, "holds no poses: there is nothing below the names of the columns")
    table = dict(zip(fields, numbers.T, strict=False))
    zero = np.zeros(len(numbers))
    lengths = [_unit(path, header, axis, _LENGTHS) for axis in "xyz"]
    positions = np.column_stack((table["x"], table["y"], table.get("z", zero))) * lengths
    quaternions = _quaternions(path, header, table, len(numbers))
    known = None
    if header.covariance:
        entries = dict(zip(header.covariance, numbers.T[len(fields) :], strict=True))
        known = covariances.assemble(entries, quaternions, of_body=header.covariance_of_body)
    oriented = quaternions is not None
    if quaternions is None:
        quaternions = np.tile((0.0, 0.0, 0.0, 1.0), (len(numbers), 1))
    return Rows(_stamps(path, table, header), positions, quaternions, oriented, known)


def cells(line: str, delimiter: str) -> list[str]:
    """Cells of a line, which quotes may enclose; one of endless cells is cut at its delimiters alone."""
    try:
        return next(csv.reader([line], delimiter=delimiter))
    except csv.Error:
        return line.split(delimiter)


def _columns(names: list[str]) -> tuple[dict[str, int], dict[str, str], str]:
    """Column and unit of each field, and what is wrong where two columns are the same."""
    columns: dict[str, int] = {}
    units: dict[str, str] = {}
    for k, name in enumerate(names):
        tokens, unit = _tokens(name)
        field = _field(tokens)
        if field in columns:
            which = f"{names[columns[field]].strip()!r} and {name.strip()!r}"
            return {}, {}, f"the columns {which} could both be {field}; leave one"
        if field:
            columns[field], units[field] = k, unit
    stamped = [one for one in _TIMES if one in columns]
    if stamped:
        chosen = columns[stamped[0]], units[stamped[0]]
        for name in stamped:
            del columns[name]
        columns["time"], units["time"] = chosen
    return columns, units, ""


def _tokens(name: str) -> tuple[list[str], str]:
    """The words in a column's name, in lower case, and the unit."""
    lowered = name.strip().strip("\"'").lower()
    bracket = re.search(r"[\[(]\s*([^\])]*?)\s*[\])]", lowered)
    tokens = [one for one in re.split(r"[^a-zµ0-9]+", re.sub(r"[\[(].*", "", lowered)) if one]
    if bracket:
        return tokens, bracket.group(1)
    # The seconds of a ROS stamp, stamp.sec and stamp.nanosec, are fields, not units.
    is_field = bool(tokens) and tokens[-1] in _SECONDS + _NANOSECONDS and "stamp" in tokens
    if len(tokens) > 1 and tokens[-1] in {*_UNITS, *_LENGTHS, *_ANGLE_UNITS} and not is_field:
        return tokens[:-1], tokens[-1]
    return tokens, ""


def _field(tokens: list[str]) -> str | None:
    """Return the field that a column stands for, by the words of its name; None for no known one."""
    if not tokens or _OTHER.intersection(tokens[:-1]):
        return None
    last, before = tokens[-1], set(tokens[:-1])
    compact = _COMPACT.fullmatch(last)
    if compact:
        before, last = {"q" if compact.group(1) in {*_ORIENTATION, "o"} else "p"}, compact.group(2)
    if last in ("x", "y", "z", "w") and before & _ORIENTATION:
        return f"q{last}"
    if last in ("x", "y", "z") and (not before or before & _POSITION):
        return last
    alone = dict.fromkeys(_SECONDS, "sec") | dict.fromkeys(_NANOSECONDS, "nsec") | _ANGLES
    return last if last in _TIMES else alone.get(last)


def _unit(path: str | Path, header: Header, name: str, known: dict[str, T]) -> T:
    """Meaning of the unit that the name of a column states.

    Raises:
        FileError: It is none that is known.
    """
    unit = header.units.get(name, "")
    if unit not in known:
        allowed = ", ".join(one for one in known if one)
        raise FileError(path, f"the unit {unit!r} of {name} isn't known; known: {allowed}", header.line)
    return known[unit]


def _stamps(path: str | Path, table: dict[str, FloatArray], header: Header) -> FloatArray:
    if "sec" in table:
        return table["sec"] + table.get("nsec", np.zeros(len(table["sec"]))) / 1e9
    stamps = table["time"]
    if header.units.get("time", "") not in _UNSAID:
        return stamps / _unit(path, header, "time", _UNITS)
    # Unix time: 1e9 s, 1e12 ms, 1e15 µs, 1e18 ns.
    finite = stamps[np.isfinite(stamps)]
    largest = np.abs(finite).max(initial=0.0)
    for limit, factor in ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3)):
        if largest > limit:
            return stamps / factor
    return stamps


def _quaternions(path: str | Path, header: Header, table: dict[str, FloatArray], n: int) -> FloatArray | None:
    parts = [name for name in ("qx", "qy", "qz", "qw") if name in table]
    if len(parts) == 4:
        return np.column_stack([table[name] for name in parts])
    if parts:
        raise FileError(path, f"has the columns {', '.join(parts)} of qx, qy, qz, qw only", header.line)
    if header.unnamed:
        told = f"the columns {', '.join(map(repr, header.unnamed))} don't say which part of a quaternion"
        raise FileError(path, f"{told} they are; name them qx, qy, qz, qw", header.line)
    angles = [name for name in ("roll", "pitch", "yaw") if name in table]
    if not angles:
        return None
    rpy = np.zeros((n, 3))
    for name in angles:
        unit = header.units.get(name, "")
        degrees = _unit(path, header, name, _ANGLE_UNITS)
        values = table[name]
        if not unit and np.abs(values).max() > _LARGEST_UNNAMED_ANGLE:
            raise FileError(
                path,
                f"the angles of {name} have no unit; name the column {name}_deg or {name}_rad",
                header.line,
            )
        rpy[:, ("roll", "pitch", "yaw").index(name)] = np.deg2rad(values) if degrees else values
    return rotation.from_roll_pitch_yaw(rpy)


def _line_by_line(path: str | Path, lines: list[str], header: Header, columns: dict[str, int]) -> FloatArray:
    rows = []
    for number, line in enumerate(lines, start=header.line + 1):
        content = line.split("#", 1)[0].strip()
        if not content:
            continue
        words = cells(content, header.delimiter) if header.delimiter else content.split()
        row = []
        for name, column in columns.items():
            if column >= len(words):
                raise FileError(path, f"found {len(words)} of {header.count} columns", number)
            word = words[column].strip()
            try:
                row.append(float(word))
            except ValueError:
                hint = f"; {DECIMAL_COMMA}" if has_decimal_comma(word) else ""
                told = f"{shorten(word)} in the column of {name} is no number{hint}"
                raise FileError(path, told, number) from None
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(-1, len(columns))
