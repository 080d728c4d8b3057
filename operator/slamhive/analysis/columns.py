# SPDX-License-Identifier: Apache-2.0
"""Columns of many rows as arrays: 80,000 runs with a hundred columns in some 40 MB.

A column holds numbers, in which NaN is what is missing, or codes that stand for values, -1 for what is
missing. Nothing in here is ever changed after it was made, so that columns can be shared.
"""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.compact.growing import joined
from slamhive.analysis.compact.texts import LONG, PackedTexts, fit_together, merged, numbers_of_texts, short
from slamhive.model.base import Choice

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from collections.abc import Set as AbstractSet

    import numpy.typing as npt

    Floats = npt.NDArray[np.float64]
    Integers = npt.NDArray[np.int32]
    Indices = npt.NDArray[np.intp]
    Mask = npt.NDArray[np.bool_]

_EXACT = 2.0**53
_PLAIN = {int, float, type(None)}
_FEW_WORDS = 8
_FEW = 127
"""Different values up to which codes have a byte."""
FIRST_THEN_ALL = (slice(4096), slice(None))
"""Rows in which most of what differs or occurs at all does so already, and all rows."""

_MANY = 256
"""Values from which on it is worth the while to look how few are different, or to hold texts as one array."""


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


class Column:
    """The values of one name in all rows.

    Numbers of which few are different are held by codes too.

    Args:
        kind: what they are.
        numbers: (n,) for numeric kinds, NaN where missing; s since 1970 for times, 0 and 1 for booleans.
        codes: (n,) for the others, places in ``values``, -1 where missing.
        values: what codes stand for, each once, none of them None; of numbers an array in their order.

    Attributes:
        kind: as given.
        values: as given.
    """

    __slots__ = ("_codes", "_numbers", "_occurs", "kind", "values")

    def __init__(
        self,
        kind: ColumnKind,
        numbers: Floats,
        codes: npt.NDArray[np.signedinteger[Any]],
        values: Sequence[Any] | Floats = (),
    ) -> None:
        self.kind = kind
        self._numbers = numbers
        self._codes = codes
        self._occurs: Mask | None = None
        self.values: Any = values

    @classmethod
    def of_numbers(cls, numbers: npt.ArrayLike, kind: ColumnKind = ColumnKind.NUMBER) -> Column:
        """Return a numeric column; infinite numbers become missing ones."""
        found = np.array(numbers, dtype=np.float64)
        found[~np.isfinite(found)] = np.nan
        return cls(kind, found, _NO_CODES)

    @classmethod
    def of_codes(cls, codes: npt.ArrayLike, values: Iterable[Any]) -> Column:
        """Return a column of values by their codes."""
        kept = values if isinstance(values, PackedTexts) else tuple(values)
        is_text = isinstance(kept, PackedTexts) or set(map(type, kept)) <= {str}
        kind = ColumnKind.TEXT if is_text else ColumnKind.OTHER
        return cls(kind, _NO_NUMBERS, _narrow(np.asarray(codes), len(kept)), kept)

    @classmethod
    def of(cls, values: Sequence[Any] | Column, types: AbstractSet[type] | None = None) -> Column:
        """Return the column of plain JSON values.

        Args:
            values: one a row, None where missing; a column is itself.
            types: those of the values, where they are known.
        """
        if isinstance(values, Column):
            return values
        types = set(map(type, values)) if types is None else types
        if types <= _PLAIN:
            found = cls.of_numbers(values)  # numpy reads None as NaN
            whole = float not in types and int in types
            if not whole or not (np.abs(found.numbers) > _EXACT).any():
                found.kind = ColumnKind.INTEGER if whole else ColumnKind.NUMBER
                return found.packed()
        if types <= {bool, type(None)}:
            return cls.of_numbers(values, ColumnKind.BOOLEAN).packed()
        if types <= {str, type(None)}:
            return cls._coded(values, values)
        return cls._coded(values, [None if value is None else _identity(value) for value in values])

    @classmethod
    def repeated(cls, value: Any, length: int, rows: Indices | None = None) -> Column:
        """Return the column of one value in all rows, or in some."""
        one = cls.of([value])
        if not one.is_coded:
            one = cls(one.kind, _NO_NUMBERS, np.zeros(1, dtype=np.int8), one.numbers)
        codes = np.zeros(length, dtype=np.int8)
        if rows is not None:
            codes.fill(-1)
            codes[rows] = 0
        return cls(one.kind, _NO_NUMBERS, codes, one.values)

    @classmethod
    def missing(cls, length: int) -> Column:
        """Return a column of nothing."""
        return cls(ColumnKind.NUMBER, _NO_NUMBERS, np.full(length, -1, dtype=np.int8), _NO_NUMBERS)

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
                return cls._of_all_numbers(kinds.pop() if len(kinds) == 1 else ColumnKind.NUMBER, columns)
        elif not any(kind.is_numeric for kind in kinds):
            return cls._merged(columns)
        return cls.of([value for column in columns for value in column.tolist()])

    @classmethod
    def _coded(cls, values: Sequence[Any], keys: Sequence[Any]) -> Column:
        places = dict.fromkeys(keys)
        places.pop(None, None)
        if keys is values and len(places) == len(keys) >= _MANY and (packed := PackedTexts.of(keys)):
            return cls.of_codes(np.arange(len(keys), dtype=np.int32), packed)
        places.update(zip(places, range(len(places)), strict=True))
        kept: Sequence[Any] = list(places)
        if keys is not values:
            # The first value of a key stands for all of them.
            firsts = dict(zip(reversed(keys), reversed(values), strict=True))
            kept = [firsts[key] for key in places]
        elif 2 * len(places) > len(keys) and len(places) >= _MANY:
            kept = PackedTexts.of(kept) or kept
        places[None] = -1
        return cls.of_codes(np.fromiter(map(places.__getitem__, keys), np.int32, len(keys)), kept)

    @classmethod
    def _of_all_numbers(cls, kind: ColumnKind, columns: Sequence[Column]) -> Column:
        """Return numeric columns one below the other; others among them hold nothing."""
        parts = [
            column if column.kind.is_numeric else cls.missing(len(column))
            for column in columns
            if len(column)
        ]
        if not parts or any(not part.is_coded for part in parts):
            return cls(kind, joined([part.numbers for part in parts] or [_NO_NUMBERS]), _NO_CODES)
        known = [part.values for part in parts if len(part.values)]
        same = all(np.array_equal(one, known[0]) for one in known)
        values = (known[0] if known else _NO_NUMBERS) if same else np.unique(np.concatenate(known))
        if len(values) > _FEW:
            return cls(kind, joined([part.numbers for part in parts]), _NO_CODES)
        if same:
            return cls(kind, _NO_NUMBERS, joined([part.held for part in parts]), values)
        codes = [
            np.append(np.searchsorted(values, part.values), -1).astype(np.int8)[part.held] for part in parts
        ]
        return cls(kind, _NO_NUMBERS, np.concatenate(codes), values)

    @classmethod
    def _merged(cls, columns: Sequence[Column]) -> Column:
        coded = [column for column in columns if not column.kind.is_numeric]
        texts = all(column.kind is ColumnKind.TEXT for column in coded)
        values: Sequence[Any]
        packed = [column.values for column in coded if isinstance(column.values, PackedTexts)]
        if len(packed) == len(coded) and fit_together(packed):
            values, places_of_all = merged(packed)
            ends = np.cumsum([len(column.values) for column in coded])[:-1]
            translations = iter(np.split(places_of_all, ends))
        else:
            keyed = [list(column.values if texts else map(_identity, column.values)) for column in coded]
            places: dict[Any, int] = {key: place for place, key in enumerate(dict.fromkeys(chain(*keyed)))}
            values = list(places)
            if texts and len(values) >= _MANY:
                values = PackedTexts.of(values) or values
            elif not texts:
                by_key = dict(zip(chain(*keyed), chain(*(column.values for column in coded)), strict=True))
                values = [by_key[key] for key in places]
            translations = (np.fromiter(map(places.__getitem__, keys), np.int32, len(keys)) for keys in keyed)
        parts = []
        for column in columns:
            if column.kind.is_numeric:
                parts.append(np.full(len(column), -1, dtype=np.int32))
            else:
                parts.append(np.append(next(translations), np.int32(-1))[column.held])
        return cls.of_codes(np.concatenate(parts), values)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._codes) if self.is_coded else len(self._numbers)

    @property
    def is_coded(self) -> bool:
        """True if rows hold places in ``values``, as all but many different numbers do."""
        return not self.kind.is_numeric or isinstance(self.values, np.ndarray)

    @property
    def numbers(self) -> Floats:
        """The numbers of numeric kinds, (n,), NaN where missing."""
        if not (self.kind.is_numeric and self.is_coded):
            return self._numbers
        found: Floats = np.append(self.values, math.nan)[self._codes]
        return found

    @property
    def codes(self) -> Integers:
        """The places of the values of other kinds, (n,), -1 where missing."""
        return _NO_CODES if self.kind.is_numeric else self._codes.astype(np.int32, copy=False)

    @property
    def held(self) -> npt.NDArray[Any]:
        """The numbers or, where rows hold such, places in ``values``, (n,), as they are in memory."""
        return self._codes if self.is_coded else self._numbers

    @property
    def present(self) -> Mask:
        """Mask of the rows that have a value, (n,)."""
        return self._codes >= 0 if self.is_coded else ~np.isnan(self._numbers)

    @property
    def is_empty(self) -> bool:
        """True if no row has a value."""
        begins_with_one = len(self) and (
            self._codes[0] >= 0 if self.is_coded else not np.isnan(self._numbers[0])
        )
        return not (begins_with_one or self.present.any())

    def marks(self) -> npt.NDArray[np.uint64]:
        """Return a number for each value, (n,), the same in every process and column (``hash`` is not)."""
        if self.kind.is_numeric:
            return self.numbers.view(np.uint64)
        values = self.values
        if not isinstance(values, PackedTexts) or values.data.itemsize > LONG:
            texts = [short(str(value).encode("utf-8", "replace")) for value in values]
            values = PackedTexts(np.array(texts, dtype=np.bytes_))
        found: npt.NDArray[np.uint64] = np.append(numbers_of_texts(values.data), _NOTHING)[self._codes]
        return found

    def among(self, wanted: Iterable[Any]) -> Mask:
        """Tell which rows have one of some texts, or none where None is wanted, (n,)."""
        if self.kind.is_numeric:
            return np.zeros(len(self), dtype=bool)
        words = frozenset(wanted) if self.kind is ColumnKind.TEXT else tuple(wanted)  # lists have no hash
        values = self.values
        if isinstance(values, PackedTexts) and len(words) <= _FEW_WORDS:
            verdicts = np.zeros(len(values) + 1, dtype=bool)
            for word in words:
                verdicts[values.places(word)] = True
            verdicts[-1] = None in words
        else:
            verdicts = np.array([value in words for value in (*values, None)], dtype=bool)
        return self.having(verdicts)

    def equal(self, number: float) -> Mask:
        """Tell which rows of a numeric column have a number, (n,); none where that is NaN."""
        if self.is_coded:
            return self.having(np.append(self.values == number, False))
        found: Mask = self._numbers == number
        return found

    def having(self, verdicts: Mask) -> Mask:
        """Tell which rows have values of which a verdict is true, (n,).

        Args:
            verdicts: one for each of ``values``, and last that on what is missing, (values + 1,).
        """
        places = np.flatnonzero(verdicts)
        if len(places) > _FEW_WORDS:
            found: Mask = verdicts[self._codes]
            return found
        # Several times as fast as to look each row's up.
        found = np.zeros(len(self), dtype=bool)
        for place in places.tolist():
            found |= self._codes == (place if place < len(self.values) else -1)
        return found

    def packed(self) -> Column:
        """Return the column, numbers by codes where few of them are different."""
        if self.is_coded or len(self._numbers) < _MANY:
            return self
        if len(np.unique(self._numbers[:: len(self._numbers) // _MANY])) > _FEW:
            return self
        values = np.unique(self._numbers)
        values = values[~np.isnan(values)]
        zeros = self._numbers[self._numbers == 0]
        if len(values) > _FEW or np.signbit(zeros).any():  # -0 is written otherwise than 0
            return self
        codes = np.searchsorted(values, self._numbers).astype(np.int8)
        codes[np.isnan(self._numbers)] = -1
        return Column(self.kind, _NO_NUMBERS, codes, values)

    def take(self, rows: Indices | Mask) -> Column:
        """Return the column of some rows."""
        if self.is_coded:
            return Column(self.kind, _NO_NUMBERS, self._codes[rows], self.values)
        return Column(self.kind, self._numbers[rows], _NO_CODES)

    def tolist(self) -> list[Any]:
        """Return the values as plain ones, None where missing, times as ISO 8601 texts."""
        if self.is_coded:
            values = self.values
            if self.kind.is_numeric:
                lookup = [*map(self.plain, values.tolist()), None]
            elif isinstance(values, PackedTexts) and len(self._codes) < len(values):
                texts = map(bytes.decode, values.data[self._codes].tolist())
                return [
                    None if code < 0 else text for code, text in zip(self._codes.tolist(), texts, strict=True)
                ]
            else:
                lookup = [*values, None]
            return [lookup[code] for code in self._codes.tolist()]
        if self.kind is ColumnKind.TIME:
            return self._plain(self._numbers)
        found: list[Any]
        present = self.present
        if present.all():
            found = self._numbers.astype(_PLAIN_TYPES[self.kind]).tolist()
            return found
        held = np.where(present, self._numbers, 0).astype(_PLAIN_TYPES[self.kind]).astype(object)
        held[~present] = None
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
        if self.kind is ColumnKind.TEXT:
            return np.full(len(self), math.nan)
        lookup = np.array([*map(_float, self.values), math.nan])
        lookup[~np.isfinite(lookup)] = math.nan
        numbers: Floats = lookup[self._codes]
        return numbers

    def factorized(self) -> tuple[Integers, list[Any]]:
        """Return (codes, values): the place of each row's among the values as ``unique`` has them, (n,)."""
        if not self.is_coded:
            uniques, places = np.unique(self._numbers, return_inverse=True)
            return places.astype(np.int32), self._plain(uniques)
        used, values = self._used()
        if used == [*range(len(values))]:
            return self._codes.astype(np.int32), values
        ranks = np.empty(len(self.values) + 1, dtype=np.int32)
        ranks[used] = np.arange(len(used), dtype=np.int32)
        ranks[-1] = len(used)  # what is missing comes last
        return ranks[self._codes], values

    def unique(self) -> list[Any]:
        """Return the values in their order, each used, None last where one is missing."""
        return self._used()[1] if self.is_coded else self._plain(np.unique(self._numbers))

    def _plain(self, numbers: Floats) -> list[Any]:
        return [None if number != number else self.plain(number) for number in numbers.tolist()]  # noqa: PLR0124

    def _used(self) -> tuple[list[int], list[Any]]:
        """Return the places in ``values`` that rows hold, in the order of what is there, and that."""
        occurs = self._occurring()
        used = np.flatnonzero(occurs[:-1]).tolist()
        if self.kind.is_numeric:
            values = self._plain(self.values[used])
        else:
            used.sort(key=lambda code: sort_key(self.values[code]))
            values = [self.values[code] for code in used]
        return used, [*values, *([None] if occurs[-1] else [])]

    def distinct(self) -> int:
        """Return the number of different values, a missing one not counted."""
        if self.is_coded:
            return int(np.count_nonzero(self._occurring()[:-1]))
        return count_distinct(self._numbers[self.present])

    def _occurring(self) -> Mask:
        """Tell which places in ``values`` rows hold, and last whether any holds none, (values + 1,)."""
        if self._occurs is None:
            self._occurs = _occurring(self._codes, len(self.values))  # whole, for whichever thread asks next
        return self._occurs

    def counted(self) -> tuple[Floats, Indices]:
        """Return the different numbers of a numeric column, in their order, and how many rows have each."""
        if not self.is_coded:
            return np.unique(self._numbers[self.present], return_counts=True)
        used, counts = counted(self._codes[self.present], len(self.values))
        return self.values[used], counts

    def ranks(self) -> Floats:
        """Return numbers, (n,), in the order of ``sort_key``; +inf where missing."""
        if self.kind.is_numeric:
            numbers = self.numbers
            return np.where(np.isnan(numbers), np.inf, numbers)
        values = self.values
        order: Any = (
            values.order()
            if isinstance(values, PackedTexts)
            else sorted(range(len(values)), key=lambda code: sort_key(values[code]))
        )
        ranks = np.empty(len(values) + 1)
        ranks[order] = np.arange(len(values), dtype=np.float64)
        ranks[-1] = np.inf
        found: Floats = ranks[self._codes]
        return found


_PLAIN_TYPES = {ColumnKind.NUMBER: np.float64, ColumnKind.INTEGER: np.int64, ColumnKind.BOOLEAN: np.bool_}
_NO_NUMBERS = np.empty(0)
_NO_CODES = np.empty(0, dtype=np.int32)
_NOTHING = np.array([math.nan]).view(np.uint64)


def _narrow(codes: npt.NDArray[Any], count: int) -> npt.NDArray[np.signedinteger[Any]]:
    """Return codes of so many values in as few bytes as hold them."""
    kind = np.int8 if count <= _FEW else np.int16 if count < 1 << 15 else np.int32
    return codes.astype(kind, copy=False)


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


def _occurring(numbers: npt.NDArray[np.integer[Any]], bound: int) -> Mask:
    """Tell which numbers below a bound occur, and last whether -1 does, (bound + 1,)."""
    occurs = np.zeros(bound + 1, dtype=bool)
    for rows in FIRST_THEN_ALL:
        occurs[numbers[rows]] = True
        if occurs[:-1].all():
            occurs[-1] = bool((numbers < 0).any())
            break
    return occurs


def renumbered(
    numbers: npt.NDArray[np.integer[Any]], bound: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the numbers that occur, sorted, and the place of each row's among them, (n,).

    The same as NumPy's ``unique``, several times as fast where few numbers are possible.

    Args:
        numbers: whole numbers from 0, -1 for what is missing, (n,).
        bound: above all of them.
    """
    if bound > 4 * len(numbers) + 1024:
        used, places = np.unique(numbers, return_inverse=True)
        return used.astype(np.int64), places.astype(np.int64)
    occurs = _occurring(numbers, bound)
    if occurs[:-1].all() and not occurs[-1]:
        return np.arange(bound), numbers.astype(np.int64, copy=False)
    used = np.flatnonzero(occurs[:-1])
    ranks = np.cumsum(occurs[:-1]) - 1
    if occurs[-1]:
        used, ranks = np.concatenate([[-1], used]), np.append(ranks + 1, 0)
    return used, ranks[numbers]


def counted(numbers: npt.NDArray[np.integer[Any]], bound: int) -> tuple[Indices, Indices]:
    """Return the numbers that occur, sorted, and how often each does; sorted themselves where few of many do.

    Args:
        numbers: whole numbers from 0, (n,).
        bound: above all of them.
    """
    if bound > 4 * len(numbers) + 1024:
        return np.unique(numbers, return_counts=True)
    counts = np.bincount(numbers, minlength=bound)
    used = np.flatnonzero(counts)
    return used, counts[used]


def count_distinct(numbers: npt.NDArray[Any]) -> int:
    """Return the count of different numbers; sorted, which is faster than NumPy's hashing of many."""
    ordered = numbers if bool((numbers[1:] >= numbers[:-1]).all()) else np.sort(numbers)
    return int(np.count_nonzero(ordered[1:] != ordered[:-1])) + 1 if len(ordered) else 0
