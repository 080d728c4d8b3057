# SPDX-License-Identifier: Apache-2.0
"""The plan: the runs of a Sweep as a sequence in which any one can be had without the others.

Point ``k`` is repetition ``k % repetitions`` of combination ``k // repetitions``; the combinations stand in
the order of the matrix, the first axis slowest, then those that include made. This order follows from the
Sweep's spec alone, on every machine and through an API server, which sorts keys.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

from slamhive.model.errors import InputError
from slamhive.model.run import DEFAULT_SEED, is_random, neutral
from slamhive.model.sweep import MAX_POINTS
from slamhive.plan.assembly import Assembler
from slamhive.plan.axes import compile_axes
from slamhive.plan.effects import Reading, recorded
from slamhive.plan.findings import Findings
from slamhive.plan.grid import Combined, Coordinates, Grid
from slamhive.plan.hashes import local_uid, run_name
from slamhive.plan.paths import (
    ALGORITHM,
    DATASET,
    INPUT,
    PACE,
    PERTURB,
    REMAP,
    SEED,
    Settings,
    bounded,
    flatten,
)
from slamhive.plan.resolution import mode_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.model.sweep import Sweep
    from slamhive.plan.axes import Dimension
    from slamhive.plan.catalog import Catalog
    from slamhive.plan.effects import Effect, Options
    from slamhive.plan.paths import Path

_LARGEST_SEED = 2**31 - 1


class Point:
    """One run of a Sweep, made when it is asked for.

    Attributes:
        index: its place in the plan.
        row: the combination it belongs to.
    """

    def __init__(self, plan: Plan, index: int) -> None:
        self._plan = plan
        self.index = index
        self.row, self._offset = divmod(index, plan.repetitions)

    def __repr__(self) -> str:
        return f"Point({self.index}, {self.coordinates})"

    @cached_property
    def settings(self) -> Settings:
        """Return the fields that axes and include set, by path, as they take effect."""
        return self._plan.settings(self.row)

    @property
    def asked(self) -> Options:
        """Return the input options that are asked for and have no effect; the spec has what takes effect."""
        return {effect.option: effect.asked for effect in self._plan.effects(self.row)}

    @cached_property
    def coordinates(self) -> Coordinates:
        """Return the value on each axis by its label, then what include added."""
        return self._plan.coordinates(self.row)

    @property
    def repetition(self) -> int:
        """Return the number of the repetition, from 0."""
        return self._plan.assembler.number(self._offset)

    @property
    def seed(self) -> int:
        """Return the seed: the template's and the number of the repetition."""
        return self._plan.assembler.seed(self.settings, self._offset)

    @property
    def short_spec(self) -> dict[str, str | None]:
        """Return the names in the spec: algorithm, dataset and sensors; all of it takes 20 times as long."""
        return self._plan.short_spec(self.settings)

    @property
    def name(self) -> str:
        """Return the run's name, a DNS label."""
        return run_name(self._plan.sweep.name, self._plan.uid, self.index)

    @cached_property
    def spec(self) -> dict[str, Any]:
        """Return the MappingRun's spec with all defaults filled in, numbers normalised."""
        return self._plan.assembler.spec(self.settings, self._offset)

    @cached_property
    def spec_hash(self) -> str:
        """Return the hash of the spec, equal to ``spec_hash(point.spec)``."""
        return self._plan.assembler.spec_hash(self.settings, self._offset)


