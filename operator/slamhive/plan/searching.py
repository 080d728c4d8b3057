# SPDX-License-Identifier: Apache-2.0
"""The plan of a search: runs of the settings that were tried so far, which grows by trials.

Trial ``t`` has ``block`` runs, with the indices from ``t × block``: repetition ``r`` on context ``c`` is
``t × block + c × repetitions + r``. A context is a combination of the axes that the search goes across, such
as the datasets. So an index says which run it is however many trials there will be.
"""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, get_args

from slamhive.model.algorithm import ParameterType
from slamhive.model.canonical import normalize
from slamhive.model.errors import InputError
from slamhive.model.search import MAX_TRIALS, VALUES_BESIDE, VALUES_NEAR, VALUES_UNKNOWN, SearchMethod, Trial
from slamhive.model.sweep import MAX_POINTS
from slamhive.plan.catalog import FixedCatalog
from slamhive.plan.expansion import Plan
from slamhive.plan.grid import Addition, Grid
from slamhive.plan.ladder import Ladder
from slamhive.plan.paths import ALGORITHM, DATASET, PARAMETERS, SENSORS, assign, field_type

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from slamhive.model.algorithm import Algorithm
    from slamhive.model.search import Search
    from slamhive.model.sweep import Sweep
    from slamhive.plan.axes import Dimension
    from slamhive.plan.catalog import Catalog
    from slamhive.plan.findings import Findings
    from slamhive.plan.paths import Path, Settings

_REFERENCES = {ALGORITHM, DATASET, SENSORS}


@dataclass(frozen=True)
class SearchedAxis:
    """An axis of which a search tries values.

    Attributes:
        dimension: the compiled axis.
        is_integer: whether only whole numbers of its range may be tried.
        is_ratio: whether its parameter is declared to be of the scale Log.
    """

    dimension: Dimension
    is_integer: bool = False
    is_ratio: bool = False

    @property
    def label(self) -> str:
        """Return the axis's name."""
        return self.dimension.label

    @property
    def parameter(self) -> str | None:
        """Return the parameter that it sets; None for another field, and for axes of points."""
        path = self.dimension.path
        return path[-1] if path is not None and path[:-1] == PARAMETERS else None

    @property
    def is_log(self) -> bool:
        """Tell whether its range is divided by ratios and not by differences."""
        span = self.dimension.span
        return span is not None and (span.scale == "Log" or (self.is_ratio and span.from_ > 0))

    @property
    def ends(self) -> tuple[float, float] | None:
        """Return the ends of its range; None where it has values of which one is chosen."""
        span = self.dimension.span
        return None if span is None else (span.from_, span.to)

    @property
    def size(self) -> int | None:
        """Return the number of its values; None where any number of a range may be tried."""
        ends = self.ends
        if ends is None or ends[0] == ends[1]:
            return len(self.dimension.values)
        return int(math.floor(ends[1]) - math.ceil(ends[0])) + 1 if self.is_integer else None

    @property
    def numbers(self) -> list[float] | None:
        """Return its values where all are numbers, in their order; None otherwise."""
        values = self.dimension.values
        plain = all(isinstance(one, int | float) and not isinstance(one, bool) for one in values)
        return None if self.ends is not None or not plain else list(values)

    def settings(self, value: Any) -> Settings:
        """Return the fields that a value sets.

        Raises:
            InputError: it is no value of the axis.
        """
        if self.dimension.span is None:
            return dict(self.dimension.settings[self.step(value)])
        ends = self.ends or (value, value)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not ends[0] <= value <= ends[1]:
            raise InputError(f"{self.dimension.where}: {value!r} is outside of {ends[0]:g} to {ends[1]:g}")
        return assign(self.dimension.path or (), value, self.dimension.where)

    def step(self, value: Any) -> int:
        """Return the place of a value among those that it has.

        Raises:
            InputError: it is no value of the axis.
        """
        try:
            return self._places[_key(value)]
        except KeyError:
            raise InputError(f"{self.dimension.where}: {value!r} is no value of {self.label}") from None

    @cached_property
    def _places(self) -> dict[str, int]:
        return {_key(value): step for step, value in enumerate(self.dimension.values)}


