# SPDX-License-Identifier: Apache-2.0
"""The table of runs: columns, one row a run and evaluation. Commands, pages, reports and analyses read it."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.columns import Column, count_distinct
from slamhive.analysis.flattening import CORE_COLUMNS
from slamhive.analysis.measures import LATE_SECONDS, UNDISTURBED, columns_ending_in, measure_of
from slamhive.model.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from collections.abc import Set as AbstractSet

    from slamhive.analysis.columns import Indices, Mask

    Declared = Mapping[str, Mapping[str, str]]

DERIVED = frozenset(
    {
        *("status", "disturbed", "superseded", "algorithm.version", "dataset.version", "ate.extended"),
        LATE_SECONDS,
        UNDISTURBED,
        "search",
        "origin",
    }
)
"""Columns that follow from others."""

OWN_COLUMNS = DERIVED | {"id", "sweep.uid", "namespace", "cluster"}
"""Columns beside the core ones that every table has: identities, and what follows from others."""


class Frame:
    """A table of columns, or some rows of one; never changed.

    Args:
        columns: by name, equally long.
        length: number of rows.
        rows: places of the rows meant, all of them unless given.
        declared: by algorithm, what its manifest says of its parameters: the unit of each column, empty for
            those without.
    """

    def __init__(
        self,
        columns: Mapping[str, Column],
        length: int,
        rows: Indices | None = None,
        declared: Declared | None = None,
    ) -> None:
        self._columns = columns
        self._length = length
        self._rows = rows
        self.declared: Declared = declared or {}
        self._own: dict[str, Column] = {}
        self._taken: dict[str, Column] = {}
        self._standing: dict[Any, Mask] = {}

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

    @cached_property
    def units(self) -> dict[str, str]:
        """The units of settings, by column: those that all algorithms of these rows agree on."""
        if not any(any(units.values()) for units in self.declared.values()):
            return {}
        algorithms = self.column("algorithm")
        codes = np.unique(algorithms.codes[algorithms.present]).tolist()
        known = [
            self.declared[name] for name in map(algorithms.values.__getitem__, codes) if name in self.declared
        ]
        strange = np.isin(algorithms.codes, [c for c in codes if algorithms.values[c] not in self.declared])
        found = {}
        for column in {column for units in known for column, unit in units.items() if unit}:
            told = {units[column] for units in known if column in units}
            if len(told) == 1 and not (strange & self.column(column).present).any():
                found[column] = told.pop()
        return found

    def has(self, name: str) -> bool:
        """Tell whether there is a column of a name."""
        return name in self._columns or name in CORE_COLUMNS or name in OWN_COLUMNS

    def require(self, names: Iterable[str], argument: str = "") -> None:
        """Refuse names of no column, which an argument may have given.

        Raises:
            UnknownNameError: with the nearest name.
        """
        for name in names:
            if not self.has(name):
                raise UnknownNameError("column", name, self.names, argument=argument)

    def resolve(self, name: str, argument: str = "") -> str:
        """Return the column that a name means: its whole name, or its last part where that is clear.

        Args:
            name: as it was written.
            argument: what gave it.

        Raises:
            InputError: it is unknown, or means several.
        """
        if self.has(name):
            return name
        if self.has(f"{name}.rmse"):
            return f"{name}.rmse"
        # What nobody knows a value of has its column all the same, as a whole name has.
        found = columns_ending_in(name, self._columns) or columns_ending_in(name, CORE_COLUMNS)
        if len(found) > 1:
            raise InputError(f"{name!r} may be {', '.join(found[:6])}; write which", argument)
        if not found:
            raise UnknownNameError("column", name[:100], self.names, argument=argument)
        return found[0]

    def resolve_key(self, name: str, argument: str = "") -> str:
        """Return the column that a name means, by which runs are told apart.

        Raises:
            InputError: it is unknown, means several, or is a result, of which each run has its own.
        """
        found = self.resolve(name, argument)
        if measure_of(found).better:
            raise InputError(f"{found} is a result, each run has one of its own; -m averages it", argument)
        return found

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
        chosen = Frame(self._columns, self._length, self.rows[rows], self.declared)
        chosen._own = {name: column.take(rows) for name, column in self._own.items()}
        chosen._standing = self._standing
        return chosen

    def standing(self, tell: Callable[[Frame], Mask], reads: AbstractSet[str]) -> Mask:
        """Return a function's answers on the rows, (n,), found once for the whole table and all its parts.

        Args:
            tell: the function.
            reads: columns that it follows from; rows that have others of their own in their place are asked
                by themselves.
        """
        if not reads.isdisjoint(self._own):
            return tell(self)
        found = self._standing.get(tell)
        if found is None:
            found = self._standing[tell] = tell(Frame(self._columns, self._length))
        return found if self._rows is None else found[self._rows]

    def count_runs(self, mask: Mask | None = None) -> int:
        """Return the number of runs that rows are of, all or some: one has a row for each evaluation."""
        ids = self.column("id").floats()
        return count_distinct(ids if mask is None else ids[mask])

    def replaced(self, columns: Mapping[str, Column]) -> Frame:
        """Return the same rows with other columns of some names."""
        changed = Frame(self._columns, self._length, self._rows, self.declared)
        changed._own = self._own | dict(columns)
        changed._standing = self._standing
        return changed

    def without(self, names: Iterable[str]) -> Frame:
        """Return the same rows without what some columns hold."""
        dropped = set(names)
        left = {name: column for name, column in self._columns.items() if name not in dropped}
        return Frame(left, self._length, self._rows, self.declared)

    def declaring(self, declared: Declared) -> Frame:
        """Return the same rows, with what manifests say of parameters."""
        changed = Frame(self._columns, self._length, self._rows, declared)
        changed._own = self._own
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
