# SPDX-License-Identifier: Apache-2.0
"""Columns of many rows as arrays: 80,000 runs with a hundred columns in some 60 MB.

A column holds numbers, in which NaN is what is missing, or codes that stand for values, -1 for what is
missing. Nothing in here is ever changed after it was made, so that columns can be shared.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.model.base import Choice

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy.typing as npt

    Floats = npt.NDArray[np.float64]
    Integers = npt.NDArray[np.int32]
    Indices = npt.NDArray[np.intp]
    Mask = npt.NDArray[np.bool_]

_EXACT = 2.0**53
_PLAIN = {int, float, type(None)}


def sort_key(value: Any) -> tuple[int, float, str]:
    """Return a key to sort values of any kind by: numbers, then texts, then what is missing."""
    if isinstance(value, int | float):
        return (2, 0.0, "") if value != value else (0, float(value), "")  # noqa: PLR0124 - NaN
    return (3, 0.0, "") if value is None else (1, 0.0, str(value))


class ColumnKind(Choice):
    """Types of values that a column can hold."""

    NUMBER = "number"
    INTEGER = "integer"
    BOOLEAN = "boolean"
    TIME = "time"
    TEXT = "text"
    OTHER = "other"

    @property
    def is_numeric(self) -> bool:
        """Tell whether the column holds numbers and not codes."""
        return self not in {ColumnKind.TEXT, ColumnKind.OTHER}


@dataclass(frozen=True, eq=False)
class Column:
    """The values of one name in all rows.

    Attributes:
        kind: what they are.
        numbers: (n,) for numeric kinds, NaN where missing; s since 1970 for times, 0 and 1 for booleans.
        codes: (n,) for the others, places in ``values``, -1 where missing.
        values: what codes stand for, each once, none of them None.
    """

    kind: ColumnKind
    numbers: Floats
    codes: Integers
    values: tuple[Any, ...] = ()

    @classmethod
    def of_numbers(cls, numbers: npt.ArrayLike, kind: ColumnKind = ColumnKind.NUMBER) -> Column:
        """Return a numeric column; infinite numbers become missing ones."""
        found = np.array(numbers, dtype=np.float64)
        found[~np.isfinite(found)] = np.nan
        return cls(kind, found, _NO_CODES)

    @classmethod
    def of_codes(cls, codes: npt.ArrayLike, values: Iterable[Any]) -> Column:
        """Return a column of values by their codes."""
        kept = tuple(values)
        kind = ColumnKind.TEXT if set(map(type, kept)) <= {str} else ColumnKind.OTHER
        return cls(kind, _NO_NUMBERS, np.asarray(codes, dtype=np.int32), kept)

    @classmethod
    def of(cls, values: Sequence[Any]) -> Column:
        """Return the column of plain JSON values."""
        types = set(map(type, values))
        if types <= _PLAIN:
            found = cls.of_numbers(values)  # numpy reads None as NaN
            whole = float not in types and int in types
            if not whole or not (np.abs(found.numbers) > _EXACT).any():
                return cls(ColumnKind.INTEGER, found.numbers, _NO_CODES) if whole else found
        if types <= {bool, type(None)}:
            return cls.of_numbers(values, ColumnKind.BOOLEAN)
        if types <= {str, type(None)}:
            return cls._coded(values, values)
        return cls._coded(values, [None if value is None else _identity(value) for value in values])

    @classmethod
    def missing(cls, length: int) -> Column:
        """Return a column of nothing."""
        return cls(ColumnKind.NUMBER, np.full(length, np.nan), _NO_CODES)

    @classmethod
    def concatenate(cls, columns: Sequence[Column]) -> Column:
        """Return columns one below the other."""
        filled = [column for column in columns if not column.is_empty]
        if len(columns) == 1:
            return columns[0]
        kinds = {column.kind for column in filled}
        if all(kind.is_numeric for kind in kinds):
            plain = kinds <= {ColumnKind.NUMBER, ColumnKind.INTEGER}
            if len(kinds) <= 1 or plain:
                kind = kinds.pop() if len(kinds) == 1 else ColumnKind.NUMBER
                parts = [
                    column.numbers if column.kind.is_numeric else np.full(len(column), np.nan)
                    for column in columns
                ]
                return cls(kind, np.concatenate(parts), _NO_CODES)
        elif not any(kind.is_numeric for kind in kinds):
            return cls._merged(columns)
        return cls.of([value for column in columns for value in column.tolist()])

    @classmethod
    def _coded(cls, values: Sequence[Any], keys: Sequence[Any]) -> Column:
        places = dict.fromkeys(keys)
        places.pop(None, None)
        places.update(zip(places, range(len(places)), strict=True))
        kept = list(places)
        if keys is not values:
            # The first value of a key stands for all of them.
            firsts = dict(zip(reversed(keys), reversed(values), strict=True))
            kept = [firsts[key] for key in places]
        places[None] = -1
        return cls.of_codes(np.fromiter(map(places.__getitem__, keys), np.int32, len(keys)), kept)

    @classmethod
    def _merged(cls, columns: Sequence[Column]) -> Column:
        texts = all(column.kind is ColumnKind.TEXT for column in columns if not column.kind.is_numeric)
        keyed = [column.values if texts else tuple(map(_identity, column.values)) for column in columns]
        places: dict[Any, int] = {key: place for place, key in enumerate(dict.fromkeys(chain(*keyed)))}
        kept = list(places)
        if not texts:
            values = dict(zip(chain(*keyed), chain(*(column.values for column in columns)), strict=True))
            kept = [values[key] for key in places]
        parts = []
        for column, keys in zip(columns, keyed, strict=True):
            if column.kind.is_numeric:
                parts.append(np.full(len(column), -1, dtype=np.int32))
                continue
            translation = np.fromiter(map(places.__getitem__, keys), np.int32, len(keys))
            parts.append(np.append(translation, np.int32(-1))[column.codes])
        return cls.of_codes(np.concatenate(parts), kept)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.numbers) if self.kind.is_numeric else len(self.codes)

    @cached_property
    def present(self) -> Mask:
        """Mask of the rows that have a value, (n,)."""
        return ~np.isnan(self.numbers) if self.kind.is_numeric else self.codes >= 0

    @property
    def is_empty(self) -> bool:
        """True if no row has a value."""
        return not self.present.any()

    def take(self, rows: Indices | Mask) -> Column:
        """Return the column of some rows."""
        if self.kind.is_numeric:
            return Column(self.kind, self.numbers[rows], _NO_CODES)
        return Column(self.kind, _NO_NUMBERS, self.codes[rows], self.values)

    def tolist(self) -> list[Any]:
        """Return the values as plain ones, None where missing, times as ISO 8601 texts."""
        if not self.kind.is_numeric:
            lookup = [*self.values, None]
            return [lookup[code] for code in self.codes.tolist()]
        if self.kind is ColumnKind.TIME:
            return [None if value != value else self.plain(value) for value in self.numbers.tolist()]  # noqa: PLR0124
        found: list[Any]
        if self.present.all():
            found = self.numbers.astype(_PLAIN_TYPES[self.kind]).tolist()
            return found
        held = np.where(self.present, self.numbers, 0).astype(_PLAIN_TYPES[self.kind]).astype(object)
        held[~self.present] = None
        found = held.tolist()
        return found

    def plain(self, number: float) -> Any:
        """Return a number of this column as the value that it stands for."""
        match self.kind:
            case ColumnKind.INTEGER:
                return int(number)
            case ColumnKind.BOOLEAN:
                return bool(number)
            case ColumnKind.TIME:
                return datetime.fromtimestamp(number, UTC).isoformat()
            case _:
                return number

    def floats(self) -> Floats:
        """Return the values as finite numbers, (n,), NaN for those that are none."""
        if self.kind.is_numeric:
            return self.numbers
        lookup = np.array([*map(_float, self.values), math.nan])
        lookup[~np.isfinite(lookup)] = math.nan
        numbers: Floats = lookup[self.codes]
        return numbers

    def factorized(self) -> tuple[Integers, list[Any]]:
        """Return (codes, values): values in their order, each used, None last where one is missing."""
        if self.kind.is_numeric:
            uniques, codes = np.unique(self.numbers, return_inverse=True)
            values = [None if value != value else self.plain(value) for value in uniques.tolist()]  # noqa: PLR0124
            return codes.astype(np.int32), values
        used, codes = renumbered(self.codes + 1, len(self.values) + 1)
        values = [None if code == 0 else self.values[code - 1] for code in used.tolist()]
        order = sorted(range(len(values)), key=lambda place: sort_key(values[place]))
        ranks = np.empty(len(values), dtype=np.int32)
        ranks[order] = np.arange(len(values), dtype=np.int32)
        return ranks[codes], [values[place] for place in order]

    def ranks(self) -> Floats:
        """Return numbers, (n,), in the order of ``sort_key``; +inf where missing."""
        if self.kind.is_numeric:
            return np.where(self.present, self.numbers, np.inf)
        order = sorted(range(len(self.values)), key=lambda code: sort_key(self.values[code]))
        ranks = np.empty(len(self.values) + 1)
        ranks[order] = np.arange(len(self.values), dtype=np.float64)
        ranks[-1] = np.inf
        return ranks[self.codes]


_PLAIN_TYPES = {ColumnKind.NUMBER: np.float64, ColumnKind.INTEGER: np.int64, ColumnKind.BOOLEAN: np.bool_}
_NO_NUMBERS = np.empty(0)
_NO_CODES = np.empty(0, dtype=np.int32)


def _float(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def _identity(value: Any) -> Any:
    """Return a key that tells values apart of which 1, 1.0 and true are three."""
    if isinstance(value, list | dict):
        return json.dumps(value, sort_keys=True)
    return type(value), value


def times(values: Sequence[Any]) -> Column:
    """Return a column of times from datetimes or ISO 8601 texts in UTC, None where missing."""
    plain = [
        value.astimezone(UTC).replace(tzinfo=None) if isinstance(value, datetime) and value.tzinfo else value
        for value in values
    ]
    stamps = np.array(plain, dtype="datetime64[us]")
    numbers = stamps.astype(np.int64) / 1e6
    numbers[np.isnat(stamps)] = np.nan
    return Column(ColumnKind.TIME, numbers, _NO_CODES)


def renumbered(
    numbers: npt.NDArray[np.integer[Any]], bound: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the numbers that occur, sorted, and the place of each row's among them, (n,).

    The same as NumPy's ``unique``, several times as fast where few numbers are possible.

    Args:
        numbers: whole numbers from 0, (n,).
        bound: above all of them.
    """
    if bound > 4 * len(numbers) + 1024:
        used, places = np.unique(numbers, return_inverse=True)
        return used.astype(np.int64), places.astype(np.int64)
    occurs = np.zeros(bound, dtype=bool)
    occurs[numbers] = True
    return np.flatnonzero(occurs), (np.cumsum(occurs) - 1)[numbers]


def count_distinct(numbers: npt.NDArray[Any]) -> int:
    """Return the count of different numbers; sorted, which is faster than NumPy's hashing of many."""
    ordered = np.sort(numbers)
    return int(np.count_nonzero(ordered[1:] != ordered[:-1])) + 1 if len(ordered) else 0
