# SPDX-License-Identifier: Apache-2.0
"""Marks of runs: a number for each that differs when what is looked at of the run or its results does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.compact.texts import FACTOR, MARKS

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from slamhive.analysis.columns import Column, Mask

    Ids = npt.NDArray[np.int64]
    Numbers = npt.NDArray[np.uint64]


@dataclass(frozen=True, eq=False)
class RunMarks:
    """Marks of runs by their ids, the same in every process and whatever other rows there are.

    Attributes:
        ids: of the runs, ascending, (n,).
        marks: of the runs, (n,).
    """

    ids: Ids
    marks: Numbers

    @classmethod
    def of(cls, runs: Sequence[Column], results: Sequence[Column]) -> RunMarks:
        """Return the marks of some runs.

        Args:
            runs: what counts of the runs, column by column, ids first, in their order.
            results: the same of results, ids of their runs first.
        """
        ids = _ids(runs[0])
        return cls(ids, _marks(runs)).with_results(results)

    @classmethod
    def joined(cls, parts: Sequence[RunMarks]) -> RunMarks:
        """Return the marks of several parts, whose ids ascend."""
        if not parts:
            return cls(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.uint64))
        return cls(np.concatenate([one.ids for one in parts]), np.concatenate([one.marks for one in parts]))

    def with_results(self, results: Sequence[Column]) -> RunMarks:
        """Return the marks with those of results added: a sum, as results come in no order."""
        if not results or not len(results[0]):
            return self
        ids, marks = _ids(results[0]), self.marks.copy()
        mine = self._holds(ids)
        np.add.at(marks, np.searchsorted(self.ids, ids[mine]), _marks(results)[mine])
        return RunMarks(self.ids, marks)

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.ids)

    def same_as(self, other: RunMarks) -> bool:
        """Tell whether runs and marks are the same."""
        return np.array_equal(self.ids, other.ids) and np.array_equal(self.marks, other.marks)

    def changed_since(self, before: RunMarks) -> Ids:
        """Return the ids of the runs that were not there before, or had another mark."""
        there = before._holds(self.ids)
        there[there] = before.marks[np.searchsorted(before.ids, self.ids[there])] == self.marks[there]
        return self.ids[~there]

    def _holds(self, ids: Ids) -> Mask:
        places = np.searchsorted(self.ids, ids)
        found: Mask = np.zeros(len(ids), dtype=bool)
        inside = places < len(self.ids)
        found[inside] = self.ids[places[inside]] == ids[inside]
        return found


def _ids(column: Column) -> Ids:
    return column.numbers.astype(np.int64)


def _marks(columns: Sequence[Column]) -> Numbers:
    """Return the mark of each row.

    Column by column: each value's number is turned by an odd factor of the column's own and added.
    """
    total = np.zeros(len(columns[0]), dtype=np.uint64)
    for place, column in enumerate(columns):
        numbers = column.marks()
        total += (numbers ^ (numbers >> np.uint64(29))) * np.uint64(pow(FACTOR, 2 * place + 1, MARKS))
    found: Numbers = total ^ (total >> np.uint64(32))
    return found
