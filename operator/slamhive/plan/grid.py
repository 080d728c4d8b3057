# SPDX-License-Identifier: Apache-2.0
"""The grid: which combinations of the axes a Sweep has, after exclude and include.

Both follow the matrix of GitHub Actions:

* ``exclude`` drops every combination that agrees with all keys of one of its entries. It comes first.
* An entry of ``include`` is added to every combination of the matrix in which it would overwrite no value
  of the matrix. What an earlier entry added may be overwritten.
* An entry that can be added to none becomes a combination of its own. Later entries are never added to such.
* A matrix without axes but with include has the combinations of include alone.

A key is the label of an axis or a path. A path that an axis of points sets belongs to the matrix in those
points that set it.
"""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from slamhive.model.errors import InputError, suggestion
from slamhive.model.sweep import MAX_POINTS
from slamhive.plan.findings import Findings
from slamhive.plan.paths import Collected, Settings, assign, parse_path, written

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import numpy.typing as npt

    from slamhive.plan.axes import Dimension
    from slamhive.plan.paths import Path

MAX_GRID = 10_000_000
"""The most combinations before exclude."""

Coordinates = dict[str, Any]
_MISSING = object()


@dataclass(frozen=True)
class Addition:
    """Fields that include adds to a combination, or a combination that it or a search makes."""

    coordinates: Coordinates = field(default_factory=dict)
    settings: Settings = field(default_factory=dict)
    origins: tuple[str, ...] = ()
    sources: dict[Path, str] = field(default_factory=dict)

    def then(self, later: Addition) -> Addition:
        """Return both additions, the later one winning."""
        return Addition(
            self.coordinates | later.coordinates,
            self.settings | later.settings,
            (*self.origins, *later.origins),
            self.sources | later.sources,
        )

    def origin(self, path: Path) -> str:
        """Return the field of the Sweep that a field was set by, or the template where none was."""
        return self.sources.get(path) or (self.origins[-1] if self.origins else "spec.template.spec")


@dataclass
class _GridEntry:
    """An entry of include or exclude: allowed steps by axis, and what is no value of the matrix."""

    where: str
    allowed: dict[int, npt.NDArray[np.bool_]] = field(default_factory=dict)
    coordinates: Coordinates = field(default_factory=dict)
    settings: Settings = field(default_factory=dict)
    matched: set[str] = field(default_factory=set)
    is_known: bool = True

    def allow(self, axis: int, steps: Sequence[bool]) -> None:
        flags = np.asarray(steps, dtype=bool)
        self.allowed[axis] = self.allowed[axis] & flags if axis in self.allowed else flags


class Combined(Protocol):
    """Combinations of axes by row."""

    dimensions: list[Dimension]

    @property
    def additions(self) -> list[Addition]:
        """Return all that is added to steps of axes anywhere, and combinations that are not of steps."""

    def __len__(self) -> int:
        """Return the number of rows."""

    def steps(self, row: int) -> tuple[int, ...] | None:
        """Return the step on each axis; None for a combination that isn't of steps."""

    def addition(self, row: int) -> Addition:
        """Return the addition to a row, which for a combination that isn't of steps is all there is."""


