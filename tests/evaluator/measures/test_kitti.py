# SPDX-License-Identifier: Apache-2.0
"""Segment errors against the devkit's procedure, written again with matrices and loops."""

from __future__ import annotations

import itertools
import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive_eval import AssociationError, OptionError, Trajectory, read_kitti, read_trajectory, rotation
from slamhive_eval.measures.kitti import KITTI_LENGTHS, SPEEDS, kitti_errors

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

Lengths = tuple[float, ...]


def devkit(
    reference: Trajectory, estimate: Trajectory, lengths: tuple[float, ...], kind: type = float
) -> Any:
    """Rows of first frame, rotation rad/m, translation, length, speed: evaluate_odometry.cpp retold."""

    def poses(trajectory: Trajectory) -> Any:
        matrix = np.tile(np.eye(4), (len(trajectory), 1, 1))
        matrix[:, :3, :3] = rotation.to_matrix(trajectory.quaternions)
        matrix[:, :3, 3] = trajectory.positions
        return matrix

    truth, found = poses(reference), poses(estimate)
    distances = [kind(0)]
    for before, after in itertools.pairwise(truth):
        distances.append(kind(distances[-1] + kind(np.linalg.norm(after[:3, 3] - before[:3, 3]))))
    rows = []
    for first in range(0, len(truth), 10):
        for length in lengths:
            beyond = (k for k in range(first, len(truth)) if distances[k] > kind(distances[first] + length))
            last = next(beyond, None)
            if last is None:
                continue
            true_motion = np.linalg.inv(truth[first]) @ truth[last]
            error = np.linalg.inv(np.linalg.inv(found[first]) @ found[last]) @ true_motion
            angle = np.arccos(np.clip(0.5 * (np.trace(error[:3, :3]) - 1), -1, 1))
            speed = length / (0.1 * (last - first + 1))
            rows.append((first, angle / length, np.linalg.norm(error[:3, 3]) / length, length, speed))
    return np.array(rows)


@pytest.mark.parametrize("lengths", [KITTI_LENGTHS, (50.0, 250.0)])
def test_kitti_00(trajectories: Path, lengths: tuple[float, ...]) -> None:
    truth = read_kitti(trajectories / "KITTI_00_gt.txt")
    estimate = read_kitti(trajectories / "KITTI_00_ORB.txt")
    found = kitti_errors(truth, estimate, lengths=lengths)
    expected = devkit(truth, estimate, lengths)
    assert found.missing == 0
    assert found.poses == 4541
    np.testing.assert_array_equal(found.segments.begin, expected[:, 0])
    np.testing.assert_allclose(found.segments.speeds, expected[:, 4], rtol=1e-12)
    np.testing.assert_allclose(found.segments.translation, expected[:, 2], rtol=1e-9)
    np.testing.assert_allclose(found.segments.rotation, expected[:, 1], rtol=1e-6)  # arccos near 1
    assert found.overall.translation_percent == pytest.approx(100 * expected[:, 2].mean(), rel=1e-9)
    assert found.overall.rotation_deg_per_m == pytest.approx(np.rad2deg(expected[:, 1].mean()), rel=1e-9)
    for group, length in zip(found.by_length, lengths, strict=True):
        rows = expected[expected[:, 3] == length]
        assert group.count == len(rows)
        assert group.translation_percent == pytest.approx(100 * rows[:, 2].mean(), rel=1e-9)
    for speed in SPEEDS:
        rows = expected[np.abs(expected[:, 4] - speed) < 2]
        groups = [group for group in found.by_speed if group.value == speed]
        assert [group.count for group in groups] == [len(rows)] * bool(len(rows))
        for group in groups:
            assert group.rotation_deg_per_m == pytest.approx(np.rad2deg(rows[:, 1].mean()), rel=1e-9)


def test_segments_begin_at_frames_of_the_ground_truth(trajectories: Path, tmp_path: Path) -> None:
    """An estimate with a frame index that lacks the first 25 frames, and 5 in the middle."""
    truth = read_kitti(trajectories / "KITTI_00_gt.txt")
    lines = (trajectories / "KITTI_00_ORB.txt").read_text().splitlines()
    there = [k for k in range(len(lines)) if k >= 25 and not 1000 <= k < 1005]
    (tmp_path / "est.txt").write_text("".join(f"{k} {lines[k]}\n" for k in there))
    found = kitti_errors(truth, read_kitti(tmp_path / "est.txt"))
    rows = devkit(truth, read_kitti(trajectories / "KITTI_00_ORB.txt"), KITTI_LENGTHS)
    # The devkit's speed is the length by the duration of all frames of a segment, 0.1 s each.
    ends = rows[:, 0] + np.rint(rows[:, 3] / rows[:, 4] / 0.1) - 1
    expected = rows[np.isin(rows[:, 0], there) & np.isin(ends, there)]
    assert found.missing == len(rows) - len(expected) > 4 * 8
    assert found.missing_frames == 30
    assert [there[k] for k in found.segments.begin] == expected[:, 0].tolist()
    np.testing.assert_allclose(found.segments.translation, expected[:, 2], rtol=1e-9)
    assert found.overall.translation_percent == pytest.approx(100 * expected[:, 2].mean(), rel=1e-9)


