# SPDX-License-Identifier: Apache-2.0
"""Runs as a table of columns, one row a run and evaluation: what the dashboard and its analyses read.

The columns have the names that ``flatten`` gives them; both are tested against each other. Beside them:
``status`` (what became of the run in one word), ``disturbed`` (other work falsified its load) and
``ate.extended`` (the original system's error that grows as coverage falls).
"""

from __future__ import annotations

from functools import cached_property
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
        return [*CORE_COLUMNS, *sorted(self._columns.keys() - set(CORE_COLUMNS))]

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
        return name in self._columns or name in CORE_COLUMNS

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
            whole = self._columns.get(name)
            if whole is None:
                found = Column.missing(len(self))
            else:
                found = whole if self._rows is None else whole.take(self._rows)
            self._taken[name] = found
        return found

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

    @classmethod
    def concatenate(cls, frames: Sequence[Frame]) -> Frame:
        """Return tables one below the other."""
        filled = [frame for frame in frames if len(frame)]
        if len(filled) == 1:
            return filled[0]
        names = dict.fromkeys(name for frame in filled for name in frame.stored)
        columns = {name: Column.concatenate([frame.column(name) for frame in filled]) for name in names}
        return cls(columns, sum(map(len, filled)))


def spread(found: dict[str, list[Any]], prefix: str, documents: Sequence[Document | None]) -> None:
    """Write nested documents, one a row, as lists of values by joined names.

    Args:
        found: gets the lists; a name that is there keeps its values where the new ones are None.
        prefix: put in front of the names.
        documents: JSON objects; None where a row has none.
    """
    filled = [document or _EMPTY for document in documents]
    names: dict[str, None] = {}
    for shape in dict.fromkeys(map(tuple, filled)):
        names.update(dict.fromkeys(shape))
    for name in names:
        if not prefix and name in LEFT_OUT:
            continue
        if len(found) >= MAX_COLUMNS:
            return
        _spread_values(
            found, f"{prefix}.{name}" if prefix else name, [document.get(name) for document in filled]
        )


def _spread_values(found: dict[str, list[Any]], name: str, values: list[Any]) -> None:
    types = set(map(type, values))
    if dict in types:
        spread(found, name, [value if type(value) is dict else None for value in values])
        if types <= {dict, type(None)}:
            return
        values = [None if type(value) is dict else value for value in values]
    if list in types:
        lists = [value if type(value) is list else () for value in values]
        records = [items if items and all(type(item) is dict for item in items) else () for items in lists]
        for number in range(min(max(map(len, records)), _MAX_ITEMS)):
            spread(
                found,
                f"{name}[{number}]",
                [items[number] if number < len(items) else None for items in records],
            )
        values = [None if records[row] or value == [] else value for row, value in enumerate(values)]
    if any(map(_is_something, values)):
        earlier = found.get(name)
        if earlier is not None:
            values = [old if new is None else new for old, new in zip(earlier, values, strict=True)]
        found[name] = values


def _is_something(value: Any) -> bool:
    return value is not None


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
    codes = [(nothing if part.kind.is_numeric else part.codes).tolist() for part in parts]
    words: dict[tuple[int, ...], int] = {}
    kept: list[str] = []
    result = np.empty(len(frame), dtype=np.int32)
    for row, key in enumerate(zip(*codes, strict=True)):
        place = words.get(key)
        if place is None:
            outcome, phase, reason = (
                part.values[code] if code >= 0 else None for part, code in zip(parts, key, strict=True)
            )
            if not outcome and phase == Phase.SUCCEEDED.value:
                outcome = "NotEvaluated"
            word = str(outcome or reason or phase)
            if word not in kept:
                kept.append(word)
            place = words[key] = kept.index(word)
        result[row] = place
    return Column.of_codes(result, kept)


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
