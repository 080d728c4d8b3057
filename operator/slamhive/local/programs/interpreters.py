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

if TYPE_CHECKING:
    from slamhive.model.algorithm import LocalProgram

_FALLBACKS = ("python3.11", "python3.12", "python3.13", "python3.14", "python3.10")
_CLAUSE = re.compile(r"^\s*(>=|<=|==|!=|<|>)\s*([0-9]+)\.([0-9]+)\s*$")


@dataclass(frozen=True)
class Interpreter:
    """A Python interpreter on this machine.

    Attributes:
        path: Where it is.
        version: Its version.
        beside: What an algorithm takes of the machine beside its own packages: ROS.
    """

    path: str
    version: tuple[int, int]
    beside: tuple[str, ...] = ()


def interpreter(program: LocalProgram, *, ros: bool = False) -> Interpreter:
    """Return an interpreter that an algorithm has packages for.

    Args:
        program: The algorithm's program.
        ros: Whether it must be the one that this machine's ROS 1 is for.

    Raises:
        Unavailable: there is none, or not for this machine.
    """
    machine = platform.machine()
    if program.machines and machine not in program.machines:
        raise Unavailable(f"has no packages for {machine}, only for {', '.join(program.machines)}")
    if ros:
        return _of_ros(program)
    own = Interpreter(getattr(sys, "_base_executable", None) or sys.executable, sys.version_info[:2])
    if _accepts(program.python, own.version):
        return own
    for name in _FALLBACKS:
        other = _probe(name)
        if other is not None and _accepts(program.python, other.version):
            return other
    raise Unavailable(
        f"needs Python {program.python}, here is {own.version[0]}.{own.version[1]}; "
        "install another python3.x with its venv module and it will be found on the PATH"
    )


def _of_ros(program: LocalProgram) -> Interpreter:
    found = find_ros()
    if found is None:
        raise Unavailable(what_it_takes())
    if not _accepts(program.python, found.version):
        version = ".".join(map(str, found.version))
        raise Unavailable(f"needs Python {program.python}, and ROS 1 is here for Python {version}")
    return Interpreter(found.python, found.version, (f"ros1 {found.release}",))


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