class Plan:
    """The runs of a Sweep, lazy and indexable.

    Args:
        sweep: the Sweep.
        catalog: Algorithms and Datasets.
        strict: whether ``check`` reports names that are not in the catalog.
        uid: identity of the Sweep; default: the server's, or else one that follows from its spec.
        findings: receives mistakes; the plan is then one of what is right, to be looked at and not to be run.

    Raises:
        InputError: the Sweep's template, matrix, include or exclude is wrong, with one sentence a line; with
            findings, it is so wrong that nothing of it can be looked at.
    """

    def __init__(
        self,
        sweep: Sweep,
        catalog: Catalog,
        *,
        strict: bool = True,
        uid: str | None = None,
        findings: Findings | None = None,
    ) -> None:
        self.sweep = sweep
        self.strict = strict
        self.algorithms = catalog.algorithms
        self.datasets = catalog.datasets
        self.repetitions = sweep.spec.repetitions
        self._uid = uid or sweep.metadata.uid
        self.findings = Findings() if findings is None else findings
        self.template = flatten(
            sweep.spec.template.spec,
            "spec.template.spec",
            self.findings.problems,
            strict=True,
            lose=self.findings.lose,
        )
        searching = sweep.spec.search.is_search
        dimensions = compile_axes(sweep.spec.matrix, catalog, self.findings, searching=searching)
        if findings is None:
            self.findings.refuse()
        self.grid = self._combinations(dimensions, findings)
        self.assembler = Assembler(self.template, self.algorithms)
        self._readings: dict[object, Reading | None] = {}
        self._bounded()

    def _combinations(self, dimensions: list[Dimension], findings: Findings | None) -> Combined:
        """Return the combinations of the axes."""
        spec = self.sweep.spec
        return Grid(dimensions, self.template, spec.include, spec.exclude, findings)

    def _bounded(self) -> None:
        if len(self) == 0 and not self.findings.lost:
            raise InputError("spec.exclude: drops every combination of the matrix; nothing is left to run")
        if len(self) > MAX_POINTS:
            raise InputError(
                f"spec.matrix: expands to {len(self.grid)} combinations × {self.repetitions} repetitions = "
                f"{len(self)} runs, at most {MAX_POINTS} are allowed"
            )
        seeds = [step[SEED] for axis in self.grid.dimensions for step in axis.settings if SEED in step]
        seeds += [item.settings[SEED] for item in self.grid.additions if SEED in item.settings]
        largest = max([*seeds, self.template.get(SEED, 1)]) + self.repetitions - 1
        if largest > _LARGEST_SEED:
            raise InputError(
                f"spec.repetitions: the last seed would be {largest}, at most {_LARGEST_SEED} is allowed"
            )

    @cached_property
    def uid(self) -> str:
        """Return the identity of the Sweep that the names of its runs follow from."""
        return self._uid or local_uid(self.sweep)

    @property
    def most_runs(self) -> int:
        """Return the number of runs that there may be: of a search more than there are so far."""
        return len(self)

    def __len__(self) -> int:
        return len(self.grid) * self.repetitions

    def __iter__(self) -> Iterator[Point]:
        return map(self.point, range(len(self)))

    def point(self, index: int) -> Point:
        """Return a run by its index.

        Raises:
            IndexError: there is no such run.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"point {index} of {len(self)}")
        return Point(self, index)

    def given(self, row: int) -> Settings:
        """Return the fields that axes and include set in a combination, by path, as they are asked for."""
        result: Settings = {}
        for axis, step in zip(self.grid.dimensions, self.grid.steps(row) or (), strict=False):
            result |= axis.settings[step]
        return result | self.grid.addition(row).settings

    def settings(self, row: int) -> Settings:
        """Return the fields of a combination as they take effect on the recording that it reads."""
        given = self.given(row)
        reading = self._reading(given)
        return given | {effect.path: effect.effective for effect in reading.idle} if reading else given

    def effects(self, row: int) -> tuple[Effect, ...]:
        """Return the input options of a combination that change nothing of its recording."""
        reading = self._reading(self.given(row))
        return reading.idle if reading else ()

    def reading(self, row: int) -> Reading | None:
        """Return the reading that a combination asks of its recording; None where none is asked or known."""
        return self._reading(self.given(row))

    def _reading(self, given: Settings) -> Reading | None:
        if not self._inputs:
            return None
        value = self.assembler.value
        name, data, mode = (
            value(given, ALGORITHM) or "",
            value(given, DATASET) or "",
            self.assembler.mode(given),
        )
        values = tuple(value(given, path) for path in self._inputs)
        key = (name, data, mode, values)
        if key not in self._readings:
            options = {
                ".".join(path[1:]): item
                for path, item in zip(self._inputs, values, strict=True)
                if item is not None
            }
            self._readings[key] = self._read(options, name, data, mode)
        return self._readings[key]

    def _read(self, options: Options, name: str, data: str, mode: str | None) -> Reading | None:
        algorithm, dataset = self.algorithms.get(name), self.datasets.get(data)
        chosen, _ = mode_of(algorithm, mode)
        if algorithm is None or dataset is None or chosen is None:
            return None
        options.setdefault("pace", str(algorithm.spec.paces[0]))
        return Reading(options, recorded(dataset, chosen, options))

    @cached_property
    def _inputs(self) -> list[Path]:
        """Return the input options that the Sweep sets; none where none of them could be without effect."""
        sets = [axis.paths for axis in self.grid.dimensions]
        sets += [frozenset(item.settings) for item in self.grid.additions]
        found = frozenset(self.template).union(*sets)
        inputs = sorted(path for path in found if path[0] == INPUT)
        return inputs if any(path != PACE and path[:-1] != REMAP for path in inputs) else []

    @cached_property
    def _idle(self) -> dict[int, tuple[Effect, ...]]:
        """Return the combinations that ask for something without effect, and what that is."""
        if not self._inputs:
            return {}
        return {row: found for row in range(len(self.grid)) if (found := self.effects(row))}

    @cached_property
    def twins(self) -> dict[int, int]:
        """Return the runs that come out as an earlier one does, since what they ask for has no effect.

        Index to index of the first that has the same spec.
        """
        first: dict[object, int] = {}
        same: dict[int, int] = {}
        perturbs = any(path[:2] == PERTURB for path in self._inputs)
        for row in range(len(self.grid)) if self._idle or perturbs else ():
            original = first.setdefault(self._sameness(row), row)
            if original != row:
                same[row] = original
        return {
            row * self.repetitions + repetition: original * self.repetitions + repetition
            for row, original in same.items()
            for repetition in range(self.repetitions)
        }

    def _sameness(self, row: int) -> object:
        """Return a key that is equal for equal specs; hashing specs takes many times as long."""
        settings = self.settings(row)
        fields = {path: item for path, item in settings.items() if path[0] != INPUT}
        fields |= {path: self.assembler.value(settings, path) for path in self._inputs}
        perturb = {path[2:]: fields.pop(path) for path in self._inputs if path[:2] == PERTURB}
        fields |= {(*PERTURB, *path): item for path, item in _perturbing(perturb)}
        return frozenset((path, type(item), item) for path, item in fields.items())

    def remarks(self, limit: int = 20) -> list[str]:
        """Return remarks on options without effect, and on the number of runs done once for several.

        Args:
            limit: the most sentences about options; one more tells how many were left out.
        """
        idle = (effect for found in self._idle.values() for effect in found)
        sentences = bounded(
            list(dict.fromkeys(f"{effect.sentence}; {_taken(effect)}" for effect in idle)), limit
        )
        count, total = len(self.twins), len(self)
        if count:
            sentences.append(f"{count} of {total} runs are equal to others and are not run again")
        return sentences

    def coordinates(self, row: int) -> Coordinates:
        """Return the value on each axis of a combination by label, then what include added."""
        steps = self.grid.steps(row) or ()
        result = {
            axis.label: axis.values[step] for axis, step in zip(self.grid.dimensions, steps, strict=False)
        }
        return result | self.grid.addition(row).coordinates

    def short_spec(self, settings: Settings) -> dict[str, str | None]:
        """Return the names in a combination's spec: algorithm, dataset and sensor mode."""
        assembler = self.assembler
        return {
            "algorithm": assembler.value(settings, ALGORITHM),
            "dataset": assembler.value(settings, DATASET),
            "sensors": assembler.mode(settings),
        }

    def basis(self, algorithm: str) -> dict[str, Any]:
        """Return the spec of the runs of an algorithm as it is before axes and include set anything."""
        return self.assembler.spec({ALGORITHM: algorithm}, 0)

    def algorithm_names(self) -> list[str]:
        """Return the names of all algorithms that the plan runs, in the order in which they come."""
        return self._names(ALGORITHM)

    def dataset_names(self) -> list[str]:
        """Return the names of all datasets that the plan reads, in the order in which they come."""
        return self._names(DATASET)

    def _names(self, path: tuple[str, ...]) -> list[str]:
        found = (self.assembler.value(self.settings(row), path) for row in range(len(self.grid)))
        return [name for name in dict.fromkeys(found) if name is not None]

    def start_order(self, *, look_first: bool = False) -> list[int]:
        """Return the order in which runs are to be started, as a permutation of the indices.

        Runs of one dataset with one set of input options and one sensor mode stand together, so that few
        prepared variants are needed at a time. Among these, every combination comes once before any is
        repeated, so that an early look shows all of them.

        Args:
            look_first: whether every combination of all datasets comes once before any is repeated, for
                which every variant is needed twice.
        """
        datasets: dict[object, dict[object, dict[object, list[int]]]] = {}
        for row in range(len(self.grid)):
            settings = self.settings(row)
            variant = tuple(
                item for item in sorted(settings.items()) if item[0][0] == "input" and item[0] != PACE
            )
            variants = datasets.setdefault(self.assembler.value(settings, DATASET), {})
            modes = variants.setdefault(variant, {})
            modes.setdefault(self.assembler.mode(settings), []).append(row)
        order = [
            row * self.repetitions + repetition
            for variants in datasets.values()
            for modes in variants.values()
            for rows in modes.values()
            for repetition in range(self.repetitions)
            for row in rows
        ]
        if look_first:
            order.sort(key=lambda index: index % self.repetitions > 0)  # stable
        return sorted(order, key=self.twins.__contains__)  # stable: those that wait for others come last


def _perturbing(fields: dict[Path, Any]) -> Iterator[tuple[Path, Any]]:
    """Yield the fields of a perturbation that change something."""
    options = {path: ".".join(path) for path in fields if path != ("seed",)}
    found = {path for path, name in options.items() if fields[path] not in {None, neutral(name)}}
    drawn = any(is_random(options[path]) for path in found)
    for path in found:
        yield path, fields[path]
    if drawn and ("seed",) in fields:
        seed = fields["seed",]
        yield ("seed",), DEFAULT_SEED if seed is None else seed


def _taken(effect: Effect) -> str:
    return "left out" if effect.effective is None else f"runs as {effect.effective}"
