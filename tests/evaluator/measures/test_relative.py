# SPDX-License-Identifier: Apache-2.0
"""Sub-trajectories, scale drift, velocities, smoothness and consistency, on errors planted on purpose."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive_eval import OptionError, Trajectory, associate, read_trajectory, rotation
from slamhive_eval.measures.consistency import CHI_SQUARE_95, measure_consistency
from slamhive_eval.measures.motion import smoothness, velocities, velocity_errors
from slamhive_eval.measures.relative import default_lengths, scale_drift, sub_trajectory_errors

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def matrices(trajectory: Trajectory) -> Any:
    found = np.tile(np.eye(4), (len(trajectory), 1, 1))
    found[:, :3, :3] = rotation.to_matrix(trajectory.quaternions)
    found[:, :3, 3] = trajectory.positions
    return found


def rpg(reference: Trajectory, estimate: Trajectory, length: float) -> Any:
    """rpg_trajectory_evaluation's relative errors, told again pose by pose: m, deg, yaw, gravity."""
    truth, found = matrices(reference), matrices(estimate)
    steps = np.linalg.norm(np.diff(reference.positions, axis=0), axis=1)
    path = np.concatenate(([0.0], np.cumsum(steps)))
    rows = []
    for i in range(len(truth)):
        miss = np.abs(path[i:] - path[i] - length)
        j = i + int(np.argmin(miss))
        if miss[j - i] >= 0.2 * length:
            continue
        motion = np.linalg.inv(np.linalg.inv(truth[i]) @ truth[j]) @ np.linalg.inv(found[i]) @ found[j]
        turn = np.eye(4)
        turn[:3, :3] = found[j][:3, :3]
        error = turn @ motion @ turn.T
        yaw = np.arctan2(error[1, 0], error[0, 0])
        cosine = np.hypot(error[0, 0], error[1, 0])
        pitch, roll = np.arctan2(-error[2, 0], cosine), np.arctan2(error[2, 1], error[2, 2])
        angle = np.degrees(np.arccos(np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1)))
        tilt = np.degrees(np.hypot(pitch, roll))
        rows.append((np.linalg.norm(error[:3, 3]), angle, np.degrees(abs(yaw)), tilt))
    return np.array(rows).T