def _key(value: Any) -> str:
    return json.dumps(normalize(value), sort_keys=True)


class SearchSpace:
    """Settings that a search may try, and the contexts that each is run in.

    Args:
        sweep: the Sweep.
        dimensions: its compiled axes.
        template: fields that its template sets.
        algorithms: Algorithms by name.

    Attributes:
        axes: the searched axes, in the order of the matrix.
        contexts: coordinates and fields of each context; one that sets nothing where there are none.
        repetitions: runs of a setting in each context at most.

    Raises:
        InputError: an axis can't be searched, or ``exclude`` names one that is.
    """

    def __init__(
        self,
        sweep: Sweep,
        dimensions: Sequence[Dimension],
        template: Settings,
        algorithms: Mapping[str, Algorithm],
    ) -> None:
        search = sweep.spec.search
        self.is_threshold = search.method is SearchMethod.THRESHOLD
        labels = [axis.label for axis in dimensions]
        across = [name for name in search.across or () if name in labels]
        if search.across is None and not self.is_threshold:
            across = [axis.label for axis in dimensions if axis.path == DATASET]
        if self.is_threshold and search.axis in across:
            raise InputError(f"spec.search.axis: {search.axis} is one of search.across; name another axis")
        over = [axis for axis in dimensions if axis.label in across]
        searched = [axis for axis in dimensions if axis.label not in across]
        for axis in over:
            if axis.span is not None:
                raise InputError(
                    f"{axis.where}.range: give step or count, as each setting is run on all of them"
                )
        dropping = [entry for entry in sweep.spec.exclude if not self.is_threshold or set(entry) & {*across}]
        excluded = [label for entry in dropping for label in entry if label not in across]
        if excluded:
            raise InputError(
                f"spec.exclude: a search goes across {', '.join(across) or 'no axis'}, only such can be "
                f"excluded, found {excluded[0]}"
            )
        grid = Grid(over, template, [], dropping)
        self.contexts: list[Addition] = [
            _combined(
                [
                    (axis, axis.values[step], axis.settings[step])
                    for axis, step in zip(over, steps, strict=True)
                ]
            )
            for row in range(len(grid))
            for steps in [grid.steps(row) or ()]
        ]
        self.axes = [
            SearchedAxis(axis, _is_integer(axis, algorithms), _is_ratio(axis, algorithms))
            for axis in searched
        ]
        self._template, self._algorithms = template, algorithms
        self._open = {path[-1] for axis in over for path in axis.paths if path[:-1] == PARAMETERS}
        if not self.axes:
            raise InputError("spec.matrix: no axis is left to search; it has none but those in search.across")
        alone = [one.dimension.where for one in self.axes if one.size == 1]
        if alone and not self.is_threshold:
            raise InputError(f"{alone[0]}: has one value, so nothing to search; set it in the template")
        self.repetitions = sweep.spec.repetitions if self.is_threshold else search.repetitions.promote
        if self.is_threshold:
            others = [entry for entry in sweep.spec.exclude if entry not in dropping]
            self._seek(search, template, others)

    def _seek(self, search: Search, template: Settings, excluded: Sequence[Mapping[str, Any]]) -> None:
        """Lay out the seeking of thresholds: an axis, and a series for each combination of the others."""
        labels = [axis.label for axis in self.axes]
        self.sought = labels.index(search.axis or "")
        sought = self.axes[self.sought]
        self.ladder = Ladder(sought.dimension, search.tolerance, is_integer=sought.is_integer)
        for axis in self.axes:
            if axis.ends is not None and axis.label != search.axis:
                raise InputError(
                    f"{axis.dimension.where}.range: give step or count, as a threshold is sought for each"
                )
        if any(search.axis in entry for entry in excluded):
            raise InputError(
                f"spec.exclude: names {search.axis}, whose threshold is sought; leave values out of the axis"
            )
        others = [axis.dimension for axis in self.axes if axis.label != search.axis]
        grid = Grid(others, template, [], excluded)
        self.series = [
            tuple(axis.values[step] for axis, step in zip(others, grid.steps(row) or (), strict=True))
            for row in range(len(grid))
        ]
        most = len(self.series) * self.values_at_most
        if most > MAX_TRIALS:
            raise InputError(
                f"spec.matrix: {len(self.series)} thresholds of up to {self.values_at_most} values each are "
                f"{most}, at most {MAX_TRIALS} are allowed"
            )

    @property
    def values_at_most(self) -> int:
        """Return the number of values tried for a threshold at most: ends, halvings, and a few beside."""
        more = VALUES_NEAR + VALUES_BESIDE + VALUES_UNKNOWN
        return min(len(self.ladder), 2 + self.ladder.halvings + more)

    @property
    def block(self) -> int:
        """Return the number of runs that a setting can have."""
        return len(self.contexts) * self.repetitions

    @property
    def size(self) -> int | None:
        """Return the number of settings; None where there is no end of them."""
        sizes = [axis.size for axis in self.axes]
        return None if None in sizes else math.prod(size for size in sizes if size is not None)

    @cached_property
    def is_conditional(self) -> bool:
        """Tell whether a searched parameter has an effect only beside some values of others."""
        names = {axis.parameter for axis in self.axes} - {None}
        declared = [
            one.spec.parameters.get(name) for one in self._algorithms.values() for name in names if name
        ]
        return any(one is not None and one.when for one in declared)

    def in_effect(self, values: Sequence[Any]) -> list[bool]:
        """Return a flag for each axis: it has an effect beside the others' values; the others set nothing."""
        if not self.is_conditional:
            return [True] * len(self.axes)
        fields = dict(self._template)
        for axis, value in zip(self.axes, values, strict=True):
            fields |= axis.settings(value)
        algorithm = self._algorithms.get(fields.get(ALGORITHM) or "")
        given = {path[-1]: value for path, value in fields.items() if path[:-1] == PARAMETERS}
        return [
            algorithm is None
            or axis.parameter not in algorithm.spec.parameters
            or not self._open.isdisjoint(algorithm.spec.conditions(axis.parameter))
            or algorithm.spec.has_effect(axis.parameter, given)
            for axis in self.axes
        ]

    def canonical(self, values: Sequence[Any]) -> list[Any]:
        """Return values that are equal for equal settings: an axis without effect has its first one."""
        return [
            value if has_effect else axis.dimension.values[0]
            for axis, value, has_effect in zip(self.axes, values, self.in_effect(values), strict=True)
        ]

    def setting(self, values: Sequence[Any]) -> Addition:
        """Return coordinates and fields of a setting, without those of axes that have no effect in it.

        Raises:
            InputError: a value isn't of its axis.
        """
        return _combined(
            [
                (axis.dimension, value, axis.settings(value))
                for axis, value, has_effect in zip(self.axes, values, self.in_effect(values), strict=True)
                if has_effect
            ]
        )

    def part(self, values: Sequence[Any]) -> tuple[tuple[Any, ...], Any]:
        """Return the values on the axes besides the one whose threshold is sought, and the one on that."""
        place = self.sought
        return (*values[:place], *values[place + 1 :]), values[place]

    def series_key(self, series: Sequence[Any]) -> str:
        """Return a text that is equal for equal values on the axes besides the sought one."""
        return _key(list(series))

    def joined(self, series: Sequence[Any], value: Any) -> list[Any]:
        """Return the values on all axes: the inverse of ``part``."""
        return [*series[: self.sought], value, *series[self.sought :]]

    def key(self, values: Sequence[Any]) -> str:
        """Return a text that is equal for equal settings."""
        return _key(self.canonical(values))

    def probes(self) -> list[Trial]:
        """Return settings that have each value of each axis, and each end: what is checked before all.

        Algorithms, datasets and modes are combined with each other; else one axis at a time is changed.
        """
        first = [axis.dimension.values[0] for axis in self.axes]
        named = [number for number, axis in enumerate(self.axes) if axis.dimension.path in _REFERENCES]
        found: dict[str, list[Any]] = {}
        for chosen in itertools.product(*(self.axes[number].dimension.values for number in named)):
            base = list(first)
            for number, value in zip(named, chosen, strict=True):
                base[number] = value
            for values in self._changed(base, named):
                found.setdefault(self.key(values), values)
        return [Trial(values=values) for values in found.values()]

    def _changed(self, base: list[Any], fixed: Sequence[int]) -> Iterator[list[Any]]:
        yield base
        shown = self.in_effect(base)
        for number, axis in enumerate(self.axes):
            for value in () if number in fixed else axis.dimension.values[int(shown[number]) :]:
                yield self._with_effect([*base[:number], value, *base[number + 1 :]], number)

    def _with_effect(self, values: list[Any], number: int) -> list[Any]:
        """Return values beside which an axis has an effect, as far as searched axes decide that."""
        if self.in_effect(values)[number]:
            return values
        declared = (
            one.spec.parameters.get(self.axes[number].parameter or "") for one in self._algorithms.values()
        )
        when = {name: list(given) for one in declared if one for name, given in (one.when or {}).items()}
        changed = list(values)
        for place, axis in enumerate(self.axes):
            allowed = [
                value for value in axis.dimension.values if value in when.get(axis.parameter or "", ())
            ]
            if allowed:
                changed[place] = allowed[0]
                changed = self._with_effect(changed, place)
        return changed


