# SPDX-License-Identifier: Apache-2.0
"""Tables of numbers in text files, with time stamps exact to the ns; many importers read with it."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN, Decimal, InvalidOperation
from typing import TYPE_CHECKING, Literal

import numpy as np

from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy.typing as npt

    Array = npt.NDArray[np.float64]
    Stamps = npt.NDArray[np.int64]
    Indices = npt.NDArray[np.intp]

Unit = Literal["s", "ms", "us", "ns"]

_NANOSECONDS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
_LARGEST = 2**63 - 1
_FEW = 0.1
"""Share of stamps that may fail to ascend; where more do, the file is another than it seems."""


@dataclass(frozen=True, eq=False)
class NumberTable:
    """Rows of numbers of a file.

    Attributes:
        path: The file.
        lines: Number of each row's line, from 1, shape (n,).
        stamps: The first column in ns, shape (n,); of a table without stamps empty.
        values: The other columns, shape (n, columns).
    """

    path: Path
    lines: Stamps
    stamps: Stamps
    values: Array

    def ascending(self, what: str, notes: list[str]) -> NumberTable:
        """Return the rows whose stamps are later than all above; see `ascending`."""
        return self.rows(ascending(self.stamps, self.path, what, notes, self.lines))

    def rows(self, kept: Indices) -> NumberTable:
        """Return some of the rows."""
        stamps = self.stamps[kept] if self.stamps.size else self.stamps
        return NumberTable(self.path, self.lines[kept], stamps, self.values[kept])


def nanoseconds(text: str, unit: Unit) -> int:
    """Return a time in ns, exactly: rounded only where there are digits beyond.

    Args:
        text: A decimal number, perhaps in scientific notation.
        unit: Of the number.

    Raises:
        ValueError: It is no number, or beyond 292 years.
    """
    try:
        value = int(text) if text.isascii() and text.isdecimal() else Decimal(text)
        found = int((Decimal(value) * _NANOSECONDS[unit]).to_integral_value(ROUND_HALF_EVEN))
    except (InvalidOperation, OverflowError, ValueError):
        raise ValueError(f"{text!r} is not a time") from None
    if abs(found) > _LARGEST:
        raise ValueError(f"{text!r} is not a time in {unit}")
    return found


def read_table(
    path: Path, columns: int, meaning: str, *, stamp: Unit | None = None, unknown: list[str] | None = None
) -> NumberTable:
    """Read a table: numbers between commas, semicolons or white space.

    Empty lines and those that begin with # are skipped, and so is a first line of names. Further columns are
    left out.

    Args:
        path: The file.
        columns: Numbers that a row must have, the stamp not counted.
        meaning: What they are, for messages.
        stamp: Unit of the stamps in the first column, if there are stamps.
        unknown: Where rows may hold NaN for what isn't known: notes, to which is added how many were
            left out.

    Raises:
        DataError: The file is missing, has no rows, or a line is no such row; names file and line.
    """
    lines, stamps, values = array("q"), array("q"), array("d")
    needed = columns + (stamp is not None)
    for line, words in rows(path):
        if not lines and not _is_number(words[0]):
            continue
        if len(words) < needed:
            raise DataError(
                f"{path}, line {line}: {len(words)} of {needed} values; each line must have {meaning}"
            )
        try:
            if stamp is not None:
                stamps.append(nanoseconds(words[0], stamp))
            values.extend(map(float, words[needed - columns : needed]))
        except ValueError as error:
            raise DataError(f"{path}, line {line}: {error}; each line must have {meaning}") from None
        lines.append(line)
    if not lines:
        raise DataError(f"{path}: no rows in it; each line must have {meaning}")
    numbers = np.array(values, dtype=np.float64).reshape(len(lines), columns)
    table = NumberTable(path, np.array(lines, dtype=np.int64), np.array(stamps, dtype=np.int64), numbers)
    finite = np.isfinite(numbers).all(axis=1)
    if finite.all():
        return table
    first = lines[int(np.flatnonzero(~finite)[0])]
    if unknown is None or not finite.any():
        raise DataError(f"{path}, line {first}: a value is not a finite number")
    unknown.append(
        f"{path}: {np.count_nonzero(~finite)} of {len(lines)} rows hold NaN (the first is line {first}): "
        "left out"
    )
    return table.rows(np.flatnonzero(finite))


def rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the lines of a file that hold something, as their number from 1 and their words.

    Raises:
        DataError: The file is missing, or is no text.
    """
    try:
        # Programs of Windows begin files with a byte order mark.
        with path.open(encoding="utf-8-sig") as file:
            for line, text in enumerate(file, start=1):
                words = text.replace(",", " ").replace(";", " ").split()
                if words and not words[0].startswith("#"):
                    yield line, words
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise DataError(f"{path}: not a text file") from None


def ascending(
    stamps: Stamps, where: Path | str, what: str, notes: list[str], lines: Stamps | None = None
) -> Indices:
    """Return the indices of the stamps that are later than all before them; a note says how many aren't.

    Args:
        stamps: ns, shape (n,).
        where: The file or folder that they come from.
        what: Whose stamps they are, in the plural: "poses".
        notes: To which the sentence is added.
        lines: Number of each stamp's line, for the sentence.

    Raises:
        DataError: More than a tenth of them aren't.
    """
    kept = np.ones(len(stamps), dtype=np.bool_)
    kept[1:] = stamps[1:] > np.maximum.accumulate(stamps)[:-1]
    lost = np.flatnonzero(~kept)
    if lost.size:
        first = f"line {lines[lost[0]]}" if lines is not None else f"number {lost[0] + 1}"
        found = (
            f"{where}: {lost.size} of {len(stamps)} stamps of {what} aren't later than those before "
            f"(the first is {first})"
        )
        if lost.size > _FEW * len(stamps):
            raise DataError(f"{found}; stamps must ascend")
        notes.append(f"{found}: these {what} were left out")
    return np.flatnonzero(kept)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
