# SPDX-License-Identifier: Apache-2.0
"""Detection of ROS 1 on this machine, and of the Python that it belongs to."""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from slamhive.contract.environment import own_variables

PACKAGES = (
    "python3-rospy",
    "python3-rosbag",
    "python3-roslaunch",
    "rosout",
    "python3-sensor-msgs",
    "python3-nav-msgs",
    "python3-geometry-msgs",
    "python3-tf2-msgs",
    "python3-std-srvs",
    "python3-venv",
)
"""Debian's packages of ROS Noetic that playing takes, some 15 MB to download."""

_PROGRAMS = ("roscore", "rosbag")
_PYTHONS = ("/usr/bin/python3", "python3")
_LEAST = (3, 11)
_PASSED_ON = (
    "ROS_ROOT",
    "ROS_PACKAGE_PATH",
    "ROS_DISTRO",
    "ROS_ETC_DIR",
    "CMAKE_PREFIX_PATH",
    "LD_LIBRARY_PATH",
)
_PROBE = """
import sys
import venv, ensurepip
import rospy, sensor_msgs.msg, nav_msgs.msg, geometry_msgs.msg, tf2_msgs.msg, std_srvs.srv
from importlib.metadata import version
print(*sys.version_info[:2], version("rospy"))
"""


@dataclass(frozen=True)
class Ros:
    """ROS 1 on this machine.

    Attributes:
        python: The interpreter that its packages are for.
        version: Of that interpreter.
        release: Version of rospy.
        paths: Folders of its packages that the interpreter doesn't know by itself.
        variables: Those of its own that its programs need.
    """

    python: str
    version: tuple[int, int]
    release: str
    paths: tuple[str, ...]
    variables: tuple[tuple[str, str], ...]


@cache
def find_ros() -> Ros | None:
    """Return this machine's ROS 1, None if something of it is missing.

    Debian's packages are found wherever they are; a ROS in a folder of its own when its setup.sh was sourced.
    """
    if not all(shutil.which(name) for name in _PROGRAMS):
        return None
    entries = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    paths = tuple(entry for entry in entries if entry and (Path(entry) / "rospy").is_dir())
    variables = own_variables(_PASSED_ON)
    for name in _PYTHONS:
        python = shutil.which(name)
        found = _probe(python, variables | {"PYTHONPATH": os.pathsep.join(paths)}) if python else None
        if python is not None and found is not None and found[0] >= _LEAST:
            return Ros(python, *found, paths, tuple(variables.items()))
    return None


def _probe(python: str, variables: dict[str, str]) -> tuple[tuple[int, int], str] | None:
    surroundings = {"PATH": os.environ.get("PATH", os.defpath)} | variables
    try:
        result = subprocess.run(
            [python, "-P", "-c", _PROBE],
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
            env=surroundings,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    if result.returncode != 0:
        return None
    major, minor, release = result.stdout.split()
    return (int(major), int(minor)), release


def missing_packages() -> list[str]:
    """Return those of the packages that this machine's dpkg hasn't installed; all where it knows of none."""
    ask = ["dpkg-query", "--show", "--showformat", "${Package} ${db:Status-Status}\\n", *PACKAGES]
    try:
        told = subprocess.run(ask, capture_output=True, text=True, check=False, timeout=60).stdout
    except (OSError, subprocess.TimeoutExpired):
        told = ""
    return [name for name in PACKAGES if f"{name} installed" not in told.splitlines()]


def what_it_takes() -> str:
    """Return the sentence for where ROS is missing, with the packages that would bring what is."""
    least = ".".join(map(str, _LEAST))
    wanted = " ".join(missing_packages() or PACKAGES)
    return f"needs ROS 1 for Python {least} or newer (on Debian 12: apt-get install {wanted})"
