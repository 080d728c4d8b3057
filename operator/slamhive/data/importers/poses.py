# SPDX-License-Identifier: Apache-2.0
"""Poses of foreign ground truth as trajectories; importers use it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.model.errors import DataError
from slamhive_eval import EvaluationError, Trajectory
from slamhive_eval.rotation import from_matrix

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    Array = npt.NDArray[np.float64]
    Stamps = npt.NDArray[np.int64]

SKEWED = 1e-3
"""Longest distance of a rotation's rows from orthonormal ones: files round."""


def trajectory(path: Path, stamps: Stamps, positions: Array, rotations: Array) -> Trajectory:
    """Return poses as a trajectory.

    Args:
        path: The file that they come from, for messages.
        stamps: ns, ascending, shape (n,).
        positions: m, shape (n, 3).
        rotations: Matrices, shape (n, 3, 3), or quaternions xyzw, shape (n, 4).

    Raises:
        DataError: A matrix is no rotation, or a value none of a pose.
    """
    if rotations.ndim == 3:
        products = rotations @ rotations.transpose(0, 2, 1)
        skewed = np.abs(products - np.eye(3)).max(axis=(1, 2)) > SKEWED
        wrong = np.flatnonzero(skewed | (np.linalg.det(rotations) < 0))
        if wrong.size:
            raise DataError(f"{path}: pose {wrong[0] + 1} of {len(stamps)} has no rotation matrix")
        rotations = from_matrix(rotations)
    try:
        return Trajectory(stamps / 1e9, positions, rotations)
    except EvaluationError as error:
        raise DataError(f"{path}: {error}") from None


def from_rows(path: Path, stamps: Stamps, rows: Array) -> Trajectory:
    """Return poses of 3×4 matrices row by row, shape (n, 12), as a trajectory; see `trajectory`."""
    matrices = rows.reshape(-1, 3, 4)
    return trajectory(path, stamps, matrices[:, :, 3], matrices[:, :, :3])


def rigid(matrix: Array, where: str) -> Array:
    """Return a rigid motion as (4, 4) of its upper three rows, shape (3, 4) or (4, 4).

    Raises:
        DataError: Its rotation is none.
    """
    pose = np.eye(4)
    pose[:3] = matrix[:3]
    part = pose[:3, :3]
    if np.abs(part @ part.T - np.eye(3)).max() > SKEWED or np.linalg.det(part) < 0:
        raise DataError(f"{where}: its first three columns are no rotation")
    return pose


def translation(x: float, y: float, z: float) -> Array:
    """Return a rigid motion without rotation, (4, 4)."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose
