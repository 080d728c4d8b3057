# SPDX-License-Identifier: Apache-2.0
"""Repair of a dataset: what its preparation changes in its messages, so that all see a clean stream.

The recording itself isn't touched. ``timeOffset`` of a sensor is another thing: what algorithms are told.
"""

from __future__ import annotations

from pydantic import Field, model_validator

from slamhive.model.base import Choice, Model, optional


class PointTimes(Choice):
    """Units of the times of a scan's points, and None for times that say nothing."""

    S = "s"
    MS = "ms"
    US = "us"
    NS = "ns"
    NONE = "None"


class BackwardStamps(Choice):
    """Ways on from stamps that go back: by the times of recording, or without the messages that go back."""

    RECORDED = "Recorded"
    DROP = "Drop"


class ClockRepair(Model):
    """Repair of the stamps of one stream, in the time of the header stamps as recorded."""

    shift: float | None = optional("Seconds added to each stamp.")
    drift: float | None = optional(
        "Seconds added for each second since the stream's first stamp.", gt=-0.1, lt=0.1
    )


class SensorRepair(ClockRepair):
    """Repair of the messages of one sensor."""

    stamps: BackwardStamps | None = optional("What is done with stamps that go back.")
    drop_leading: int | None = optional("Number of first messages left out.", ge=1)
    drop: list[int] = Field(
        default_factory=list, max_length=10_000, description="Numbers of messages left out, from 0."
    )
    point_times: PointTimes | None = optional(
        "Lidar: unit of the times of points; None: they are left out, as they say nothing."
    )
    no_returns: bool | None = optional("Lidar: whether points at the origin, or of NaN, are left out.")
    force_scale: float | None = optional("Imu: factor of the specific forces, 9.80665 where they are in g.")
    rate_scale: float | None = optional(
        "Imu: factor of the turning rates, 0.0174533 where they are in deg/s."
    )
    forces: str | None = optional(
        "Imu: topic of the forces, where the sensor's own has the rates alone; interpolated to its stamps."
    )
    depth_scale: float | None = optional("DepthCamera: units of its images per metre.", gt=0)


class Repair(Model):
    """Repair of a dataset, applied by its preparation; what it names is the recording as it is."""

    sensors: dict[str, SensorRepair] = Field(default_factory=dict, description="Repairs by sensor.")
    ground_truth: ClockRepair | None = optional("Repair of the ground truth's stamps.")

    @model_validator(mode="after")
    def _repairs_something(self) -> Repair:
        if not self.sensors and self.ground_truth is None:
            raise ValueError("repair: nothing is repaired; leave it out")
        return self
