# SPDX-License-Identifier: Apache-2.0
"""The pose of an estimate's frame in the ground truth's body, found from the two trajectories.

Where the extrinsics aren't known: both frames are fixed to one body, so each motion A of the body and B of
the other frame obey A·X = X·B. Rotation first, as the quaternion that fits all motions best (the smallest
eigenvector; Chou and Kamel 1991), then translation and scale by least squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import OptionError, TrajectoryError

if TYPE_CHECKING:
    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory

_TURN_RADIANS = float(np.deg2rad(15.0))
"""Least turn of a motion, rad: less says little, and an estimate drifts over more."""
_LARGEST_RADIANS = float(np.deg2rad(150.0))
_FEWEST_MOTIONS = 10
_SMALLEST_SPREAD = 1e-3
"""Variance of the turns' axes off their main one, below which they count as one axis."""


@dataclass(frozen=True, eq=False)
class HandEye:
    """Result of `hand_eye`, a hand-eye calibration: extrinsic, scale and residuals.

    Attributes:
        extrinsic: T_body_sensor, the pose of the estimate's frame in the ground truth's, shape (4, 4).
        scale: Metres in a unit of the estimate.
        motions: How many motions it comes from.
        rotation_rms_deg: What is left of A·X − X·B, as rotation in degrees.
        translation_rms: The same as translation in m.
    """

    extrinsic: FloatArray
    scale: float
    motions: int
    rotation_rms_deg: float
    translation_rms: float


def hand_eye(reference: Trajectory, estimate: Trajectory, *, with_scale: bool = False) -> HandEye:
    """Find the pose of the estimate's frame in the body whose ground truth is given.

    Args:
        reference: m poses of the body.
        estimate: m poses of another frame fixed to it, associated with those of the reference; its world
            may be any.
        with_scale: Whether the estimate's unit of length is unknown.

    Returns:
        The pose; move the ground truth by it (`Trajectory.moved`), then align as usual.

    Raises:
        OptionError: Unequal lengths.
        TrajectoryError: There are no orientations, or the motion leaves the pose undetermined: too little
            turning, or all about one axis, as on a floor.
    """
    if len(reference) != len(estimate):
        raise OptionError(
            f"hand-eye needs as many reference poses ({len(reference)}) as estimated ({len(estimate)})"
        )
    if not (reference.oriented and estimate.oriented):
        raise TrajectoryError("hand-eye needs orientations, and there are positions only")
    i, j = _motions(reference)
    if len(i) < _FEWEST_MOTIONS:
        raise TrajectoryError(
            f"hand-eye needs {_FEWEST_MOTIONS} motions that turn by {np.rad2deg(_TURN_RADIANS):.0f} degrees; "
            f"{len(i)} were found"
        )
    (qa, ta), (qb, tb) = (_relative(one, i, j) for one in (reference, estimate))
    _require_axes(qa)
    turn = _rotation(qa, qb)
    matrix = rotation.to_matrix(turn)
    shift, scale, missed = _translation(qa, ta, rotation.apply_matrix(matrix, tb), with_scale=with_scale)
    extrinsic = np.eye(4)
    extrinsic[:3, :3], extrinsic[:3, 3] = matrix, shift
    left = rotation.multiply(rotation.conjugate(rotation.multiply(turn, qb)), rotation.multiply(qa, turn))
    degrees = np.rad2deg(rotation.angle(left))
    return HandEye(extrinsic, scale, len(i), float(np.sqrt(np.mean(degrees**2))), missed)


def _motions(reference: Trajectory) -> tuple[IndexArray, IndexArray]:
    """From every pose to the first that is turned by enough along the way, none by too much."""
    q = reference.quaternions
    steps = rotation.angle(rotation.multiply(rotation.conjugate(q[:-1]), q[1:]))
    turned = np.concatenate(([0.0], np.cumsum(steps)))
    j = np.searchsorted(turned, turned + _TURN_RADIANS)
    i = np.flatnonzero(j < len(q))
    j = j[i]
    direct = rotation.angle(rotation.multiply(rotation.conjugate(q[i]), q[j]))
    good = (direct > _TURN_RADIANS / 3.0) & (direct < _LARGEST_RADIANS)
    return i[good], j[good]


def _relative(trajectory: Trajectory, i: IndexArray, j: IndexArray) -> tuple[FloatArray, FloatArray]:
    back = rotation.conjugate(trajectory.quaternions[i])
    turn = rotation.multiply(back, trajectory.quaternions[j])
    turn = np.where(turn[:, 3:] < 0, -turn, turn)
    return turn, rotation.rotate(back, trajectory.positions[j] - trajectory.positions[i])


def _require_axes(qa: FloatArray) -> None:
    axes = qa[:, :3] / rotation.vector_norm(qa)[:, np.newaxis]
    spread = np.linalg.eigvalsh(axes.T @ axes / len(axes))
    if spread[1] < _SMALLEST_SPREAD:
        raise TrajectoryError(
            "the body turns about one axis only, as on a floor, which leaves the sensor's height and its "
            "turn about that axis open; give the extrinsic"
        )


def _rotation(qa: FloatArray, qb: FloatArray) -> FloatArray:
    """The unit quaternion q that minimises Σ|qa ⊗ q − q ⊗ qb|²."""
    basis = np.eye(4)
    left = np.stack([rotation.multiply(qa, unit) - rotation.multiply(unit, qb) for unit in basis], axis=-1)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->ij", left, left))
    found: FloatArray = vectors[:, 0]
    return found


def _translation(
    qa: FloatArray, ta: FloatArray, turned: FloatArray, *, with_scale: bool
) -> tuple[FloatArray, float, float]:
    """Least squares for t and s of (R_A − I)·t − s·R_X·t_B = −t_A; also the rms of what is left, in m."""
    rows = (rotation.to_matrix(qa) - np.eye(3)).reshape(-1, 3)
    unknown = turned.reshape(-1, 1)
    if with_scale:
        columns, wanted = np.hstack((rows, -unknown)), -ta.reshape(-1)
    else:
        columns, wanted = rows, turned.reshape(-1) - ta.reshape(-1)
    found = np.asarray(np.linalg.lstsq(columns, wanted, rcond=None)[0], dtype=np.float64)
    left = (columns @ found - wanted).reshape(-1, 3)
    scale = float(found[3]) if with_scale else 1.0
    if not scale > 0:
        raise TrajectoryError(f"hand-eye finds no positive scale ({scale:.3g}): the motions don't fit")
    return found[:3], scale, float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
