# SPDX-License-Identifier: Apache-2.0
"""Extrinsics as an algorithm is told them where they are perturbed; evaluation keeps the right ones."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

import numpy as np

from slamhive.model.run import DEFAULT_SEED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from slamhive.model.configuration import SensorView
    from slamhive.model.run import Perturbation
    from slamhive.model.sensors import Role

    Pose = npt.NDArray[np.float64]


def misled(sensors: Mapping[Role, SensorView], perturb: Perturbation | None) -> dict[Role, SensorView]:
    """Return the sensors by role with the extrinsics that an algorithm is told.

    R' = R·exp([θu]×) and t' = t + d·v, with random unit vectors u and v. They stay the same for all
    angles θ and lengths d, so that a larger one is more of the same.

    Args:
        sensors: As they are.
        perturb: What is told wrongly; None: nothing.
    """
    found = dict(sensors)
    if perturb is None:
        return found
    for role, view in sensors.items():
        if perturb.rotation.get(role) or perturb.translation.get(role):
            pose = np.array(view.T_body_sensor, dtype=np.float64)
            turn, shift = _wrong(role, perturb)
            pose[:3, :3] @= turn
            pose[:3, 3] += shift
            found[role] = view.replace(T_body_sensor=pose.tolist())
    return found


def right_pose(told: Sequence[Sequence[float]], role: str, perturb: Perturbation | None) -> Pose:
    """Return T_body_sensor of a role's sensor as it is, (4, 4), from what an algorithm was told.

    Args:
        told: As it stands in the algorithm's configuration, (4, 4).
        role: The sensor's.
        perturb: What was told wrongly; None: nothing.
    """
    pose = np.array(told, dtype=np.float64)
    if perturb is not None and pose.shape == (4, 4):
        turn, shift = _wrong(role, perturb)
        pose[:3, :3] @= turn.T
        pose[:3, 3] -= shift
    return pose


def _wrong(role: str, perturb: Perturbation) -> tuple[Pose, Pose]:
    """Return the rotation (3, 3) and the translation (3,) by which a role's sensor is told wrongly."""
    seed = DEFAULT_SEED if perturb.seed is None else perturb.seed
    angle = np.radians(perturb.rotation.get(role, 0.0))
    shift = perturb.translation.get(role, 0.0) * _direction(seed, f"translation {role}")
    return _turn(_direction(seed, f"rotation {role}"), angle), shift


def _direction(seed: int, purpose: str) -> Pose:
    vector = np.random.default_rng([seed, zlib.crc32(purpose.encode())]).standard_normal(3)
    unit: Pose = vector / np.linalg.norm(vector)
    return unit


def _turn(axis: Pose, angle: float) -> Pose:
    """Return the rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn: Pose = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return turn
