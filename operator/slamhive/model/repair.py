# SPDX-License-Identifier: Apache-2.0
"""Repair of a dataset: what its preparation changes in its messages, so that all see a clean stream.

The recording itself isn't touched. ``timeOffset`` of a sensor is another thing: what algorithms are told.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

from pydantic import Field, model_validator
from pydantic.alias_generators import to_camel

from slamhive.model.base import Choice, Model, optional
from slamhive.model.errors import suggestion
from slamhive.model.sensors import SensorType

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from slamhive.model.sensors import Sensor

_OF = {
    "point_times": SensorType.LIDAR,
    "no_returns": SensorType.LIDAR,
    "force_scale": SensorType.IMU,
    "rate_scale": SensorType.IMU,
    "forces": SensorType.IMU,
    "depth_scale": SensorType.DEPTH_CAMERA,
}
"""Kinds of sensors whose messages some repairs are of; the others are of any."""


MOST_DROPPED = 10_000
"""Messages that a repair names at most."""


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

    shift: float | None = optional("Seconds added to each stamp.", ge=-4e9, le=4e9)
    drift: float | None = optional(
        "Seconds added for each second since the stream's first stamp.", gt=-0.1, lt=0.1
    )


class SensorRepair(ClockRepair):
    """Repair of the messages of one sensor."""

    stamps: BackwardStamps | None = optional("What is done with stamps that go back.")
    drop_leading: int | None = optional("Number of first messages left out.", ge=1)
    drop: list[int] = Field(
        default_factory=list, max_length=MOST_DROPPED, description="Numbers of messages left out, from 0."
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

    @model_validator(mode="after")
    def _scales_to_something(self) -> SensorRepair:
        for name in ("force_scale", "rate_scale"):
            if getattr(self, name) == 0:
                raise ValueError(f"{to_camel(name)}: 0 leaves nothing of the messages")
        return self

    def told(self, sensor: Sensor) -> Sensor:
        """Return a sensor as its repaired messages are: what algorithms are told of it."""
        if self.depth_scale is not None and sensor.camera is not None:
            return sensor.replace(camera=sensor.camera.replace(depth_scale=self.depth_scale))
        if self.point_times is PointTimes.NONE and sensor.lidar is not None:
            return sensor.replace(lidar=sensor.lidar.replace(time_field=None, times_since=None))
        return sensor


class Repair(Model):
    """Repair of a dataset, applied by its preparation; what it names is the recording as it is."""

    sensors: dict[str, SensorRepair] = Field(default_factory=dict, description="Repairs by sensor.")
    ground_truth: ClockRepair | None = optional("Repair of the ground truth's stamps.")

    @model_validator(mode="after")
    def _repairs_something(self) -> Repair:
        if not self.sensors and self.ground_truth is None:
            raise ValueError("repair: nothing is repaired; leave it out")
        return self

    def of_topics(self, sensors: Mapping[str, Sensor]) -> dict[str, SensorRepair]:
        """Return the repairs by topic: sensors of one topic share their messages."""
        return {sensors[name].topic: repair for name, repair in self.sensors.items() if name in sensors}

    def misfits(self, sensors: Mapping[str, Sensor]) -> Iterator[str]:
        """Yield a sentence on each repair that a dataset's sensors can't have."""
        for name, repair in self.sensors.items():
            sensor, where = sensors.get(name), f"repair.sensors.{name}"
            if sensor is None:
                yield f"repair.sensors: unknown sensor {name!r}{suggestion(name, sensors)}"
                continue
            for field, kind in _OF.items():
                if getattr(repair, field) is not None and sensor.type is not kind:
                    yield f"{where}.{to_camel(field)}: {name} is of type {sensor.type}; only {kind} takes it"
            if repair.point_times is not None and (sensor.lidar is None or sensor.lidar.time_field is None):
                yield f"{where}.pointTimes: name the field of the times as sensors.{name}.lidar.timeField"
            if repair.forces == sensor.topic:
                yield f"{where}.forces: {repair.forces} is the sensor's own topic; name that of the forces"
            if repair.depth_scale is not None and sensor.camera is None:
                yield f"{where}.depthScale: sensors.{name}.camera is needed, which tells algorithms of it"
        for one, other in combinations([name for name in self.sensors if name in sensors], 2):
            topic = sensors[one].topic
            if topic == sensors[other].topic and self.sensors[one] != self.sensors[other]:
                yield (
                    f"repair.sensors.{other}: another repair than that of {one}, which has the same messages "
                    f"({topic}); give one of them alone"
                )
