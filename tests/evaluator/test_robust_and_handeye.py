# SPDX-License-Identifier: Apache-2.0
"""Alignments that heed outliers little, and extrinsics found from the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive_eval import (
    OptionError,
    Trajectory,
    TrajectoryError,
    align,
    align_robustly,
    ape_errors,
    hand_eye,
    rotation,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

TURN = rotation.to_matrix(rotation.from_roll_pitch_yaw(np.array([[0.3, -0.8, 2.0]])))[0]
YAW = rotation.to_matrix(rotation.from_roll_pitch_yaw(np.array([[0.0, 0.0, 2.0]])))[0]
METHODS = {"se3": (TURN, 1.0), "sim3": (TURN, 0.3), "yaw": (YAW, 1.0)}


def noisy(truth: Trajectory, sigma: float = 0.01) -> Trajectory:
    rng = np.random.default_rng(5)
    moved = truth.positions + rng.normal(0, sigma, truth.positions.shape)
    return Trajectory(truth.stamps, moved, truth.quaternions)


@pytest.fixture(name="lost", params=["jump", "scattered"])
def lost_fixture(request: pytest.FixtureRequest, wander: Callable[..., Trajectory]) -> tuple[Trajectory, ...]:
    """Ground truth, a good estimate, the same with a fifth of it far off, and which poses those are."""
    truth = wander(500, seed=2)
    good = noisy(truth)
    positions = good.positions.copy()
    wrong = np.zeros(500, dtype=bool)
    if request.param == "jump":
        wrong[300:400] = True
    else:
        wrong[np.random.default_rng(1).choice(500, 100, replace=False)] = True
    positions[wrong] += (40.0, -30.0, 20.0)
    return truth, good, Trajectory(good.stamps, positions, good.quaternions), wrong


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("loss", ["trimmed", "huber"])
def test_planted_outliers(lost: tuple[Trajectory, ...], method: str, loss: str) -> None:
    truth, good, bad, wrong = lost
    turn, scale = METHODS[method]
    good, bad = (one.transformed(turn, np.array((3.0, 4.0, 5.0)), scale) for one in (good, bad))
    clean = ape_errors(truth, align(truth, good, method).apply(good))[~wrong]
    plain = ape_errors(truth, align(truth, bad, method).apply(bad))[~wrong]
    found = align_robustly(truth, bad, method, loss)
    robust = ape_errors(truth, found.apply(bad))[~wrong]
    assert np.sqrt(np.mean(plain**2)) > 1
    assert np.sqrt(np.mean(robust**2)) < 1.5 * np.sqrt(np.mean(clean**2))
    assert found.scale == pytest.approx(1 / scale, rel=0.01)
    assert "of 500 poses" in found.notes[-1]


def test_without_outliers_nearly_nothing_changes(wander: Callable[..., Trajectory]) -> None:
    truth = wander(300)
    estimate = noisy(truth)
    plain = align(truth, estimate, "sim3").transform
    for loss in ("trimmed", "huber"):
        np.testing.assert_allclose(align_robustly(truth, estimate, "sim3", loss).transform, plain, atol=0.01)
    np.testing.assert_allclose(align_robustly(truth, estimate, "sim3", keep=1.0).transform, plain, atol=1e-12)
    assert align_robustly(truth, estimate, "scale").scale == align_robustly(truth, estimate, "sim3").scale
    assert align_robustly(truth, truth, "se3", "huber").scale == 1.0


@given(st.integers(0, 100), st.lists(st.integers(0, 4), min_size=40, max_size=40))
def test_whole_weights_are_repetitions(seed: int, counts: list[int]) -> None:
    if sum(counts) < 1:
        counts[0] = 1
    rng = np.random.default_rng(seed)
    q = rotation.normalize(rng.normal(size=(40, 4)))
    truth = Trajectory(np.arange(40.0), rng.normal(size=(40, 3)), q)
    estimate = noisy(truth, 0.1)
    again = np.repeat(np.arange(40), counts)
    for method in ("se3", "sim3", "yaw", "scale"):
        weighted = align(truth, estimate, method, weights=np.array(counts, dtype=float))
        repeated = align(truth.select(again), estimate.select(again), method)
        np.testing.assert_allclose(weighted.transform, repeated.transform, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("none",), "the alignment none fits no positions"),
        (("se3", "l1"), "unknown robust loss 'l1'; known are huber, trimmed"),
        (("se3", "trimmed", 0.2), "within 0.5 and 1, not 0.2"),
    ],
)
def test_wrong_options(wander: Callable[..., Trajectory], arguments: tuple[str, ...], says: str) -> None:
    with pytest.raises(OptionError, match=says):
        align_robustly(wander(), wander(), *arguments)


@pytest.mark.parametrize("weights", [np.ones(3), np.zeros(200), -np.ones(200), np.full(200, np.nan)])
def test_wrong_weights(wander: Callable[..., Trajectory], weights: npt.NDArray[np.float64]) -> None:
    with pytest.raises(OptionError, match="weights of 200 poses must be finite numbers"):
        align(wander(), wander(), "se3", weights=weights)


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_few_poses(wander: Callable[..., Trajectory], n: int) -> None:
    truth = wander(n)
    found = align_robustly(truth, truth.transformed(TURN, np.ones(3)), "se3", "huber")
    assert ape_errors(truth, found.apply(truth.transformed(TURN, np.ones(3)))).max() < 1e-9


def bare(trajectory: Trajectory) -> Trajectory:
    return Trajectory(trajectory.stamps, trajectory.positions, trajectory.quaternions, oriented=False)


def test_positions_alone_determine_what_they_can(wander: Callable[..., Trajectory]) -> None:
    truth = wander()
    found = align(truth, bare(truth.transformed(TURN, np.ones(3))), "se3")
    np.testing.assert_allclose(found.rotation, TURN.T, atol=1e-12)
    with pytest.raises(OptionError, match="origin needs orientations"):
        align(truth, bare(truth), "origin")
    with pytest.raises(TrajectoryError, match="positions don't determine a rotation"):
        align(truth.select(slice(2)), bare(truth.select(slice(2))), "se3")


def hand_eye_pair(
    truth: Trajectory, scale: float, sigma: float
) -> tuple[Trajectory, npt.NDArray[np.float64]]:
    extrinsic = np.eye(4)
    extrinsic[:3, :3], extrinsic[:3, 3] = TURN, (0.2, -0.4, 0.1)
    sensor = noisy(truth.moved(extrinsic), sigma)
    return sensor.transformed(TURN, np.array((7.0, 8.0, 9.0)), scale), extrinsic


@pytest.mark.parametrize(("scale", "with_scale"), [(1.0, False), (1.0, True), (0.05, True)])
def test_hand_eye(wander: Callable[..., Trajectory], scale: float, with_scale: bool) -> None:
    truth = wander(800, seed=3)
    sensor, extrinsic = hand_eye_pair(truth, scale, 0.0)
    found = hand_eye(truth, sensor, with_scale=with_scale)
    np.testing.assert_allclose(found.extrinsic, extrinsic, atol=1e-7)
    assert found.scale == pytest.approx(1 / scale)
    assert (found.rotation_rms_deg, found.translation_rms) == pytest.approx((0, 0), abs=1e-5)
    rough = hand_eye(truth, hand_eye_pair(truth, scale, 0.01)[0], with_scale=with_scale)
    np.testing.assert_allclose(rough.extrinsic, extrinsic, atol=0.02)
    moved = truth.moved(found.extrinsic)
    assert ape_errors(moved, align(moved, sensor, "sim3").apply(sensor)).max() < 1e-6


def flat(truth: Trajectory) -> Trajectory:
    yaw = np.column_stack((np.zeros((len(truth), 2)), np.linspace(0, 9, len(truth))))
    return Trajectory(truth.stamps, truth.positions, rotation.from_roll_pitch_yaw(yaw))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (flat, "turns about one axis only, as on a floor"),
        (bare, "hand-eye needs orientations"),
        (lambda truth: truth.select(slice(5)), "needs 10 motions .*; 0 were found"),
    ],
)
def test_what_hand_eye_cannot_tell(
    wander: Callable[..., Trajectory], make: Callable[[Trajectory], Trajectory], says: str
) -> None:
    truth = make(wander(800))
    with pytest.raises(TrajectoryError, match=says):
        hand_eye(truth, truth)
    with pytest.raises(OptionError, match="as many reference poses"):
        hand_eye(wander(), wander(3))
