# SPDX-License-Identifier: Apache-2.0
"""Text files of stamped rows in foreign layouts: lists of images, and tables of samples.

Values stand between commas or white space, comments begin with ``#``, and a first line without a number is a
heading. Stamps are exact to the ns, as whole numbers, decimal fractions or in scientific notation.
"""

from __future__ import annotations

import math
import re
from array import array
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy.typing as npt

    Array = npt.NDArray[np.float64]
    Stamps = npt.NDArray[np.int64]

NANOSECONDS, SECONDS = 1, 10**9
"""ns in a unit of a file's stamps."""

_SEPARATOR = re.compile(r"[\s,]+")
_SHOWN = 3
"""Missing images that a note names."""
_LARGEST = 2**62


class Images(NamedTuple):
    """The images that a list names.

    Attributes:
        stamps: ns, ascending, shape (n,).
        files: The image of each, n.
        notes: Sentences on what is missing or out of order.
    """

    stamps: Stamps
    files: list[Path]
    notes: list[str]


class Samples(NamedTuple):
    """The rows of a table.

    Attributes:
        stamps: ns, ascending, shape (n,).
        values: What follows each stamp, shape (n, columns).
        notes: Sentences on what is out of order.
    """

    stamps: Stamps
    values: Array
    notes: list[str]


def read_images(path: Path, folder: Path, unit: int) -> Images:
    """Read a list of images: a stamp and the name of a file in each line.

    Args:
        path: The list.
        folder: Where names start from.
        unit: ns in one unit of its stamps.

    Raises:
        DataError: It is missing, damaged or empty, or more than half of its images don't exist.
    """
    stamps, files = array("q"), []
    missing: list[tuple[int, Path]] = []
    for line, (stamp, name) in _rows(path, 2, rest=True):
        time, image = _time(stamp, unit, path, line), folder / name
        if image.is_file():
            stamps.append(time)
            files.append(image)
        else:
            missing.append((line, image))
    if len(missing) > len(files):
        line, image = missing[0]
        raise DataError(
            f"{path}, line {line}: {image} does not exist, nor do {len(missing) - 1} others of the "
            f"{len(missing) + len(files)} images that it lists: is the archive unpacked whole?"
        )
    notes = []
    if missing:
        names = ", ".join(image.name for _, image in missing[:_SHOWN])
        more = f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
        notes.append(
            f"{path}: {len(missing)} of {len(missing) + len(files)} images do not exist and are left out: "
            f"{names}{more}"
        )
    times, order, unsorted = _in_order(np.frombuffer(stamps, dtype=np.int64), path)
    return Images(times, files if order is None else [files[k] for k in order.tolist()], notes + unsorted)


def read_samples(path: Path, columns: int, unit: int) -> Samples:
    """Read a table of numbers: a stamp and values in each line; further columns are left out.

    Args:
        path: The table.
        columns: Values after the stamp.
        unit: ns in one unit of its stamps.

    Raises:
        DataError: It is missing, damaged or empty; names the line.
    """
    stamps, values = array("q"), array("d")
    for line, words in _rows(path, 1 + columns):
        stamps.append(_time(words[0], unit, path, line))
        for word in words[1 : 1 + columns]:
            values.append(_number(word, path, line))
    table = np.frombuffer(values).reshape(-1, columns)
    times, order, notes = _in_order(np.frombuffer(stamps, dtype=np.int64), path)
    return Samples(times, table if order is None else table[order], notes)


def _rows(path: Path, columns: int, *, rest: bool = False) -> Iterator[tuple[int, list[str]]]:
    """Yield number and words of each row; with rest the last column is all that is left of the line."""
    found = False
    try:
        file = path.open(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        raise DataError(f"{path} does not exist") from None
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from None
    with file:
        for line, text in enumerate(file, start=1):
            content = text.lstrip("\ufeff").strip().rstrip(",")
            if not content or content.startswith("#"):
                continue
            words = _SEPARATOR.split(content, columns - 1 if rest else 0)
            if not found and _decimal(words[0]) is None:
                continue
            if len(words) < columns:
                raise DataError(f"{path}, line {line}: {columns} values are needed, found {len(words)}")
            found = True
            yield line, words
    if not found:
        raise DataError(f"{path}: no rows in it")


def _time(word: str, unit: int, path: Path, line: int) -> int:
    value = _decimal(word)
    scaled = None if value is None else value * unit
    if scaled is None or not 0 <= scaled < _LARGEST or (unit == NANOSECONDS and scaled % 1):
        name = "ns" if unit == NANOSECONDS else "s"
        raise DataError(f"{path}, line {line}: {word!r} is not a time stamp in {name}")
    return round(scaled)


def _decimal(word: str) -> Decimal | None:
    try:
        value = Decimal(word)
    except InvalidOperation:
        return None
    return value if value.is_finite() else None


def _number(word: str, path: Path, line: int) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DataError(f"{path}, line {line}: a value is not a finite number: {word!r}")
    return value


def _in_order(stamps: Stamps, path: Path) -> tuple[Stamps, npt.NDArray[np.intp] | None, list[str]]:
    """Return stamps in the order of time; where each was, and a note, if they weren't."""
    back = int(np.count_nonzero(np.diff(stamps) < 0))
    if not back:
        return stamps, None, []
    order = np.argsort(stamps, kind="stable")
    return (
        stamps[order],
        order,
        [f"{path}: {back} rows are stamped before the one above them; sorted by time"],
    )
