# SPDX-License-Identifier: Apache-2.0
"""The standard recordings. Their figures are quoted: a change here changes published results."""

from __future__ import annotations

from slamhive.model.synthetic import SyntheticRecording, SyntheticSensor

STANDARD_LIDAR = SyntheticRecording(
    seed=11, sensors=(SyntheticSensor.LIDAR, SyntheticSensor.IMU), duration_seconds=30.0
)
"""One lap of 30 m in 30 s for lidar and lidar-inertial algorithms."""

STANDARD_CAMERA = SyntheticRecording(
    seed=23,
    sensors=(SyntheticSensor.STEREO, SyntheticSensor.RGBD, SyntheticSensor.IMU),
    duration_seconds=30.0,
)
"""One lap of 30 m in 30 s for monocular, stereo, RGB-D and inertial algorithms."""

TRAINING_CAMERA = STANDARD_CAMERA.model_copy(update={"seed": 1009, "sensors": (SyntheticSensor.STEREO,)})
"""Another room to train a vocabulary in: never the textures that an algorithm is tested on."""
