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
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slamhive.model.base import Choice

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    Floats = npt.NDArray[np.float64]
    Integers = npt.NDArray[np.intp]
    Key = tuple[Any, ...]

COVERED = 0.8
"""Share of the cases in which what is predicted is to lie within its interval."""

MOST_BINS = 8
"""Values of an option that are told apart; more numbers than that are put into so many groups."""

MOST_OPTIONS = 6
"""Options of an algorithm that are looked at, those with most values among what is asked for first."""

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


class Quantity(Choice):
    """Costs of a run that are predicted: CPU time, wall time, memory and disk space."""

    CPU = "cpuSeconds"
    WALL = "wallSeconds"
    MEMORY = "memoryBytes"
    DISK = "diskBytes"


class Nearness(Choice):
    """Levels of similarity between a predicted run and the known runs nearest to it."""

    SETTING = "the same settings"
    PAIR = "other settings on the dataset"
    ALGORITHM = "other datasets"
    MODE = "another sensor mode or pace"
    NOTHING = "nothing"


_KINDS = ("name", "mode", "dataset", "unknown length", "pair", "option", "processor", "trend", "occasion")
# The usual scatter of the logarithm: of those kinds, then between settings and between runs of a setting.
_USUAL = {
    Quantity.CPU: (1.0, 0.5, 0.3, _LENGTH_UNKNOWN, 0.2, 0.15, 0.35, 0.2, 0.1, 0.15, 0.1),
    Quantity.WALL: (1.0, 0.5, 0.3, _LENGTH_UNKNOWN, 0.2, 0.15, 0.35, 0.2, 0.15, 0.15, 0.15),
    Quantity.MEMORY: (0.7, 0.4, 0.3, 0.1, 0.2, 0.15, 0.05, 0.15, 0.03, 0.1, 0.05),
    Quantity.DISK: (0.7, 0.9, 0.2, _LENGTH_UNKNOWN, 0.2, 0.15, 0.05, 0.15, 0.1, 0.1, 0.1),
}


class Setting(NamedTuple):
    """Configuration of a run without its repetition, from which the costs of the run are predicted.

    Attributes:
        algorithm, sensors, pace, dataset: by their names.
        processor: model of the processor; None: not known.
        occasion: what ran together, as a sweep: what else the machine did then is the same for all of it.
            None: nothing is known of that.
        frames: that it is given; None: not known.
        seconds: of recording that it is given; None: not known.
        resolution: of its images.
        rate: speed of playback.
        options: values of all other options.
        changed: those that differ from ``options``: many settings share most of them.
    """

    algorithm: str
    sensors: str
    pace: str
    dataset: str
    processor: str | None = None
    occasion: str | None = None
    frames: float | None = None
    seconds: float | None = None
    resolution: float = 1.0
    rate: float = 1.0
    options: Mapping[str, Any] = {}
    changed: Mapping[str, Any] = {}

    def option(self, name: str) -> Any:
        """Return the value of an option; None where it has none."""
        return self.changed[name] if name in self.changed else self.options.get(name)

    @property
    def unit(self) -> Key:
        """Return what runs have in common whose costs are compared without further ado."""
        return self.algorithm, self.sensors, self.pace

    def work(self, quantity: Quantity) -> float | None:
        """Return what a cost grows with in proportion; None where it isn't known."""
        if quantity is Quantity.MEMORY:
            return 1.0
        if quantity is Quantity.WALL and self.pace == "Realtime" and self.seconds:
            return self.seconds / self.rate
        if not self.frames:
            return None
        return self.frames * (1.0 if quantity is Quantity.DISK else self.resolution)


class Known(NamedTuple):
    """A run that has been done: its setting, and what it did cost as far as that is known."""

    setting: Setting
    costs: Mapping[Quantity, float]


@dataclass
class Interval:
    """A prediction: the middle one of all that are thought possible, and what most of them lie between."""

    middle: float
    low: float
    high: float

    @classmethod
    def of(cls, draws: Floats) -> Interval:
        """Return the interval of draws."""
        edge = (1.0 - COVERED) / 2
        low, middle, high = np.quantile(draws, (edge, 0.5, 1.0 - edge)).tolist()
        return cls(middle, low, high)


