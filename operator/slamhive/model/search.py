# SPDX-License-Identifier: Apache-2.0
"""Search of a Sweep: which points of its matrix are tried, and what is known of each try."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any, Self

from pydantic import Field, model_validator

from slamhive.model.base import Choice, Model, optional
from slamhive.model.results import Outcome

if TYPE_CHECKING:
    from collections.abc import Mapping

MAX_TRIALS = 5_000
"""The most settings that a search may try: its trials are kept in the Sweep's status."""
VALUES_BESIDE = 2
"""Values that are tried beside a threshold that was found, to see whether failing is monotone."""
VALUES_NEAR = 4
"""Values that are tried next to a threshold at most, where repetitions disagree."""
VALUES_UNKNOWN = 2
"""Values of which nothing becomes known after which a threshold is left as wide as it is."""


class SearchMethod(Choice):
    """Methods of choosing points from the matrix of a Sweep."""

    GRID = "Grid"
    RANDOM = "Random"
    SOBOL = "Sobol"
    TPE = "TPE"
    NSGA_II = "NSGA-II"
    THRESHOLD = "Threshold"

    @property
    def is_sampled(self) -> bool:
        """Tell whether a sampler proposes the settings that are tried."""
        return self not in {SearchMethod.GRID, SearchMethod.THRESHOLD}


class Goal(Choice):
    """Directions in which an objective is better."""

    MINIMIZE = "Minimize"
    MAXIMIZE = "Maximize"


class Objective(Model):
    """A figure that a search makes as good as it can."""

    metric: str = Field(
        min_length=1, max_length=253, description="Column of the table of runs, such as ate.rmse."
    )
    goal: Goal = Field(default=Goal.MINIMIZE, description="Whether small or large is good.")


class TrialRepetitions(Model):
    """Numbers of runs of a setting on each of the datasets that a search goes over."""

    first: int = Field(default=1, ge=1, le=1_000, description="Runs that every setting gets.")
    promote: int = Field(default=1, ge=1, le=1_000, description="Runs that good settings get in all.")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.promote < self.first:
            raise ValueError(f"promote: {self.promote} is less than first, {self.first}")
        return self


class SettingAggregate(Choice):
    """Ways to make one figure of a setting's figures on several datasets."""

    MEAN = "Mean"
    WORST = "Worst"


class Failing(Model):
    """Rule by which a run counts as failed for a threshold; a run whose program failed always does."""

    outcome: list[Outcome] | None = optional(
        "Outcomes that count as failed; default: all but Tracked.", min_length=1
    )
    metric: str | None = optional("Column of the table of runs, such as ate.rmse.", max_length=253)
    above: float | None = optional("The run has failed where the metric is greater.")
    below: float | None = optional("The run has failed where the metric is less.")
    quantile: float = Field(
        default=0.5, gt=0, le=1, description="Share of the repetitions that must fail for a value to fail."
    )

    @model_validator(mode="after")
    def _one_rule(self) -> Self:
        if self.metric is None:
            if self.above is not None or self.below is not None:
                raise ValueError("metric: needed beside above and below")
            return self
        if self.outcome is not None:
            raise ValueError("give either outcome or metric")
        if (self.above is None) == (self.below is None):
            raise ValueError("a metric needs either above or below")
        return self


