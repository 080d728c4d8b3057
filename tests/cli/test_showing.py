# SPDX-License-Identifier: Apache-2.0
"""Tests of `algorithm show`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.mark.parametrize(("name", "ros"), [("kiss-icp-ros", 1), ("kiss-icp-ros2", 2)])
def test_of_which_ros_a_node_is(
    run_command: Callable[..., tuple[int, str, str]], name: str, ros: int
) -> None:
    code, told, _ = run_command("algorithm", "show", name)
    assert code == 0
    assert f"as a ROS {ros} node: poses on /kiss_icp/odometry (Odometry)" in told
