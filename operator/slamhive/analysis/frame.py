# SPDX-License-Identifier: Apache-2.0
"""Runs as a table of columns, one row a run and evaluation: what the dashboard and its analyses read.

The columns have the names that ``flatten`` gives them; both are tested against each other. Beside them:
``status`` (what became of the run in one word), ``disturbed`` (other work falsified its load) and
``ate.extended`` (the original system's error that grows as coverage falls).
"""

from __future__ import annotations

from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.columns import Column, ColumnKind
from slamhive.analysis.flattening import CORE_COLUMNS
from slamhive.analysis.pivot import MAX_CONTENDED, MAX_THROTTLED
from slamhive.model.errors import UnknownNameError
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.analysis.columns import Indices, Mask

    Document = Mapping[str, Any]

MAX_COLUMNS = 1500
"""Columns that a table has at most; an evaluator that invents a name for each run fills no memory."""

OWN_COLUMNS = frozenset({"id", "status", "disturbed", "ate.extended"})
"""Columns beside those of ``flatten``: the run's number, and what follows from others."""

LEFT_OUT = frozenset({"transform", "notes"})
"""Names of results that are no figures."""

_EMPTY: dict[str, Any] = {}
_MAX_ITEMS = 16


class Frame:
    """A table of columns, or some rows of one; never changed.

    Args:
        columns: by name, equally long.
        length: number of rows.
        rows: places of the rows meant, all of them unless given.
    """

    def __init__(self, columns: Mapping[str, Column], length: int, rows: Indices | None = None) -> None:
        self._columns = columns
        self._length = length
        self._rows = rows
        self._own: dict[str, Column] = {}
        self._taken: dict[str, Column] = {}

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._length if self._rows is None else len(self._rows)

    @cached_property
    def names(self) -> list[str]:
        """The names of all columns: the core ones, then the others sorted."""
        others = (self._columns.keys() | OWN_COLUMNS) - set(CORE_COLUMNS)
        return [*CORE_COLUMNS, *sorted(others)]

    @property
    def stored(self) -> list[str]:
        """The names of the columns that hold something."""
        return list(self._columns)

    @cached_property
    def rows(self) -> Indices:
        """Places of the rows in the whole table, (n,)."""
        return np.arange(self._length) if self._rows is None else self._rows

    def has(self, name: str) -> bool:
        """Tell whether there is a column of a name."""
        return name in self._columns or name in CORE_COLUMNS or name in OWN_COLUMNS

    def require(self, names: Iterable[str], where: str = "") -> None:
        """Refuse names of no column.

        Raises:
            UnknownNameError: with the nearest name.
        """
        for name in names:
            if not self.has(name):
                raise UnknownNameError("column", name, self.names, where)

    def column(self, name: str) -> Column:
        """Return a column; one of nothing where nothing is known by the name."""
        found = self._own.get(name, self._taken.get(name))
        if found is None:
            found = self._taken[name] = self.glance(name)
        return found

    def glance(self, name: str) -> Column:
        """Return a column as ``column`` does, without keeping it: for those that go through many once."""
        found = self._own.get(name, self._taken.get(name))
        if found is not None:
            return found
        whole = self._columns.get(name)
        if whole is None:
            return Column.missing(len(self))
        return whole if self._rows is None else whole.take(self._rows)

    def select(self, rows: Indices | Mask) -> Frame:
        """Return some rows: by a mask, (n,), or by their places."""
        chosen = Frame(self._columns, self._length, self.rows[rows])
        chosen._own = {name: column.take(rows) for name, column in self._own.items()}
        return chosen

    def replaced(self, columns: Mapping[str, Column]) -> Frame:
        """Return the same rows with other columns of some names."""
        changed = Frame(self._columns, self._length, self._rows)
        changed._own = self._own | dict(columns)
        return changed

    def row(self, place: int, names: Sequence[str] | None = None) -> dict[str, Any]:
        """Return one row as a flat record."""
        one = self.select(np.array([place]))
        return {name: one.column(name).tolist()[0] for name in names or self.names}

    def records(self, names: Sequence[str]) -> list[dict[str, Any]]:
        """Return all rows as flat records."""
        if not names:
            return [{} for _ in range(len(self))]
        values = [self.column(name).tolist() for name in names]
        return [dict(zip(names, row, strict=True)) for row in zip(*values, strict=True)]


def stack(parts: list[tuple[dict[str, Column], int]]) -> tuple[dict[str, Column], int]:
    """Return columns one below the other, with their length; takes the parts to pieces to save memory.

    Args:
        parts: columns by name and their length.
    """
    length = sum(count for _, count in parts)
    stacked: dict[str, Column] = {}
    for name in dict.fromkeys(name for columns, _ in parts for name in columns):
        pieces = [columns.pop(name) if name in columns else Column.missing(count) for columns, count in parts]
        stacked[name] = Column.concatenate(pieces)
    return stacked, length


