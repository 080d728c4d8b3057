# SPDX-License-Identifier: Apache-2.0
"""Detection of ROS 1 on this machine, and of the Python that it belongs to; ros2.py is the same of ROS 2."""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

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
PYTHONS = ("/usr/bin/python3", "python3")
"""Interpreters that a ROS may be for."""
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


class Probed(NamedTuple):
    """An interpreter's answer about a ROS: its own version, and the ROS's release."""

    version: tuple[int, int]
    release: str


@dataclass(frozen=True)
class Ros:
    """A ROS on this machine.

    Attributes:
        number: 1 or 2.
        python: The interpreter that its packages are for.
        version: Of that interpreter.
        release: Version of rospy, or name of the distribution and version of rclpy.
        paths: Folders of its packages that the interpreter doesn't know by itself.
        variables: Those of its own that its programs need.
    """

    number: int
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
    for name in PYTHONS:
        python = shutil.which(name)
        found = probe(python, _PROBE, variables, paths) if python else None
        if python is not None and isinstance(found, Probed) and found.version >= _LEAST:
            return Ros(1, python, *found, paths, tuple(variables.items()))
    return None


def probe(python: str, code: str, variables: dict[str, str], paths: tuple[str, ...]) -> Probed | str:
    """Ask an interpreter for a ROS.

    Args:
        python: The interpreter.
        code: Program that imports what is needed, and prints major, minor and the ROS's release.
        variables: Those of the ROS.
        paths: Folders of its packages.

    Returns:
        What it printed; where it failed, the last line of what it said.
    """
    surroundings = {"PATH": os.environ.get("PATH", os.defpath)} | variables
    surroundings["PYTHONPATH"] = os.pathsep.join(paths)
    try:
        result = subprocess.run(
            # Not -P, which Python 3.10 doesn't know: what lies in the working folder is no ROS.
            [python, "-c", code],
            cwd="/",
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
            env=surroundings,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    if result.returncode != 0:
        return (result.stderr.strip().splitlines() or [f"exit code {result.returncode}"])[-1]
    major, minor, release = result.stdout.split(maxsplit=2)
    return Probed((int(major), int(minor)), release.strip())


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
