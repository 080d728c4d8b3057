# SPDX-License-Identifier: Apache-2.0
"""Prediction of what runs cost, from what others did cost: a regression over what they have in common.

The logarithm of a cost is taken for a sum of effects: of the algorithm, of it in its sensor mode, of the
dataset, of this algorithm on this dataset, of each value of an option, of the processor, and of what is
particular to a setting and to a run. How much each kind of effect scatters is learned from the runs,
beginning with what is usual. So a run is predicted from the nearest runs there are, what is far from all of
them gets a wide interval, and what several runs have in common is wrong in all of them at once: a sum of many
is no surer than what they share. docs/decisions/0014-estimates.md says why.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.design import KINDS, Quantity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.design import Design, Floats, Integers, Known, Setting

COVERED = 0.8
"""Share of the cases in which what is predicted is to lie within its interval."""

DRAWS = 200
"""Draws from which an interval is read; of very many settings, whose sums take long, fewer."""
_FEWER_DRAWS = 100
_MANY = 4_000
_ROUNDS = 4
_SETTLED = 0.02
_CHUNK = 2_000
_WEIGHT = 4.0
"""For how many effects of a kind it counts what is usual of that kind."""
_LENGTH_UNKNOWN = 1.0
_NORMAL = 1.2815515655446004
"""Quantile of the normal distribution that leaves (1 - COVERED) / 2 above it."""

# The usual scatter of the logarithm: of KINDS, then between settings and between runs of a setting.
_USUAL = {
    Quantity.CPU: (1.0, 0.5, 0.3, _LENGTH_UNKNOWN, 0.2, 0.15, 0.35, 0.2, 0.1, 0.15, 0.1),
    Quantity.WALL: (1.0, 0.5, 0.3, _LENGTH_UNKNOWN, 0.2, 0.15, 0.35, 0.2, 0.15, 0.15, 0.15),
    Quantity.MEMORY: (0.7, 0.4, 0.3, 0.1, 0.2, 0.15, 0.05, 0.15, 0.03, 0.1, 0.05),
    Quantity.DISK: (0.7, 0.9, 0.2, _LENGTH_UNKNOWN, 0.2, 0.15, 0.05, 0.15, 0.1, 0.1, 0.1),
}


@dataclass
class CostInterval:
    """A prediction: the middle one of all that are thought possible, and what most of them lie between."""

    middle: float
    low: float
    high: float

    @classmethod
    def of(cls, draws: Floats) -> CostInterval:
        """Return the interval of draws."""
        edge = (1.0 - COVERED) / 2
        low, middle, high = np.quantile(draws, (edge, 0.5, 1.0 - edge)).tolist()
        return cls(middle, low, high)


@dataclass
class Prediction:
    """Prediction of one cost for all settings asked for, by a regression over known runs.

    Attributes:
        quantity: which cost.
        design: the rows.
        asked: the settings.
        base: logarithm of what all have in common.
        effects: mean of each effect, (p + 1,), the last one 0.
        covariance: of the effects, (p + 1, p + 1).
        settings, runs: variance between settings, and between runs of a setting.
        offsets: logarithm of the work of each asked setting, (a,).
        residuals: what known rows show beyond work and base, (n,); NaN if nothing.
        shares: how much of that counts, (n,).
        pairs: number of algorithms on datasets that are known.
        rows: number of settings that are known.
    """

    quantity: Quantity
    design: Design
    base: float
    effects: Floats
    covariance: Floats
    settings: float
    runs: float
    offsets: Floats
    residuals: Floats
    shares: Floats
    pairs: int
    rows: int

    def middles(self) -> Floats:
        """Return the middle prediction for each asked setting, (a,)."""
        found = np.concatenate([self._expected(part, self.effects[None])[0] for part in self._parts()])
        middles: Floats = np.exp(found)
        return middles

    def scatter(self) -> Floats:
        """Return the standard deviation of the logarithm of a run of each asked setting, (a,)."""
        found = []
        for part in self._parts():
            columns, factors = self._columns(part)
            both = self.covariance[columns[:, :, None], columns[:, None, :]]
            shared = np.einsum("ni,nij,nj->n", factors, both, factors)
            share = self._share(part)
            found.append(shared + self.settings * (1 - share) + self.runs)
        scatter: Floats = np.sqrt(np.concatenate(found))
        return scatter

    def each(self) -> tuple[Floats, Floats]:
        """Return the least and the greatest cost of a run of each asked setting in most cases, (a,) twice."""
        middle, width = self.middles(), np.exp(self._edge() * self.scatter())
        return middle / width, middle * width

    def total(self, counts: Floats, most: Floats | None = None) -> Floats:
        """Return draws of the sum over runs, (d,).

        Args:
            counts: runs of each asked setting, (a,).
            most: what a run of each can cost at most, (a,).
        """
        chance = np.random.default_rng(0)
        effects, particular = self._drawn(chance)
        mean, variance = np.zeros(self._draws), np.zeros(self._draws)
        for part in self._parts():
            number = counts[part][None]
            expected = self._expected(part, effects)
            between = (self.settings * (1 - self._share(part)))[None] * particular[:, None]
            within = self.runs * particular[:, None]
            one = np.exp(expected + (between + within) / 2)
            if most is not None:
                one = np.minimum(one, most[part][None])
            mean += (number * one).sum(axis=1)
            variance += (
                number**2 * one**2 * np.expm1(between) + number * one**2 * np.exp(between) * np.expm1(within)
            ).sum(axis=1)
        # A sum of log-normal numbers is taken for one of the same mean and variance (Fenton, 1960).
        width = np.log1p(variance / np.maximum(mean, 1e-300) ** 2)
        draws: Floats = mean * np.exp(np.sqrt(width) * chance.standard_normal(self._draws) - width / 2)
        return draws

    def largest(self) -> Floats:
        """Return draws of the largest of one run of each asked setting, (d,)."""
        chance = np.random.default_rng(0)
        effects, particular = self._drawn(chance)
        found: Floats = np.zeros(self._draws)
        for part in self._parts():
            expected = self._expected(part, effects)
            spread = np.sqrt(
                (self.settings * (1 - self._share(part)) + self.runs)[None] * particular[:, None]
            )
            noise = chance.standard_normal(expected.shape) * spread
            found = np.maximum(found, np.exp(expected + noise).max(axis=1))
        return found

    @property
    def _draws(self) -> int:
        return DRAWS if len(self.design.twin) <= _MANY else _FEWER_DRAWS

    @cached_property
    def _root(self) -> Floats:
        size = len(self.effects) - 1
        steadied = self.covariance[:size, :size] + 1e-12 * np.eye(size)
        return np.asarray(np.linalg.cholesky(steadied), dtype=np.float64)

    def _parts(self) -> list[slice]:
        count = len(self.design.twin)
        return [slice(start, min(start + _CHUNK, count)) for start in range(0, count, _CHUNK)]

    def _columns(self, part: slice) -> tuple[Integers, Floats]:
        """Return the effects of asked rows, with those of their twins, of which the same share is known."""
        rows = slice(self.design.known + part.start, self.design.known + part.stop)
        columns, factors = self.design.columns[rows], self.design.factors[rows]
        share, twin = self._share(part), self.design.twin[part]
        if not share.any():
            return columns, factors
        return (
            np.concatenate([columns, self.design.columns[twin]], axis=1),
            np.concatenate([factors, -share[:, None] * self.design.factors[twin]], axis=1),
        )

    def _share(self, part: slice) -> Floats:
        twin = self.design.twin[part]
        return np.where(twin >= 0, self.shares[twin], 0.0)

    def _expected(self, part: slice, effects: Floats) -> Floats:
        """Return expected logarithms, (d, a), by draws of the effects, (d, p + 1)."""
        columns, factors = self._columns(part)
        found = np.zeros((len(effects), len(columns)))
        for place in range(columns.shape[1]):
            found += effects[:, columns[:, place]] * factors[:, place]
        twin = self.design.twin[part]
        residuals = np.where(twin >= 0, np.nan_to_num(self.residuals[twin]), 0.0)
        found += (self._share(part) * residuals)[None]
        total: Floats = found + self.base + self.offsets[part][None]
        return total

    def _edge(self) -> float:
        # Of Student's distribution (Cornish and Fisher, first term): how much scatters is itself uncertain.
        freedom = _WEIGHT + self.pairs
        return _NORMAL + (_NORMAL**3 + _NORMAL) / (4 * freedom)

    def _drawn(self, chance: np.random.Generator) -> tuple[Floats, Floats]:
        """Return draws of the effects, (d, p + 1), and by how much scatter is under- or overrated."""
        size = len(self.effects) - 1
        freedom = _WEIGHT + self.pairs
        shared = np.sqrt(freedom / chance.chisquare(freedom, self._draws))
        noise = chance.standard_normal((self._draws, size)) * shared[:, None]
        effects = np.zeros((self._draws, size + 1))
        effects[:, :size] = self.effects[None, :size] + noise @ self._root.T
        freedom = _WEIGHT + self.rows
        return effects, freedom / chance.chisquare(freedom, self._draws)


def predict(
    quantity: Quantity, known: Sequence[Known], asked: Sequence[Setting], rows: Design
) -> Prediction | None:
    """Return the prediction of a cost; None where no run is known that has one.

    Args:
        quantity: which cost.
        known: runs.
        asked: settings.
        rows: of the same runs and settings.
    """
    offsets = _offsets(quantity, [one.setting for one in known], asked)
    logs = np.array([math.log(cost) if (cost := one.costs.get(quantity)) else math.nan for one in known])
    logs -= offsets[: len(known)]
    here = np.flatnonzero(np.isfinite(logs))
    if not len(here):
        return None
    usual = np.array(_USUAL[quantity]) ** 2
    found, row = logs[here], rows.row_of[here]
    counts = np.bincount(row, minlength=rows.known).astype(np.float64)
    used = np.flatnonzero(counts)
    means = np.zeros(rows.known)
    means[used] = np.bincount(row, found, minlength=rows.known)[used] / counts[used]
    apart = float(((found - means[row]) ** 2).sum())
    within = (_WEIGHT * usual[-1] + apart) / (_WEIGHT + len(found) - len(used))
    base = float(np.median(means[used]))
    # Where repeated runs differ, the machine does other things too, and sweeps differ as much at least.
    usual[KINDS.index("occasion")] = max(usual[KINDS.index("occasion")], within)
    solved = _solve(rows, used, means[used] - base, counts[used], (usual[:-2], float(usual[-2]), within))
    effects, covariance, between = solved
    residuals, shares = np.full(rows.known, np.nan), np.zeros(rows.known)
    residuals[used] = means[used] - base
    shares[used] = between / (between + within / counts[used])
    pairs = len({(*known[place].setting.unit, known[place].setting.dataset) for place in here.tolist()})
    return Prediction(
        quantity,
        rows,
        base,
        effects,
        covariance,
        between,
        within,
        offsets[len(known) :],
        residuals,
        shares,
        pairs,
        len(used),
    )


def _offsets(quantity: Quantity, known: Sequence[Setting], asked: Sequence[Setting]) -> Floats:
    """Return the logarithm of the work of each setting; of an unknown one, what its dataset usually has."""
    works = [setting.work(quantity) for setting in (*known, *asked)]
    logs = np.array([math.log(work) if work else math.nan for work in works])
    missing = np.isnan(logs)
    if missing.all():
        return np.zeros(len(logs))
    if missing.any():
        datasets = [setting.dataset for setting in (*known, *asked)]
        by_dataset: dict[str, list[float]] = {}
        for name, log in zip(datasets, logs.tolist(), strict=True):
            if log == log:  # noqa: PLR0124 - NaN
                by_dataset.setdefault(name, []).append(log)
        overall = float(np.nanmedian(logs))
        usual = {name: float(np.median(found)) for name, found in by_dataset.items()}
        for place in np.flatnonzero(missing).tolist():
            logs[place] = usual.get(datasets[place], overall)
    return logs


def _solve(
    rows: Design, used: Integers, values: Floats, counts: Floats, begin: tuple[Floats, float, float]
) -> tuple[Floats, Floats, float]:
    """Return the effects, their covariance, and the variance between settings.

    How much each kind of effect scatters is found by expectation and maximisation (Dempster, Laird, Rubin
    1977; for mixed models Laird and Ware 1982), held to what is usual by a prior.
    """
    kinds, between, within = begin
    size, columns, factors = len(rows.kinds), rows.columns[used], rows.factors[used]
    variances = kinds.copy()
    numbers = np.bincount(rows.kinds, minlength=len(KINDS))
    flexible = np.array([name not in {"name", "unknown length"} for name in KINDS])
    groups, group = np.unique(counts, return_inverse=True)
    products = [
        _products(columns[group == place], factors[group == place], size) for place in range(len(groups))
    ]
    effects, covariance = np.zeros(size + 1), np.zeros((size + 1, size + 1))
    for _ in range(_ROUNDS):
        weights = 1.0 / (between + within / groups)
        precision = sum(weight * one for weight, one in zip(weights.tolist(), products, strict=True))
        precision[np.diag_indices(size)] += 1.0 / variances[rows.kinds]
        inverse = np.linalg.inv(precision)
        inverse = (inverse + inverse.T) / 2
        heavy = ((weights[group] * values)[:, None] * factors).ravel()
        effects[:size] = inverse @ np.bincount(columns.ravel(), heavy, minlength=size + 1)[:size]
        covariance[:size, :size] = inverse
        sums = np.bincount(rows.kinds, effects[:size] ** 2 + np.diag(inverse), minlength=len(KINDS))
        learned = np.where(flexible, (_WEIGHT * kinds + sums) / (_WEIGHT + numbers), kinds)
        settled = bool((np.abs(np.log(learned / variances)) < _SETTLED).all())
        variances = learned
        share = between / (between + within / groups)
        beyond = share[group] * (values - (effects[columns] * factors).sum(axis=1))
        spread = sum(
            (
                own**2 * float((one * inverse).sum())
                for own, one in zip(share.tolist(), products, strict=True)
            ),
            start=float((between * (1 - share))[group].sum()),
        )
        between = (_WEIGHT * begin[1] + float((beyond**2).sum()) + spread) / (_WEIGHT + len(values))
        if settled:
            break
    return effects, covariance, between


def _products(columns: Integers, factors: Floats, size: int) -> Floats:
    """Return the sums over rows of the products of each two effects' factors, (size, size)."""
    wide = size + 1
    found = np.zeros(wide * wide)
    for start in range(0, len(columns), _CHUNK):
        part = columns[start : start + _CHUNK]
        both = part[:, :, None] * wide + part[:, None, :]
        weights = factors[start : start + _CHUNK]
        products = weights[:, :, None] * weights[:, None, :]
        found += np.bincount(both.ravel(), products.ravel(), minlength=wide * wide)
    return found.reshape(wide, wide)[:size, :size]
