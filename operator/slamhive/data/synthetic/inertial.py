# SPDX-License-Identifier: Apache-2.0
"""Measurements of a synthetic IMU, at its own place on the platform and in its own axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.synthetic import rig
from slamhive.data.synthetic.streams import stream

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive.data.synthetic.trajectory import SyntheticMotion
    from slamhive.model.synthetic import SyntheticRecording

    Array = npt.NDArray[np.float64]

ACCELEROMETER_BIAS = 0.02
"""Standard deviation of the bias at the start, m/s², at noise 1."""
GYROSCOPE_BIAS = 0.002
"""Standard deviation of the bias at the start, rad/s, at noise 1."""


@dataclass(frozen=True)
class InertialSamples:
    """Samples of an IMU in its own frame.

    Attributes:
        specific_force: `(n, 3)`, m/s²: at rest it points up.
        angular_rate: `(n, 3)`, rad/s.
        force_bias: `(n, 3)`, part of specific_force.
        rate_bias: `(n, 3)`, part of angular_rate.
    """

    specific_force: Array
    angular_rate: Array
    force_bias: Array
    rate_bias: Array


def sample_imu(spec: SyntheticRecording, trajectory: SyntheticMotion, t: Array) -> InertialSamples:
    """Measure specific force and angular rate.

    White noise of density σ has the standard deviation σ·√rate in a sample, and a bias walks by σ_b/√rate
    from one sample to the next (Kalibr's IMU noise model).

    Args:
        spec: The recording.
        trajectory: Its motion.
        t: `(n,)`, evenly spaced at the IMU's rate, s since the start of the recording.
    """
    motion = trajectory.at(t)
    mounting = rig.imu_pose(spec)
    lever, axes = mounting[:3, 3], mounting[:3, :3]
    omega, alpha = motion.angular_rate, motion.angular_acceleration
    relative = np.cross(alpha, lever) + np.cross(omega, np.cross(omega, lever))
    upward = motion.acceleration + np.array([0.0, 0.0, rig.GRAVITY])
    force = (np.einsum("nji,nj->ni", motion.rotation, upward) + relative) @ axes
    rng = stream(spec.seed, "imu")
    force_bias = _bias(rng, len(t), ACCELEROMETER_BIAS, rig.ACCELEROMETER_RANDOM_WALK, spec)
    rate_bias = _bias(rng, len(t), GYROSCOPE_BIAS, rig.GYROSCOPE_RANDOM_WALK, spec)
    white = spec.noise * np.sqrt(spec.imu.rate)
    force_noise = rng.standard_normal((len(t), 3)) * (rig.ACCELEROMETER_NOISE * white)
    rate_noise = rng.standard_normal((len(t), 3)) * (rig.GYROSCOPE_NOISE * white)
    return InertialSamples(
        force + force_bias + force_noise, omega @ axes + rate_bias + rate_noise, force_bias, rate_bias
    )


def _bias(rng: np.random.Generator, count: int, start: float, walk: float, spec: SyntheticRecording) -> Array:
    steps = rng.standard_normal((count, 3)) * (walk / np.sqrt(spec.imu.rate))
    steps[0] = rng.standard_normal(3) * start
    return np.asarray(np.cumsum(steps, axis=0) * spec.noise)