def _combined(parts: Sequence[tuple[Dimension, Any, Settings]]) -> Addition:
    whole = Addition()
    for axis, value, settings in parts:
        place = list(axis.values).index(value) if axis.span is None else 0
        sources = dict.fromkeys(settings, axis.origin(place))
        whole = whole.then(Addition({axis.label: value}, dict(settings), (), sources))
    return whole


def _is_ratio(axis: Dimension, algorithms: Mapping[str, Algorithm]) -> bool:
    """Tell whether an axis sets a parameter of the scale Log."""
    if axis.path is None or axis.path[:-1] != PARAMETERS:
        return False
    declared = [one.spec.parameters.get(axis.path[-1]) for one in algorithms.values()]
    return any(one is not None and one.scale == "Log" for one in declared)


def _is_integer(axis: Dimension, algorithms: Mapping[str, Algorithm]) -> bool:
    """Tell whether the field that an axis sets takes whole numbers alone."""
    if axis.span is None or axis.path is None:
        return False
    if axis.path[:-1] == PARAMETERS:
        declared = [one.spec.parameters.get(axis.path[-1]) for one in algorithms.values()]
        return any(one is not None and one.type is ParameterType.INTEGER for one in declared)
    found = field_type(axis.path)
    return int in (get_args(found) or (found,)) and float not in get_args(found)


