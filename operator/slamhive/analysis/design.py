# SPDX-License-Identifier: Apache-2.0
"""Design of the regression that predicts costs: settings of runs as rows, what they share as columns.

`predicting` solves it; what is planned and what is archived becomes settings in `local/running/costs.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slamhive.model.algorithm import Pace
from slamhive.model.base import Choice

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    Floats = npt.NDArray[np.float64]
    Integers = npt.NDArray[np.intp]
    Key = tuple[Any, ...]

MOST_BINS = 8
"""Values of an option that are told apart; more numbers than that are put into so many groups."""

MOST_OPTIONS = 6
"""Options of an algorithm that are looked at, those with most values among what is asked for first."""

_PLAYED = frozenset(pace.value for pace in Pace if pace.is_played)

KINDS = ("name", "mode", "dataset", "unknown length", "pair", "option", "processor", "trend", "occasion")
"""Kinds of effects."""


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
        """Return the key of the runs whose costs are compared without further ado."""
        return self.algorithm, self.sensors, self.pace

    def work(self, quantity: Quantity) -> float | None:
        """Return the work that a cost grows with in proportion; None where it isn't known."""
        if quantity is Quantity.MEMORY:
            return 1.0
        if quantity is Quantity.WALL and self.pace in _PLAYED and self.seconds:
            return self.seconds / self.rate  # Stepped takes longer, by what the known runs tell
        if not self.frames:
            return None
        return self.frames * (1.0 if quantity is Quantity.DISK else self.resolution)


class Known(NamedTuple):
    """A run that has been done: its setting, and what it did cost as far as that is known."""

    setting: Setting
    costs: Mapping[Quantity, float]


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
