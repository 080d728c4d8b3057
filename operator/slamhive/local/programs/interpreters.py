# SPDX-License-Identifier: Apache-2.0
"""Python interpreters of this machine: the one that an algorithm has packages for."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from slamhive.local.programs.unavailable import Unavailable
from slamhive.playback.ros import find_ros, what_it_takes
from slamhive.playback.ros2 import WHEELS_NODE_PYTHON, find_ros2, is_of_wheels, ros2_fault, wheels_fault

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

    from slamhive.local.home.catalog import AlgorithmEntry
    from slamhive.model.algorithm import LocalProgram
    from slamhive.playback.ros import Ros

_FALLBACKS = ("python3.11", "python3.12", "python3.13", "python3.14", "python3.10")
_RCLPY_MISSING = (
    "needs ROS 2: source the setup of an installed one before slamhive is started, or name "
    "ros-rclpy[fastrtps] in its requirements"
)
_TAKES_RCLPY = re.compile(rb"^[ \t]*(?:import|from)[ \t]+rclpy\b", re.MULTILINE)
_CLAUSE = re.compile(r"^\s*(>=|<=|==|!=|<|>)\s*([0-9]+)\.([0-9]+)\s*$")


@dataclass(frozen=True)
class Interpreter:
    """A Python interpreter on this machine.

    Attributes:
        path: Where it is.
        version: Its version.
        ros: What an algorithm takes of the machine beside its own packages.
    """

    path: str
    version: tuple[int, int]
    ros: Ros | None = None

    @property
    def beside(self) -> str | None:
        """Return the name of what is taken of the machine, such as ros1 1.16.0; None where nothing is."""
        return f"ros{self.ros.number} {self.ros.release}" if self.ros is not None else None


def interpreter(entry: AlgorithmEntry) -> Interpreter:
    """Return an interpreter that an algorithm has packages for: that of this machine's ROS for its nodes.

    A ROS 2 node whose requirements bring rclpy has nothing of the machine's; others get the ROS 2 that was
    sourced. Where none was, nodes that import no rclpy get a Python as all programs do.

    Raises:
        Unavailable: there is none, or not for this machine.
    """
    program, spec = entry.algorithm.spec.local, entry.algorithm.spec
    if program is None:
        raise Unavailable("has a container image only; a workstation runs algorithms with spec.local")
    if spec.ros1 is not None:
        ros = find_ros()
        if ros is None:
            raise Unavailable(what_it_takes())
        return _of_ros(program, ros)
    if spec.ros2 is not None and _brings_rclpy(entry, program):
        fault = wheels_fault()
        if fault is not None:
            raise Unavailable(f"brings rclpy in its requirements: {fault}")
        return python_for(f"{program.python},{WHEELS_NODE_PYTHON}", program.machines)
    if spec.ros2 is not None:
        ros = find_ros2()
        if ros is not None:
            return _of_ros(program, ros)
        if _takes_rclpy(entry, program):
            raise Unavailable(ros2_fault() or _RCLPY_MISSING)
    return python_for(program.python, program.machines)


def python_for(versions: str, machines: Collection[str]) -> Interpreter:
    """Return an interpreter of some versions, ours where it is one.

    Args:
        versions: Such as >=3.11,<3.14.
        machines: Such as x86_64; empty: any.

    Raises:
        Unavailable: There is none, or not for this machine.
    """
    _check_machine(machines)
    own = Interpreter(getattr(sys, "_base_executable", None) or sys.executable, sys.version_info[:2])
    if _accepts(versions, own.version):
        return own
    for name in _FALLBACKS:
        other = _probe(name)
        if other is not None and _accepts(versions, other.version):
            return other
    raise Unavailable(
        f"needs Python {versions}, here is {own.version[0]}.{own.version[1]}; "
        "install another python3.x with its venv module and it will be found on the PATH"
    )


def _check_machine(machines: Collection[str]) -> None:
    machine = platform.machine()
    if machines and machine not in machines:
        raise Unavailable(f"has no packages for {machine}, only for {', '.join(machines)}")


def _of_ros(program: LocalProgram, ros: Ros) -> Interpreter:
    _check_machine(program.machines)
    # A program of its own needs no Python.
    if program.command is None and not _accepts(program.python, ros.version):
        version = ".".join(map(str, ros.version))
        raise Unavailable(f"needs Python {program.python}, and ROS {ros.number} is here for Python {version}")
    return Interpreter(ros.python, ros.version, ros)


def _brings_rclpy(entry: AlgorithmEntry, program: LocalProgram) -> bool:
    return program.command is None and is_of_wheels(_bytes_of(entry.folder / program.requirements))


def _takes_rclpy(entry: AlgorithmEntry, program: LocalProgram) -> bool:
    """Tell whether a node is a program in Python that imports rclpy, or has a file beside it that does."""
    if program.command is not None:
        return False
    files = [entry.folder / program.adapter, *sorted(entry.folder.glob("*.py"))]
    return any(_TAKES_RCLPY.search(_bytes_of(path)) for path in files)


def _bytes_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # whoever needs it says so
        return b""


@cache
def _probe(name: str) -> Interpreter | None:
    path = shutil.which(name)
    if path is None:
        return None
    code = "import sys, venv, ensurepip; print(*sys.version_info[:2])"
    # Debian's Python comes without venv and ensurepip: an interpreter that lacks them can't make
    # environments.
    result = subprocess.run([path, "-I", "-c", code], capture_output=True, text=True, check=False, timeout=30)
    if result.returncode != 0:
        return None
    major, minor = result.stdout.split()
    return Interpreter(path, (int(major), int(minor)))


def _accepts(clauses: str, version: tuple[int, int]) -> bool:
    for clause in filter(None, clauses.split(",")):
        match = _CLAUSE.match(clause)
        if match is None:
            raise Unavailable(f"local.python: {clause!r} is not a clause such as >=3.11")
        bound = (int(match.group(2)), int(match.group(3)))
        holds = {
            ">=": version >= bound,
            "<=": version <= bound,
            "==": version == bound,
            "!=": version != bound,
            "<": version < bound,
            ">": version > bound,
        }[match.group(1)]
        if not holds:
            return False
    return True
