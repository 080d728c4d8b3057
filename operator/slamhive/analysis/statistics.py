# SPDX-License-Identifier: Apache-2.0
"""Statistics for few and for many repetitions, numpy alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval.statistics import student_quantile

if TYPE_CHECKING:
    import numpy.typing as npt

    Floats = npt.NDArray[np.float64]
    Indices = npt.NDArray[np.intp]
    Bytes = npt.NDArray[np.uint8]

LEVEL = 0.95
"""Confidence of all intervals."""

ENOUGH = 10
"""Repetitions from which on an interval is given; below, the points themselves say more."""

_MANY = 100
_ADDED = 1000
"""Numbers of a group beyond which NumPy adds them up, several times as fast."""
_MOST_EXACT = 14
_FLIPS = 20_000
_MOST_PLACED = 128
"""Numbers whose sample's middle places are tabulated at most: a table of their square is made once."""
_QUANTILES = 1 << 14
"""Equally likely quantiles of such a table: finer than what the draws of an interval can tell."""
_SUMS_AT_ONCE = 500_000
"""Sums of differences with flipped signs that are made at once: what a test needs memory for."""


@dataclass(frozen=True)
class Summary:
    """Some numbers in short.

    Attributes:
        n: how many.
        mean: arithmetic mean.
        std: standard deviation of the sample (n − 1 in the denominator), None for one number.
        median, min, max: as their names say.
    """

    n: int
    mean: float
    std: float | None
    median: float
    min: float
    max: float


@dataclass(frozen=True)
class Interval:
    """Confidence interval (95 %) of a figure.

    Attributes:
        low, high: its ends; infinite where failed runs reach into it.
        method: how it was found.
    """

    low: float
    high: float
    method: str

    def times(self, sign: float) -> Interval:
        """Return the interval turned round by -1, as it is by 1."""
        return self if sign > 0 else Interval(-self.high, -self.low, self.method)


@dataclass(frozen=True)
class Summaries:
    """The summaries of many groups as columns.

    Attributes:
        n: how many numbers each has, (groups,).
        mean, std, median, min, max: as those of `Summary`, (groups,), NaN where it has none.
    """

    n: Indices
    mean: Floats
    std: Floats
    median: Floats
    min: Floats
    max: Floats

    def of(self, group: int) -> Summary | None:
        """Return the summary of a group, None for one of nothing."""
        if not self.n[group]:
            return None
        columns = (self.mean, self.std, self.median, self.min, self.max)
        mean, std, median, low, high = (float(column[group]) for column in columns)
        return Summary(int(self.n[group]), mean, None if self.n[group] < 2 else std, median, low, high)

    def taken(self, groups: Indices) -> Summaries:
        """Return those of some groups, by their places."""
        columns = (self.mean, self.std, self.median, self.min, self.max)
        return Summaries(self.n[groups], *(column[groups] for column in columns))