def test_sub_trajectories_of_a_real_run_as_rpg_measures_them(trajectories: Path) -> None:
    truth = read_trajectory(trajectories / "fr2_desk_groundtruth.txt")
    estimate = read_trajectory(trajectories / "fr2_desk_ORB.txt")
    pairs = associate(truth, estimate)
    truth, estimate = truth.select(pairs.reference), estimate.select(pairs.estimate)
    found = sub_trajectory_errors(truth, estimate)
    assert [errors.length for errors in found] == list(default_lengths(truth.path_length))
    for errors in (found[0], found[4]):
        translation, angle, yaw, gravity = rpg(truth, estimate, errors.length)
        np.testing.assert_allclose(errors.translation, translation, rtol=1e-9)
        np.testing.assert_allclose(errors.rotation_deg, angle, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(errors.yaw_deg, yaw, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(errors.gravity_deg, gravity, rtol=1e-9, atol=1e-9)
    table = json.loads(json.dumps(found[0].as_dict(), allow_nan=False))
    assert table["count"] == len(found[0].pairs)
    assert table["translationPercent"]["mean"] == pytest.approx(
        100 * table["translation"]["mean"] / table["length"]
    )


def along_x(n: int = 501) -> Trajectory:
    positions = np.zeros((n, 3))
    positions[:, 0] = 0.1 * np.arange(n)
    return Trajectory(np.arange(n) * 0.1, positions, np.tile((0.0, 0, 0, 1), (n, 1)))


@pytest.mark.parametrize(("axis", "yaw", "gravity"), [(0, 0, 1), (1, 0, 1), (2, 1, 0)])
def test_rotation_errors_are_split_by_the_vertical(axis: int, yaw: float, gravity: float) -> None:
    truth = along_x()
    angles = np.zeros((len(truth), 3))
    angles[:, axis] = np.deg2rad(truth.distances / 10)  # one degree in ten metres
    tilted = Trajectory(truth.stamps, truth.positions, rotation.from_roll_pitch_yaw(angles))
    (found,) = sub_trajectory_errors(truth, tilted, (10.0,))
    inner = found.pairs[:, 1] - found.pairs[:, 0] == 100
    np.testing.assert_allclose(found.yaw_deg[inner], yaw, atol=1e-9)
    np.testing.assert_allclose(found.gravity_deg[inner], gravity, atol=1e-9)
    np.testing.assert_allclose(found.rotation_deg_per_m[inner], 0.1)


def test_lengths() -> None:
    assert default_lengths(100.0) == (10, 20, 30, 40, 50)
    assert default_lengths(4.0) == (0.4, 0.8, 1.0, 2.0)
    assert default_lengths(0.0) == ()
    still = along_x().transformed(np.eye(3), np.zeros(3), 0.0)
    assert sub_trajectory_errors(still, still) == ()
    with pytest.raises(OptionError, match="as many reference poses"):
        sub_trajectory_errors(along_x(), along_x(5))
    with pytest.raises(OptionError, match="positive number, not 0"):
        sub_trajectory_errors(along_x(), along_x(), (0.0,))


def test_planted_scale_drift_is_found(wander: Callable[..., Trajectory]) -> None:
    truth = wander(2000, seed=3)
    steps = np.diff(truth.positions, axis=0)
    rate = 0.002  # ln s per metre
    shrunk = np.vstack((np.zeros(3), np.cumsum(steps * np.exp(-rate * truth.distances[1:, None]), axis=0)))
    found = scale_drift(truth, Trajectory(truth.stamps, shrunk, truth.quaternions))
    assert len(found.scales) == 9  # each a little over a tenth
    assert found.percent_per_100m == pytest.approx(1e4 * rate, rel=0.05)
    assert found.spread == pytest.approx(np.exp(rate * np.ptp(found.distances)), rel=0.05)
    steady = scale_drift(truth, truth.transformed(np.eye(3), np.ones(3), 0.25))
    np.testing.assert_allclose(steady.scales, 4.0)
    assert steady.percent_per_100m == pytest.approx(0.0, abs=1e-9)
    still = truth.transformed(np.eye(3), np.zeros(3), 0.0)
    assert scale_drift(still, truth).as_dict() == {
        "windows": 0,
        "percentPer100m": None,
        "spread": None,
        "distances": [],
        "scales": [],
    }
    assert len(scale_drift(truth, still).scales) == 0
    assert scale_drift(truth, truth, truth.path_length * 0.9).percent_per_100m is None


def test_velocities() -> None:
    truth = along_x(50)
    times, found = velocities(truth.select(np.r_[0:20, 35:50]))
    assert len(times) == 33  # the hole of 1.6 s gives none
    np.testing.assert_allclose(found, np.tile((1.0, 0, 0), (33, 1)))
    np.testing.assert_allclose(times[0], 0.05)
    faster = truth.transformed(np.eye(3), np.zeros(3), 1.1)
    np.testing.assert_allclose(velocity_errors(truth, faster), 0.1)
    given = np.tile((1.0, 0, 0), (50, 1))
    np.testing.assert_allclose(velocity_errors(truth, truth, given, given + np.array((0.0, 0.3, 0.4))), 0.5)
    for wrong in ((along_x(5),), (truth, given), (truth, given, given[:3])):
        with pytest.raises(OptionError):
            velocity_errors(truth, *wrong)


def test_smoothness_of_a_parabola_and_a_turntable() -> None:
    t = np.sort(np.r_[np.linspace(0, 10, 101), 5.03])  # stamps need not be even
    positions, angles = np.zeros((102, 3)), np.zeros((102, 3))
    positions[:, 1] = 0.5 * 3.0 * t**2
    angles[:, 2] = np.deg2rad(0.5 * 4.0 * t**2)
    path = Trajectory(t, positions, rotation.from_roll_pitch_yaw(angles))
    found = smoothness(path)
    assert found.acceleration == pytest.approx(3.0)
    assert found.jerk == pytest.approx(0.0, abs=1e-8)
    assert found.angular_acceleration_deg == pytest.approx(4.0)
    doubled = smoothness(path.select(np.repeat(np.arange(102), 2)))
    assert doubled.acceleration == pytest.approx(3.0)
    cubic = Trajectory(t, np.column_stack((t**3, 0 * t, 0 * t)), path.quaternions)
    even = cubic.select(np.flatnonzero(t != 5.03))
    assert smoothness(even).jerk == pytest.approx(6.0)
    few = smoothness(path.select(slice(0, 2))).as_dict()
    assert few == {"acceleration": None, "jerk": None, "angularAccelerationDeg": None}


@pytest.mark.parametrize("d", [3, 6])
def test_consistent_gaussian_errors_have_nees_d(d: int) -> None:
    n = 20000
    rng = np.random.default_rng(1)
    truth = Trajectory(np.arange(n) * 0.1, np.zeros((n, 3)), rng.normal(size=(n, 4)))
    root = 1e-2 * (np.eye(d) + 0.3 * rng.normal(size=(d, d)))
    error = rng.normal(size=(n, d)) @ root.T
    turned = truth.quaternions
    if d == 6:
        half = np.linalg.norm(error[:, 3:], axis=1, keepdims=True) / 2
        off = np.hstack((np.sin(half) * error[:, 3:] / (2 * half), np.cos(half)))
        turned = rotation.multiply(off, truth.quaternions)
    # Covariances are those of the estimate's own world, 2 times larger and turned about z.
    turn = np.array(((0.0, -1, 0), (1, 0, 0), (0, 0, 1)))
    back = np.eye(d)
    back[:3, :3] = 2.0 * turn.T
    if d == 6:
        back[3:, 3:] = turn.T
    covariances = np.tile(back @ root @ root.T @ back.T, (n, 1, 1))
    covariances[:5] = 0.0
    covariances[5] = np.nan
    estimate = Trajectory(truth.stamps, error[:, :3], turned)
    found = measure_consistency(truth, estimate, covariances, turn, 0.5)
    assert len(found.nees) == n - 6
    assert found.nees.mean() == pytest.approx(d, rel=0.03)
    expected = np.einsum("ni,ij,nj->n", error[6:], np.linalg.inv(root @ root.T), error[6:])
    np.testing.assert_allclose(found.nees, expected, rtol=1e-6)
    for sigma, share in ((1, 0.6827), (2, 0.9545), (3, 0.9973)):
        np.testing.assert_allclose(found.within[sigma], share, atol=0.015)
    told = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert told["withoutCovariance"] == 6
    assert told["neesWithin95"] == pytest.approx(0.95, abs=0.01)
    # An estimator that promises a tenth of its errors is found out.
    bold = measure_consistency(truth, estimate, covariances / 100, turn, 0.5)
    assert bold.nees.mean() == pytest.approx(100 * found.nees.mean())


def test_no_covariance_at_all_and_wrong_ones() -> None:
    truth = along_x(4)
    told = measure_consistency(truth, truth, np.zeros((4, 6, 6))).as_dict()
    assert (told["count"], told["nees"], told["neesWithin95"], told["withinSigma"]) == (0, None, None, [])
    for wrong in (np.zeros((3, 3, 3)), np.zeros((4, 2, 2)), np.zeros((4, 6))):
        with pytest.raises(OptionError, match="consistency needs 4 estimated poses"):
            measure_consistency(truth, truth, wrong)


@pytest.mark.parametrize("d", [3, 6])
def test_limits_of_chi_square(d: int) -> None:
    samples = np.sum(np.random.default_rng(0).normal(size=(400_000, d)) ** 2, axis=1)
    assert np.mean(samples <= CHI_SQUARE_95[d]) == pytest.approx(0.95, abs=0.002)