def test_float32_as_in_the_devkit_differs_little(trajectories: Path) -> None:
    truth = read_kitti(trajectories / "KITTI_00_gt.txt").select(slice(0, 1500))
    estimate = read_kitti(trajectories / "KITTI_00_ORB.txt").select(slice(0, 1500))
    single = devkit(truth, estimate, KITTI_LENGTHS, np.float32)
    found = kitti_errors(truth, estimate)
    assert len(found.segments) == len(single)
    assert found.overall.translation_percent == pytest.approx(100 * single[:, 2].mean(), rel=1e-4)


def straight(n: int = 301, scale: float = 1.0, yaw_rate: float = 0.0) -> Trajectory:
    """One metre a pose along x, every 0.1 s."""
    angles = np.zeros((n, 3))
    angles[:, 2] = yaw_rate * np.arange(n)
    positions = np.zeros((n, 3))
    positions[:, 0] = scale * np.arange(n)
    return Trajectory(np.arange(n) * 0.1, positions, rotation.from_roll_pitch_yaw(angles))


def test_hand_made() -> None:
    found = kitti_errors(straight(), straight(scale=1.02), lengths=(100.0,))
    # The first pose more than 100 m away is the 101st, whose 101 m come out 2.02 m too long.
    assert len(found.segments) == 20
    np.testing.assert_array_equal(found.segments.end - found.segments.begin, 101)
    assert found.overall.translation_percent == pytest.approx(2.02)
    assert found.overall.rotation_deg_per_m == 0.0
    np.testing.assert_allclose(found.segments.speeds, 100 / 10.1)
    assert [(group.value, group.count) for group in found.by_speed] == [(8, 20), (10, 20)]
    turned = kitti_errors(straight(), straight(yaw_rate=1e-3), lengths=(100.0,))
    assert turned.overall.rotation_deg_per_m == pytest.approx(np.rad2deg(0.101) / 100)
    assert kitti_errors(straight(), straight(scale=0.5), scale=2.0).overall.translation_percent == 0.0


def test_poses_that_are_numbered_take_a_tenth_of_a_second() -> None:
    numbered = Trajectory(np.arange(301.0), straight().positions, straight().quaternions)
    assert kitti_errors(numbered, numbered, lengths=(100.0,)).segments.speeds[0] == pytest.approx(100 / 10.2)
    slow = kitti_errors(numbered, numbered, lengths=(100.0,), frame_seconds=1.0)
    assert slow.segments.speeds[0] == pytest.approx(100 / 102)


def test_what_the_estimate_lacks_is_counted(wander: Callable[..., Trajectory]) -> None:
    keep = np.r_[0:95, 150:301]
    found = kitti_errors(straight(), straight().select(keep), lengths=(100.0,), step=1)
    # Ends between 95 and 149 are missing: those up to 140 lie 10 m and more before the next pose.
    ends = np.arange(95) + 101
    assert found.missing == np.count_nonzero((ends >= 101) & (ends <= 140))
    assert found.overall.translation_percent == pytest.approx(0.0, abs=1e-12)
    early = kitti_errors(straight(), straight().select(slice(0, 150)), lengths=(100.0, 300.5))
    assert (len(early.segments), early.missing) == (5, 10)
    assert kitti_errors(wander(), wander()).as_dict()["translationPercent"] is None


def test_json(trajectories: Path) -> None:
    truth = read_trajectory(trajectories / "KITTI_00_gt.txt").select(slice(0, 800))
    found = json.loads(json.dumps(kitti_errors(truth, truth).as_dict(), allow_nan=False))
    first = {"length": 100, "count": 67, "translationPercent": 0, "rotationDegPerM": 0}
    assert found["byLength"][0] == pytest.approx(first, abs=1e-12)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"lengths": ()}, "positive numbers of metres"),
        ({"lengths": (0.0,)}, "positive numbers of metres"),
        ({"lengths": (5.0, 5.0)}, "once only"),
        ({"step": 0}, "at least 1 pose, not 0"),
        ({"scale": 0.0}, "scale must be a positive number"),
        ({"frame_seconds": -1.0}, "positive number of seconds, not -1"),
    ],
)
def test_wrong_options(asked: dict[str, Any], says: str) -> None:
    with pytest.raises(OptionError, match=says):
        kitti_errors(straight(), straight(), **asked)
    with pytest.raises(AssociationError, match="no pose of the estimate"):
        kitti_errors(straight(), straight(), offset_seconds=1e6)