def spread(found: dict[str, Sequence[Any]], prefix: str, documents: Sequence[Document | None]) -> None:
    """Write nested documents, one a row, as lists of values by joined names.

    Args:
        found: gets the lists; a name that is there keeps its values where the new ones are None.
        prefix: put in front of the names.
        documents: JSON objects; None where a row has none.
    """
    shapes = {tuple(document) for document in documents if document}
    if len(shapes) == 1:
        # Nearly always: the documents are turned round without a look-up for each value.
        (names,) = shapes
        nothing = (None,) * len(names)
        turned = zip(*[document.values() if document else nothing for document in documents], strict=True)
        values_by_name: dict[str, Sequence[Any]] = dict(zip(names, turned, strict=True))
    else:
        filled = [document or _EMPTY for document in documents]
        names = tuple(dict.fromkeys(chain(*sorted(shapes))))
        values_by_name = {name: [document.get(name) for document in filled] for name in names}
    for name, values in values_by_name.items():
        if not prefix and name in LEFT_OUT:
            continue
        if len(found) >= MAX_COLUMNS:
            return
        _spread_values(found, f"{prefix}.{name}" if prefix else name, values)


def _spread_values(found: dict[str, Sequence[Any]], name: str, values: Sequence[Any]) -> None:
    types = set(map(type, values))
    if dict in types:
        spread(found, name, [value if type(value) is dict else None for value in values])
        if types <= {dict, type(None)}:
            return
        values = [None if type(value) is dict else value for value in values]
    if list in types:
        values = _spread_lists(found, name, values)
        types = set(map(type, values))
    if types <= {type(None)}:
        return
    earlier = found.get(name)
    if earlier is not None:
        values = [old if new is None else new for old, new in zip(earlier, values, strict=True)]
    found[name] = values


def _spread_lists(found: dict[str, Sequence[Any]], name: str, values: Sequence[Any]) -> list[Any]:
    """Write lists of records item by item; return what is no such list."""
    records = [
        value if type(value) is list and value and all(type(item) is dict for item in value) else ()
        for value in values
    ]
    for number in range(min(max(map(len, records)), _MAX_ITEMS)):
        items = [held[number] if number < len(held) else None for held in records]
        spread(found, f"{name}[{number}]", items)
    return [None if held or value == [] else value for held, value in zip(records, values, strict=True)]


def with_derived(columns: dict[str, Column], length: int) -> Frame:
    """Return the table of some columns, with those that follow from others."""
    frame = Frame(columns, length)
    extra = {
        "status": _status(frame),
        "disturbed": _disturbed(frame),
        "ate.extended": _extended(frame),
    }
    return Frame(columns | {name: column for name, column in extra.items() if not column.is_empty}, length)


def _status(frame: Frame) -> Column:
    """Return what ``pivot.status`` says of each row."""
    names = ("outcome", "phase", "reason")
    parts = [frame.column(name) for name in names]
    nothing = np.full(len(frame), -1)
    codes = [nothing if part.kind.is_numeric else part.codes for part in parts]
    combined = np.zeros(len(frame), dtype=np.int64)
    for part, code in zip(parts, codes, strict=True):
        combined = combined * (len(part.values) + 1) + code + 1
    _, firsts, places = np.unique(combined, return_index=True, return_inverse=True)
    words = []
    for row in firsts.tolist():
        outcome, phase, reason = (
            part.values[code[row]] if code[row] >= 0 else None
            for part, code in zip(parts, codes, strict=True)
        )
        if not outcome and phase == Phase.SUCCEEDED.value:
            outcome = "NotEvaluated"
        words.append(str(outcome or reason or phase))
    kept = sorted(set(words))
    lookup = np.array([kept.index(word) for word in words], dtype=np.int32)
    return Column.of_codes(lookup[places], kept)


def _disturbed(frame: Frame) -> Column:
    wall = frame.column("usage.wallSeconds").floats()
    contended = np.nan_to_num(frame.column("usage.contendedSeconds").floats())
    throttled = np.nan_to_num(frame.column("usage.throttledSeconds").floats())
    found = (wall > 0) & ((contended > MAX_CONTENDED * wall) | (throttled > MAX_THROTTLED * wall))
    return Column.of_numbers(found, ColumnKind.BOOLEAN)


def _extended(frame: Frame) -> Column:
    coverage = frame.column("coverage").floats()
    error = frame.column("ate.rmse").floats()
    factor = np.select([coverage >= 0.75, coverage >= 0.5, coverage >= 0.25], [1.0, 2.0, 5.0], 10.0)
    return Column.of_numbers(np.where(np.isnan(coverage), np.nan, error * factor))
