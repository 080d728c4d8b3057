# SPDX-License-Identifier: Apache-2.0
"""``health.csv`` and ``covariances.csv``: how sure a system was of itself, and of its poses.

::

    stamp,value,flag
    1403636580.86,0.93,ok
    1403636580.91,0.41,degraded
    1403636580.96,,lost

``value`` is any number, larger where the system is more confident; it or ``flag`` may be empty, and either
column may be left out. Covariances have a column ``stamp`` and columns as `slamhive_eval.formats.covariances`
knows them, ``cov_xx`` or ``cov_x_rz``: those of one triangle do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval.errors import FileError
from slamhive_eval.formats import covariances
from slamhive_eval.formats.textfiles import (
    data_lines,
    decode,
    fault_in_row,
    is_number,
    parse_table,
    read_bytes,
)
from slamhive_eval.trajectory import LARGEST_STAMP_SECONDS

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy.typing as npt

    from slamhive_eval.rotation import FloatArray

HEALTH, COVARIANCES = "health.csv", "covariances.csv"
COLUMNS = ("stamp", "value", "flag")
FLAGS = ("ok", "degraded", "lost")
SAYS_NOTHING = -1
"""Number of a flag that is empty; others are numbered as in FLAGS."""
MOST_ROWS = 1_000_000
_SHOWN = 30


@dataclass(frozen=True, eq=False)
class Confidence:
    """Rows of a ``health.csv``: what a system said of itself, and when.

    Attributes:
        stamps: Time of each in s, shape (n,), never decreasing.
        values: Confidence, larger is more; NaN where that is empty, shape (n,).
        flags: Numbers of FLAGS, SAYS_NOTHING where that is empty, shape (n,).
    """

    stamps: FloatArray
    values: FloatArray
    flags: npt.NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.stamps)

    def shifted(self, offset_seconds: float) -> Confidence:
        """The same with so many seconds added to the stamps."""
        return Confidence(self.stamps + offset_seconds, self.values, self.flags)


def read_health(path: str | Path) -> Confidence:
    """Read a ``health.csv``, plain or compressed.

    Raises:
        FileError: The file can't be read or is empty, its first line doesn't name its columns, or a row is
            none.
    """
    lines = iter(data_lines(decode(read_bytes(path))))
    names, number = _names(path, next(lines, None), ",".join(COLUMNS))
    if not {"value", "flag"}.intersection(names) or set(names) > set(COLUMNS):
        raise FileError(path, f"the first line must be {','.join(COLUMNS)}, not {','.join(names)}", number)
    places = [names.index(name) if name in names else None for name in COLUMNS]
    stamps: list[float] = []
    values: list[float] = []
    flags: list[int] = []
    for number, content in lines:
        words = [word.strip().strip('"') for word in content.split(",")]
        if len(words) != len(names):
            raise FileError(path, f"found {len(words)} of {len(names)} columns: {','.join(names)}", number)
        stamp, value, flag = ("" if place is None else words[place] for place in places)
        stamps.append(_stamp(path, number, stamp, stamps))
        values.append(_number(path, number, "value", value) if value else math.nan)
        if flag and flag not in FLAGS:
            told = f"flag is {flag[:_SHOWN]!r}; it must be one of {', '.join(FLAGS)}, or empty"
            raise FileError(path, told, number)
        flags.append(FLAGS.index(flag) if flag else SAYS_NOTHING)
        if len(stamps) > MOST_ROWS:
            raise FileError(path, f"has more than {MOST_ROWS:,} rows")
    if not stamps:
        raise FileError(path, "has no row below the names of the columns")
    return Confidence(np.array(stamps), np.array(values), np.array(flags, dtype=np.int8))


def read_covariances(path: str | Path) -> tuple[FloatArray, FloatArray]:
    """Read a ``covariances.csv``, plain or compressed.

    Returns:
        Stamps in s, shape (n,), never decreasing, and covariances as `slamhive_eval.Trajectory` has them, in
        the world frame of the poses, shape (n, 3, 3) or (n, 6, 6).

    Raises:
        FileError: The file can't be read or is empty, its first line doesn't name its columns, or a row is
            none.
    """
    data = read_bytes(path)
    usual = "stamp,cov_xx,cov_xy,cov_xz,cov_yy,cov_yz,cov_zz"
    names, number = _names(path, next(data_lines(decode(data)), None), usual)
    entries, of_body = covariances.find_columns(names)
    unknown = [name for k, name in enumerate(names) if name != "stamp" and k not in entries.values()]
    if of_body or not entries or unknown:
        raise FileError(
            path, f"the first line must name the columns, as in {usual}, not {','.join(names)}", number
        )
    # The names are made a comment: numbers of lines stay what they are.
    lines = data.split(b"\n")
    lines[number - 1] = b"#"
    table = parse_table(path, b"\n".join(lines), len(names), ",".join(names))
    if len(table) > MOST_ROWS:
        raise FileError(path, f"has more than {MOST_ROWS:,} rows")
    stamps = table[:, names.index("stamp")]
    bad = ~(np.abs(stamps) <= LARGEST_STAMP_SECONDS)
    bad[1:] |= np.diff(stamps) < 0
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        told = f"stamp is {stamps[row]:.10g}, which is no time in s after the one above it"
        raise fault_in_row(path, data, row, told, skipped=number)
    columns = {entry: table[:, place] for entry, place in entries.items()}
    made = covariances.assemble(columns, np.zeros((len(table), 4)), of_body=False)
    if made is None:
        raise FileError(path, "holds zeros alone: that says nothing of how wrong poses are")
    return stamps, made


def _names(path: str | Path, line: tuple[int, str] | None, usual: str) -> tuple[list[str], int]:
    """Return the names of the columns, and the number of their line."""
    if line is None:
        raise FileError(path, f"is empty; its first line names the columns: {usual}")
    number, content = line
    names = [name.strip().strip('"').lower() for name in content.split(",")]
    if "stamp" not in names or len(set(names)) < len(names):
        shown = content if len(content) <= 2 * _SHOWN else content[: 2 * _SHOWN] + "…"
        raise FileError(path, f"the first line must name the columns, as in {usual}, not {shown!r}", number)
    return names, number


def _stamp(path: str | Path, number: int, word: str, before: Sequence[float]) -> float:
    stamp = _number(path, number, "stamp", word)
    if abs(stamp) > LARGEST_STAMP_SECONDS:
        raise FileError(path, f"stamp {word} is no number of seconds (nanoseconds perhaps?)", number)
    if before and stamp < before[-1]:
        told = f"stamp {stamp:.9f} s comes before the one above it, {before[-1]:.9f} s"
        raise FileError(path, f"{told}; stamps must not decrease", number)
    return stamp


def _number(path: str | Path, line: int, name: str, word: str) -> float:
    if not is_number(word) or not math.isfinite(float(word)):
        raise FileError(path, f"{name} is {word[:_SHOWN]!r}, which is no finite number", line)
    return float(word)
