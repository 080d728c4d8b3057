# SPDX-License-Identifier: Apache-2.0
"""Control points: what is met, how the estimate gets there, and what they say beside dense ground truth."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive_eval import (
    ControlPoints,
    OptionError,
    Options,
    Trajectory,
    TrajectoryError,
    evaluate,
    evaluate_points,
    read_kitti,
    rotation,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

MONO = Options(alignment="sim3", has_scale=False)


def every(truth: Trajectory, seconds: float, first: float = 0.0) -> ControlPoints:
    """Return the poses of ground truth nearest to ticks."""
    ticks = np.arange(truth.stamps[0] + first, truth.stamps[-1], seconds)
    index = np.unique(np.searchsorted(truth.stamps, ticks))
    return ControlPoints(truth.stamps[index], truth.positions[index])


def turned(poses: Trajectory, scale: float = 1.0) -> Trajectory:
    """Return the same poses in another world."""
    turn = rotation.to_matrix(np.array([0.1, 0.7, -0.3, 0.64]) / np.linalg.norm([0.1, 0.7, -0.3, 0.64]))
    return poses.transformed(turn, np.array([10.0, -3.0, 4.0]), scale)


def without(poses: Trajectory, start: float, end: float) -> Trajectory:
    """Return the poses outside of a span, s after the first."""
    at = poses.stamps - poses.stamps[0]
    return poses.select(np.flatnonzero((at < start) | (at > end)))


@pytest.mark.parametrize(("options", "scale"), [(Options(), 1.0), (MONO, 0.25)])
def test_a_perfect_estimate_meets_every_point(
    wander: Callable[..., Trajectory], options: Options, scale: float
) -> None:
    """With dense association its coverage was 0 and it was Lost."""
    truth = wander(n=1200)
    points = every(truth, 15, first=0.05)
    found = evaluate_points(points, turned(truth, scale), options)
    assert (found.outcome, found.share, found.message) == ("Tracked", 1.0, "")
    assert found.ate is not None
    assert found.ate.rmse < 1e-6
    assert found.scale == pytest.approx(1 / scale)
    values = found.as_dict()
    assert values["points"]["count"] == values["points"]["met"] == len(points) == 8
    assert values["points"]["medianSpacingSeconds"] == pytest.approx(15, abs=0.1)
    assert len(values["pointErrors"]) == 8
    assert values["rpe"] == []
    assert "drift and jumps between them are not seen" in values["notes"][0]
    bare = Trajectory(points.stamps, points.positions, np.tile((0.0, 0, 0, 1), (8, 1)), oriented=False)
    assert evaluate(bare, turned(truth, scale), options).coverage.share == 0


def test_the_estimate_is_interpolated_to_the_points_over_short_gaps_only(
    wander: Callable[..., Trajectory],
) -> None:
    truth = wander(n=600)
    points = every(truth, 5, first=2.0)
    thinned = without(truth, 11.95, 12.55).select(slice(None))
    assert evaluate_points(points, thinned).share == 1
    assert evaluate_points(points, thinned).ate.rmse < 0.05
    holed = without(truth, 11, 13)
    found = evaluate_points(points, holed)
    assert found.met.tolist() == [k != 2 for k in range(len(points))]
    assert (found.outcome, found.message) == ("Tracked", "")
    found = evaluate_points(points, holed, Options(min_coverage=0.95))
    assert (found.outcome, found.message) == (
        "Partial",
        "the estimate meets 11 of 12 control points; 95% were asked",
    )
    assert evaluate_points(points, holed, Options(max_gap_seconds=3)).share == 1
    assert evaluate_points(points, holed, Options(keyframes=True)).share == 1


@pytest.mark.parametrize(
    ("end", "share", "outcome"), [(59.95, 1, "Tracked"), (45, 9 / 12, "Partial"), (25, 5 / 12, "Lost")]
)
def test_coverage_is_the_share_of_points_met(
    wander: Callable[..., Trajectory], end: float, share: float, outcome: str
) -> None:
    truth = wander(n=600)
    found = evaluate_points(every(truth, 5, first=2.0), without(truth, end, 1e9))
    assert (found.share, found.outcome) == (pytest.approx(share), outcome)


def test_points_outside_the_run_do_not_count(wander: Callable[..., Trajectory]) -> None:
    truth = wander(n=600)
    begin = truth.stamps[0]
    found = evaluate_points(every(truth, 5, first=2.0), truth, Options(window=(begin + 10, begin + 30)))
    assert len(found.points) == found.met.sum() == 4
    with pytest.raises(OptionError, match="no control point in the run's time"):
        evaluate_points(every(truth, 5), truth, Options(window=(0, 1)))


def test_points_that_determine_nothing_have_a_reason(wander: Callable[..., Trajectory]) -> None:
    truth = wander(n=600)
    two = evaluate_points(every(truth, 30), truth)
    assert (two.outcome, two.ate) == ("Lost", None)
    assert two.message == (
        "2 of 2 control points lie between poses of the estimate at most 1 s apart; an error needs at least 3"
    )
    line = Trajectory(truth.stamps, truth.positions * (1, 0, 0), truth.quaternions)
    found = evaluate_points(every(line, 10), line)
    assert (found.outcome, found.ate) == ("Lost", None)
    assert "don't determine a rotation (a straight line" in found.message
    assert found.message.endswith("6 control points were met")
    assert evaluate_points(every(truth, 10), None).message == "the algorithm wrote no pose"
    later = truth.shifted(1e5)
    assert evaluate_points(every(truth, 10), later).message.startswith("0 of 6 control points lie between")


def test_a_wild_estimate_has_diverged(wander: Callable[..., Trajectory]) -> None:
    truth = wander(n=600)
    far = evaluate_points(every(truth, 5), wander(n=600, seed=9))
    assert far.outcome == "Diverged"
    large = evaluate_points(every(truth, 5), turned(truth, 3.0))
    assert (large.outcome, large.message[:14]) == ("Diverged", "the scale is 0")
    still = Trajectory(truth.stamps, np.zeros((600, 3)), truth.quaternions)
    assert evaluate_points(every(truth, 5), still, Options(alignment="none")).outcome == "Diverged"


def test_a_lever_arm_is_taken_by_the_orientation_of_the_estimate(wander: Callable[..., Trajectory]) -> None:
    truth, pole = wander(n=600), np.eye(4)
    pole[:3, 3] = 0.3, 0.0, -1.5
    points = every(truth.moved(pole), 5)
    for options, scale in ((Options(), 1.0), (MONO, 0.1)):
        found = evaluate_points(points, turned(truth, scale), replace(options, extrinsic=np.linalg.inv(pole)))
        assert found.ate.rmse < 1e-8
        assert any("positions alone, of a frame 1.53 m away" in note for note in found.notes)
    assert evaluate_points(points, turned(truth)).ate.rmse > 0.01
    bare = Trajectory(truth.stamps, truth.positions, truth.quaternions, oriented=False)
    with pytest.raises(OptionError, match="no lever arm can be applied"):
        evaluate_points(points, bare, Options(extrinsic=pole))


@given(st.integers(0, 10_000), st.floats(0.3, 3))
def test_errors_do_not_depend_on_the_worlds(seed: int, scale: float) -> None:
    random = np.random.default_rng(seed)
    stamps = np.arange(60) * 0.5
    quaternions = random.normal(size=(60, 4))
    truth = Trajectory(stamps, np.cumsum(random.normal(size=(60, 3)), axis=0), quaternions)
    estimate = Trajectory(stamps, truth.positions + random.normal(0, 0.1, (60, 3)), quaternions)
    points = every(truth, 3)
    plain = evaluate_points(points, estimate, MONO)
    moved = evaluate_points(points, turned(estimate, scale), MONO)
    assert moved.errors == pytest.approx(plain.errors, abs=1e-9)


def test_only_the_largest_errors_are_listed_where_there_are_many(wander: Callable[..., Trajectory]) -> None:
    truth = wander(n=600)
    random = np.random.default_rng(4)
    points = ControlPoints(truth.stamps, truth.positions + random.normal(0, 0.01, (600, 3)))
    found = evaluate_points(points, truth)
    listed = found.as_dict()["pointErrors"]
    assert len(listed) == 100
    assert min(one["error"] for one in listed) == pytest.approx(np.sort(found.errors)[-100], rel=1e-5)
    assert [one["time"] for one in listed] == sorted(one["time"] for one in listed)


def test_points_must_be_sound() -> None:
    with pytest.raises(TrajectoryError, match="no poses"):
        ControlPoints(np.empty(0), np.empty((0, 3)))
    with pytest.raises(TrajectoryError, match="comes before"):
        ControlPoints(np.array([2.0, 1.0]), np.zeros((2, 3)))


@pytest.fixture
def drive(trajectories: Path) -> tuple[Trajectory, Trajectory]:
    """KITTI 00, 471 s: ground truth, and ORB-SLAM's result."""
    times = trajectories / "KITTI_00_gt_times.txt"
    return tuple(read_kitti(trajectories / name, times) for name in ("KITTI_00_gt.txt", "KITTI_00_ORB.txt"))  # type: ignore[return-value]


