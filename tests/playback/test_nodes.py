# SPDX-License-Identifier: Apache-2.0
"""Real recordings played to real nodes of ROS 1 and of ROS 2: what becomes of each kind of node."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive.monitor import find_orphans

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.model.results import RunRecord


def output(record: RunRecord) -> Path:
    return Path(record.folder or "") / "run" / "output"


@pytest.mark.parametrize(
    "act",
    ["Odometry", "PoseStamped", "PoseWithCovarianceStamped", "Path", "TF", "stubborn", "fault", "careless"],
)
def test_poses_are_recorded_whatever_carries_them_and_however_the_node_ends(
    play: Callable[..., RunRecord], act: str
) -> None:
    record = play(act)
    assert (record.message or "", record.phase) == ("", "Succeeded")
    told = json.loads((Path(record.folder or "") / "summary.json").read_text())
    assert (told["reason"], told["message"]) == (None, "")
    rows = np.loadtxt(output(record) / "trajectory.txt")
    assert record.frames is not None
    assert len(rows) == record.frames.processed == record.frames.offered
    np.testing.assert_allclose(rows[:, 1], rows[:, 0] - 1.6e9, atol=1e-6)
    assert (rows[:, 2] == (7.0 if act == "TF" else 0.0)).all()
    latency = record.metrics["latencySeconds"]
    assert 0 < latency["median"] <= latency["p95"] <= latency["p99"] <= latency["max"]
    assert 0.9 < record.metrics["realTimeFactor"] < 2  # a busy machine is behind too
    table = np.loadtxt(output(record) / "latency.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 0], rows[:, 0])
    np.testing.assert_allclose(table[:, 2] - table[:, 1], table[:, 3], atol=1e-5)
    assert record.metrics["playSeconds"] > 0.9


def test_of_a_path_the_last_is_the_estimate_and_what_came_first_is_kept(
    play: Callable[..., RunRecord],
) -> None:
    folder = output(play("Path"))
    final, online = (np.loadtxt(folder / name) for name in ("trajectory.txt", "trajectory.online.txt"))
    assert (final[:, 3] == len(final)).all()
    np.testing.assert_array_equal(online[:, 3], np.arange(1, len(online) + 1))


def test_keyframes_are_kept_beside_the_poses(play: Callable[..., RunRecord]) -> None:
    folder = output(play("Odometry"))
    poses, keyframes = (np.loadtxt(folder / name) for name in ("trajectory.txt", "trajectory.keyframes.txt"))
    np.testing.assert_array_equal(keyframes[:, 0], poses[::10, 0])
    assert (keyframes[:, 1] == len(keyframes)).all()
    assert not (output(play("Path")) / "trajectory.keyframes.txt").exists()


def test_what_the_node_writes_itself_is_the_estimate(play: Callable[..., RunRecord]) -> None:
    folder = output(play("final"))
    assert (np.loadtxt(folder / "trajectory.txt")[:, 1] == 9).all()
    assert np.loadtxt(folder / "trajectory.online.txt")[0, 1] == 0


def test_a_slow_node_drops_frames(play: Callable[..., RunRecord]) -> None:
    record = play("slow")
    assert record.phase == "Succeeded"
    assert record.frames is not None
    assert record.frames.offered == 30
    assert record.frames.processed is not None
    assert 1 < record.frames.processed < 28
    assert record.frames.dropped == 30 - record.frames.processed
    assert record.metrics["latencySeconds"]["median"] > 0.059


def test_a_slow_node_drops_nothing_where_time_waits_for_it(play: Callable[..., RunRecord]) -> None:
    record = play("slow", "Stepped")
    assert (record.message or "", record.phase) == ("", "Succeeded")
    assert record.frames is not None
    assert record.frames.offered == record.frames.processed == 30
    assert record.metrics["playSeconds"] > 29 * 0.06


def test_a_node_that_publishes_no_pose_is_lost(play: Callable[..., RunRecord]) -> None:
    record = play("silent")
    assert (record.phase, record.message) == ("Succeeded", None)
    assert record.trajectory is not None
    assert record.trajectory.poses == 0
    assert record.frames is not None
    assert (record.frames.offered, record.frames.processed) == (30, 0)


def test_what_was_heard_of_a_node_that_ends_before_its_recording_is_kept(
    play: Callable[..., RunRecord],
) -> None:
    record = play("quits")
    assert (record.message or "", record.phase) == ("", "Succeeded")
    assert record.frames is not None
    assert record.frames.processed is not None
    assert 1 <= record.frames.processed <= 15
    assert record.metrics["latencySeconds"]["max"] > 0


@pytest.mark.parametrize(
    ("act", "message"),
    [
        ("deaf", "the node did not subscribe to /points in 15 s"),
        ("crash", "lost the map"),
        ("astray", "no poses on /actor/elsewhere"),
        ("astray", "/actor/poses (nav_msgs/"),
        ("broken", "can't open the vocabulary"),
    ],
)
def test_a_node_that_fails(play: Callable[..., RunRecord], act: str, message: str) -> None:
    record = play(act)
    assert (record.phase, record.reason) == ("Failed", "AlgorithmFailed")
    assert message in (record.message or "")
    assert record.usage is not None
    assert record.usage.includes_reader is False


def test_nothing_is_left_and_waiting_does_not_count(play: Callable[..., RunRecord]) -> None:
    record = play("Odometry")
    folder = Path(record.folder or "")
    for name in ("process.json", "player/process.json"):
        assert find_orphans(folder / name) == []
    report = json.loads((output(record) / "playback.json").read_text())
    assert report["state"] == "Ended"
    assert record.usage is not None
    wall = record.usage.wall_seconds
    assert wall is not None
    assert report["playEnd"] - report["playStart"] < wall
    assert record.usage.cpu.mean_cores != pytest.approx((record.usage.cpu.seconds or 0) / wall, rel=1e-3)
