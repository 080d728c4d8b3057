# SPDX-License-Identifier: Apache-2.0
"""MappingRun: one algorithm on one dataset with one set of parameters."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from slamhive.model.algorithm import Pace
from slamhive.model.base import Duration, Model, Quantity, Reference, Resource, Scalar
from slamhive.model.sensors import SensorMode


class LidarInput(Model):
    """Filter of LiDAR scans: range of the points and number of rings that are kept."""

    min_range: float | None = Field(default=None, ge=0, description="Points nearer than this go, in m.")
    max_range: float | None = Field(default=None, gt=0, description="Points farther than this go, in m.")
    rings: int | None = Field(default=None, gt=0, description="Rings to keep, evenly spaced.")


class InputOptions(Model):
    """Options of a run's input: pace, and what is taken of the recording and its sensors."""

    pace: Pace | None = Field(
        default=None, description="Lockstep or Realtime; default: the algorithm's first."
    )
    frame_rate: float | None = Field(
        default=None, gt=0, description="Frames per second of cameras and LiDARs; default: as recorded."
    )
    resolution: float = Field(default=1.0, gt=0, le=1, description="Scale of images in each direction.")
    start: Duration | None = Field(default=None, description="Time to leave out at the beginning.")
    duration: Duration | None = Field(default=None, description="Length to keep.")
    rate: float | None = Field(default=None, gt=0, le=100, description="Speed of playback in real time.")
    lidar: LidarInput | None = Field(default=None, description="Filter of LiDAR scans.")
    remap: dict[str, str] = Field(
        default_factory=dict, description="Sensor of the dataset for a role, such as camera: back."
    )


class Resources(Model):
    """Processors, memory and GPUs that a run may use; requests equal limits."""

    cpu: Quantity = Field(default="1", description="Processors; on a workstation whole cores.")
    memory: Quantity = Field(default="4Gi", description="Memory.")
    gpu: int | None = Field(default=None, ge=1, description="GPUs.")


class MappingRunSpec(Model):
    """One mapping run."""

    algorithm_ref: Reference = Field(description="The Algorithm.")
    dataset_ref: Reference = Field(description="The Dataset.")
    sensors: SensorMode | None = Field(default=None, description="Sensor mode; default: the only one.")
    parameters: dict[str, Scalar] = Field(default_factory=dict, description="The algorithm's parameters.")
    input: InputOptions = Field(
        default_factory=InputOptions, description="Options of the input: pace, rates, resolution, span."
    )
    repetition: int = Field(default=0, ge=0, le=100_000, description="Number of the repetition.")
    seed: int = Field(default=1, ge=0, le=2**31 - 1, description="Seed for the algorithm.")
    resources: Resources = Field(default_factory=Resources, description="Processors, memory and GPUs.")
    timeout: Duration = Field(default="1h", description="Longest time from the algorithm's first process.")
    retries: int = Field(
        default=2, ge=0, le=10, description="Further attempts after infrastructure failures."
    )
    evaluate: bool = Field(default=True, description="Whether to evaluate the trajectory.")
    cancel: bool = Field(default=False, description="Whether to end the run.")


class MappingRun(Resource):
    """A run as an object of its own."""

    kind: Literal["MappingRun"] = "MappingRun"
    spec: MappingRunSpec


UNHASHED = ("timeout", "retries", "evaluate", "cancel")
"""Fields of the spec that do not change what a run produces."""