@pytest.mark.parametrize("seconds", [5, 15, 30])
def test_points_say_the_same_as_dense_ground_truth_of_the_same_drive(
    drive: tuple[Trajectory, Trajectory], seconds: float
) -> None:
    """94, 31 and 16 points instead of 4,541 poses, surveyed at twelve different beginnings.

    At the same instants the RMSE differs only by the alignment, which fewer points determine. Against the
    RMSE of the whole drive there is the chance of which instants were surveyed, which a mean doesn't have,
    and which the standard error tells.
    """
    truth, estimate = drive
    dense = evaluate(truth, estimate)
    found = []
    for first in np.linspace(0, seconds, 12, endpoint=False):
        points = every(truth, seconds, first)
        sparse = evaluate_points(points, estimate)
        assert (sparse.outcome, sparse.share) == ("Tracked", 1.0)
        there = np.isin(dense.poses.reference.stamps, points.stamps)
        same = float(np.sqrt(np.mean(dense.poses.errors[there] ** 2)))
        assert sparse.ate.rmse == pytest.approx(same, rel=0.02)
        assert abs(sparse.ate.rmse - dense.ate.rmse) < 2 * sparse.standard_error
        found.append(sparse.ate.rmse)
    assert np.mean(found) == pytest.approx(dense.ate.rmse, rel=0.02)


