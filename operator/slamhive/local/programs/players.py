# SPDX-License-Identifier: Apache-2.0
"""The Python and packages of the ROS 2 player on a workstation: of an installed ROS 2, or wheels.

Never those of slamhive: what brings the wheels' libraries has every Python of its environment start twice.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from slamhive.local.programs.interpreters import Interpreter, python_for
from slamhive.local.programs.unavailable import Unavailable
from slamhive.playback.player.ros2.transport import has_rmw
from slamhive.playback.ros import Ros
from slamhive.playback.ros2 import (
    BAGS,
    PLAYER_PYTHON,
    WHEELS,
    WHEELS_MACHINES,
    WHEELS_PYTHON,
    WHEELS_RMW,
    find_ros2,
    wheels_fault,
)

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.model.rosnodes import Ros2


class PlayerBase(NamedTuple):
    """Interpreter and pinned requirements from which the environment of the ROS 2 player is made."""

    python: Interpreter
    requirements: Path

    def in_environment(self, path: Path) -> Ros:
        """Return the ROS 2 of the player, whose environment lies at a path."""
        python, ros = str(path / "bin" / "python"), self.python.ros
        if ros is not None:
            return replace(ros, python=python)
        return Ros(2, python, self.python.version, "wheels", (), (("AMENT_PREFIX_PATH", str(path)),))


def player_base() -> PlayerBase:
    """Return the base of the ROS 2 player on this machine: an installed ROS 2 that was sourced, else wheels.

    Raises:
        Unavailable: There is neither.
    """
    ros = find_ros2()
    if ros is not None and ros.version >= PLAYER_PYTHON:
        return PlayerBase(Interpreter(ros.python, ros.version, ros), BAGS)
    helps = "source the setup of an installed ROS 2"
    if ros is not None:
        found, least = (".".join(map(str, version)) for version in (ros.version, PLAYER_PYTHON))
        helps = f"{ros.release}, which was sourced, is for Python {found}, and it takes {least}"
    fault = wheels_fault()
    if fault is not None:
        raise Unavailable(f"the ROS 2 player can't be had: {fault}; {helps}")
    try:
        return PlayerBase(python_for(WHEELS_PYTHON, WHEELS_MACHINES), WHEELS)
    except Unavailable as error:
        raise Unavailable(f"the ROS 2 player {error}; {helps}") from None


def player_for(node: Ros2) -> PlayerBase:
    """Return the base of a player that a node can meet.

    Raises:
        Unavailable: There is none, or none with the node's rmw.
    """
    base, rmw = player_base(), node.rmw or WHEELS_RMW
    ros = base.python.ros
    places = dict(ros.variables).get("AMENT_PREFIX_PATH", "") if ros is not None else ""
    if rmw != WHEELS_RMW and not has_rmw(places, rmw):
        found = f"{ros.release} has none" if ros is not None else f"wheels have {WHEELS_RMW} alone"
        raise Unavailable(f"needs an installed ROS 2 with {rmw}, which was sourced: {found}")
    return base
