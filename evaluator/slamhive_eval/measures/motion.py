# SPDX-License-Identifier: Apache-2.0
"""Velocities and how smooth a trajectory is, by finite differences over its own stamps."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import OptionError

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive_eval.rotation import FloatArray
    from slamhive_eval.trajectory import Trajectory

    BoolArray = npt.NDArray[np.bool_]

LARGEST_STEP_SECONDS = 1.0
"""Differences over longer steps than this say nothing about a velocity and are left out."""


@dataclass(frozen=True)
class Smoothness:
    """Root mean squares of a trajectory's derivatives; jumps and jitter raise them.

    Attributes:
        acceleration: In m/s², None for fewer than three poses in close succession.
        jerk: In m/s³, None for fewer than four.
        angular_acceleration_deg: In deg/s², None for fewer than three.
    """

    acceleration: float | None
    jerk: float | None
    angular_acceleration_deg: float | None

    def as_dict(self) -> dict[str, float | None]:
        """Plain JSON data."""
        found = asdict(self)
        return {
            "acceleration": found["acceleration"],
            "jerk": found["jerk"],
            "angularAccelerationDeg": found["angular_acceleration_deg"],
        }


def velocities(trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Mean velocities between consecutive poses.

    Args:
        trajectory: n poses.

    Returns:
        Times in s in the middle of the steps, shape (k,), and velocities in m/s in the world frame, shape
        (k, 3); steps over no time or more than 1 s are left out.
    """
    step = np.diff(trajectory.stamps)
    used = (step > 0) & (step <= LARGEST_STEP_SECONDS)
    middle = (trajectory.stamps[:-1] + step / 2.0)[used]
    velocity: FloatArray = np.diff(trajectory.positions, axis=0)[used] / step[used, np.newaxis]
    return middle, velocity


def velocity_errors(
    reference: Trajectory,
    estimate: Trajectory,
    reference_velocities: FloatArray | None = None,
    estimate_velocities: FloatArray | None = None,
) -> FloatArray:
    """|v_estimate − v_reference| of associated, aligned trajectories.

    Args:
        reference: m poses.
        estimate: m poses in the reference's world frame.
        reference_velocities: In m/s in the world frame at each pose, shape (m, 3); None to take the mean
            velocities between consecutive poses.
        estimate_velocities: The same of the estimate, turned into the reference's world frame.

    Returns:
        Errors in m/s: shape (m,) where both velocities are given, else one a step of at most 1 s.

    Raises:
        OptionError: Unequal numbers of poses, velocities of one trajectory only or of another shape.
    """
    m = len(reference)
    if len(estimate) != m:
        raise OptionError(f"{m} reference poses can't be compared with {len(estimate)} estimated ones")
    if reference_velocities is not None and estimate_velocities is not None:
        if reference_velocities.shape != (m, 3) or estimate_velocities.shape != (m, 3):
            raise OptionError(
                f"the velocities must have the shape ({m}, 3), "
                f"not {reference_velocities.shape} and {estimate_velocities.shape}"
            )
        return rotation.vector_norm(estimate_velocities - reference_velocities)
    if reference_velocities is not None or estimate_velocities is not None:
        raise OptionError("velocities must be given for both trajectories or for none")
    # Over the same steps for both, by each one's own clock.
    true_step, step = np.diff(reference.stamps), np.diff(estimate.stamps)
    used = (true_step > 0) & (step > 0) & (np.maximum(true_step, step) <= LARGEST_STEP_SECONDS)
    true_velocity = np.diff(reference.positions, axis=0)[used] / true_step[used, np.newaxis]
    velocity = np.diff(estimate.positions, axis=0)[used] / step[used, np.newaxis]
    return rotation.vector_norm(velocity - true_velocity)


def smoothness(trajectory: Trajectory) -> Smoothness:
    """Accelerations and jerk of a trajectory, to be read beside those of its ground truth.

    Derivatives are divided differences over the poses' own stamps; poses with equal stamps count once, and
    nothing is differentiated over a step of more than 1 s.

    Args:
        trajectory: n poses; equal rates make two of them comparable.

    Returns:
        The root mean squares.
    """
    first = np.concatenate(([True], np.diff(trajectory.stamps) > 0))
    stamps = trajectory.stamps[first] - trajectory.stamps[0]
    q = trajectory.quaternions[first]
    turn = rotation.multiply(rotation.conjugate(q[:-1]), q[1:])
    turn = np.where(turn[:, 3:] < 0, -turn, turn)
    half_sine = rotation.vector_norm(turn)
    factor = np.where(half_sine > 1e-12, rotation.angle(turn) / np.maximum(half_sine, 1e-12), 2.0)
    step = np.diff(stamps)
    close = step <= LARGEST_STEP_SECONDS
    middle = stamps[:-1] + step / 2.0
    rate = turn[:, :3] * (factor / step)[:, np.newaxis]
    velocity = np.diff(trajectory.positions[first], axis=0) / step[:, np.newaxis]
    acceleration, at, near = _derivative(velocity, middle, close)
    jerk, _, nearer = _derivative(acceleration, at, near)
    angular, _, near_angular = _derivative(rate, middle, close)
    angular_rms = _rms(angular[near_angular])
    return Smoothness(
        acceleration=_rms(acceleration[near]),
        jerk=_rms(jerk[nearer]),
        angular_acceleration_deg=None if angular_rms is None else float(np.rad2deg(angular_rms)),
    )


def _derivative(
    values: FloatArray, times: FloatArray, usable: BoolArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Divided differences, their times and which of them rest on usable values only."""
    step = np.diff(times)
    slope = np.diff(values, axis=0) / step[:, np.newaxis]
    return slope, times[:-1] + step / 2.0, usable[:-1] & usable[1:]


def _rms(vectors: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(np.sum(vectors * vectors, axis=1)))) if len(vectors) else None
