# SPDX-License-Identifier: Apache-2.0
"""Errors over sub-trajectories and the drift of the scale.

Zhang and Scaramuzza 2018, "A tutorial on quantitative trajectory evaluation for visual(-inertial)
odometry": from every pose on, the motion over a given length of the path is compared with the true one,
and the rotation error is split into what gravity makes observable and the yaw, which it doesn't.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.alignment import umeyama_scale
from slamhive_eval.errors import OptionError
from slamhive_eval.pairs import find_pairs
from slamhive_eval.statistics import Statistics

if TYPE_CHECKING:
    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory

LENGTH_SHARES = (0.1, 0.2, 0.3, 0.4, 0.5)
"""Shares of the ground truth's path that are measured unless lengths are given."""
LENGTH_TOLERANCE = 0.2
MIN_WINDOW_POSES = 3


@dataclass(frozen=True, eq=False)
class SubTrajectoryErrors:
    """Errors over all sub-trajectories of one length, k of them.

    Attributes:
        length: Nominal length in m.
        pairs: First and last pose of each, shape (k, 2).
        translation: |t(E)| in m, shape (k,).
        rotation_deg: Angle of E in degrees, shape (k,).
        yaw_deg: The part about the vertical in degrees, ≥ 0, shape (k,).
        gravity_deg: √(roll² + pitch²) of E in degrees, shape (k,).
    """

    length: float
    pairs: IndexArray
    translation: FloatArray
    rotation_deg: FloatArray
    yaw_deg: FloatArray
    gravity_deg: FloatArray

    @property
    def translation_percent(self) -> FloatArray:
        """Translation errors in % of the nominal length, shape (k,)."""
        return self.translation / self.length * 100.0

    @property
    def rotation_deg_per_m(self) -> FloatArray:
        """Rotation errors by nominal length in degrees per metre, shape (k,)."""
        return self.rotation_deg / self.length

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data: length, count and the statistics of each kind."""
        kinds = {
            "translation": self.translation,
            "translationPercent": self.translation_percent,
            "rotationDeg": self.rotation_deg,
            "rotationDegPerM": self.rotation_deg_per_m,
            "yawDeg": self.yaw_deg,
            "gravityDeg": self.gravity_deg,
        }
        found = {name: Statistics.of(errors) for name, errors in kinds.items()}
        return {
            "length": self.length,
            "count": len(self.pairs),
            **{name: value.as_dict() if value else None for name, value in found.items()},
        }


@dataclass(frozen=True, eq=False)
class ScaleDrift:
    """Drift of an estimate's scale along the path, from windows of it that are aligned one by one.

    Attributes:
        distances: Where each window's middle lies on the ground truth's path, in m, shape (k,).
        scales: Scale of each window's own Sim(3) alignment, which turns estimated metres into true ones,
            shape (k,).
        percent_per_100m: Slope of ln s over the distance by least squares, in % per 100 m; None for fewer
            than two windows.
        spread: Largest by smallest scale, 1 for no drift; None without windows.
    """

    distances: FloatArray
    scales: FloatArray
    percent_per_100m: float | None
    spread: float | None

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data."""
        return {
            "windows": len(self.scales),
            "percentPer100m": self.percent_per_100m,
            "spread": self.spread,
            "distances": self.distances.tolist(),
            "scales": self.scales.tolist(),
        }


def default_lengths(path_length: float) -> tuple[float, ...]:
    """10 to 50 % of the path in whole metres; below one metre as it is."""
    shares = (share * path_length for share in LENGTH_SHARES)
    lengths = {float(np.floor(length)) if length >= 1 else length for length in shares}
    return tuple(sorted(length for length in lengths if length > 0))


