# SPDX-License-Identifier: Apache-2.0
"""Figures of many groups of runs at once: summaries, medians with failures, outcomes; grouping.py asks.

A table may have a group a run. So what can be is done for all groups by one call of NumPy, and records of
groups are made where somebody goes through them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from slamhive.analysis.columns import counted
from slamhive.analysis.statistics import ENOUGH, Interval, Numbers, Summary, mean_interval, median_interval

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import numpy.typing as npt

    from slamhive.analysis.columns import Floats, Indices, Mask
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.statistics import Summaries

_KEPT = 1000
"""Groups up to which they are kept once they were made; of more as many are made at a time."""


@dataclass(frozen=True)
class Figure:
    """A metric over a group of runs.

    Attributes:
        summary: of the numbers that count; None for none.
        points: the numbers themselves, where they are few.
        mean_interval, median_interval: from 10 numbers on.
        censored: runs that failed, ranked behind all others.
        censored_median: median of all runs so ranked; infinite when it is a failed run.
    """

    summary: Summary | None
    points: tuple[float, ...] = ()
    mean_interval: Interval | None = None
    median_interval: Interval | None = None
    censored: int = 0
    censored_median: float | None = None

    @property
    def middle(self) -> float | None:
        """The median, runs that failed in an error behind all others; infinite when it is one of them."""
        if self.censored_median is not None:
            return self.censored_median
        return self.summary.median if self.summary else None

    @property
    def ends(self) -> tuple[float, ...]:
        """The range of few runs, the interval of the median of many; fewer than two where unknown."""
        interval = self.median_interval
        if interval is not None:
            return tuple(end for end in (interval.low, interval.high) if math.isfinite(end))
        return (self.summary.min, self.summary.max) if self.summary and self.summary.n > 1 else ()


@dataclass(frozen=True)
class Cell:
    """Figures, failures and coverage of a group of runs: one row of an aggregated table.

    Attributes:
        keys: the values that its runs share, by column.
        runs: number of rows: runs, each once an evaluation; n, copies and all failures together.
        n: number of results that count: runs with equal trajectories are one, where a metric is of those.
        copies: number of runs that count and whose result another one of n has.
        failures: number of runs that don't, by what became of them.
        untracked: number of runs that count without being tracked, by what became of them.
        coverage: of the evaluated runs, and 0 for those that failed of themselves.
        figures: by column.
        findings: codes of what was known to be wrong with the recordings of its runs, sorted.
        reader: whether its figures of CPU hold the reading of the recording, or may, and others' don't.
        late: whether poses of some of its runs came late, so that its memory holds frames that waited.
        chosen: whether a search chose some of its runs by its results.
    """

    keys: dict[str, Any]
    runs: int
    n: int
    copies: int
    failures: dict[str, int]
    untracked: dict[str, int]
    coverage: Summary | None
    figures: dict[str, Figure]
    findings: tuple[str, ...] = ()
    reader: bool = False
    late: bool = False
    chosen: bool = False

    @property
    def deterministic(self) -> bool:
        """True if the runs that count, more than one, have the very same trajectory."""
        return self.n == 1 and self.copies > 0


class Places:
    """The rows of groups, one group after the other.

    Args:
        sizes: how many rows each group has, (groups,).
        order: the rows, (n,); those of the frame as they are unless given.
    """

    def __init__(self, sizes: Indices, order: Indices | slice = slice(None)) -> None:
        self.order = order
        self.sizes = sizes
        self.count = len(sizes)
        self.of_row: Indices = np.repeat(np.arange(self.count), sizes)
        """The group of each row, in their order, (n,)."""

    def numbers(self, values: Floats, inside: Mask) -> Numbers:
        """Return the numbers of all groups.

        Args:
            values: of each row of the frame, NaN where unknown.
            inside: which of these rows count.
        """
        mine = values[self.order]
        kept = inside[self.order] & ~np.isnan(mine)
        return Numbers(mine[kept], self.of_row[kept], self.count)

    def counts(self, mask: Mask) -> Indices:
        """Return the number of rows of each group in a mask, (groups,)."""
        return np.bincount(self.of_row[mask[self.order]], minlength=self.count)

    def tallies(self, words: Sequence[str], codes: Indices, inside: Mask) -> dict[int, dict[str, int]]:
        """Return the count of each word in each group that has one, the words sorted.

        Args:
            words: what codes stand for.
            codes: the word of each row of the frame.
            inside: which of these rows count.
        """
        kept = inside[self.order]
        cells = self.of_row[kept] * len(words) + codes[self.order][kept]
        used, counts = counted(cells, self.count * len(words))
        found: dict[int, dict[str, int]] = {}
        ranked = sorted(
            zip(used.tolist(), counts.tolist(), strict=True), key=lambda one: words[one[0] % len(words)]
        )
        for cell, count in ranked:
            group, word = divmod(cell, len(words))
            found.setdefault(group, {})[words[word]] = count
        return found


class GroupFigures(Sequence[Figure]):
    """The figures of a metric over groups: columns, of which one is made when it is asked for.

    Args:
        numbers: those that count; of an error, failed runs rank behind all others.
        failed: number of failed runs of each group, (groups,); None where they have no rank.
        sign: -1 where large numbers are good: then failed runs are below all others.

    Attributes:
        summaries: of the numbers.
    """

    def __init__(self, numbers: Numbers, failed: Indices | None = None, sign: float = 1.0) -> None:
        self._numbers, self._failed, self._sign = numbers, failed, sign
        self._costs = numbers.times(sign)
        self.summaries = numbers.summaries()
        self._middles = None if failed is None else self._costs.medians(failed)

    def __len__(self) -> int:
        """Return the number of groups."""
        return len(self.summaries.n)

    @overload
    def __getitem__(self, place: int) -> Figure: ...
    @overload
    def __getitem__(self, place: slice) -> list[Figure]: ...
    def __getitem__(self, place: int | slice) -> Figure | list[Figure]:
        """Return the figure of a group, or those of several."""
        if isinstance(place, slice):
            return [self[group] for group in range(*place.indices(len(self)))]
        summary = self.summaries.of(place)
        behind = 0 if self._failed is None else int(self._failed[place])
        middle = None
        if self._middles is not None and not np.isnan(cost := self._middles[place]):
            middle = self._sign * float(cost)
        interval = of_median = None
        if summary and summary.n >= ENOUGH:
            interval = mean_interval(summary)
        if (summary.n if summary else 0) + behind >= ENOUGH:
            ordered = np.concatenate([self._costs.ordered(place), np.full(behind, np.inf)])
            of_median = median_interval(ordered)
        turned = of_median and of_median.times(self._sign)
        return Figure(summary, self._numbers.points(place), interval, turned, behind, middle)


@dataclass(frozen=True)
class CellColumns:
    """Columns of groups; words are of those alone that have some.

    Attributes:
        keys: their first rows.
        names: columns that tell them apart.
        runs, n, copies, coverage, figures, reader, late, chosen: as those of `Cell`, for each group.
        failures, untracked: as those of `Cell`, by the group.
        findings: codes of what was known to be wrong with recordings, by the group.
    """

    keys: Frame
    names: tuple[str, ...]
    runs: Indices
    n: Indices
    copies: Indices
    failures: Mapping[int, dict[str, int]]
    untracked: Mapping[int, dict[str, int]]
    coverage: Summaries
    figures: Mapping[str, GroupFigures]
    findings: Mapping[int, tuple[str, ...]]
    reader: Mask
    late: Mask
    chosen: Mask


class Cells(Sequence[Cell]):
    """Groups of runs, each made when it is asked for: a table may have a group a run.

    Args:
        columns: what there is of them.
        order: their places in the columns, (n,).
    """

    def __init__(self, columns: CellColumns, order: Indices) -> None:
        self.columns = columns
        self.order = order

    def __len__(self) -> int:
        """Return the number of groups."""
        return len(self.order)

    @overload
    def __getitem__(self, place: int) -> Cell: ...
    @overload
    def __getitem__(self, place: slice) -> list[Cell]: ...
    def __getitem__(self, place: int | slice) -> Cell | list[Cell]:
        """Return a group, or several."""
        places = self.order[place : place + 1 or None] if isinstance(place, int) else self.order[place]
        if isinstance(place, slice):
            return self._made(places)
        if not len(places):
            raise IndexError(f"there are {len(self)} groups, and none is number {place}")
        return self._few[place] if len(self) <= _KEPT else self._made(places)[0]

    def __iter__(self) -> Iterator[Cell]:
        """Go through the groups."""
        if len(self) <= _KEPT:
            yield from self._few
            return
        for start in range(0, len(self), _KEPT):
            yield from self._made(self.order[start : start + _KEPT])

    @cached_property
    def _few(self) -> list[Cell]:
        return self._made(self.order)

    def _made(self, places: Indices) -> list[Cell]:
        held = self.columns
        found = []
        keys = held.keys.select(places).records(held.names)
        for group, key in zip(places.tolist(), keys, strict=True):
            found.append(
                Cell(
                    key,
                    int(held.runs[group]),
                    int(held.n[group]),
                    int(held.copies[group]),
                    held.failures.get(group, {}),
                    held.untracked.get(group, {}),
                    held.coverage.of(group),
                    {name: figures[group] for name, figures in held.figures.items()},
                    held.findings.get(group, ()),
                    bool(held.reader[group]),
                    bool(held.late[group]),
                    bool(held.chosen[group]),
                )
            )
        return found

    @property
    def keys(self) -> Frame:
        """The values that tell groups apart, a row each."""
        return self.columns.keys.select(self.order)

    def sorted(self, names: Sequence[str]) -> Cells:
        """Return the groups in the order of keys, means of metrics, coverage or n.

        Args:
            names: a dash before one turns its order round. What is missing comes last either way.
        """
        turned = [self._ranks(name) for name in reversed(names)]
        return Cells(self.columns, self.order[np.lexsort(turned)]) if turned else self

    def _ranks(self, name: str) -> Floats:
        held, column = self.columns, name.removeprefix("-")
        if column in held.names:
            ranks = self.keys.column(column).ranks()
        elif column == "n":
            ranks = held.n[self.order].astype(np.float64)
        else:
            of = held.coverage if column == "coverage" else held.figures[column].summaries
            means = of.mean[self.order]
            ranks = np.where(np.isnan(means), np.inf, means)
        return np.where(np.isinf(ranks), np.inf, -ranks) if name.startswith("-") else ranks


def different(codes: npt.NDArray[np.signedinteger[Any]]) -> Indices:
    """Return the places of codes that are like no earlier one; each below 0 is like none."""
    return np.flatnonzero(~again(codes) | (codes < 0))


def again(*codes: npt.NDArray[np.integer[Any]]) -> Mask:
    """Tell which places have the same codes as an earlier one, (n,)."""
    found: Mask = np.zeros(len(codes[0]), dtype=bool)
    order = np.lexsort(codes)  # equal ones stay in their order
    found[order[1:]] = np.logical_and.reduce([one[order[1:]] == one[order[:-1]] for one in codes])
    return found