class Grid:
    """Combinations by row: those of the matrix that are left, in its order, then those of include.

    Args:
        dimensions: the compiled axes, the first one slowest.
        template: fields that the template sets.
        include: entries as they stand in the Sweep.
        exclude: entries as they stand in the Sweep.
        findings: receives mistakes of entries, which are then left out; None: they are raised.

    Attributes:
        matrix_rows: number of combinations of the matrix that exclude left.

    Raises:
        InputError: one sentence a line for each mistake.
    """

    def __init__(
        self,
        dimensions: Sequence[Dimension],
        template: Settings,
        include: Sequence[Mapping[str, Any]],
        exclude: Sequence[Mapping[str, Any]],
        findings: Findings | None = None,
    ) -> None:
        self._findings = findings or Findings()
        self.dimensions = list(dimensions)
        self.shape = tuple(len(axis.values) for axis in self.dimensions)
        self._template = template
        self._setter = {path: number for number, axis in enumerate(self.dimensions) for path in axis.paths}
        self._labels = {axis.label: number for number, axis in enumerate(self.dimensions)}
        self._strides = [int(np.prod(self.shape[n + 1 :], dtype=object)) for n in range(len(self.shape))]
        excluded = self._entries(exclude, "spec.exclude", self._exclude_key)
        included = self._entries(include, "spec.include", self._include_key)
        if findings is None:
            self._findings.refuse()
        self._kept = self._keep(excluded, only_include=not self.dimensions and bool(included))
        self.matrix_rows = math.prod(self.shape) if self._kept is None else len(self._kept)
        self._additions: list[Addition] = [Addition()]
        self._addition_of: npt.NDArray[np.int32] | None = None
        self._extra: list[Addition] = []
        self._extend(included)
        if findings is None:
            self._findings.refuse()

    def __len__(self) -> int:
        return self.matrix_rows + len(self._extra)

    def steps(self, row: int) -> tuple[int, ...] | None:
        """Return the step on each axis, or None for a combination that include made."""
        if row >= self.matrix_rows:
            return None
        rest = row if self._kept is None else int(self._kept[row])
        result = []
        for stride in self._strides:
            step, rest = divmod(rest, stride)
            result.append(step)
        return tuple(result)

    @property
    def additions(self) -> list[Addition]:
        """Return all that include adds anywhere, and the combinations that it makes."""
        return [*self._additions, *self._extra]

    def addition(self, row: int) -> Addition:
        """Return the addition of include to a row, which for a combination of its own is all there is."""
        if row >= self.matrix_rows:
            return self._extra[row - self.matrix_rows]
        return self._additions[0 if self._addition_of is None else int(self._addition_of[row])]

    def _keep(self, excluded: list[_GridEntry], *, only_include: bool) -> npt.NDArray[np.intp] | None:
        total = int(np.prod(self.shape, dtype=object))
        if only_include:
            return np.empty(0, dtype=np.intp)
        if total > (MAX_GRID if excluded else MAX_POINTS):
            factors = " × ".join(map(str, self.shape))
            raise InputError(
                f"spec.matrix: {factors} = {total} combinations, at most "
                f"{MAX_POINTS} are allowed ({MAX_GRID} before exclude)"
            )
        if not excluded:
            return None
        mask = np.ones(self.shape, dtype=bool)
        for entry in excluded:
            choices: list[list[Any]] = [
                np.flatnonzero(entry.allowed[axis]).tolist() if axis in entry.allowed else [slice(None)]
                for axis in range(len(self.shape))
            ]
            for place in itertools.product(*choices):
                mask[place] = False
        return np.flatnonzero(mask)

    def _extend(self, included: list[_GridEntry]) -> None:
        rows = self.matrix_rows
        if rows > MAX_POINTS or not included:
            return
        flat = np.arange(rows) if self._kept is None else self._kept
        self._addition_of = np.zeros(rows, dtype=np.int32)
        codes: dict[int, npt.NDArray[np.intp]] = {}
        made: dict[str, str] = {}
        for entry in included:
            match = np.ones(rows, dtype=bool)
            for axis, allowed in entry.allowed.items():
                if axis not in codes:
                    codes[axis] = flat // self._strides[axis] % self.shape[axis]
                match &= allowed[codes[axis]]
            if match.any():
                self._add(match, Addition(*self._added(entry), (entry.where,)))
                continue
            addition = Addition(entry.coordinates, entry.settings, (entry.where,))
            key = json.dumps([[written(path), value] for path, value in sorted(entry.settings.items())])
            if key in made:
                self._findings.problems.append(f"{entry.where}: makes the same combination as {made[key]}")
                continue
            made[key] = entry.where
            self._extra.append(addition)

    def _add(self, match: npt.NDArray[np.bool_], addition: Addition) -> None:
        if self._addition_of is None or not addition.settings:
            return
        for number in np.unique(self._addition_of[match]).tolist():
            self._additions.append(self._additions[number].then(addition))
            self._addition_of[match & (self._addition_of == number)] = len(self._additions) - 1

    @staticmethod
    def _added(entry: _GridEntry) -> tuple[Coordinates, Settings]:
        coordinates = {key: value for key, value in entry.coordinates.items() if key not in entry.matched}
        return coordinates, {
            path: entry.settings[path] for path in entry.settings if written(path) not in entry.matched
        }

    def _entries(
        self,
        items: Sequence[Mapping[str, Any]],
        where: str,
        take: Callable[[_GridEntry, str, Any, str], None],
    ) -> list[_GridEntry]:
        found = (self._entry(item, f"{where}[{number}]", take) for number, item in enumerate(items))
        return [entry for entry in found if entry is not None]

    def _entry(
        self, item: Mapping[str, Any], where: str, take: Callable[[_GridEntry, str, Any, str], None]
    ) -> _GridEntry | None:
        """Return an entry of include or exclude; None where something of it is wrong or not known."""
        entry = _GridEntry(where)
        problems = self._findings.problems
        before = len(problems)
        if not item:
            nothing = "sets nothing" if "include" in where else "names no axis, so it would drop everything"
            problems.append(f"{where}: {nothing}")
        for key, value in sorted(item.items()):
            if key in self._findings.labels:
                entry.is_known = False  # the axis that it names is wrong
                continue
            count = len(problems)
            with Collected(problems):
                take(entry, key, value, f"{where}.{key}")
            if len(problems) > count and "include" in where:
                self._findings.lose(key)
        return entry if len(problems) == before and entry.is_known else None

    def _include_key(self, entry: _GridEntry, key: str, value: Any, where: str) -> None:
        axis = self._points_axis(key)
        if axis is not None:
            step = self._point(axis, value, where)
            entry.allow(axis, [number == step for number in range(self.shape[axis])])
            entry.coordinates[key] = value
            entry.matched.add(key)
            found = self.dimensions[axis].settings[step]
            entry.matched.update(written(path) for path in found)
        else:
            found = assign(self._path(key, where), value, where)
            for path, setting in found.items():
                self._include_path(entry, key, path, setting)
        for path, setting in found.items():
            if path in entry.settings and not _same(entry.settings[path], setting):
                raise InputError(f"{where}: sets {written(path)} a second time")
            entry.settings[path] = setting

    def _include_path(self, entry: _GridEntry, key: str, path: Any, setting: Any) -> None:
        number = self._setter.get(path)
        label = written(path)
        if number is not None:
            axis = self.dimensions[number]
            values = [step.get(path, _MISSING) for step in axis.settings]
            entry.allow(number, [value is _MISSING or _same(value, setting) for value in values])
            if axis.path == path:
                label = axis.label
                entry.matched.update((label, written(path)))
        elif key in {"algorithm", "dataset"}:
            label = key
        entry.coordinates[label] = setting

    def _exclude_key(self, entry: _GridEntry, key: str, value: Any, where: str) -> None:
        axis = self._points_axis(key)
        if axis is not None:
            step = self._point(axis, value, where)
            entry.allow(axis, [number == step for number in range(self.shape[axis])])
            return
        for path, setting in assign(self._path(key, where), value, where).items():
            number = self._setter.get(path)
            if number is None:
                if self._findings.unsure(path):
                    entry.is_known = False  # an axis that is wrong may have been meant to
                    continue
                labels = suggestion(key, self._labels) if self._labels else "; the matrix has no axes"
                raise InputError(f"{where}: no axis sets {written(path)}{labels}")
            base = self._template.get(path, _MISSING)
            values = [step.get(path, base) for step in self.dimensions[number].settings]
            entry.allow(number, [value is not _MISSING and _same(value, setting) for value in values])

    def _points_axis(self, key: str) -> int | None:
        axis = self._labels.get(key)
        return axis if axis is not None and self.dimensions[axis].path is None else None

    def _path(self, key: str, where: str) -> Any:
        axis = self._labels.get(key)
        if axis is not None and self.dimensions[axis].path is not None:
            return self.dimensions[axis].path
        try:
            return parse_path(key, where)
        except InputError as error:
            named = f" (axes: {', '.join(self._labels)})" if self._labels else ""
            raise InputError(f"{error}{named}") from None

    def _point(self, axis: int, value: Any, where: str) -> int:
        names = [str(name) for name in self.dimensions[axis].values]
        if value not in names:
            raise InputError(f"{where}: unknown point {value!r}{suggestion(str(value), names)}")
        return names.index(value)


def _same(left: Any, right: Any) -> bool:
    """Tell whether two normalised values are equal; true is not 1."""
    return type(left) is type(right) and bool(left == right)
