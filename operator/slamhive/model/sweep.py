# SPDX-License-Identifier: Apache-2.0
"""Sweep: many mapping runs in a few lines."""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import Field, model_validator

from slamhive.model.base import Choice, Duration, Labels, Model, Name, Resource, Scalar, optional
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.search import Search, SearchMethod

MAX_POINTS = 100_000
"""The most runs that a Sweep may have."""
MOST_WEIGHT = 1000
"""The largest weight of a Sweep or a namespace."""


class Range(Model):
    """Evenly spaced numbers, both ends included where the step meets them; in a search all between them."""

    from_: float = Field(alias="from", description="First value.")
    to: float = Field(description="Last value.")
    step: float | None = Field(default=None, gt=0, description="Distance between values.")
    count: int | None = Field(default=None, ge=1, le=MAX_POINTS, description="Number of values.")
    scale: Literal["Linear", "Log"] = Field(default="Linear", description="Spacing.")

    @model_validator(mode="after")
    def _determined(self) -> Self:
        if self.step is not None and self.count is not None:
            raise ValueError("give either step or count")
        if self.scale == "Log" and self.step is not None:
            raise ValueError("the scale Log needs count, or in a search neither count nor step")
        if self.scale == "Log" and min(self.from_, self.to) <= 0:
            raise ValueError(f"the scale Log needs ends above zero, found {min(self.from_, self.to):g}")
        if self.count is None and self.to < self.from_:
            raise ValueError("to must not be below from")
        return self

    @property
    def is_continuous(self) -> bool:
        """Tell whether it holds all numbers between its ends, which only a search can try."""
        return self.step is None and self.count is None


class LabelSelector(Model):
    """Algorithms or datasets by their labels."""

    match_labels: dict[str, str] = Field(min_length=1, description="Labels that must be equal.")


class Axis(Model):
    """One dimension of the matrix."""

    name: str | None = Field(default=None, description="Name of an axis of points.")
    path: str | None = Field(
        default=None,
        description="Field to set: algorithm, dataset, sensors, parameters.NAME, input.frameRate …",
    )
    values: list[Any] | None = Field(default=None, min_length=1, description="The values.")
    range: Range | None = Field(default=None, description="Evenly spaced values.")
    selector: LabelSelector | None = Field(default=None, description="Catalog entries, sorted by name.")
    points: dict[str, dict[str, Any]] | None = Field(
        default=None, min_length=1, description="Named points that set several fields each."
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        given = [key for key in ("values", "range", "selector", "points") if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError("give one of values, range, selector or points")
        if self.points is not None and (self.name is None or self.path is not None):
            raise ValueError("an axis of points has a name and no path")
        if self.points is None and self.path is None:
            raise ValueError("path: needed with values, range and selector")
        return self

    @property
    def label(self) -> str:
        """Return the axis's name in include and exclude."""
        return self.name or self.path or ""


class Budget(Model):
    """Limits at which a Sweep stops starting runs."""

    wall_time: Duration | None = Field(default=None, description="Time since its start.")
    cpu_hours: float | None = Field(default=None, gt=0, description="CPU hours of its runs.")


class CachePolicy(Choice):
    """Policies for a run that equals a finished one: take that one's result, or run again."""

    REUSE = "Reuse"
    RERUN = "Rerun"


class Retention(Model):
    """Rules for what is kept of a Sweep's finished runs: objects, and run folders."""

    runs: int = Field(default=1000, ge=0, description="MappingRun objects kept when there is an archive.")
    files: Literal["Keep", "Delete"] = Field(default="Keep", description="Run folders.")


class TemplateMeta(Model):
    """Metadata that every run gets."""

    labels: Labels = Field(default_factory=dict, description="Labels.")
    annotations: dict[str, str] = Field(default_factory=dict, description="Annotations.")


class RunTemplate(Model):
    """Template of a Sweep that every run starts from: metadata and spec."""

    metadata: TemplateMeta = Field(default_factory=TemplateMeta, description="Labels and annotations.")
    spec: dict[str, Any] = Field(
        default_factory=dict, description="Fields of a MappingRun's spec; axes set or replace them."
    )


class SweepSpec(Model):
    """Many runs: a template, and a matrix of what varies."""

    template: RunTemplate = Field(
        default_factory=RunTemplate, description="Metadata and spec that every run starts from."
    )
    matrix: list[Axis] = Field(
        default_factory=list, max_length=32, description="Axes, the first one slowest."
    )
    include: list[dict[str, Any]] = Field(
        default_factory=list, max_length=10_000, description="Points to add or to extend, as in CI matrices."
    )
    exclude: list[dict[str, Any]] = Field(
        default_factory=list, max_length=10_000, description="Patterns of points to drop, as in CI matrices."
    )
    repetitions: int = Field(
        default=1, ge=1, le=10_000, description="Runs of each point, each with its seed."
    )
    search: Search = Field(default_factory=Search, description="Choice of points from the matrix.")
    parallelism: int | None = Field(default=None, ge=1, le=10_000, description="Runs at the same time.")
    weight: int = Field(
        default=1, ge=1, le=MOST_WEIGHT, description="Weight by which it shares a cluster with other Sweeps."
    )
    priority_class_name: Name | None = optional(
        "PriorityClass of its runs' pods; Sweeps of one with a higher value are served first."
    )
    max_failures: int | None = Field(default=None, ge=0, description="Failed runs after which it stops.")
    budget: Budget = Field(default_factory=Budget, description="Limits at which it stops starting runs.")
    suspend: bool = Field(default=False, description="Whether to start no further runs.")
    cache_policy: CachePolicy = Field(default=CachePolicy.REUSE, description="Reuse of equal runs' results.")
    evaluation: EvaluationSettings = Field(
        default_factory=EvaluationSettings, description="Settings for measuring the runs."
    )
    retention: Retention = Field(
        default_factory=Retention, description="Finished runs and folders that are kept."
    )

    @property
    def priority_class(self) -> str | None:
        """Return the name of the PriorityClass that it has, or its template; None: the chart's."""
        own: str | None = self.priority_class_name or self.template.spec.get("priorityClassName")
        return own

    @property
    def runs_alone(self) -> bool:
        """Tell whether its template says that each run has its node for itself."""
        resources = self.template.spec.get("resources")
        return isinstance(resources, dict) and resources.get("exclusiveNodes") is True

    @model_validator(mode="after")
    def _fits_search(self) -> Self:
        search = self.search
        if not search.is_search:
            return self
        if search.method.is_sampled and self.repetitions != 1:
            raise ValueError(
                "repetitions: a search has its own, search.repetitions; give them in one place alone"
            )
        if self.include:
            raise ValueError("include: a search adds no points; make them values of an axis")
        labels = [axis.label for axis in self.matrix]
        for name in [*(search.across or ()), *([search.axis] if search.axis else [])]:
            if name not in labels:
                field = "axis" if search.method is SearchMethod.THRESHOLD else "across"
                raise ValueError(
                    f"search.{field}: {name!r} is no label of an axis, these are: {', '.join(labels)}"
                )
        return self


IMMUTABLE = ("template", "matrix", "include", "exclude", "repetitions", "search")
"""Fields of a Sweep that say which runs it has; they make its identity."""


class Sweep(Resource):
    """A study: many runs described at once."""

    kind: Literal["Sweep"] = "Sweep"
    spec: SweepSpec


__all__ = [
    "IMMUTABLE",
    "MAX_POINTS",
    "MOST_WEIGHT",
    "Axis",
    "Budget",
    "CachePolicy",
    "Range",
    "Scalar",
    "Sweep",
    "SweepSpec",
]