class Drawn:
    """Combinations of a search: each trial in each context.

    Args:
        dimensions: all compiled axes.
        space: what can be tried.
    """

    def __init__(self, dimensions: list[Dimension], space: SearchSpace) -> None:
        self.dimensions = dimensions
        self._space = space
        self._rows: list[Addition] = []

    def draw(self, trial: Trial) -> None:
        """Add the rows of a trial."""
        setting = self._space.setting(trial.values)
        self._rows += [setting.then(context) for context in self._space.contexts]

    @property
    def additions(self) -> list[Addition]:
        """Return all rows."""
        return self._rows

    def __len__(self) -> int:
        return len(self._rows)

    def steps(self, row: int) -> tuple[int, ...] | None:  # noqa: ARG002
        """Return None: no row is of steps."""
        return None

    def addition(self, row: int) -> Addition:
        """Return a row's coordinates and fields."""
        return self._rows[row]


def plan_of(
    sweep: Sweep,
    catalog: Catalog,
    trials: Sequence[Trial] = (),
    *,
    strict: bool = True,
    uid: str | None = None,
    findings: Findings | None = None,
) -> Plan:
    """Return the plan of a Sweep, of a search that of its trials so far; arguments as of these.

    Raises:
        InputError: the Sweep is wrong, or a trial doesn't fit it.
    """
    if sweep.spec.search.is_search:
        return SearchPlan(sweep, catalog, trials, strict=strict, uid=uid, findings=findings)
    return Plan(sweep, catalog, strict=strict, uid=uid, findings=findings)


def probed(plan: Plan) -> Plan:
    """Return the plan whose runs tell what of a Sweep is wrong: of a search, of settings at all its ends."""
    return plan.probing() if isinstance(plan, SearchPlan) else plan


