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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import FileError
from slamhive_eval.formats import covariances
from slamhive_eval.formats.textfiles import DECIMAL_COMMA, has_decimal_comma, lines_of

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive_eval.rotation import FloatArray

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
_TIMES = ("stamp", "timestamp", "time", "t", "stamps", "timestamps", "times")
_SECONDS, _NANOSECONDS = ("sec", "secs"), ("nsec", "nsecs", "nanosec", "nanosecs")
_ANGLES = {"roll": "roll", "pitch": "pitch", "yaw": "yaw", "theta": "yaw", "heading": "yaw"}
_UNITS = {
    **dict.fromkeys(("ns", "nanoseconds", "nsec"), 1e9),
    **dict.fromkeys(("us", "µs", "microseconds", "usec"), 1e6),
    **dict.fromkeys(("ms", "milliseconds", "msec"), 1e3),
    **dict.fromkeys(("s", "sec", "seconds"), 1.0),
}
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
    """

    line: int
    delimiter: str | None
    columns: dict[str, int]
    units: dict[str, str]
    count: int
    covariance: dict[covariances.Entry, int] = field(default_factory=dict)
    covariance_of_body: bool = False

    @property
    def is_trajectory(self) -> bool:
        """True if the columns contain a time and a position."""
        return ("time" in self.columns or "sec" in self.columns) and {"x", "y"} <= self.columns.keys()

    @property
    def order(self) -> tuple[str, ...]:
        """The fields of the first eight columns; empty where one of them is of no use."""
        fields = {k: name for name, k in self.columns.items()}
        found = tuple(fields.get(k, "") for k in range(8))
        return found if all(found) else ()


def find_header(path: str | Path, text: str) -> Header | None:
    """The names of a table's columns in the first line that isn't empty; it may begin with # or %.

    Returns:
        The header, None where the line holds no names of a time and a position.

    Raises:
        FileError: Two columns could be the same.
    """
    lines = ((number, line.strip()) for number, line in enumerate(lines_of(text), start=1))
    number, line = next(((number, line) for number, line in lines if line.strip("#% \t")), (0, ""))
    content = line.lstrip("#% \t")
    delimiter = next((one for one in ",;\t" if one in content), None)
    names = next(csv.reader([content], delimiter=delimiter)) if delimiter else content.split()
    columns, units, clash = _columns(names)
    entries, of_body = covariances.find_columns(names)
    if clash and line.startswith("#"):
        return None  # a remark, not the names of columns
    if clash:
        raise FileError(path, clash, number)
    header = Header(number, delimiter, columns, units, len(names), entries, of_body)
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
    positions = np.column_stack((table["x"], table["y"], table.get("z", zero)))
    quaternions = _quaternions(path, header, table, len(numbers))
    known = None
    if header.covariance:
        entries = dict(zip(header.covariance, numbers.T[len(fields) :], strict=True))
        known = covariances.assemble(entries, quaternions, of_body=header.covariance_of_body)
    oriented = quaternions is not None
    if quaternions is None:
        quaternions = np.tile((0.0, 0.0, 0.0, 1.0), (len(numbers), 1))
    return Rows(_stamps(table, header), positions, quaternions, oriented, known)


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
    if len(tokens) > 1 and tokens[-1] in {*_UNITS, "deg", "rad", "degrees", "m"} and not is_field:
        return tokens[:-1], tokens[-1]
    return tokens, ""


def _field(tokens: list[str]) -> str | None:
    """Return the field that a column stands for, by the words of its name; None for no known one."""
    if not tokens or _OTHER.intersection(tokens[:-1]):
        return None
    last, before = tokens[-1], set(tokens[:-1])
    compact = re.fullmatch(r"(p|t|pos|q|quat|o)([xyzw])", last)
    if compact:
        before, last = {"q" if compact.group(1) in ("q", "quat", "o") else "p"}, compact.group(2)
    if last in ("x", "y", "z", "w") and before & _ORIENTATION:
        return f"q{last}"
    if last in ("x", "y", "z") and (not before or before & _POSITION):
        return last
    alone = dict.fromkeys(_SECONDS, "sec") | dict.fromkeys(_NANOSECONDS, "nsec") | _ANGLES
    return last if last in _TIMES else alone.get(last)


def _stamps(table: dict[str, FloatArray], header: Header) -> FloatArray:
    if "sec" in table:
        return table["sec"] + table.get("nsec", np.zeros(len(table["sec"]))) / 1e9
    stamps = table["time"]
    unit = header.units.get("time", "")
    if unit in _UNITS:
        return stamps / _UNITS[unit]
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
    angles = [name for name in ("roll", "pitch", "yaw") if name in table]
    if not angles:
        return None
    rpy = np.zeros((n, 3))
    for name in angles:
        unit = header.units.get(name, "")
        values = table[name]
        if not unit and np.abs(values).max() > _LARGEST_UNNAMED_ANGLE:
            raise FileError(
                path,
                f"the angles of {name} have no unit; name the column {name}_deg or {name}_rad",
                header.line,
            )
        rpy[:, ("roll", "pitch", "yaw").index(name)] = (
            np.deg2rad(values) if unit.startswith("deg") else values
        )
    return rotation.from_roll_pitch_yaw(rpy)


def _line_by_line(path: str | Path, lines: list[str], header: Header, columns: dict[str, int]) -> FloatArray:
    rows = []
    for number, line in enumerate(lines, start=header.line + 1):
        content = line.split("#", 1)[0].strip()
        if not content:
            continue
        words = (
            next(csv.reader([content], delimiter=header.delimiter)) if header.delimiter else content.split()
        )
        row = []
        for name, column in columns.items():
            if column >= len(words):
                raise FileError(path, f"found {len(words)} of {header.count} columns", number)
            word = words[column].strip()
            try:
                row.append(float(word))
            except ValueError:
                shown = word if len(word) <= 30 else word[:30] + "…"
                hint = f"; {DECIMAL_COMMA}" if has_decimal_comma(word) else ""
                told = f"{shown!r} in the column of {name} is no number{hint}"
                raise FileError(path, told, number) from None
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(-1, len(columns))