def test_what_few_points_cannot_say_is_said(drive: tuple[Trajectory, Trajectory]) -> None:
    truth, estimate = drive
    few = evaluate_points(every(truth, 30, first=15), estimate)
    said = " | ".join(few.notes)
    assert f"at 16 control points has a standard error of {few.standard_error:.2g} m" in said
    assert "fits 6 numbers to 16 points, by which the RMSE looks smaller than it is: by 6%" in said
    assert few.as_dict()["points"]["rmseStandardError"] == few.standard_error
    many = evaluate_points(every(truth, 5), estimate)
    assert "looks smaller" not in " | ".join(many.notes)
    assert many.standard_error < 0.6 * few.standard_error
    # Without one of three points no alignment is left.
    three = ControlPoints(truth.stamps[:4000:1500], truth.positions[:4000:1500])
    assert evaluate_points(three, estimate).standard_error is None


def test_independent_errors_look_smaller_by_what_is_said(wander: Callable[..., Trajectory]) -> None:
    """Of independent errors, six points show as much as the note says, and the standard error is right."""
    truth, random = wander(n=1200), np.random.default_rng(5)
    points = every(truth, 20)
    found, told = [], []
    for _ in range(150):
        noise = random.normal(0, 0.1, truth.positions.shape)
        moved = Trajectory(truth.stamps, truth.positions + noise, truth.quaternions)
        one = evaluate_points(points, moved)
        found.append(one.ate.rmse)
        told.append(one.standard_error)
    assert len(points) == 6
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(
        0.1 * np.sqrt(3) * np.sqrt(1 - 6 / 18), rel=0.05
    )
    assert np.median(told) == pytest.approx(np.std(found), rel=0.5)
