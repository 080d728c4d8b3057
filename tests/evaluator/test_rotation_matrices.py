# SPDX-License-Identifier: Apache-2.0
"""KITTI's rotation matrices, which are orthonormal to 1e-6 only: errors come from them as they are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import (
    Trajectory,
    TrajectoryError,
    align,
    ape_errors,
    find_pairs,
    read_kitti,
    rotation,
    rpe_errors,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.mark.parametrize(
    ("asked", "rmse", "largest"),
    [
        ("ape|trans_part|none", 7.790288882656827, 13.45850880738189),
        ("ape|rot_part|none", 0.0397248722829852, 0.19573531146663778),
        ("ape|full|sim3", 0.9378947995789575, 2.6938060987358488),
        ("ape|angle_deg|origin", 1.609558710629735, 7.936409654954009),
        ("rpe|trans_part|none|1|frames|consecutive", 0.02812037701739386, 0.30271249059536337),
        ("rpe|rot_part|sim3|100|m|all", 0.022169657365913503, 0.17833636097287298),
        ("rpe|full|se3|10|deg|consecutive", 0.3038758825370475, 2.2274024046982936),
        ("rpe|angle_deg|none|1|frames|consecutive", 0.11497352125979224, 2.196615406942415),
    ],
)
def test_as_evo(trajectories: Path, asked: str, rmse: float, largest: float) -> None:
    truth, estimate = (read_kitti(trajectories / f"KITTI_00_{name}.txt") for name in ("gt", "ORB"))
    metric, relation, method, *delta = asked.split("|")
    estimate = align(truth, estimate, method).apply(estimate)
    if metric == "ape":
        errors = ape_errors(truth, estimate, relation)
    else:
        pairs = find_pairs(estimate, float(delta[0]), delta[1], all_pairs=delta[2] == "all")
        errors = rpe_errors(truth, estimate, pairs, relation)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(rmse, rel=1e-9)
    assert errors.max() == pytest.approx(largest, rel=1e-9)


def with_matrices(trajectory: Trajectory) -> Trajectory:
    return Trajectory(
        trajectory.stamps, trajectory.positions, trajectory.quaternions, rotations=trajectory.matrices
    )


@pytest.mark.parametrize("relation", ["trans_part", "rot_part", "full", "angle_deg"])
def test_matrices_and_quaternions_agree(wander: Callable[..., Trajectory], relation: str) -> None:
    truth, estimate = wander(60), wander(60, seed=1)
    extrinsic = np.eye(4)
    extrinsic[:3, :3] = rotation.to_matrix(np.array((0.5, 0.5, -0.5, 0.5)))
    extrinsic[:3, 3] = (1.0, 2.0, 3.0)
    pairs = find_pairs(truth, 3, "frames", all_pairs=True)
    found = []
    for wrap in (with_matrices, lambda trajectory: trajectory):
        reference = wrap(truth).moved(extrinsic).select(slice(5, None))
        moved = wrap(estimate).select(slice(5, None))
        moved = align(reference, moved, "sim3").apply(moved)
        assert (moved.rotations is None) == (wrap is not with_matrices)
        found.append(
            (ape_errors(reference, moved, relation), rpe_errors(reference, moved, pairs[:50], relation))
        )
    for ours, theirs in zip(*found, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)


def test_nearest_rotations() -> None:
    rng = np.random.default_rng(0)
    exact = rotation.to_matrix(rotation.normalize(rng.normal(size=(50, 4))))
    rounded = exact + rng.normal(0, 3e-3, exact.shape)
    found = rotation.orthonormalize(rounded)
    np.testing.assert_allclose(found, [rotation.nearest_rotation(one) for one in rounded], atol=1e-14)


def test_orthonormal(wander: Callable[..., Trajectory]) -> None:
    assert with_matrices(wander(3)).rotations is not None
    assert with_matrices(wander(3)).orthonormal().rotations is None


def test_rotations_of_another_shape(wander: Callable[..., Trajectory]) -> None:
    one = wander(3)
    with pytest.raises(
        TrajectoryError, match=r"rotations must be finite, \(3, 3, 3\), not of shape \(3, 4\)"
    ):
        Trajectory(one.stamps, one.positions, one.quaternions, rotations=one.quaternions)


def test_shifted_in_time(wander: Callable[..., Trajectory]) -> None:
    np.testing.assert_array_equal(wander(3).shifted(-2.5).stamps, wander(3).stamps - 2.5)
