# SPDX-License-Identifier: Apache-2.0
"""Axes: from one entry of a Sweep's matrix to the fields that each of its values sets."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

from slamhive.model.canonical import normalize
from slamhive.model.errors import InputError
from slamhive.model.sweep import MAX_POINTS
from slamhive.plan.catalog import select
from slamhive.plan.paths import (
    ALGORITHM,
    DATASET,
    Collected,
    Settings,
    assign,
    flatten,
    parse_path,
    sets_one_field,
    written,
)

if TYPE_CHECKING:
    from slamhive.model.sweep import Axis, Range
    from slamhive.plan.catalog import Catalog
    from slamhive.plan.findings import Findings
    from slamhive.plan.paths import Path

_LOG_DIGITS = 12


class OneField(Sequence[Settings]):
    """Settings of the steps of an axis that all set one field; each is made when it is asked for.

    A mapping for each of 80,000 steps would take 17 MB of the operator's memory.

    Args:
        path: the field.
        values: what each step sets it to.
    """

    def __init__(self, path: Path, values: Sequence[Any]) -> None:
        self._path = path
        self._values = tuple(values)

    def __len__(self) -> int:
        return len(self._values)

    @overload
    def __getitem__(self, index: int) -> Settings: ...

    @overload
    def __getitem__(self, index: slice) -> OneField: ...

    def __getitem__(self, index: int | slice) -> Settings | OneField:
        if isinstance(index, slice):
            return OneField(self._path, self._values[index])
        return {self._path: self._values[index]}


@dataclass(frozen=True)
class Dimension:
    """A compiled axis.

    Attributes:
        label: what include, exclude and tables call it.
        where: the field of the manifest, such as ``spec.matrix[2]``.
        source: the field below it that holds the values.
        values: coordinate of each step; the point's name on an axis of points.
        settings: fields that each step sets.
        path: the field that all steps set; None on an axis of points.
        span: the range of which a search tries any number; ``values`` are its ends then.
    """

    label: str
    where: str
    source: str
    values: tuple[Any, ...]
    settings: Sequence[Settings]
    path: Path | None = None
    span: Range | None = None

    @cached_property
    def paths(self) -> frozenset[Path]:
        """Return all fields that any of its steps sets."""
        return frozenset(path for step in self.settings for path in step)

    def origin(self, step: int) -> str:
        """Return the field of the manifest that a step comes from."""
        if self.source == "points":
            return f"{self.where}.points.{self.values[step]}"
        return f"{self.where}.values[{step}]" if self.source == "values" else f"{self.where}.{self.source}"


def spread(span: Range, where: str) -> list[float]:
    """Return the numbers of a range, the ends exact, steps as decimals and not as sums of floats.

    Raises:
        InputError: there would be too many numbers, or one for two different ends.
    """
    first, last = (Fraction(repr(float(end))) for end in (span.from_, span.to))
    if span.is_continuous:
        raise InputError(f"{where}: give step or count; without them it is for a search alone")
    if span.step is not None:
        width = Fraction(repr(float(span.step)))
        count = int((last - first) / width) + 1
    else:
        count = span.count or 1
        width = (last - first) / max(count - 1, 1)
    if count > MAX_POINTS:
        raise InputError(f"{where}: gives {count} values, at most {MAX_POINTS} are allowed")
    if span.step is None and count == 1 and first != last:
        raise InputError(
            f"{where}: count 1 needs from and to to be equal, found {span.from_:g} and {span.to:g}"
        )
    if span.scale == "Linear":
        return [float(first + number * width) for number in range(count)]
    inner = [
        float(f"{span.from_ * (span.to / span.from_) ** (number / (count - 1)):.{_LOG_DIGITS}g}")
        for number in range(1, count - 1)
    ]
    return [span.from_, *inner, span.to][:count]


def compile_axes(
    axes: Sequence[Axis], catalog: Catalog, findings: Findings, *, searching: bool = False
) -> list[Dimension]:
    """Compile the axes of a matrix; mistakes go to the findings, axes without a right value are left out.

    Args:
        axes: as they stand in the Sweep.
        catalog: what selectors choose from.
        findings: receives the mistakes.
        searching: whether a range may have neither step nor count, as any number of it may be tried.
    """
    problems = findings.problems
    dimensions: list[Dimension] = []
    labels: dict[str, str] = {}
    setters: dict[Path, str] = {}
    for number, axis in enumerate(axes):
        where = f"spec.matrix[{number}]"
        if axis.label in labels:
            problems.append(f"{where}: {labels[axis.label]} has the label {axis.label!r} already")
            findings.lose_axis(axis.label, axis.path)
            continue
        labels[axis.label] = where
        dimension = None
        with Collected(problems):
            dimension = (
                _points(axis, where, findings)
                if axis.points
                else _steps(axis, where, catalog, findings, searching=searching)
            )
        if dimension is None or not dimension.values:
            findings.lose_axis(axis.label, axis.path)
            continue
        for path in sorted(dimension.paths):
            if path in setters:
                problems.append(f"{where}: sets {written(path)}, which {setters[path]} sets already")
            setters.setdefault(path, where)
        dimensions.append(dimension)
    return dimensions


def _points(axis: Axis, where: str, findings: Findings) -> Dimension:
    # The order of keys doesn't survive an API server, so points are sorted by name.
    points = sorted((axis.points or {}).items())
    return Dimension(
        label=axis.label,
        where=where,
        source="points",
        values=tuple(name for name, _ in points),
        settings=tuple(
            flatten(fields, f"{where}.points.{name}", findings.problems, lose=findings.lose)
            for name, fields in points
        ),
    )


def _steps(axis: Axis, where: str, catalog: Catalog, findings: Findings, *, searching: bool) -> Dimension:
    path = parse_path(axis.path or "", f"{where}.path")
    span = axis.range if searching and axis.range is not None and axis.range.is_continuous else None
    values, source = (
        ([span.from_, span.to][: 1 + (span.from_ < span.to)], "range")
        if span
        else _values(axis, path, where, catalog, findings)
    )
    seen: set[object] = set()
    plain: list[Any] = []
    settings: list[Any] = []
    # What a value sets is one field, but for axes of whole objects and of maps.
    is_field = sets_one_field(path)
    for number, value in enumerate(values):
        place = f"{where}.values[{number}]" if source == "values" else f"{where}.{source}"
        setting: Settings | None = None
        with Collected(findings.problems):
            setting = assign(path, value, place)
        if setting is None:
            continue
        taken = setting[path] if is_field else setting
        is_single = isinstance(taken, int | float | str)
        key = (type(taken), taken) if is_single else json.dumps(sorted(setting.items()))
        if key in seen:
            findings.problems.append(f"{place}: the value {value!r} stands twice")
        seen.add(key)
        shown = normalize(value, place)
        # A range may have 100,000 numbers: each is held once.
        plain.append(taken if is_single and (type(shown), shown) == key else shown)
        settings.append(taken)
    steps = OneField(path, settings) if is_field else tuple(settings)
    return Dimension(axis.label, where, source, tuple(plain), steps, path, span)


def _values(
    axis: Axis, path: Path, where: str, catalog: Catalog, findings: Findings
) -> tuple[list[Any], str]:
    if axis.values is not None:
        return axis.values, "values"
    if axis.range is not None:
        return spread(axis.range, f"{where}.range"), "range"
    if path not in {ALGORITHM, DATASET}:
        raise InputError(f"{where}.selector: selects algorithms or datasets, so path must be one of them")
    kind = "algorithm" if path == ALGORITHM else "dataset"
    labels = axis.selector.match_labels if axis.selector else {}
    names = select(catalog, kind, labels)
    if not names and not findings.hidden(kind, ""):
        wanted = ", ".join(f"{key}: {value}" for key, value in sorted(labels.items()))
        raise InputError(f"{where}.selector: no {kind} has the labels {wanted}")
    return list(names), "selector"
