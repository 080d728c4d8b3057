# SPDX-License-Identifier: Apache-2.0
"""Figures of many groups of runs at once: summaries, medians with failures, outcomes; grouping.py asks.

A table may have a group a run. So what can be is done for all groups by one call of NumPy, and what stays in
Python is one pass over plain numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.statistics import ENOUGH, Interval, Numbers, Summary, mean_interval, median_interval

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from slamhive.analysis.columns import Floats, Indices, Mask


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
        order: the rows, (n,).
        edges: where each group begins and ends among them.
    """

    def __init__(self, order: Indices, edges: Sequence[tuple[int, int]]) -> None:
        self.order = order
        self.count = len(edges)
        sizes = np.array([end - begin for begin, end in edges], dtype=np.intp)
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

    def tallies(self, words: Sequence[str], codes: Indices, inside: Mask) -> list[dict[str, int]]:
        """Return the count of each word in each group, the words sorted.

        Args:
            words: what codes stand for.
            codes: the word of each row of the frame, (n,).
            inside: which of these rows count.
        """
        kept = inside[self.order]
        cells = self.of_row[kept] * len(words) + codes[self.order][kept]
        used, counts = np.unique(cells, return_counts=True)
        found: list[dict[str, int]] = [{} for _ in range(self.count)]
        ranked = sorted(
            zip(used.tolist(), counts.tolist(), strict=True), key=lambda one: words[one[0] % len(words)]
        )
        for cell, count in ranked:
            group, word = divmod(cell, len(words))
            found[group][words[word]] = count
        return found


def figures(numbers: Numbers, failed: Indices | None = None, sign: float = 1.0) -> list[Figure]:
    """Return the figures of a metric; of an error, failed runs rank behind all others.

    Args:
        numbers: those that count.
        failed: number of failed runs of each group, (groups,); None where they have no rank.
        sign: -1 where large numbers are good: then failed runs are below all others.
    """
    found, costs, summaries = [], numbers.times(sign), numbers.summaries()
    middles: Sequence[float | None] = [None] * len(summaries) if failed is None else costs.medians(failed)
    rows = zip(
        summaries,
        numbers.points(),
        middles,
        [0] * len(summaries) if failed is None else failed.tolist(),
        strict=True,
    )
    for group, (summary, points, cost, behind) in enumerate(rows):
        middle = None if cost is None else sign * cost
        interval = of_median = None
        if summary and summary.n >= ENOUGH:
            interval = mean_interval(summary)
        if (summary.n if summary else 0) + behind >= ENOUGH:
            ordered = np.concatenate([costs.ordered(group), np.full(behind, np.inf)])
            of_median = median_interval(ordered)
        turned = of_median and of_median.times(sign)
        found.append(Figure(summary, points, interval, turned, behind, middle))
    return found


def different(codes: npt.NDArray[np.signedinteger[Any]]) -> Indices:
    """Return the places of codes that are like no earlier one; each below 0 is like none."""
    return np.flatnonzero(~again(codes) | (codes < 0))


def again(*codes: npt.NDArray[np.integer[Any]]) -> Mask:
    """Tell which places have the same codes as an earlier one, (n,)."""
    found: Mask = np.zeros(len(codes[0]), dtype=bool)
    order = np.lexsort(codes)  # equal ones stay in their order
    found[order[1:]] = np.logical_and.reduce([one[order[1:]] == one[order[:-1]] for one in codes])
    return found