@dataclass
class Design:
    """Known and asked settings as rows of a regression.

    Attributes:
        known: number of rows that are known; the asked ones come behind them.
        columns: effects of each row, (n, k), filled up with the number of effects.
        factors: how much each of them counts, (n, k).
        kinds: kind of each effect, (p,).
        row_of: row of each known run, (m,).
        twin: the known row of the same setting of each asked one, -1 for none, (a,).
        nearness: how near the nearest known run is to each asked setting.
    """

    known: int
    columns: Integers
    factors: Floats
    kinds: Integers
    row_of: Integers
    twin: Integers
    nearness: list[Nearness]

    def only(self, chosen: npt.NDArray[np.bool_]) -> Design:
        """Return the same with some of the asked settings, (a,)."""
        rows = np.concatenate([np.ones(self.known, dtype=bool), chosen])
        near = [one for one, stays in zip(self.nearness, chosen.tolist(), strict=True) if stays]
        columns, factors = self.columns[rows], self.factors[rows]
        return Design(self.known, columns, factors, self.kinds, self.row_of, self.twin[chosen], near)


def design(known: Sequence[Known], asked: Sequence[Setting]) -> Design:
    """Return the rows of a regression over known runs, to predict what is asked.

    Args:
        known: runs, the latest first.
        asked: settings.
    """
    codes = _Codes([one.setting for one in known], asked)
    rows: dict[Key, int] = {}
    occasions: dict[tuple[Key, str | None], int] = {}
    effects: list[list[tuple[int, float]]] = []
    row_of = np.zeros(len(known), dtype=np.intp)
    for place, one in enumerate(known):
        key = _key(one.setting, codes.exact(one.setting))
        then = (key, one.setting.occasion)
        if then not in occasions:
            occasions[then] = len(effects)
            rows.setdefault(key, len(effects))  # the latest comes first
            effects.append(codes.effects(one.setting))
        row_of[place] = occasions[then]
    count = len(effects)
    units = {(*one.setting.unit, one.setting.dataset) for one in known}
    modes, names = {unit[:3] for unit in units}, {unit[0] for unit in units}
    twin = np.full(len(asked), -1, dtype=np.intp)
    nearness = []
    for place, setting in enumerate(asked):
        effects.append(codes.effects(setting))
        twin[place] = rows.get(_key(setting, codes.exact(setting)), -1)
        if twin[place] >= 0:
            near = Nearness.SETTING
        elif (*setting.unit, setting.dataset) in units:
            near = Nearness.PAIR
        elif setting.unit in modes:
            near = Nearness.ALGORITHM
        else:
            near = Nearness.MODE if setting.algorithm in names else Nearness.NOTHING
        nearness.append(near)
    width = max(map(len, effects), default=1)
    total = len(codes.kinds)
    columns = np.full((len(effects), width), total, dtype=np.intp)
    factors = np.zeros((len(effects), width))
    for place, found in enumerate(effects):
        columns[place, : len(found)], factors[place, : len(found)] = zip(*found, strict=True)
    return Design(count, columns, factors, np.array(codes.kinds, dtype=np.intp), row_of, twin, nearness)


def _key(setting: Setting, options: Key) -> Key:
    return (*setting.unit, setting.dataset, setting.processor, options)


