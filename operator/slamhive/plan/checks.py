# SPDX-License-Identifier: Apache-2.0
"""Checks of a whole plan against the catalog, before anything of it starts.

A plan of 80,000 runs has few distinct names, modes and parameter values: each is looked at once, and the
sentence names the axis, entry of include or template that it came from.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from slamhive.model.errors import InputError, suggestion
from slamhive.model.variant import OpenFinding, Severity, preventing
from slamhive.plan.effects import start_problem
from slamhive.plan.paths import (
    ALGORITHM,
    DATASET,
    INPUT,
    PACE,
    PARAMETERS,
    PREPARED_BY,
    REMAP,
    SENSORS,
    bounded,
    written,
)
from slamhive.plan.resolution import mode_of, pace_problem, parameter_problem, program_problem, role_problems

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

    from slamhive.model.algorithm import Algorithm, Mode
    from slamhive.model.dataset import Dataset
    from slamhive.model.sensors import Role
    from slamhive.plan.effects import Effect
    from slamhive.plan.expansion import Plan
    from slamhive.plan.paths import Path, Settings

_LIDAR = (("input", "lidar", "minRange"), ("input", "lidar", "maxRange"))


@dataclass
class _Use:
    """Findings on one value of an input option: who asks for it, and whether it has an effect.

    Attributes:
        row: the first combination that asks for it.
        works: whether it has an effect anywhere.
        first: what it comes to where it has none.
        values: the values that take effect in its place.
        places: datasets and modes that it was asked of.
    """

    row: int
    works: bool = False
    first: Effect | None = None
    values: set[object] = field(default_factory=set)
    places: set[tuple[str, str]] = field(default_factory=set)

    def add(self, effect: Effect | None, place: tuple[str, str]) -> None:
        """Take in what it comes to in a combination; None if it has an effect."""
        self.places.add(place)
        if effect is None:
            self.works = True
            return
        self.first = self.first or effect
        self.values.add(effect.effective)


def plan_problems(plan: Plan, limit: int = 20) -> list[str]:
    """Return the parts of a plan that the catalog doesn't allow: one sentence each, naming the field.

    Every distinct name, mode, pace, parameter value and sensor is looked at once.

    Args:
        plan: the runs.
        limit: the most sentences; one more tells how many were left out.
    """
    return _Check(plan).problems(limit)


def impossible(plan: Plan, findings: Mapping[str, Sequence[OpenFinding]]) -> list[str]:
    """Return the parts of a plan that findings of recordings make impossible: a sentence a dataset and mode.

    Args:
        plan: the runs, without a mistake.
        findings: what is known to be wrong with each dataset, by name.
    """
    faulty = {
        name for name, found in findings.items() if any(one.severity is Severity.ERROR for one in found)
    }
    return _Check(plan).impossible(faulty, findings) if faulty else []


class _Check:
    """One check of a plan; keeps what it has looked at."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._seen: set[object] = set()
        self._found: dict[str, None] = {}
        self._template = {
            path: value for path, value in plan.template.items() if path[:-1] in {PARAMETERS, REMAP}
        }
        self._uses: dict[tuple[str, object], _Use] = {}

    def problems(self, limit: int) -> list[str]:
        """Return at most so many sentences, and how many more there are."""
        for row in range(len(self._plan.grid)):
            self._row(row)
        self._without_effect()
        return bounded(list(self._found), limit)

    def impossible(self, faulty: Collection[str], findings: Mapping[str, Sequence[OpenFinding]]) -> list[str]:
        """Return a sentence on each mode that can't be run on a faulty dataset."""
        plan = self._plan
        value = plan.assembler.value
        for row in range(len(plan.grid)):
            settings = plan.given(row)
            data = value(settings, DATASET)
            name, dataset = value(settings, ALGORITHM), plan.datasets.get(data or "")
            chosen, _ = mode_of(plan.algorithms.get(name or ""), value(settings, SENSORS))
            if data not in faulty or chosen is None or dataset is None:
                continue
            remap, program = self._remap(settings), value(settings, PREPARED_BY)
            roles = dataset.spec.recorded_roles(chosen.needs, program)
            key = (data, chosen.name, roles, *sorted(remap.items()))
            self._once(key, row, DATASET, partial(_prevented, findings[data], chosen, dataset, roles, remap))
        return list(self._found)

    def _row(self, row: int) -> None:
        plan = self._plan
        settings, unsure = plan.given(row), plan.findings.unsure
        value = plan.assembler.value
        name, data = value(settings, ALGORITHM), value(settings, DATASET)
        mode, pace, program = (value(settings, path) for path in (SENSORS, PACE, PREPARED_BY))
        self._reference(row, ALGORITHM, "algorithm", name, plan.algorithms)
        self._reference(row, DATASET, "dataset", data, plan.datasets)
        algorithm, dataset = plan.algorithms.get(name or ""), plan.datasets.get(data or "")
        if algorithm is not None:
            for path, setting in (self._template | settings).items():
                if path[:-1] == PARAMETERS:
                    self._parameter(row, algorithm, path, setting)
            self._once((name, pace), row, PACE, lambda: pace_problem(algorithm, pace))
            chosen, problem = mode_of(algorithm, mode)
            if mode is not None or not unsure(SENSORS):
                self._once(("mode", name, mode), row, SENSORS, lambda: [problem] if problem else [])
            if chosen is not None and dataset is not None and not unsure(SENSORS, REMAP, PREPARED_BY):
                remap = self._remap(settings)
                key = ("roles", name, chosen.name, data, program, *sorted(remap.items()))
                self._once(key, row, SENSORS, lambda: role_problems(chosen, dataset, remap, program))
        if dataset is not None:
            self._once(
                ("program", data, program), row, PREPARED_BY, lambda: program_problem(dataset, program)
            )
        if not unsure(PACE):
            self._lidar(row, settings)
        if not unsure(PACE, SENSORS, ALGORITHM, DATASET):
            self._input(row)

    def _reference(self, row: int, path: Path, kind: str, name: str | None, known: Mapping[str, Any]) -> None:
        findings = self._plan.findings
        if name is None and not findings.unsure(path):
            self._once(
                ("none", kind),
                row,
                path,
                lambda: [f"{written(path)}: needed, but no axis and no template sets it"],
            )
        elif name is not None and name not in known and self._plan.strict and not findings.hidden(kind, name):
            self._once(
                (kind, name),
                row,
                path,
                lambda: [f"{written(path)}: unknown {kind} {name!r}{suggestion(name, known)}"],
            )

    def _parameter(self, row: int, algorithm: Algorithm, path: Path, value: Any) -> None:
        key = (algorithm.name, path, type(value), value)
        self._once(key, row, path, lambda: parameter_problem(algorithm, path[1], value))

    def _remap(self, settings: Settings) -> dict[str, str]:
        fields = self._template | settings
        return {path[-1]: value for path, value in fields.items() if path[:-1] == REMAP}

    def _lidar(self, row: int, settings: Settings) -> None:
        low, high = (self._plan.assembler.value(settings, path) for path in _LIDAR)
        if low is not None and high is not None and low >= high:
            self._once(
                ("lidar", low, high),
                row,
                _LIDAR[0],
                lambda: [f"input.lidar: minRange {low:g} must be below maxRange {high:g}"],
            )

    def _input(self, row: int) -> None:
        """Note which input options of a combination have an effect."""
        reading = self._plan.reading(row)
        if reading is None:
            return
        problem = start_problem(reading.options, reading.seen)
        self._once(("start", problem), row, (INPUT, "start"), lambda: [problem] if problem else [])
        idle = {effect.option: effect for effect in reading.idle}
        for option, asked in reading.options.items():
            use = self._uses.setdefault((option, asked), _Use(row))
            use.add(idle.get(option), (reading.seen.dataset, reading.seen.mode))

    def _without_effect(self) -> None:
        """Refuse options that have no effect, in the template and in each axis.

        Where it leads to another value on each recording, it means all of each, and is no mistake.
        """
        for use in self._uses.values():
            if use.first is not None and not use.works and len(use.values) == 1:
                more = "; nor has it an effect elsewhere in the sweep" if len(use.places) > 1 else ""
                self._found.setdefault(f"{self._origin(use.row, use.first.path)}: {use.first.sentence}{more}")

    def _once(self, key: object, row: int, path: Path, look: Callable[[], Iterable[str]]) -> None:
        if key in self._seen:
            return
        self._seen.add(key)
        for problem in look():
            self._found.setdefault(f"{self._origin(row, path)}: {problem}")

    def _origin(self, row: int, path: Path) -> str:
        """Return the field of the Sweep that a combination's value of a path comes from."""
        grid = self._plan.grid
        addition = grid.addition(row)
        if path in addition.settings:
            return addition.origin(path)
        for axis, step in zip(grid.dimensions, grid.steps(row) or (), strict=False):
            if path in axis.settings[step]:
                return axis.origin(step)
        if path in self._plan.template or not grid.dimensions:
            return "spec.template.spec"
        return addition.origin(path) if grid.steps(row) is None else "spec.template.spec"


def _prevented(
    found: Sequence[OpenFinding], mode: Mode, dataset: Dataset, roles: Sequence[Role], remap: dict[str, str]
) -> Iterator[str]:
    try:
        used = {dataset.spec.sensor_for(role, remap) for role in roles}
    except InputError:  # its sensors are known when it is made
        used = {str(role) for role in roles}
    fault = preventing(found, used)
    if fault is not None:
        yield f"{mode.name} can't be run on {dataset.name}, and isn't started: {fault.sentence}"