class Search(Model):
    """Settings for choosing points from the matrix of a Sweep."""

    method: SearchMethod = Field(
        default=SearchMethod.GRID, description="Grid: every point. Others try some of them."
    )
    objectives: list[Objective] = Field(
        default_factory=list, max_length=2, description="Figures that it makes as good as it can."
    )
    trials: int | None = optional("Settings that are tried; may be raised later.", ge=1, le=MAX_TRIALS)
    seed: int = Field(default=0, ge=0, le=2**31 - 1, description="Seed of the sampler.")
    repetitions: TrialRepetitions = Field(
        default_factory=TrialRepetitions, description="Runs of a setting on each dataset."
    )
    across: list[str] | None = optional(
        "Labels of axes on all values of which each setting is run, rather than searched; default: dataset, "
        "of a threshold none.",
        max_length=32,
    )
    aggregate: SettingAggregate = Field(
        default=SettingAggregate.MEAN, description="Figure over datasets: their mean, or the worst."
    )
    keep: int = Field(
        default=4, ge=1, le=100, description="After each step one in so many settings goes on; 1: all."
    )
    at_a_time: int = Field(
        default=4,
        ge=1,
        le=1_000,
        description="Settings under way: a new one is proposed by the results of all before these.",
    )
    axis: str | None = optional("Label of the axis whose threshold is sought.")
    failing: Failing = Field(default_factory=Failing, description="When a run has failed.")
    tolerance: float | None = optional(
        "Width of the interval at which a threshold on a range without step is good enough, of a logarithmic "
        "one the ratio of its ends less 1; default: a hundredth of the range.",
        gt=0,
    )

    @model_validator(mode="after")
    def _fields_of_method(self) -> Self:
        sampled = {"objectives", "trials", "across", "aggregate", "keep", "at_a_time", "seed"}
        threshold = {"axis", "failing", "tolerance"}
        foreign = {
            SearchMethod.GRID: sampled | threshold | {"repetitions"},
            SearchMethod.THRESHOLD: (sampled - {"across"}) | {"repetitions"},
        }.get(self.method, threshold)
        for name in sorted(foreign):
            field = type(self).model_fields[name]
            if getattr(self, name) != field.get_default(call_default_factory=True):
                raise ValueError(f"{field.alias or name}: means nothing to the method {self.method}")
        needed = {SearchMethod.GRID: (), SearchMethod.THRESHOLD: ("axis",)}.get(
            self.method, ("objectives", "trials")
        )
        for name in needed:
            if not getattr(self, name):
                raise ValueError(f"{name}: the method {self.method} needs it")
        return self

    @property
    def chooses(self) -> bool:
        """Tell whether results decide what is run, or how often: then its runs are no fair sample."""
        return self.is_search and not (self.method in _BLIND and self.keep == 1)

    @property
    def is_search(self) -> bool:
        """Tell whether not every point of the matrix is run."""
        return self.method is not SearchMethod.GRID


_BLIND = frozenset({SearchMethod.RANDOM, SearchMethod.SOBOL})
"""Methods that look at no results, where they drop nothing."""


def choosing_method(spec: Mapping[str, Any]) -> str | None:
    """Return the method of a stored Sweep whose results decide what is run; None where they don't.

    Args:
        spec: of the Sweep, of any version of slamhive.
    """
    given = spec.get("search")
    if not isinstance(given, dict):
        return None
    with suppress(ValueError):
        search = Search.model_validate(given)
        return search.method.value if search.chooses else None
    return str(given.get("method"))


class TrialOrigin(Choice):
    """Reasons for which a setting is tried."""

    DRAWN = "Drawn"
    KNOWN = "Known"


class Trial(Model):
    """A setting that a search tries: written down before its first run starts, and never drawn anew.

    Its number is its place in the list of trials. Its runs have the indices from ``number × block``.
    """

    values: list[Any] = Field(description="Value on each searched axis, in the order of the matrix.")
    told: int = Field(
        default=0,
        ge=0,
        description="The results of all trials below this number had been told to the sampler.",
    )
    origin: TrialOrigin = Field(
        default=TrialOrigin.DRAWN, description="Drawn by the method, or known to the archive before."
    )

    @property
    def is_known(self) -> bool:
        """Tell whether the archive knew it before the search began."""
        return self.origin is TrialOrigin.KNOWN


class SearchRecord(Model):
    """A search as far as it has come: what it goes on from after any end."""

    trials: list[Trial] = Field(default_factory=list, description="The settings that are tried, by number.")
    spared: int = Field(
        default=0, ge=0, description="Runs whose results the archive had before the search began."
    )
