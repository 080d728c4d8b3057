# SPDX-License-Identifier: Apache-2.0
"""Absolute and relative pose errors, in every relation evo has.

Absolute (APE, Sturm et al. 2012; Zhang and Scaramuzza 2018): E = P⁻¹·Q of the aligned estimate P and the
reference Q. Relative (RPE): E = (Q_i⁻¹·Q_j)⁻¹·(P_i⁻¹·P_j) over pairs (i, j).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import OptionError

if TYPE_CHECKING:
    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory

Relation = Literal[
    "trans_part", "rot_part", "full", "angle_deg", "angle_rad", "point_distance", "point_distance_error_ratio"
]
RELATIONS: tuple[Relation, ...] = get_args(Relation)

RELATION_UNITS: dict[Relation, str] = {
    "trans_part": "m",
    "rot_part": "",
    "full": "",
    "angle_deg": "deg",
    "angle_rad": "rad",
    "point_distance": "m",
    "point_distance_error_ratio": "%",
}


def ape_errors(reference: Trajectory, estimate: Trajectory, relation: Relation = "trans_part") -> FloatArray:
    """Absolute errors of associated, aligned trajectories.

    Args:
        reference: n poses.
        estimate: n poses in the reference's world frame.
        relation: ``trans_part`` and ``point_distance``: distance in m. ``angle_deg``, ``angle_rad``: angle
            of the rotation. ``rot_part``: Frobenius norm of R − I. ``full``: Frobenius norm of E − I.

    Returns:
        Errors ≥ 0, shape (n,).

    Raises:
        OptionError: Unknown relation, the ratio, which only relative errors have, or a relation that
            needs orientations where there are none.
    """
    _check_relation(relation)
    if relation == "point_distance_error_ratio":
        raise OptionError("the relation point_distance_error_ratio exists for relative errors only")
    distance = rotation.vector_norm(reference.positions - estimate.positions)
    if relation in ("trans_part", "point_distance"):
        return distance
    _check_orientations(reference, estimate, relation)
    if reference.rotations is not None or estimate.rotations is not None:
        back = np.swapaxes(estimate.matrices, 1, 2)
        moved = np.einsum("nij,nj->ni", back, reference.positions - estimate.positions)
        return _of_matrices(back @ reference.matrices, rotation.vector_norm(moved), relation)
    turn = rotation.multiply(rotation.conjugate(estimate.quaternions), reference.quaternions)
    return _of_motion(distance, turn, relation)


def rpe_errors(
    reference: Trajectory, estimate: Trajectory, pairs: IndexArray, relation: Relation = "trans_part"
) -> FloatArray:
    """Relative errors of associated, aligned trajectories over pairs of poses.

    Args:
        reference: n poses.
        estimate: n poses in the reference's world frame.
        pairs: Indices (i, j), shape (k, 2).
        relation: As for ape_errors; ``point_distance``: difference of the distances |p_j − p_i| in m,
            ``point_distance_error_ratio``: that in % of the reference's distance, pairs whose reference
            doesn't move left out.

    Returns:
        Errors ≥ 0, shape (k,), fewer for the ratio.

    Raises:
        OptionError: Unknown relation, or one that needs orientations where there are none.
    """
    _check_relation(relation)
    i, j = pairs[:, 0], pairs[:, 1]
    reference_step = reference.positions[j] - reference.positions[i]
    estimate_step = estimate.positions[j] - estimate.positions[i]
    if relation in ("point_distance", "point_distance_error_ratio"):
        travelled = rotation.vector_norm(reference_step)
        missed = np.abs(travelled - rotation.vector_norm(estimate_step))
        if relation == "point_distance":
            return missed
        moved = travelled > 0
        return missed[moved] / travelled[moved] * 100.0
    _check_orientations(reference, estimate, relation)
    if reference.rotations is not None or estimate.rotations is not None:
        return _rpe_of_matrices(reference, estimate, pairs, relation)
    reference_back = rotation.conjugate(reference.quaternions[i])
    estimate_back = rotation.conjugate(estimate.quaternions[i])
    distance = rotation.vector_norm(
        rotation.rotate(estimate_back, estimate_step) - rotation.rotate(reference_back, reference_step)
    )
    if relation == "trans_part":
        return distance
    turn = rotation.multiply(
        rotation.conjugate(rotation.multiply(reference_back, reference.quaternions[j])),
        rotation.multiply(estimate_back, estimate.quaternions[j]),
    )
    return _of_motion(distance, turn, relation)


def _rpe_of_matrices(
    reference: Trajectory, estimate: Trajectory, pairs: IndexArray, relation: Relation
) -> FloatArray:
    """The same from rotation matrices, which needn't be orthonormal to the last bit."""
    i, j = pairs[:, 0], pairs[:, 1]
    reference_back = np.swapaxes(reference.matrices, 1, 2)
    estimate_back = np.swapaxes(estimate.matrices, 1, 2)
    reference_turn = reference_back[i] @ reference.matrices[j]
    reference_step = np.einsum(
        "nij,nj->ni", reference_back[i], reference.positions[j] - reference.positions[i]
    )
    estimate_step = np.einsum("nij,nj->ni", estimate_back[i], estimate.positions[j] - estimate.positions[i])
    missed = np.einsum("nji,nj->ni", reference_turn, estimate_step - reference_step)
    distance = rotation.vector_norm(missed)
    if relation == "trans_part":
        return distance
    turn = np.swapaxes(reference_turn, 1, 2) @ (estimate_back[i] @ estimate.matrices[j])
    return _of_matrices(turn, distance, relation)


def _of_matrices(turn: FloatArray, distance: FloatArray, relation: Relation) -> FloatArray:
    if relation in ("angle_rad", "angle_deg"):
        radians = rotation.angle(rotation.from_matrix(rotation.orthonormalize(turn)))
        return radians if relation == "angle_rad" else np.rad2deg(radians)
    part: FloatArray = np.sqrt(np.sum((turn - np.eye(3)) ** 2, axis=(1, 2)))
    return part if relation == "rot_part" else np.hypot(part, distance)


def _check_relation(relation: str) -> None:
    if relation not in RELATIONS:
        raise OptionError(f"unknown relation {relation!r}; known are {', '.join(RELATIONS)}")


def _check_orientations(reference: Trajectory, estimate: Trajectory, relation: str) -> None:
    for trajectory, name in ((reference, "ground truth"), (estimate, "estimate")):
        if not trajectory.oriented:
            raise OptionError(f"the {name} has no orientations, which this error of {relation} needs")


def _of_motion(distance: FloatArray, turn: FloatArray, relation: Relation) -> FloatArray:
    """Errors of E with |t| = distance and the rotation ``turn``; ‖R − I‖ = 2√2·sin(θ/2) (Frobenius)."""
    if relation == "angle_rad":
        return rotation.angle(turn)
    if relation == "angle_deg":
        return np.rad2deg(rotation.angle(turn))
    part: FloatArray = 2.0 * np.sqrt(2.0) * rotation.vector_norm(turn)
    return part if relation == "rot_part" else np.hypot(part, distance)
