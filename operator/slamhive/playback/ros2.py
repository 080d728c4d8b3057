# SPDX-License-Identifier: Apache-2.0
"""Detection of an installed ROS 2 that was sourced, and of what its wheels need where there is none."""

from __future__ import annotations

import os
import platform
import re
import shutil
from functools import cache
from pathlib import Path

from slamhive.contract.environment import own_variables
from slamhive.playback.ros import PYTHONS, Probed, Ros, probe

WHEELS = Path(__file__).with_name("ros2-player.txt")
"""Requirements of the player where no ROS 2 is installed: all of it, with rclpy."""

BAGS = Path(__file__).with_name("ros2-bags.txt")
"""Requirements of the player beside an installed ROS 2."""

WHEELS_NODE_PYTHON = ">=3.10,<3.14"
"""Versions of Python that there are wheels for."""
WHEELS_PYTHON = ">=3.11,<3.14"
"""Those of them that the player runs in."""
WHEELS_MACHINES = ("x86_64",)
WHEELS_RMW = "rmw_fastrtps_cpp"
_WHEELS_GLIBC = (2, 28)
PLAYER_PYTHON = (3, 11)
"""Oldest Python that the player runs in; that of Humble is older."""

_PASSED_ON = (
    "AMENT_PREFIX_PATH",
    "LD_LIBRARY_PATH",
    "ROS_VERSION",
    "ROS_DISTRO",
    "ROS_PYTHON_VERSION",
)
_PROBE = """
import sys
import venv, ensurepip
import rclpy, sensor_msgs.msg, nav_msgs.msg, geometry_msgs.msg, rosgraph_msgs.msg, rcl_interfaces.srv
from importlib.metadata import PackageNotFoundError, version
try: release = version("rclpy")
except PackageNotFoundError: release = version("ros-rclpy")
print(*sys.version_info[:2], release)
"""
_OF_WHEELS = re.compile(r"ros_\w+\.libs")


def find_ros2() -> Ros | None:
    """Return the ROS 2 that was sourced in the shell that slamhive was started from, if one was."""
    found = _look()
    return found if isinstance(found, Ros) else None


def ros2_fault() -> str | None:
    """Return the reason that a ROS 2 that was sourced can't be used; None where none was, or it can."""
    found = _look()
    return found if isinstance(found, str) else None


@cache
def _look() -> Ros | str | None:
    if os.environ.get("ROS_VERSION") != "2":
        return None
    distribution = os.environ.get("ROS_DISTRO") or "ROS 2"
    variables = own_variables(_PASSED_ON)
    paths = tuple(filter(_in_ros, os.environ.get("PYTHONPATH", "").split(os.pathsep)))
    faults = []
    for python in dict.fromkeys(filter(None, map(shutil.which, PYTHONS))):
        found = probe(python, _PROBE, variables, paths)
        if isinstance(found, Probed):
            variables["PATH"] = os.pathsep.join(filter(_in_ros, os.get_exec_path()))
            release = f"{distribution} {found.release}"
            return Ros(2, python, found.version, release, paths, tuple(variables.items()))
        faults.append(f"{python}: {found}")
    why = "; ".join(faults) or "there is no python3"
    why += ": apt-get install python3-venv" if "'ensurepip'" in why else ""
    return f"{distribution} is sourced, and no Python here can take it ({why})"


def _in_ros(path: str) -> bool:
    """Tell whether a path lies below a folder in which the sourced ROS 2 has packages."""
    folders = [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
    return bool(path) and any(Path(path).is_relative_to(folder) for folder in folders)


def libraries_without_ros(paths: str) -> str:
    """Return a LD_LIBRARY_PATH without any ROS 2's folders.

    Wheels put theirs beside what is there, in any order: with those of another ROS 2 among them, libraries of
    both would be mixed.

    Args:
        paths: Folders, as in LD_LIBRARY_PATH.
    """
    return os.pathsep.join(
        entry
        for entry in paths.split(os.pathsep)
        if entry
        and not _in_ros(entry)
        and not _OF_WHEELS.fullmatch(Path(entry).name)
        and not _has_wheels(entry)
    )


def _has_wheels(folder: str) -> bool:
    return any(Path(folder).glob("python3.*/site-packages/ros_wheels_bootstrapper.pth"))


def wheels_fault() -> str | None:
    """Return the reason that this machine can't have wheels of ROS 2, its Pythons apart; None if it can."""
    machine = platform.machine()
    if machine not in WHEELS_MACHINES:
        return f"there are wheels of ROS 2 for {', '.join(WHEELS_MACHINES)} alone, and this is {machine}"
    library, version = platform.libc_ver()
    numbers = tuple(map(int, re.findall(r"\d+", version)[:2]))
    if library != "glibc" or numbers < _WHEELS_GLIBC:
        least = ".".join(map(str, _WHEELS_GLIBC))
        return (
            f"wheels of ROS 2 need glibc {least} or newer, and here is {library or 'none'} {version}".rstrip()
        )
    return None


def is_of_wheels(requirements: bytes) -> bool:
    """Tell whether a file of requirements brings rclpy itself."""
    # ros-kilted-rclpy and ros-jazzy-rclpy name the ros-rclpy of a distribution.
    pattern = rb"^\s*ros[-_.]+(?:[a-z]+[-_.]+)?rclpy\b"
    return re.search(pattern, requirements, re.MULTILINE | re.IGNORECASE) is not None