def sub_trajectory_errors(
    reference: Trajectory,
    estimate: Trajectory,
    lengths: tuple[float, ...] | None = None,
    rel_tolerance: float = LENGTH_TOLERANCE,
) -> tuple[SubTrajectoryErrors, ...]:
    """Relative errors over sub-trajectories of associated trajectories, pose k to pose k.

    From every pose i the pose j whose path from i is nearest to the length is taken, within the tolerance.
    E = (Q_i⁻¹·Q_j)⁻¹·(P_i⁻¹·P_j) is turned into the world by the estimate's orientation at j, R_j·E·R_jᵀ,
    and its rotation split as Rz(yaw)·Ry(pitch)·Rx(roll). Yaw and gravity parts therefore mean something
    only where z of the estimate's world points up: give an estimate of a visual-inertial algorithm as it
    is, any other aligned by SE(3) to ground truth whose z points up. Turning the world about z changes them
    in second order, since pitch is taken before roll about axes that turn along. A monocular estimate needs
    its scale applied before.

    Args:
        reference: m poses.
        estimate: m poses.
        lengths: In m, each > 0; None for 10, 20, 30, 40 and 50 % of the reference's path.
        rel_tolerance: Share of the length by which a sub-trajectory may miss it.

    Returns:
        One entry a length; none where the reference doesn't move and no lengths are given.

    Raises:
        OptionError: Unequal numbers of poses, none with orientations, or a length or tolerance that
            isn't allowed.
    """
    _check_equal(reference, estimate)
    if not (reference.oriented and estimate.oriented):
        raise OptionError("errors over sub-trajectories need orientations of both trajectories")
    if lengths is None:
        lengths = default_lengths(reference.path_length)
    return tuple(_over(reference, estimate, length, rel_tolerance) for length in lengths)


def scale_drift(
    reference: Trajectory, estimate: Trajectory, window_metres: float | None = None
) -> ScaleDrift:
    """Scales of consecutive stretches of associated trajectories, pose k to pose k.

    Each window holds at least the given length of the reference's path and is aligned on its own by Sim(3)
    (Umeyama 1991), so that noise, which lengthens an estimated path, hardly changes the scale.

    Args:
        reference: m poses.
        estimate: m poses, not scaled piece by piece.
        window_metres: Length of a window in m; None for a tenth of the reference's path.

    Returns:
        The scales and their drift.

    Raises:
        OptionError: Unequal numbers of poses, or a window that isn't positive.
    """
    _check_equal(reference, estimate)
    if window_metres is None:
        window_metres = 0.1 * reference.path_length
        if not window_metres > 0:
            return ScaleDrift(np.empty(0), np.empty(0), None, None)
    middles, scales = [], []
    for begin, end in find_pairs(reference, window_metres, "m", all_pairs=False).tolist():
        part = slice(begin, end + 1)
        scale = umeyama_scale(reference.select(part), estimate.select(part))
        if end + 1 - begin >= MIN_WINDOW_POSES and scale is not None and scale > 0:
            middles.append(float(reference.distances[begin] + reference.distances[end]) / 2.0)
            scales.append(scale)
    at, found = np.array(middles), np.array(scales)
    if not len(found):
        return ScaleDrift(at, found, None, None)
    slope = None
    if len(found) > 1:
        away = at - at.mean()
        slope = float(away @ np.log(found) / (away @ away)) * 1e4
    return ScaleDrift(at, found, slope, float(found.max() / found.min()))


def _check_equal(reference: Trajectory, estimate: Trajectory) -> None:
    if len(reference) != len(estimate):
        raise OptionError(
            f"relative errors need as many reference poses ({len(reference)}) as estimated ({len(estimate)})"
        )


def _over(
    reference: Trajectory, estimate: Trajectory, length: float, rel_tolerance: float
) -> SubTrajectoryErrors:
    pairs = find_pairs(reference, length, "m", all_pairs=True, rel_tolerance=rel_tolerance)
    i, j = pairs[:, 0], pairs[:, 1]
    true_shift, true_turn = _motion(reference, i, j)
    shift, turn = _motion(estimate, i, j)
    error = rotation.multiply(rotation.conjugate(true_turn), turn)
    last = estimate.quaternions[j]
    in_world = rotation.to_matrix(rotation.multiply(rotation.multiply(last, error), rotation.conjugate(last)))
    pitch = np.arcsin(np.clip(-in_world[:, 2, 0], -1.0, 1.0))
    roll = np.arctan2(in_world[:, 2, 1], in_world[:, 2, 2])
    yaw = np.arctan2(in_world[:, 1, 0], in_world[:, 0, 0])
    return SubTrajectoryErrors(
        length=float(length),
        pairs=pairs,
        translation=rotation.vector_norm(shift - true_shift),
        rotation_deg=np.rad2deg(rotation.angle(error)),
        yaw_deg=np.rad2deg(np.abs(yaw)),
        gravity_deg=np.rad2deg(np.hypot(pitch, roll)),
    )


def _motion(trajectory: Trajectory, i: IndexArray, j: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Translation and rotation of P_i⁻¹·P_j, shapes (k, 3) and (k, 4)."""
    back = rotation.conjugate(trajectory.quaternions[i])
    shift = rotation.rotate(back, trajectory.positions[j] - trajectory.positions[i])
    return shift, rotation.multiply(back, trajectory.quaternions[j])
