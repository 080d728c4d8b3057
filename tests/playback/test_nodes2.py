# SPDX-License-Identifier: Apache-2.0
"""Runs as ROS 2 alone can spoil them: types and qualities that don't match, params files, stamps, clocks."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.model.results import RunRecord

pytestmark = pytest.mark.parametrize("play", [2], indirect=True, ids=["ros2"])

SENTENCES = {
    "deaf": "the node did not subscribe to /points in 15 s; it subscribes to /camera/image "
    "(ros2.topics in its Algorithm has its names)",
    "picture": "the node did not subscribe to /points as sensor_msgs/msg/PointCloud2 in 15 s; "
    "it subscribes as sensor_msgs/msg/Image",
    "latched": "the node did not subscribe to /points in a way that fits in 15 s; it asks for "
    "a durability that isn't offered (ros2.qos in its Algorithm)",
    "stranger": "ros2.parameters: the file is for slam, and the nodes are /actor, which take nothing of it; "
    "above ros__parameters stands a node's name, or /** for any",
}
"""Nodes that nothing would reach."""


def trajectory(record: RunRecord, name: str = "trajectory.txt") -> np.ndarray:
    return np.loadtxt(Path(record.folder or "") / "run" / "output" / name, ndmin=2)


def test_a_node_on_the_wheels_is_played_to(play: Callable[..., RunRecord]) -> None:
    record = play("Odometry")
    assert (record.message or "", record.phase) == ("", "Succeeded")
    assert record.frames is not None
    assert record.frames.offered == record.frames.processed == 30
    rows = trajectory(record)
    np.testing.assert_allclose(rows[:, 1], rows[:, 0] - 1.6e9, atol=1e-6)


@pytest.mark.parametrize("act", SENTENCES)
def test_why_nothing_would_reach_the_node_is_said(play: Callable[..., RunRecord], act: str) -> None:
    record = play(act)
    assert (record.message, record.phase, record.reason) == (SENTENCES[act], "Failed", "AlgorithmFailed")


def test_whether_a_node_takes_simulated_time_is_said(play: Callable[..., RunRecord]) -> None:
    assert play("Odometry").metrics["usesSimulatedTime"] is True
    record = play("forgetful")
    assert record.metrics["usesSimulatedTime"] is False
    assert record.frames is not None
    assert record.frames.processed == 30


@pytest.mark.parametrize(
    ("act", "said"),
    [
        ("misspelt", "no node declares delayy (did you mean delay?), which node.yaml sets: ROS 2 ignored it"),
        ("liberal", ""),
    ],
)
def test_a_parameter_that_no_node_declares_is_said(
    play: Callable[..., RunRecord], act: str, said: str
) -> None:
    record = play(act)
    assert (record.phase, record.message or "") == ("Succeeded", said)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("act", "said", "simulated"),
    [("wall", r"1[789]\d{8}\.\d{3} s to .* s", False), ("stampless", "0.000 s to 0.000 s", True)],
)
def test_stamps_of_another_time_than_the_recordings_are_said(
    play: Callable[..., RunRecord], act: str, said: str, simulated: bool
) -> None:
    record = play(act)
    assert record.frames is not None
    assert (record.frames.offered, record.frames.processed) == (30, 0)
    (result,) = record.results
    assert result.outcome == "Lost"
    assert re.match(f"no pose of the estimate, {said}, lies within", result.values["message"])
    assert record.metrics["usesSimulatedTime"] is simulated


@pytest.mark.slow
def test_a_stamp_that_comes_twice_has_a_first_and_a_last_pose(play: Callable[..., RunRecord]) -> None:
    record = play("twice")
    assert (record.message or "", record.phase) == ("", "Succeeded")
    assert (trajectory(record)[:, 3] == 5.0).all()
    assert (trajectory(record, "trajectory.online.txt")[:, 3] == 0.0).all()
    assert record.frames is not None
    assert record.frames.processed == 30


@pytest.mark.slow
def test_thousands_of_poses_a_second_are_all_taken(play: Callable[..., RunRecord]) -> None:
    record = play("flood")
    assert (record.message or "", record.phase) == ("", "Succeeded")
    rows = trajectory(record)
    assert len(rows) == 30 * 200
    assert record.metrics["posesPublished"] == 30 * 200
    assert record.frames is not None
    assert record.frames.processed == 30
    assert (np.diff(rows[:, 0]) > 0).all()
