# SPDX-License-Identifier: Apache-2.0
"""Evaluation: how trajectories are compared with ground truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator

from slamhive.model.base import Choice, Duration, Image, Model, Name, Reference, Resource

if TYPE_CHECKING:
    from collections.abc import Mapping


class Alignment(Choice):
    """Methods of aligning an estimate with the ground truth before its error is taken."""

    AUTO = "Auto"
    SE3 = "SE3"
    SIM3 = "Sim3"
    YAW = "Yaw"
    ORIGIN = "Origin"
    NONE = "None"


class RpeSpec(Model):
    """One relative pose error to compute."""

    delta: float = Field(default=1.0, gt=0, description="Distance between the poses of a pair, in unit.")
    unit: Literal["frames", "m", "deg", "rad", "s"] = Field(default="m", description="Unit of delta.")
    pairs: Literal["All", "Consecutive"] = Field(
        default="All", description="Pairs of poses: all, or those that follow each other."
    )
    rel_tolerance: float = Field(
        default=0.1, ge=0, le=1, description="Tolerance of delta for all pairs, relative."
    )


class Association(Model):
    """Settings for matching the poses of an estimate with the ground truth by their time stamps."""

    max_difference: Duration = Field(default="10ms", description="Greatest difference of time stamps.")
    offset: float = Field(default=0.0, description="Seconds to add to the estimate's stamps.")


class Success(Model):
    """Conditions under which a run counts as tracked."""

    min_coverage: float = Field(default=0.9, gt=0, le=1, description="Least share of the path covered.")
    max_ate: float | None = Field(default=None, gt=0, description="Greatest ATE RMSE in m.")


class EvaluationSettings(Model):
    """Settings for measuring trajectories; part of an Evaluation and of a Sweep."""

    alignment: Alignment = Field(
        default=Alignment.AUTO, description="Auto: Sim3 for monocular runs, SE3 for all others."
    )
    frame: Literal["Estimate", "None"] = Field(
        default="Estimate",
        description="Estimate: the ground truth is moved into the estimate's frame. None: taken as it is.",
    )
    association: Association = Field(default_factory=Association, description="Matching by time.")
    rpe: list[RpeSpec] = Field(
        default_factory=lambda: [RpeSpec()], max_length=16, description="Relative pose errors."
    )
    success: Success = Field(
        default_factory=Success, description="Conditions under which a run counts as tracked."
    )


class RunSelector(Model):
    """Selection of the runs that an Evaluation measures, by name, Sweep or label."""

    names: list[Name] = Field(default_factory=list, description="Runs by name.")
    sweep_ref: Reference | None = Field(default=None, description="All runs of a Sweep.")
    match_labels: dict[str, str] = Field(default_factory=dict, description="Runs by label.")

    @model_validator(mode="after")
    def _selects(self) -> Self:
        if not (self.names or self.sweep_ref or self.match_labels):
            raise ValueError("name runs by names, sweepRef or matchLabels")
        return self

    def selects(self, name: str, sweep: str | None, labels: Mapping[str, str]) -> bool:
        """Tell whether a run is selected; several conditions must all hold.

        Args:
            name: the run's.
            sweep: name of its Sweep, None if it is a run by itself.
            labels: the run's.
        """
        if self.sweep_ref is not None and sweep != self.sweep_ref.name:
            return False
        if self.names and name not in self.names:
            return False
        return all(labels.get(key) == value for key, value in self.match_labels.items())


class Evaluator(Model):
    """A container that evaluates in the place of ours."""

    image: Image = Field(description="Container image.")
    command: list[str] = Field(default_factory=list, description="Program in the container.")


class EvaluationSpec(EvaluationSettings):
    """An evaluation of finished runs."""

    runs: RunSelector = Field(description="Runs to measure.")
    evaluator: Evaluator | None = Field(default=None, description="A custom evaluator.")


class Evaluation(Resource):
    """A measurement of runs that have finished."""

    kind: Literal["Evaluation"] = "Evaluation"
    spec: EvaluationSpec