class Numbers:
    """Finite numbers of groups.

    Args:
        values: the numbers, group by group, (n,).
        of_value: the group of each, from 0, ascending, (n,).
        count: number of groups.
    """

    def __init__(self, values: Floats, of_value: Indices, count: int) -> None:
        self._values, self._of_value = values, of_value
        self.counts = np.bincount(of_value, minlength=count)
        self._ends = np.cumsum(self.counts)
        self._starts = self._ends - self.counts
        if count * _MANY < len(values):  # sorted by themselves, groups of many take a third of the time
            self._ordered = values.copy()
            for begin, end in zip(self._starts.tolist(), self._ends.tolist(), strict=True):
                self._ordered[begin:end].sort()
        else:
            self._ordered = values[np.lexsort((values, of_value))]

    def times(self, sign: float) -> Numbers:
        """Return the numbers as costs, small is good: turned round by -1."""
        return self if sign > 0 else Numbers(-self._values, self._of_value, len(self.counts))

    def points(self, group: int) -> tuple[float, ...]:
        """Return the numbers of a group as they came; none where they are many."""
        if self.counts[group] >= ENOUGH:
            return ()
        return tuple(self._values[self._starts[group] : self._ends[group]].tolist())

    def ordered(self, group: int) -> Floats:
        """Return the numbers of a group, sorted, (n,)."""
        return self._ordered[self._starts[group] : self._ends[group]]

    def ends(self) -> tuple[Floats, Floats]:
        """Return the smallest and largest number of each group, (groups,) each, NaN for those of nothing."""
        low, high = np.full((2, len(self.counts)), np.nan)
        some = np.flatnonzero(self.counts)
        low[some] = self._ordered[self._starts[some]]
        high[some] = self._ordered[self._ends[some] - 1]
        return low, high

    def means(self) -> Floats:
        """Return the mean of each group as NumPy has it, (groups,), NaN for those of nothing."""
        found = np.full(len(self.counts), np.nan)
        for count in np.unique(self.counts[self.counts > 0]).tolist():
            # Of equally many numbers NumPy adds each row up as it does those of one group.
            groups = np.flatnonzero(self.counts == count)
            found[groups] = self._values[self._starts[groups, None] + np.arange(count)].mean(axis=1)
        return found

    def medians(self, behind: Indices | None = None) -> Floats:
        """Return the median of each group, (groups,), NaN for those of nothing.

        Args:
            behind: how many further ones of each group rank behind all its numbers, (groups,): +inf.
        """
        extra = np.zeros_like(self.counts) if behind is None else behind
        totals = self.counts + extra
        low, high = self._placed((totals - 1) // 2), self._placed(totals // 2)
        found = np.where(totals % 2 == 1, high, (low + high) / 2)
        found[totals == 0] = np.nan
        return found

    def _placed(self, places: Indices) -> Floats:
        """Return the number at a place of each group's order, (groups,), +inf behind the last."""
        inside = (places >= 0) & (places < self.counts)
        found = np.full(len(places), np.inf)
        found[inside] = self._ordered[(self._starts + places)[inside]]
        return found

    def summaries(self) -> Summaries:
        """Return the summary of each group; sums are exact until rounded."""
        means = self._sums(self._ordered) / np.maximum(self.counts, 1)
        deviations = self._ordered - np.repeat(means, self.counts)
        squares = self._sums(deviations * deviations)
        several = self.counts > 1
        std = np.full(len(self.counts), np.nan)
        std[several] = np.sqrt(squares[several] / (self.counts[several] - 1))
        means[self.counts == 0] = np.nan
        return Summaries(self.counts, means, std, self.medians(), *self.ends())

    def _sums(self, values: Floats) -> Floats:
        """Return the sum of each group, (groups,), as exact as `math.fsum`: that of two numbers is.

        Those of many are added in extended precision: rounded, that is the same but for the last digit now
        and then.

        Args:
            values: the same, however the rows came: sorted, or made of such.
        """
        found = np.zeros(len(self.counts))
        some = self.counts > 0
        found[some] += values[self._starts[some]]
        two = self.counts == 2
        found[two] += values[self._starts[two] + 1]
        more = np.flatnonzero(self.counts > 2)
        for group, begin, end in zip(
            more.tolist(), self._starts[more].tolist(), self._ends[more].tolist(), strict=True
        ):
            part = values[begin:end]
            found[group] = part.sum(dtype=np.longdouble) if end - begin > _ADDED else math.fsum(part.tolist())
        return found


def median_of_sorted(ordered: Floats) -> float:
    """Return the median of sorted numbers, +inf among them or not."""
    half = len(ordered) // 2
    if len(ordered) % 2:
        return float(ordered[half])
    return float((ordered[half - 1] + ordered[half]) / 2)


def mean_interval(summary: Summary) -> Interval | None:
    """Return Student's interval of a mean; None below 10 numbers."""
    if summary.n < ENOUGH or summary.std is None:
        return None
    half = student_quantile(0.5 + LEVEL / 2, summary.n - 1) * summary.std / math.sqrt(summary.n)
    return Interval(summary.mean - half, summary.mean + half, "Student's t")


def median_interval(ordered: Floats) -> Interval | None:
    """Return an interval of the median of any distribution by its order statistics; None below 10 numbers.

    The widest binomial tail that still leaves 95 % is cut off on both sides (Conover, Practical
    Nonparametric Statistics, section 3.2).

    Args:
        ordered: sorted numbers, (n,), failed runs as +inf.
    """
    count = len(ordered)
    if count < ENOUGH:
        return None
    if count > 1000:
        below = math.floor(count / 2 - 1.959964 * math.sqrt(count) / 2) - 1
    else:
        below, tail = -1, 0.0
        weight = 0.5**count if count < 1000 else math.exp(-count * math.log(2))
        while tail + weight <= (1 - LEVEL) / 2:
            tail += weight
            below += 1
            weight *= (count - below) / (below + 1)
    below = max(below, 0)
    return Interval(float(ordered[below]), float(ordered[count - 1 - below]), "order statistics")


def resampled_medians(ordered: Floats, draws: int, generator: np.random.Generator) -> Floats:
    """Return medians of bootstrap samples, (draws,), without drawing the samples.

    The places of a sample's middle numbers have an exact distribution (Efron 1982, chapter 10.3): each median
    takes one random number, not n.

    Args:
        ordered: sorted numbers, (n,), failed runs as +inf.
        draws: number of samples.
        generator: source of randomness.
    """
    count = len(ordered)
    if count > _MOST_PLACED:
        return _medians_of_many(ordered, draws, generator)
    lower, upper = _middle_places(count)
    chosen = generator.integers(0, _QUANTILES, draws)
    first = ordered[lower[chosen]]
    return first if count % 2 else (first + ordered[upper[chosen]]) / 2


@cache
def _middle_places(count: int) -> tuple[Bytes, Bytes]:
    """Return the places of a sample's middle numbers at equally likely quantiles, (quantiles,) each.

    Of n numbers drawn from n with replacement, the m-th smallest lies at or before place a (from 1) if at
    least m were drawn from the first a: a binomial tail. With n = 2m, the m-th lies at or before a, and the
    next one at or behind b > a, if m were drawn from the first a and m from place b on.
    """
    half = (count + 1) // 2
    share = np.arange(count + 1) / count
    several = np.arange(half, count + 1)
    ways = np.array([float(math.comb(count, k)) for k in several.tolist()])
    before = (ways * share[1:, None] ** several * (1 - share[1:, None]) ** (count - several)).sum(axis=1)
    alone = np.diff(before, prepend=0.0)
    chances = np.zeros((count, count))
    if count % 2 == 0:
        powers = np.diff(share**half)
        chances = np.triu(ways[0] * powers[:, None] * powers[::-1], 1)
    chances[np.diag_indices(count)] = np.maximum(alone - chances.sum(axis=1), 0.0)
    reached = np.cumsum(chances)
    quantiles = (np.arange(_QUANTILES) + 0.5) / _QUANTILES * reached[-1]
    lower, upper = np.divmod(np.searchsorted(reached, quantiles), count)
    return lower.astype(np.uint8), upper.astype(np.uint8)


def _medians_of_many(ordered: Floats, draws: int, generator: np.random.Generator) -> Floats:
    """Return medians of bootstrap samples: the k-th smallest of n uniform numbers is Beta(k, n + 1 − k)."""
    count = len(ordered)
    half = (count + 1) // 2
    lower = generator.beta(half, count + 1 - half, draws)
    first = ordered[np.minimum((lower * count).astype(np.intp), count - 1)]
    if count % 2:
        return first
    upper = lower + (1 - lower) * generator.beta(1, count - half, draws)
    second = ordered[np.minimum((upper * count).astype(np.intp), count - 1)]
    return (first + second) / 2


def percentiles(values: Floats) -> list[Interval]:
    """Return the middle 95 % of bootstrap figures, one for each row of (figures, draws); NaN is left out."""
    ordered = np.sort(values, axis=1)  # NaN comes last
    counts = np.count_nonzero(~np.isnan(values), axis=1).tolist()
    found = []
    for known, count in zip(ordered, counts, strict=True):
        low = high = math.nan
        if count:
            low = float(known[round((1 - LEVEL) / 2 * (count - 1))])
            high = float(known[round((1 + LEVEL) / 2 * (count - 1))])
        found.append(Interval(low, high, "bootstrap"))
    return found


def sign_flip_test(differences: Floats) -> float:
    """Return ``sign_flip_tests`` of one line of differences, (n,)."""
    return float(sign_flip_tests(differences[None])[0])


def sign_flip_tests(differences: Floats) -> Floats:
    """Return the two-sided p values of paired differences having mean 0, by flipping their signs, (lines,).

    Exact up to 14 pairs: with n pairs it can't be below 2 / 2ⁿ.

    Args:
        differences: a line each, one a pair, (lines, n).
    """
    lines, count = differences.shape
    exact = count <= _MOST_EXACT
    if exact:
        # With all signs turned round a sum is as far from 0: the first one need not be flipped.
        signs = 1.0 - 2.0 * (np.arange(2 ** max(count - 1, 0))[:, None] >> np.arange(count) & 1)
    else:
        signs = np.random.default_rng(0).integers(0, 2, (_FLIPS, count)) * 2.0 - 1.0
    # Rounding is as large as the differences are, also where their sum is 0.
    seen = np.abs(differences.sum(axis=1)) - 1e-12 * np.abs(differences).sum(axis=1)
    found = np.ones(lines)
    at_once = max(1, _SUMS_AT_ONCE // len(signs))
    for start in range(0, lines, at_once):
        part = slice(start, start + at_once)
        sums = differences[part] @ signs.T
        beyond = np.count_nonzero(np.abs(sums, out=sums) >= seen[part, None], axis=1)
        found[part] = beyond / len(signs) if exact else (beyond + 1) / (_FLIPS + 1)
    found[~differences.any(axis=1)] = 1.0
    return found


def holm(p_values: npt.ArrayLike) -> list[float]:
    """Return p values corrected for their number (Holm 1979)."""
    given = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(given, kind="stable")
    corrected = np.empty(len(given))
    weighted = np.minimum(1.0, (len(given) - np.arange(len(given))) * given[order])
    corrected[order] = np.maximum.accumulate(weighted)
    found: list[float] = corrected.tolist()
    return found


def log_ratios(first: Floats, second: Floats, sign: float) -> Floats:
    """Return by how much the second is worse than the first, as logarithms of ratios, of the same shape.

    ±inf where one failed or a ratio has no logarithm, by which is worse; 0 where both failed or are equal.

    Args:
        first: costs, that is figures times their sign; infinite for failed runs, NaN where there is none.
        second: as many.
        sign: -1 where large figures are good, else 1.
    """
    above, below = second, first
    if sign < 0:
        above, below = (np.where(np.isposinf(costs), 0.0, -costs) for costs in (first, second))
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        ratios: Floats = np.log(above / below)
        if (odd := np.isnan(ratios)).any():
            apart = second - first
            ratios = np.where(odd & ~np.isnan(apart), np.copysign(np.inf, apart), ratios)
    ratios[first == second] = 0.0
    return ratios


def average_ranks(values: Floats) -> Floats:
    """Return ranks from 1 along the last axis, equal values sharing the mean of theirs; the same shape."""
    count = values.shape[-1]
    order = np.argsort(values, axis=-1)  # whichever of equal ones is first: they share a rank
    ordered = np.take_along_axis(values, order, axis=-1)
    differs = np.empty((*values.shape[:-1], count + 1), dtype=bool)
    differs[..., [0, -1]] = True
    np.not_equal(ordered[..., 1:], ordered[..., :-1], out=differs[..., 1:-1])
    places = np.arange(count, dtype=np.int32)
    first = np.where(differs[..., :-1], places, np.int32(0))
    np.maximum.accumulate(first, axis=-1, out=first)
    last = np.where(differs[..., 1:], places, np.int32(count))[..., ::-1]
    first += np.minimum.accumulate(last, axis=-1)[..., ::-1]
    ranks = np.empty(values.shape)
    np.put_along_axis(ranks, order, first / 2 + 1, axis=-1)
    return ranks


def rank_correlation(first: Floats, second: Floats) -> float | None:
    """Return Spearman's rank correlation; None where one side does not vary."""
    a, b = average_ranks(first), average_ranks(second)
    a, b = a - a.mean(), b - b.mean()
    scale = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / scale if scale else None


def bounds(codes: npt.NDArray[np.intp], count: int) -> Indices:
    """Return the place of each group's beginning among sorted group numbers, and the end, (count + 1,)."""
    return np.searchsorted(codes, np.arange(count + 1))
