# SPDX-License-Identifier: Apache-2.0
"""Tests of a gate: how much worse a figure became over all cells, how sure that is, and where it stands out.

Cells are fixed, their repetitions are what varies: a figure's shift is the mean over cells of how much worse
it became, its standard error follows from the spread within cells (Welch 1947, Satterthwaite 1946).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.gating.figures import MarginScale
from slamhive_eval.statistics import student_quantile, student_tail

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.columns import Floats
    from slamhive.analysis.gating.cells import GateCell
    from slamhive.analysis.gating.figures import GateFigure

_EXCHANGES = 20_000

_SHRUNK = 20.0
"""Runs that the share of failures of all cells weighs in that of one."""

_RARELY = 0.1
"""Weight of what was recorded otherwise: no failure after some, some after none."""

_STANDS_OUT = 2.0
"""Margins beyond which one cell may stand out, though all together are within one."""


@dataclass(frozen=True)
class CellShift:
    """Shift of one cell.

    Attributes:
        cell: its number.
        shift: how much worse, on the scale of the figure.
        counts: numbers before and now.
        variance: of a number; None where nothing tells.
        degrees: of freedom of that.
        exact: whether all numbers of each side are equal, several now: nothing varies.
        above: whether each number now is worse than all before.
    """

    cell: int
    shift: float
    counts: tuple[int, int]
    variance: float | None
    degrees: int
    exact: bool
    above: bool

    @property
    def chance(self) -> float:
        """Chance that so many runs come behind all those before, were they alike: exact."""
        if not self.above:
            return 1.0
        return 0.0 if self.exact else 1 / math.comb(sum(self.counts), self.counts[1])


@dataclass(frozen=True)
class Shift:
    """Shift of a figure over all cells in which both sides have numbers.

    Attributes:
        cells: one by one.
        mean: how much worse.
        error: standard error; None where nothing tells the spread.
        degrees: of freedom.
    """

    cells: Sequence[CellShift]
    mean: float
    error: float | None
    degrees: int

    def reach(self, level: float) -> float:
        """Return the distance from the mean to an end of the interval, at a one-sided level."""
        if self.error is None:
            return math.inf
        return student_quantile(1 - level, self.degrees) * self.error if self.error else 0.0

    def chance(self, *, worse: bool = True) -> float:
        """Return the one-sided p of no shift against one to the worse, or to the better."""
        away = self.mean if worse else -self.mean
        if self.error is None or away <= 0:
            return 1.0
        return student_tail(away / self.error, self.degrees) if self.error else 0.0


def shift_of(figure: GateFigure, cells: Sequence[GateCell]) -> Shift | None:
    """Return the shift of a figure over all cells; None where no cell has numbers on both sides."""
    found = []
    for number, cell in enumerate(cells):
        before, now = (
            figure.sign * side.numbers(figure.name, logarithms=figure.scale is MarginScale.RATIO)
            for side in (cell.before, cell.now)
        )
        if len(before) and len(now):
            found.append(_cell_shift(number, before, now))
    if not found:
        return None
    known = [one for one in found if one.variance is not None]
    pooled = sum((one.variance or 0) * one.degrees for one in known)
    total = sum(one.degrees for one in known)
    mean = float(np.mean([one.shift for one in found]))
    # Of one number a side nothing tells the spread, and one alone says nothing of what varied never before.
    if not total or any(one.variance == 0 and one.counts[1] == 1 and one.shift for one in found):
        return Shift(found, mean, None, 1)
    terms, weights = 0.0, 0.0
    for one in found:
        variance = pooled / total if one.variance is None else one.variance
        term = variance * sum(1 / count for count in one.counts) / len(found) ** 2
        terms += term
        weights += term**2 / (one.degrees or total)
    degrees = math.floor(terms**2 / weights) if weights else total
    return Shift(found, mean, math.sqrt(terms), max(1, degrees))


def _cell_shift(number: int, before: Floats, now: Floats) -> CellShift:
    degrees = len(before) + len(now) - 2
    squares = sum(float(((side - side.mean()) ** 2).sum()) for side in (before, now))
    still = all(bool((side == side[0]).all()) for side in (before, now))
    return CellShift(
        cell=number,
        shift=float(now.mean() - before.mean()) if not still else float(now[0] - before[0]),
        counts=(len(before), len(now)),
        variance=(0.0 if still else squares / degrees) if degrees else None,
        degrees=degrees,
        exact=still and min(len(before), len(now)) > 1,
        above=bool(now.min() > before.max()),
    )


def permuted_chance(figure: GateFigure, cells: Sequence[GateCell]) -> float:
    """Return the one-sided p of a figure's mean shift by exchanging runs of before and now within cells.

    However runs are distributed it is right, of few runs too, where Student's t trusts in a normal one: a
    single run of a heavy tail isn't called worse. Exact up to 20,000 exchanges, else by as many at random.
    """
    both, seen, ways = [], 0.0, 1
    for cell in cells:
        before, now = (
            figure.sign * side.numbers(figure.name, logarithms=figure.scale is MarginScale.RATIO)
            for side in (cell.before, cell.now)
        )
        if len(before) and len(now):
            both.append((np.concatenate([before, now]), len(now)))
            seen += float(now.mean() - before.mean())
            ways *= math.comb(len(before) + len(now), len(now))
    random = np.random.default_rng(0)
    shifts = np.zeros(1 if ways <= _EXCHANGES else _EXCHANGES)
    for numbers, count in both:
        total, others = float(numbers.sum()), len(numbers) - count
        if ways <= _EXCHANGES:
            sums = np.array([sum(chosen) for chosen in combinations(numbers.tolist(), count)])
        else:
            places = np.argpartition(random.random((_EXCHANGES, len(numbers))), count - 1, axis=1)
            sums = numbers[places[:, :count]].sum(axis=1)
        drawn = sums / count - (total - sums) / others
        shifts = (shifts[:, None] + drawn).ravel() if ways <= _EXCHANGES else shifts + drawn
    beyond = int(np.count_nonzero(shifts >= seen - 1e-12 * (1 + abs(seen))))
    return beyond / ways if ways <= _EXCHANGES else (beyond + 1) / (_EXCHANGES + 1)


def standing_out(figure: GateFigure, shift: Shift) -> list[CellShift]:
    """Return the cells whose runs are all worse than any before, by over two margins, the worst first."""
    found = [one for one in shift.cells if one.above and one.shift > _STANDS_OUT * figure.bound]
    return sorted(found, key=lambda one: -one.shift)


def failure_chances(cells: Sequence[GateCell]) -> tuple[float, float]:
    """Return the exact one-sided p of no more failures than before, and of no fewer.

    Conditional on how many of each cell failed in all (Fisher's test, stratified): the failures now are then
    sums of hypergeometric numbers.
    """
    spread = np.ones(1)
    seen = 0
    for cell in cells:
        if not cell.before.count or not cell.now.count:
            continue
        failed = cell.before.failed + cell.now.failed
        ways = [
            math.comb(cell.now.count, k) * math.comb(cell.before.count, failed - k)
            for k in range(min(failed, cell.now.count) + 1)
        ]
        spread = np.convolve(spread, np.array(ways, dtype=np.float64) / sum(ways))
        seen += cell.now.failed
    return float(spread[seen:].sum()), float(spread[: seen + 1].sum())


def failure_evidence(cells: Sequence[GateCell], margin: float) -> float:
    """Return the evidence that runs fail less often than before by a margin more, as a betting factor.

    It is a mean of two likelihood ratios against the recorded share plus the margin: of no failure, which
    weighs more where none was recorded, and of about the recorded share. Where failures are as frequent as
    that, it is beyond 1/α with a probability of α at most, however often one looks (Ville 1939).
    """
    never, recorded = 0.0, 0.0
    lost = sum(cell.before.failed for cell in cells)
    usually = (lost + 0.5) / (sum(cell.before.count for cell in cells) + 1)
    weight = _RARELY if lost else 1 - _RARELY
    for cell in cells:
        # Of few runs a cell's own share is little known: it is drawn towards that of all.
        usual = (cell.before.failed + _SHRUNK * usually) / (cell.before.count + _SHRUNK)
        limit = usual + margin
        if limit >= 1:
            continue
        good = cell.now.count - cell.now.failed
        never += -math.inf if cell.now.failed else -good * math.log1p(-limit)
        recorded += good * math.log((1 - usual) / (1 - limit)) + cell.now.failed * math.log(usual / limit)
    return weight * math.exp(min(never, 700)) + (1 - weight) * math.exp(min(recorded, 700))


def failure_bound(cells: Sequence[GateCell], level: float) -> float:
    """Return the least margin, in thousandths, within which failures surely are; 1 where none is."""
    low, high = 0, 1000
    while low < high:
        middle = (low + high) // 2
        if middle and failure_evidence(cells, middle / 1000) >= 1 / level:
            high = middle
        else:
            low = middle + 1
    return high / 1000


def failure_share(cells: Sequence[GateCell], *, now: bool) -> float:
    """Return the share of runs that failed, the mean over the cells that have any."""
    sides = [cell.now if now else cell.before for cell in cells]
    shares = [side.failed / side.count for side in sides if side.count]
    return float(np.mean(shares)) if shares else math.nan