class _Codes:
    """Numbers for effects, given out as they are met."""

    def __init__(self, known: Sequence[Setting], asked: Sequence[Setting]) -> None:
        self.kinds: list[int] = []
        self._numbers: dict[Key, int] = {}
        self._wanted = {setting.algorithm for setting in asked}
        self._varied: dict[str, list[str]] = {}
        self._bins: dict[tuple[str, str], list[float]] = {}
        self._middles: dict[tuple[str, str], float] = {}
        self._looked_at: dict[str, list[str]] = {}
        self._places: dict[Key, list[tuple[int, float]]] = {}
        self._values: dict[Key, list[tuple[int, float]]] = {}
        self._unmeasured = {setting.dataset for setting in (*known, *asked) if not setting.frames}
        self._look(known, asked)

    def _look(self, known: Sequence[Setting], asked: Sequence[Setting]) -> None:
        """Find out which options vary, and which have too many values to be told apart."""
        values: dict[str, dict[str, dict[Any, None]]] = {name: {} for name in self._wanted}
        shared: dict[tuple[str, int], Mapping[str, Any]] = {}
        for setting in asked:
            shared[setting.algorithm, id(setting.options)] = setting.options
            _gather(values[setting.algorithm], setting.changed)
        counts = {
            (name, option): len(kept) for name, found in values.items() for option, kept in found.items()
        }
        for setting in known:
            if setting.algorithm in values:
                shared[setting.algorithm, id(setting.options)] = setting.options
                _gather(values[setting.algorithm], setting.changed)
        for (algorithm, _), options in shared.items():
            _gather(values[algorithm], options)
        for algorithm, found in values.items():
            varied = sorted(name for name, kept in found.items() if len(kept) > 1)
            self._varied[algorithm] = varied
            order = sorted((-counts.get((algorithm, name), 0), -len(found[name]), name) for name in varied)
            self._looked_at[algorithm] = [name for _, _, name in order[:MOST_OPTIONS]]
            for name in self._looked_at[algorithm]:
                self._tell_apart(algorithm, name, list(found[name]))

    def _tell_apart(self, algorithm: str, name: str, values: Sequence[Any]) -> None:
        numbers = sorted(value for value in values if _is_number(value))
        if len(numbers) > 1 and numbers[0] > 0:
            self._middles[algorithm, name] = float(np.exp(np.log(numbers).mean()))
        if len(numbers) > MOST_BINS:
            edges = np.quantile(numbers, np.linspace(0, 1, MOST_BINS + 1)[1:-1])
            self._bins[algorithm, name] = edges.tolist()

    def exact(self, setting: Setting) -> Key:
        """Return the values of the options that vary."""
        if setting.algorithm not in self._varied:
            return tuple(setting.changed.values())
        return tuple(setting.option(name) for name in self._varied[setting.algorithm])

    def effects(self, setting: Setting) -> list[tuple[int, float]]:
        """Return the numbers of a setting's effects, and how much each counts."""
        place = (*setting.unit, setting.dataset, setting.processor, setting.occasion)
        if place not in self._places:
            self._places[place] = self._of_place(setting)
        counting = list(self._places[place])
        for option in self._looked_at.get(setting.algorithm, ()):
            value = setting.option(option)
            key = (setting.algorithm, option, value)
            if key not in self._values:
                self._values[key] = self._of_value(*key)
            counting += self._values[key]
        return counting

    def _of_place(self, setting: Setting) -> list[tuple[int, float]]:
        data = setting.dataset
        found = [
            self._number(0, (setting.algorithm,)),
            self._number(1, setting.unit),
            self._number(2, (data,)),
            self._number(4, (*setting.unit, data)),
            self._number(6, (setting.processor,)),
        ]
        if setting.occasion is not None:
            found.append(self._number(8, (setting.occasion,)))
        if data in self._unmeasured:
            found.append(self._number(3, (data,)))
        return [(number, 1.0) for number in found]

    def _of_value(self, algorithm: str, option: str, value: Any) -> list[tuple[int, float]]:
        edges = self._bins.get((algorithm, option))
        told = float(np.searchsorted(edges, value)) if edges and _is_number(value) else value
        found = [(self._number(5, (algorithm, option, told)), 1.0)]
        middle = self._middles.get((algorithm, option))
        if middle is not None and _is_number(value):
            found.append((self._number(7, (algorithm, option)), math.log2(value / middle)))
        return found

    def _number(self, kind: int, key: Key) -> int:
        whole = (kind, *key)
        number = self._numbers.get(whole)
        if number is None:
            number = self._numbers[whole] = len(self.kinds)
            self.kinds.append(kind)
        return number


def _gather(found: dict[str, dict[Any, None]], options: Mapping[str, Any]) -> None:
    """Add the values of options to those that were met."""
    for name, value in options.items():
        found.setdefault(name, {})[value] = None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


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
        """Return what a run of each asked setting costs at least and at most, in most cases, (a,) twice."""
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
    """Return what is thought of a cost; None where no run is known that has one.

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
    usual[_KINDS.index("occasion")] = max(usual[_KINDS.index("occasion")], within)
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
    rows: Design,
    used: Integers,
    values: Floats,
    counts: Floats,
    begin: tuple[Floats, float, float],
) -> tuple[Floats, Floats, float]:
    """Return the effects, their covariance, and the variance between settings.

    How much each kind of effect scatters is found by expectation and maximisation (Dempster, Laird, Rubin
    1977; for mixed models Laird and Ware 1982), held to what is usual by a prior.
    """
    kinds, between, within = begin
    size, columns, factors = len(rows.kinds), rows.columns[used], rows.factors[used]
    variances = kinds.copy()
    numbers = np.bincount(rows.kinds, minlength=len(_KINDS))
    flexible = np.array([name not in {"name", "unknown length"} for name in _KINDS])
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
        sums = np.bincount(rows.kinds, effects[:size] ** 2 + np.diag(inverse), minlength=len(_KINDS))
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
