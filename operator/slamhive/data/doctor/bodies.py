# SPDX-License-Identifier: Apache-2.0
"""Judgement of poses in the body: whether a sensor and the ground truth are of the same one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.doctor.findings import Finding, Severity
from slamhive.data.recordings.kinds import GNSS_FIX
from slamhive.data.recordings.posetopics import relative_pose, static_tree
from slamhive.data.recordings.reading import TF_TYPES
from slamhive.model.sensors import SensorType

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.data.doctor.examined import Examined
    from slamhive.data.recordings.reading import Recording

_PLACED = {
    SensorType.CAMERA,
    SensorType.LIDAR,
    SensorType.LASER_SCAN,
    SensorType.IMU,
    SensorType.GNSS,
}
"""Devices with a place of their own. Depth has its colour camera's; wheels are of the body."""
_PATHS = {SensorType.CAMERA, SensorType.LIDAR, SensorType.LASER_SCAN}
"""Those whose path algorithms estimate."""


def judge_bodies(examined: Examined) -> Iterator[Finding]:
    """Yield sensors of whose pose against the body of the ground truth nothing is known.

    Their pose in the body is the identity. So is that of another device, or the truth says that it is of
    another frame, and no static transform leads from one to the other. That a single sensor is the body is
    noted.
    """
    spec, recording = examined.entry.dataset.spec, examined.recording
    truth = spec.ground_truth
    if truth is None or truth.frame != "body" or truth.T_body_frame is not None:
        return
    tree = static_tree(recording)
    frames = {
        f"sensors.{name}": _frame(recording, sensor.topic)
        for name, sensor in spec.sensors.items()
        if sensor.topic in examined.watched.scans
        and sensor.type in _PLACED
        and np.array_equal(sensor.T_body_sensor, np.eye(4))
    }
    frames["groundTruth"] = _frame_of_truth(recording, truth.topic)
    for name, sensor in spec.sensors.items():
        frame = frames.get(f"sensors.{name}")
        if not frame or sensor.type not in _PATHS:
            continue
        others = [
            f"{where} is of {other!r}"
            for where, other in frames.items()
            if other and other != frame and relative_pose(tree, other, frame) is None
        ]
        if others:
            yield Finding(
                "frames.missing",
                Severity.WARNING,
                f"sensors.{name}.T_body_sensor: the identity, but {', '.join(others)}, this sensor of "
                f"{frame!r}, and no /tf_static leads from one to the other: the ground truth may be of "
                "another body, and a bare absolute error has the lever arm between the two in it. Measure "
                "the pose and write it down, or say whose pose the truth is (groundTruth.frame)",
                name,
            )
        elif len([one for one in frames.values() if one]) == 1 and not any(frame in edge for edge in tree):
            yield Finding(
                "frames.missing",
                Severity.NOTE,
                f"sensors.{name}.T_body_sensor: the identity, and nothing in the recording says where "
                f"{frame!r} is in the body: the ground truth is taken for this sensor's own pose; if it is "
                "that of a marker or a vehicle, the lever arm between the two is in every absolute error",
                name,
            )


def _frame(recording: Recording, topic: str) -> str:
    return str(recording.first(topic).header.frame_id).lstrip("/")


def _frame_of_truth(recording: Recording, topic: str | None) -> str:
    """Return the frame whose poses a topic has; empty where it doesn't say."""
    if topic is None:
        return ""
    name, _, pair = topic.partition(":")
    found = recording.topics.get(name)
    if found is None or not found.count:
        return ""
    if found.message_type in TF_TYPES:
        return pair.rpartition(".")[2]
    if found.message_type == GNSS_FIX:
        return _frame(recording, name)
    return str(getattr(recording.first(name), "child_frame_id", "")).lstrip("/")
