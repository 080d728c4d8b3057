# SPDX-License-Identifier: Apache-2.0
"""The motion that lays an estimate onto its reference.

Positions decide, by Umeyama's closed form. Where they leave a rotation free (a straight line, a robot that
stands, one pose) the orientations decide what is left: the position errors are the least possible either
way, and the answer doesn't hang on rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import OptionError, TrajectoryError

if TYPE_CHECKING:
    from slamhive_eval.rotation import FloatArray
    from slamhive_eval.trajectory import Trajectory

Method = Literal["none", "origin", "se3", "sim3", "scale", "yaw"]
METHODS: tuple[Method, ...] = get_args(Method)

_RANK_TOLERANCE = 1e-12
"""Singular values below this share of the largest are rounding: 1 mm of width on 1 km of road."""
_STILL_METRES = 1e-12


@dataclass(frozen=True, eq=False)
class Alignment:
    """p_reference ≈ scale · R · p_estimate + t.

    Attributes:
        method: How it was found.
        rotation: R, shape (3, 3).
        translation: t in m, shape (3,).
        scale: s > 0; 1 unless the method has scale.
        notes: Sentences about what the positions left undetermined.
    """

    method: Method
    rotation: FloatArray
    translation: FloatArray
    scale: float = 1.0
    notes: tuple[str, ...] = ()

    @property
    def transform(self) -> FloatArray:
        """[[s·R, t], [0 0 0 1]], shape (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.scale * self.rotation
        matrix[:3, 3] = self.translation
        return matrix

    def apply(self, estimate: Trajectory) -> Trajectory:
        """The estimate in the reference's world frame."""
        if self.method == "none":
            return estimate
        return estimate.transformed(self.rotation, self.translation, self.scale)


def align(
    reference: Trajectory,
    estimate: Trajectory,
    method: Method,
    first_poses: int | None = None,
    weights: FloatArray | None = None,
) -> Alignment:
    """Align associated trajectories, pose k to pose k.

    Args:
        reference: m poses.
        estimate: m poses, associated with those of the reference.
        method: ``none``; ``origin`` lays the first pose onto the reference's first; ``se3`` and ``sim3``
            minimise the squared position errors (Umeyama 1991, eq. 40 to 42); ``scale`` applies only the
            scale of ``sim3``, about the origin; ``yaw`` turns about z and shifts (Zhang and Scaramuzza
            2018, the 4-DoF alignment of visual-inertial estimates).
        first_poses: Use only so many poses from the start; None for all.
        weights: Of the squared position errors, ≥ 0, shape (m,); None for equal ones. ``none`` and
            ``origin`` have no use for them.

    Returns:
        The alignment.

    Raises:
        OptionError: Unknown method, unequal lengths, fewer than one pose to use, an ``origin`` without
            orientations, or weights that aren't ≥ 0 with one above.
        TrajectoryError: Positions that don't determine the alignment, without orientations.
    """
    if method not in METHODS:
        raise OptionError(f"unknown alignment {method!r}; known are {', '.join(METHODS)}")
    if len(reference) != len(estimate):
        raise OptionError(
            f"alignment needs as many reference poses ({len(reference)}) as estimated ({len(estimate)})"
        )
    if first_poses is not None and first_poses < 1:
        raise OptionError(f"the number of poses to align must be at least 1, not {first_poses}")
    if first_poses is not None and first_poses < len(reference):
        reference, estimate = reference.select(slice(first_poses)), estimate.select(slice(first_poses))
        weights = weights[:first_poses] if weights is not None else None
    if method == "none":
        return Alignment(method, np.eye(3), np.zeros(3))
    if method == "origin":
        if not (reference.oriented and estimate.oriented):
            raise OptionError("the alignment origin needs orientations, and there are positions only")
        turn = reference.select(slice(1)).matrices[0] @ estimate.select(slice(1)).matrices[0].T
        return Alignment(method, turn, reference.positions[0] - turn @ estimate.positions[0])
    if weights is not None:
        weights = _checked_weights(weights, len(reference))
        used = np.flatnonzero(weights)
        reference, estimate, weights = reference.select(used), estimate.select(used), weights[used]
    return _umeyama(reference, estimate, method, weights)


def umeyama_scale(reference: Trajectory, estimate: Trajectory) -> float | None:
    """The scale s > 0 of the Sim(3) alignment, None where one of the two doesn't move."""
    if stands_still(estimate.positions) or stands_still(reference.positions):
        return None
    x, y = _centred(estimate.positions)[0], _centred(reference.positions)[0]
    u, d, vt = np.linalg.svd(y.T @ x / len(x))
    return float((d @ _handedness(u, vt)) / (np.sum(x * x) / len(x)))


def stands_still(positions: FloatArray) -> bool:
    """Tell whether positions, shape (n, 3), differ by no more than rounding."""
    spread = np.abs(positions - positions[0]).max()
    return bool(spread <= max(_STILL_METRES, _RANK_TOLERANCE * np.abs(positions).max()))


def _checked_weights(weights: FloatArray, n: int) -> FloatArray:
    weights = np.asarray(weights, dtype=np.float64)
    if weights.shape != (n,) or not (np.isfinite(weights) & (weights >= 0)).all() or not weights.any():
        raise OptionError(f"weights of {n} poses must be finite numbers ≥ 0, shape ({n},), one of them above")
    return weights


def _umeyama(
    reference: Trajectory, estimate: Trajectory, method: Method, weights: FloatArray | None
) -> Alignment:
    x, mean_x = _centred(estimate.positions, weights)
    y, mean_y = _centred(reference.positions, weights)
    if weights is None:
        covariance, variance = y.T @ x / len(x), np.sum(x * x) / len(x)
    else:
        share = (weights / weights.sum())[:, np.newaxis]
        covariance, variance = (share * y).T @ x, np.sum(share * x * x)
    u, d, vt = np.linalg.svd(covariance)
    sign = _handedness(u, vt)
    notes: list[str] = []
    scale = 1.0
    if method in ("sim3", "scale"):
        if stands_still(estimate.positions) or stands_still(reference.positions):
            notes.append("the positions don't determine a scale (no common motion); 1 was taken")
        else:
            scale = float((d @ sign) / variance)
    if method == "scale":
        return Alignment(method, np.eye(3), np.zeros(3), scale, tuple(notes))
    if method == "yaw":
        turn = _yaw(covariance, reference, estimate, notes)
    elif d[1] > _RANK_TOLERANCE * d[0] and not stands_still(estimate.positions):
        turn = (u * sign) @ vt
    else:
        turn = _degenerate(u, vt, reference, estimate, notes)
    return Alignment(method, turn, mean_y - scale * (turn @ mean_x), scale, tuple(notes))


def _centred(positions: FloatArray, weights: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    mean = positions.mean(axis=0) if weights is None else np.average(positions, axis=0, weights=weights)
    return positions - mean, mean


def _handedness(u: FloatArray, vt: FloatArray) -> FloatArray:
    """Diagonal of Umeyama's S (eq. 43), which keeps R a rotation."""
    return np.array((1.0, 1.0, -1.0 if np.linalg.det(u) * np.linalg.det(vt) < 0 else 1.0))


def _orientation_agreement(reference: Trajectory, estimate: Trajectory) -> FloatArray:
    """M = Σ R_reference·R_estimateᵀ: trace(Rᵀ·M) grows with how well R turns one onto the other."""
    turns = rotation.multiply(reference.quaternions, rotation.conjugate(estimate.quaternions))
    agreement: FloatArray = rotation.to_matrix(turns).sum(axis=0)
    return agreement


def _require_orientations(reference: Trajectory, estimate: Trajectory, what: str) -> None:
    if not (reference.oriented and estimate.oriented):
        raise TrajectoryError(
            f"the positions don't determine {what} (a straight line, or no common motion), and there are no "
            "orientations; align with none"
        )


def _degenerate(
    u: FloatArray, vt: FloatArray, reference: Trajectory, estimate: Trajectory, notes: list[str]
) -> FloatArray:
    """Of all rotations with the least position errors, the one that the orientations like best."""
    _require_orientations(reference, estimate, "a rotation")
    agreement = _orientation_agreement(reference, estimate)
    if stands_still(estimate.positions) or stands_still(reference.positions):
        notes.append("the positions don't determine a rotation (no common motion); the orientations did")
        return rotation.nearest_rotation(agreement)
    notes.append("the positions lie on a line; the orientations determined the rotation about it")
    line = u[:, 0]
    base = (u * _handedness(u, vt)) @ vt
    rest = agreement @ base.T
    along = line @ rest @ line
    across = line @ np.array((rest[2, 1] - rest[1, 2], rest[0, 2] - rest[2, 0], rest[1, 0] - rest[0, 1]))
    theta = np.arctan2(across, np.trace(rest) - along)
    about = rotation.to_matrix(np.append(np.sin(theta / 2.0) * line, np.cos(theta / 2.0)))
    turn: FloatArray = about @ base
    return turn


def _yaw(covariance: FloatArray, reference: Trajectory, estimate: Trajectory, notes: list[str]) -> FloatArray:
    """The turn about z that maximises trace(Rzᵀ·covariance)."""
    sine, cosine = covariance[1, 0] - covariance[0, 1], covariance[0, 0] + covariance[1, 1]
    size = np.std(reference.positions, axis=0).max() * np.std(estimate.positions, axis=0).max()
    if np.hypot(sine, cosine) <= _RANK_TOLERANCE * size or stands_still(estimate.positions):
        _require_orientations(reference, estimate, "a yaw")
        notes.append(
            "the positions don't determine a yaw (no common horizontal motion); the orientations did"
        )
        agreement = _orientation_agreement(reference, estimate)
        sine, cosine = agreement[1, 0] - agreement[0, 1], agreement[0, 0] + agreement[1, 1]
    theta = np.arctan2(sine, cosine)
    c, s = np.cos(theta), np.sin(theta)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
