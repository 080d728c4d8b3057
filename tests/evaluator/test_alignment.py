# SPDX-License-Identifier: Apache-2.0
"""Tests of the alignments: what each must undo, whatever the path."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive_eval import (
    OptionError,
    Trajectory,
    align,
    ape_errors,
    find_pairs,
    rotation,
    rpe_errors,
    umeyama_scale,
)

angles = st.floats(-np.pi, np.pi)
metres = st.floats(-100, 100)
turns = st.tuples(angles, angles, angles)
points = st.tuples(metres, metres, metres)
scales = st.floats(0.05, 20)


def path(seed: int, n: int = 60) -> Trajectory:
    rng = np.random.default_rng(seed)
    positions = np.cumsum(rng.normal(0, 0.3, (n, 3)), axis=0)
    orientation = rotation.from_roll_pitch_yaw(np.cumsum(rng.normal(0, 0.1, (n, 3)), axis=0))
    return Trajectory(1e9 + 0.1 * np.arange(n), positions, orientation)


def noisy(trajectory: Trajectory, seed: int) -> Trajectory:
    rng = np.random.default_rng(seed)
    return Trajectory(
        trajectory.stamps,
        trajectory.positions + rng.normal(0, 0.05, trajectory.positions.shape),
        trajectory.quaternions + rng.normal(0, 0.01, trajectory.quaternions.shape),
    )


def matrix(rpy: tuple[float, float, float]) -> npt.NDArray[np.float64]:
    return rotation.to_matrix(rotation.from_roll_pitch_yaw(np.array([rpy])))[0]


def errors_after(reference: Trajectory, estimate: Trajectory, method: str) -> tuple[float, float]:
    aligned = align(reference, estimate, method).apply(estimate)
    return ape_errors(reference, aligned).max(), ape_errors(reference, aligned, "angle_deg").max()


@given(st.integers(0, 1000), turns, points, scales)
def test_what_each_method_undoes(
    seed: int, rpy: tuple[float, float, float], shift: tuple[float, float, float], scale: float
) -> None:
    truth = path(seed)
    for method, turn, s in (
        ("origin", matrix(rpy), 1.0),
        ("se3", matrix(rpy), 1.0),
        ("sim3", matrix(rpy), scale),
        ("yaw", matrix((0.0, 0.0, rpy[2])), 1.0),
        ("none", np.eye(3), 1.0),
    ):
        moved = truth.transformed(turn, np.array(shift) if method != "none" else np.zeros(3), s)
        distance, degrees = errors_after(truth, moved, method)
        assert distance < 1e-9, method
        assert degrees < 1e-5, method


@given(st.integers(0, 1000), turns, points, scales)
def test_errors_ignore_the_choice_of_world(
    seed: int, rpy: tuple[float, float, float], shift: tuple[float, float, float], scale: float
) -> None:
    truth = path(seed)
    estimate = noisy(truth, seed + 1)
    turn, t = matrix(rpy), np.array(shift)
    for method, s in (("se3", 1.0), ("sim3", scale)):
        expected = errors_after(truth, estimate, method)
        assert errors_after(truth.transformed(turn, t), estimate, method) == pytest.approx(expected)
        assert errors_after(truth, estimate.transformed(turn, t, s), method) == pytest.approx(expected)
    pairs = find_pairs(estimate, 10, "frames", all_pairs=True)
    for relation in ("trans_part", "angle_deg", "full"):
        np.testing.assert_allclose(
            rpe_errors(truth.transformed(turn, t), estimate, pairs, relation),
            rpe_errors(truth, estimate, pairs, relation),
            atol=1e-7,
        )


@given(st.integers(0, 1000), turns, points)
def test_no_other_motion_fits_better(
    seed: int, rpy: tuple[float, float, float], shift: tuple[float, float, float]
) -> None:
    truth = path(seed)
    estimate = noisy(truth, seed + 1).transformed(matrix(rpy), np.array(shift))
    rng = np.random.default_rng(seed)
    for method in ("se3", "sim3", "yaw"):
        found = align(truth, estimate, method)
        best = np.sum(ape_errors(truth, found.apply(estimate)) ** 2)
        small = rng.normal(0, 1e-3, 3) * ((0, 0, 1) if method == "yaw" else (1, 1, 1))
        factor = 1 + rng.normal(0, 1e-3) * (method == "sim3")
        other = found.apply(estimate).transformed(matrix(tuple(small)), rng.normal(0, 1e-3, 3), factor)
        assert np.sum(ape_errors(truth, other) ** 2) >= best


def test_scale_of_an_estimate_that_is_too_large() -> None:
    truth = path(3)
    assert umeyama_scale(truth, truth.transformed(np.eye(3), np.zeros(3), 1.04)) == pytest.approx(1 / 1.04)


def line(n: int, direction: tuple[float, float, float]) -> Trajectory:
    rpy = np.column_stack((np.linspace(0, 1, n), np.linspace(0, 0.5, n), np.zeros(n)))
    positions = np.outer(np.linspace(0, 5, n), direction)
    return Trajectory(np.arange(n) * 0.1, positions, rotation.from_roll_pitch_yaw(rpy))


@pytest.mark.parametrize(
    "truth",
    [line(40, (1, 0, 0)), line(40, (0.3, -2, 1)), line(2, (0, 0, 1)), line(1, (1, 1, 1)), line(9, (0, 0, 0))],
    ids=["line", "slanted", "two poses", "one pose", "standing"],
)
@pytest.mark.parametrize("method", ["se3", "sim3", "yaw"])
def test_what_positions_leave_free_is_taken_from_orientations(truth: Trajectory, method: str) -> None:
    turn = matrix((0.0, 0.0, 2.5) if method == "yaw" else (0.7, -0.4, 2.5))
    estimate = truth.transformed(turn, np.array((4.0, 5.0, 6.0)))
    distance, degrees = errors_after(truth, estimate, method)
    assert distance < 1e-9
    assert degrees < 1e-5
    vertical = np.ptp(truth.positions[:, :2]) == 0
    assert bool(align(truth, estimate, method).notes) == (method != "yaw" or vertical)


def test_a_straight_line_gives_the_least_errors_with_noise_in_the_orientations() -> None:
    truth = line(50, (1, 2, 3))
    estimate = noisy(truth, 1)
    estimate = Trajectory(truth.stamps, 1.01 * truth.positions, estimate.quaternions)
    found = align(truth, estimate, "se3")
    along = np.linspace(-2.5, 2.5, 50) * np.sqrt(14) * 0.01
    np.testing.assert_allclose(ape_errors(truth, found.apply(estimate)), np.abs(along), atol=1e-12)
    assert ape_errors(truth, found.apply(estimate), "angle_deg").max() < 5


@pytest.mark.parametrize(
    ("method", "first", "says"),
    [("se4", None, "unknown alignment 'se4'; known are none, origin"), ("se3", 0, "at least 1, not 0")],
)
def test_wrong_options(method: str, first: int | None, says: str) -> None:
    with pytest.raises(OptionError, match=says):
        align(path(0), path(0), method, first)


def test_unequal_lengths() -> None:
    with pytest.raises(OptionError, match="as many reference poses"):
        align(path(0), path(0, 59), "se3")
