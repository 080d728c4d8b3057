# SPDX-License-Identifier: Apache-2.0
"""Tests of reading paths beside the library that decodes them as a whole."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from slamhive.playback.player.poses import reader
from slamhive.playback.player.ros2.paths import PathReader
from slamhive.playback.protocol import PoseSource

STORE = get_typestore(Stores.ROS2_JAZZY)
PATH = "nav_msgs/msg/Path"


def _path(rows: np.ndarray, frame: str = "map", other: str = "odom") -> Any:
    kinds = STORE.types

    def header(stamp: int, name: str) -> Any:
        return kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](stamp, 7 * stamp), name)

    poses = [
        kinds["geometry_msgs/msg/PoseStamped"](
            header(10 + index, other),
            kinds["geometry_msgs/msg/Pose"](
                kinds["geometry_msgs/msg/Point"](*row[:3]), kinds["geometry_msgs/msg/Quaternion"](*row[3:])
            ),
        )
        for index, row in enumerate(rows.tolist())
    ]
    return kinds[PATH](header(1, frame), poses)


@pytest.mark.parametrize("frame", ["", "m", "map", "world", "a_long_name"])
@pytest.mark.parametrize("other", ["", "odo", "odom", "odometry"])
def test_a_path_has_the_poses_that_the_library_decodes(frame: str, other: str) -> None:
    rows = np.random.default_rng(5).normal(size=(7, 7))
    whole = reader(PoseSource("/path", "Path"))
    for count in range(8):
        message = _path(rows[:count], frame, other)
        data = bytes(STORE.serialize_cdr(message, PATH))
        assert list(PathReader().changed(data)) == list(whole(STORE.deserialize_cdr(data, PATH)))


def test_of_a_path_that_grows_new_and_changed_poses_are_read() -> None:
    rows = np.random.default_rng(5).normal(size=(6, 7))
    path = PathReader()

    def stamps(values: np.ndarray) -> list[int]:
        data = bytes(STORE.serialize_cdr(_path(values), PATH))
        return [pose.stamp // 1_000_000_000 for pose in path.changed(data)]

    assert stamps(rows[:4]) == [10, 11, 12, 13]
    assert stamps(rows[:5]) == [10, 14]  # the first pose is always read: it lies elsewhere
    rows[2] += 1
    assert stamps(rows) == [10, 12, 15]
    assert stamps(rows[:3]) == [10]


def test_what_is_laid_out_otherwise_is_left_to_the_library() -> None:
    rows = np.zeros((2, 7))
    data = bytes(STORE.serialize_cdr(_path(rows), PATH))
    for broken in (data[:30], data[:-8], b"\x00\x00" + data[2:], data[:4]):
        with pytest.raises(ValueError, match=r"cut off|little endian"):
            list(PathReader().changed(broken))
