# SPDX-License-Identifier: Apache-2.0
"""Way of the image of what is far over an exposure, as the platform turned: what motion blur is made of.

The dataset's first IMU says how it turned, or else its ground truth. Of a turn, what moves the middle of the
image counts: not that about the optical axis, nor how the platform moves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.doctor.turning import gyro_turning, turning_of
from slamhive.data.recordings.kinds import IMU
from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.errors import DataError
from slamhive.model.sensors import SensorType
from slamhive_eval import Trajectory

if TYPE_CHECKING:
    import numpy.typing as npt
    from rosbags.interfaces import Connection

    from slamhive.data.doctor.turning import Turning
    from slamhive.data.recordings.entries import DatasetEntry
    from slamhive.data.recordings.reading import Recording
    from slamhive.model.sensors import Sensor

    Array = npt.NDArray[np.float64]


class ImageMotion:
    """Motion of images over an exposure.

    Args:
        entry: The dataset, materialised.
        recording: Its recording, open.

    Attributes:
        source: What says how the platform turned: the name of an IMU, or groundTruth.

    Raises:
        DataError: Nothing says how, or what should is damaged.
    """

    def __init__(self, entry: DatasetEntry, recording: Recording) -> None:
        for name, sensor in entry.dataset.spec.told_sensors.items():
            if sensor.type is SensorType.IMU and (turning := _of_imu(recording, sensor)) is not None:
                self.source, self._turning = name, turning
                self._mounting = np.array(sensor.T_body_sensor)[:3, :3]
                return
        truth = ground_truth(entry)
        poses = truth.poses if truth is not None else None
        turning = turning_of(poses) if isinstance(poses, Trajectory) else None
        if turning is None or truth is None:
            raise DataError(
                f"input.perturb.images.motionBlur: nothing says how {entry.name} turns: no IMU whose rates "
                "aren't all alike, and no ground truth with orientations that differ"
            )
        self.source, self._turning, self._mounting = "groundTruth", turning, truth.T_body_frame[:3, :3]

    def over(self, camera: Sensor, stamps: npt.NDArray[np.int64], exposure: float) -> Array:
        """Return the way of the image's middle over exposures around some stamps, px, shape (n, 2).

        It is 0 where nobody knows how the platform turned. With z forward, a turn by (a, b) about x and y
        moves what is ahead by (-fx b, fy a).

        Args:
            camera: With intrinsics.
            stamps: Header stamps, ns, shape (n,); middles of the exposures.
            exposure: Length of an exposure, s.
        """
        assert camera.camera is not None  # noqa: S101 - `perturbation_problems` says so before
        middle = stamps / 1e9 + camera.time_offset
        known, rates = self._turning.over(middle - exposure / 2, middle + exposure / 2)
        turns = rates @ self._mounting.T @ np.array(camera.T_body_sensor)[:3, :3] * exposure
        way = np.stack([-camera.camera.fx * turns[:, 1], camera.camera.fy * turns[:, 0]], axis=1)
        return np.where(known[:, None], way, 0.0)


def _of_imu(recording: Recording, sensor: Sensor) -> Turning | None:
    """Return the turning by an IMU's rates; None where the recording hasn't got them."""
    topic = recording.topics.get(sensor.topic)
    if topic is None or topic.message_type != IMU:
        return None
    rates: list[tuple[float, float, float]] = []

    def see(connection: Connection, _: int, __: int, ___: int, raw: bytes) -> None:
        rate = recording.decode(raw, connection.msgtype).angular_velocity
        rates.append((rate.x, rate.y, rate.z))

    scan = recording.scan([sensor.topic], see=see)[sensor.topic]
    return gyro_turning(scan.stamps, np.array(rates), sensor.time_offset) if rates else None
