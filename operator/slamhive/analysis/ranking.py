# SPDX-License-Identifier: Apache-2.0
"""Runs of groups by a figure, the best first and failed ones last: shares that reach a value, quartiles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.cells import Places
from slamhive.analysis.grouping import Copies, counting, ranked_errors, sound, tally, worst
from slamhive.analysis.measures import follows_trajectory, measure_of
from slamhive.analysis.statistics import median_of_sorted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.analysis.columns import Floats, Indices, Mask
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.grouping import Groups, Outcomes


@dataclass(frozen=True)
class Ranked:
    """The runs of a group by a figure.

    Attributes:
        costs: of the runs that have one, sorted, then infinite ones of those that failed, (total,).
        sign: what makes figures of costs: -1 where large is good, else 1.
        runs: all of the group.
        left_out: those that say nothing of the algorithm, by what became of them.
        failures: those that failed, by what became of them.
        copies: number of those that repeat a result that has its place among the costs already.
    """

    costs: Floats
    sign: float
    runs: int
    left_out: dict[str, int]
    failures: dict[str, int]
    copies: int = 0

    @property
    def total(self) -> int:
        """The number of results that have a rank."""
        return len(self.costs)

    @property
    def n(self) -> int:
        """The number of results that reached a value."""
        return int(np.isfinite(self.costs).sum())

    @property
    def values(self) -> Floats:
        """The values that were reached, the best first, (n,)."""
        return self.sign * self.costs[: self.n]

    @property
    def shares(self) -> Floats:
        """Shares of the results that are as good as each value or better, (n,): failed ones never are."""
        return np.arange(1, self.n + 1) / max(self.total, 1)

    @property
    def median(self) -> float | None:
        """The median of the runs, infinite where it is a failed one; None for none."""
        return self.sign * median_of_sorted(self.costs) if self.total else None

    @property
    def quartiles(self) -> tuple[float | None, float | None, float | None]:
        """The quartiles by value, infinite where they are failed runs'; None for none."""
        if not self.total:
            return None, None, None
        last, found = self.total - 1, []
        for share in (0.25, 0.5, 0.75):
            below, above = self.costs[math.floor(last * share)], self.costs[math.ceil(last * share)]
            cost = below + (above - below) * (last * share % 1) if below < above else below
            found.append(self.sign * float(cost))
        first, second, third = sorted(found)
        return first, second, third


class Ranking:
    """Ranking of runs by a figure, failed ones last: arrays over all rows, taken out of their columns once.

    Args:
        frame: the rows.
        metric: column of numbers.
        which: the runs that count.
    """

    def __init__(self, frame: Frame, metric: str, which: Outcomes) -> None:
        self.sign = measure_of(metric).sign
        self._costs: Floats = self.sign * frame.column(metric).floats()
        self.inside: Mask = counting(frame, which) & sound(frame, metric, which) & ~np.isnan(self._costs)
        """Rows with a number that counts, (n,)."""
        self.failed: Mask = worst(frame, metric, which) & ~self.inside
        """Rows that rank behind all of them, (n,)."""
        status = frame.column("status")
        self._words, self._status = status.values, status.codes
        self._copies = Copies(frame, which) if follows_trajectory(metric) else None

    def medians(self, groups: Groups) -> Floats:
        """Return the median cost of each group, failed runs last, (groups,): NaN where no run has a rank."""
        places = Places(groups.sizes, groups.order)
        once = self._once(groups.of_row)
        return places.numbers(self._costs, self.inside & once).medians(places.counts(self.failed & once))

    def _once(self, of_row: Indices) -> Mask:
        if self._copies is None:
            return np.ones(len(of_row), dtype=bool)
        return ~self._copies.among(of_row)

    def each(self, groups: Groups) -> Iterator[Ranked]:
        """Go through the runs of each group."""
        once = self._once(groups.of_row)
        for rows in groups.members():
            yield self._of(rows, once[rows])

    def _of(self, rows: Indices, once: Mask) -> Ranked:
        inside, failed, status = self.inside[rows], self.failed[rows], self._status[rows]
        return Ranked(
            costs=ranked_errors(self._costs[rows], inside & once, failed & once),
            copies=int(np.count_nonzero((inside | failed) & ~once)),
            sign=self.sign,
            runs=len(rows),
            left_out=tally(self._words, status[~(inside | failed)]),
            failures=tally(self._words, status[failed]),
        )