class SearchPlan(Plan):
    """The runs of a search: those of the trials so far.

    Args:
        sweep: the Sweep.
        catalog: Algorithms and Datasets.
        trials: what was tried before, as it was written down.
        strict, uid, findings: as of a Plan.

    Attributes:
        space: what can be tried.
        trials: what was tried, by number.
        is_exhausted: whether the sampler found nothing that is left to try.

    Raises:
        InputError: the Sweep is wrong, or a trial doesn't fit it.
    """

    def __init__(
        self,
        sweep: Sweep,
        catalog: Catalog,
        trials: Sequence[Trial] = (),
        *,
        strict: bool = True,
        uid: str | None = None,
        findings: Findings | None = None,
    ) -> None:
        self.trials: list[Trial] = []
        self.is_exhausted = False
        super().__init__(sweep, catalog, strict=strict, uid=uid, findings=findings)
        self.repetitions = self.space.repetitions
        most = self.most_trials
        if most * self.space.block > MAX_POINTS:
            raise InputError(
                f"spec.search.trials: {most} settings × {self.space.block} runs = {most * self.space.block} "
                f"runs, at most {MAX_POINTS} are allowed"
            )
        for trial in trials:
            self.draw(trial)

    def _combinations(self, dimensions: list[Dimension], findings: Findings | None) -> Drawn:  # noqa: ARG002
        self.space = SearchSpace(self.sweep, dimensions, self.template, self.algorithms)
        self._drawn = Drawn(dimensions, self.space)
        return self._drawn

    def _bounded(self) -> None:
        """Check nothing: how many runs there may be is known when the space is."""

    @property
    def most_trials(self) -> int:
        """Return the number of trials at most: as many as asked for or tried, or as there are settings."""
        if self.is_exhausted:
            return len(self.trials)
        if self.space.is_threshold:
            return len(self.space.series) * self.space.values_at_most
        asked = self.sweep.spec.search.trials or min(MAX_TRIALS, MAX_POINTS // self.space.block)
        # What was tried stays, with its runs, also where fewer are asked for now.
        return max(len(self.trials), min(asked, self.space.size or asked))

    @property
    def surplus(self) -> str | None:
        """Return a sentence where more settings were tried before than are asked for now."""
        asked, tried = self.sweep.spec.search.trials, len(self.trials)
        if asked is None or tried <= asked:
            return None
        return f"{tried:,} settings are tried already, trials: {asked} asks for fewer: none is added"

    @property
    def twins(self) -> dict[int, int]:
        """Return nothing: no setting is tried twice, and equal results are taken over."""
        return {}

    def _names(self, path: Path) -> list[str]:
        """Return all that it may run, tried or not."""
        steps = [step for axis in self.space.axes for step in axis.dimension.settings]
        steps += [context.settings for context in self.space.contexts]
        found = [step[path] for step in steps if step.get(path) is not None]
        return list(dict.fromkeys(found)) or [name for name in [self.assembler.value({}, path)] if name]

    def remarks(self, limit: int = 20) -> list[str]:
        """Return remarks on options without effect, and on trials that there are no settings for."""
        asked, most = self.sweep.spec.search.trials, self.most_trials
        few = f"spec.search.trials: {asked} are asked for, the matrix has {most} settings: all are tried"
        return [*super().remarks(limit), *([few] if asked is not None and asked > most else [])]

    def draw(self, trial: Trial) -> None:
        """Add a trial; its runs are the last ones of the plan from now on.

        Raises:
            InputError: its values aren't of the axes.
        """
        self._drawn.draw(trial)
        self.trials.append(trial)

    @property
    def most_runs(self) -> int:
        """Return the number of runs at most."""
        return self.most_trials * self.space.block

    def probing(self) -> SearchPlan:
        """Return the plan of the settings that tell what of the Sweep is wrong before anything runs."""
        return self.with_trials(self.space.probes())

    def with_trials(self, trials: Sequence[Trial]) -> SearchPlan:
        """Return the plan of other settings than those that are tried.

        Raises:
            InputError: one doesn't fit.
        """
        return SearchPlan(
            self.sweep,
            FixedCatalog(self.algorithms, self.datasets),
            trials,
            strict=self.strict,
            uid=self.uid,
            findings=self.findings,
        )
