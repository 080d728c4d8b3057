# SPDX-License-Identifier: Apache-2.0
"""Cgroup hierarchies of this process, found through /proc/self, and the reading of their files."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.monitor.measuring.machine import processors_of
from slamhive.monitor.measuring.processes import read_file
from slamhive.monitor.measuring.sources import field, read_number

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable


@dataclass(frozen=True, slots=True)
class Hierarchy:
    """A cgroup tree we are in.

    Attributes:
        version: 1 or 2.
        controllers: The controllers mounted there; empty for version 2, where each directory tells.
        mount: Where it is mounted.
        directory: Our own cgroup in it.
    """

    version: int
    controllers: frozenset[str]
    mount: str
    directory: str


def own_hierarchies() -> list[Hierarchy]:
    """Return the cgroup trees we are in, as /proc/self tells."""
    return hierarchies_of("self")


def hierarchies_of(process: int | str) -> list[Hierarchy]:
    """Return the cgroup trees that a process is in, each where we see it.

    Raises:
        OSError: The process is gone.
    """
    paths: dict[str, str] = {}
    for line in read_file(f"/proc/{process}/cgroup").decode().splitlines():
        _, controllers, path = line.split(":", 2)
        for controller in controllers.split(","):
            paths[controller] = path
    found = []
    for line in read_file("/proc/self/mountinfo").decode("utf-8", "surrogateescape").splitlines():
        left, _, right = line.partition(" - ")
        kind, _, options = right.split(" ", 2)
        if kind not in ("cgroup", "cgroup2"):
            continue
        root, mount = (_unescape(part) for part in left.split(" ")[3:5])
        controllers_here = frozenset(options.split(",")) & paths.keys() if kind == "cgroup" else frozenset()
        path_here = paths.get(next(iter(controllers_here), ""))
        if path_here is None or (kind == "cgroup" and not controllers_here):
            continue
        # In a container the mount shows a part of the tree: the path in /proc/self/cgroup is that of the
        # machine.
        relative = _relative(path_here, root)
        if relative is not None:
            directory = f"{mount}{relative}".rstrip("/")
            found.append(Hierarchy(1 if kind == "cgroup" else 2, controllers_here, mount, directory))
    return found


def cpu_quota() -> float | None:
    """Return the number of processors that cgroups allow us, as containers limit it; None for no limit."""
    return _least(lambda directory: _quota_v2(directory) or _quota_v1(directory))


def own_cpuset_directory() -> str | None:
    """Return the directory of our own cgroup that tells its processors, None where none does."""
    try:
        trees = own_hierarchies()
    except (OSError, ValueError):
        return None
    return next((tree.directory for tree in trees if cpuset(tree.directory)), None)


def cpuset(directory: str) -> set[int] | None:
    """Return the processors that a cgroup may use, None where its files don't tell."""
    for name in ("cpuset.cpus.effective", "cpuset.effective_cpus"):
        with suppress(OSError):
            return processors_of(read_file(f"{directory}/{name}").decode("ascii", "replace").strip())
    return None


def memory_limit() -> int:
    """Return the bytes of memory that there are for us: the machine's, or those that cgroups allow."""
    allowed = _least(
        lambda directory: (
            read_number(f"{directory}/memory.max") or read_number(f"{directory}/memory.limit_in_bytes")
        )
    )
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return machine if allowed is None else min(machine, int(allowed))


def _least(limit: Callable[[str], float | None]) -> float | None:
    """Return the least limit of our cgroups and those that they are in."""
    limits = []
    try:
        trees = own_hierarchies()
    except (OSError, ValueError):
        return None
    for tree in trees:
        directory = tree.directory
        while directory.startswith(tree.mount):
            limits.append(limit(directory))
            directory = directory.rpartition("/")[0]
    return min((limit for limit in limits if limit is not None), default=None)


def _quota_v2(directory: str) -> float | None:
    try:
        most, period = read_file(f"{directory}/cpu.max").split()
        return None if most == b"max" else int(most) / int(period)
    except (OSError, ValueError):
        return None


def _quota_v1(directory: str) -> float | None:
    most, period = (read_number(f"{directory}/cpu.cfs_{word}_us") for word in ("quota", "period"))
    return most / period if most and period and most > 0 else None


def _relative(path: str, root: str) -> str | None:
    """Return a cgroup's path below what is mounted, None if it lies outside."""
    root = root.rstrip("/")
    if not f"{path}/".startswith(f"{root}/") or path.startswith("/.."):
        return None
    return path[len(root) :]


def _unescape(text: str) -> str:
    for code, character in (("\\040", " "), ("\\011", "\t"), ("\\012", "\n"), ("\\134", "\\")):
        text = text.replace(code, character)
    return text


def unified_parents(trees: Iterable[Hierarchy]) -> list[str]:
    """Our own group, then those above it: a group that holds processes can't pass controllers on."""
    parents: list[str] = []
    for tree in trees:
        directory = tree.directory if tree.version == 2 else ""
        while directory.startswith(tree.mount) and directory:
            parents.append(directory)
            directory = directory.rpartition("/")[0]
    return parents


def host_throttled() -> float | None:
    """Return the seconds in which a CPU quota on our own cgroup held back all in it, None if unknown."""
    for tree in own_hierarchies():
        for key, unit in ((b"throttled_usec", 1e6), (b"throttled_time", 1e9)):
            value = read_stat(f"{tree.directory}/cpu.stat", key)
            if value is not None:
                return value / unit
    return None


def directory_processes(directory: str) -> list[int]:
    """Return the processes in a cgroup directory, none if it is gone."""
    try:
        return [int(pid) for pid in read_file(f"{directory}/cgroup.procs").split()]
    except OSError:
        return []


def read_stat(path: str, key: bytes) -> int | None:
    """Return one number of a file of `key number` lines, None if there is no such file or line."""
    try:
        data = read_file(path)
    except OSError:
        return None
    return field(data, key) if key in data else None


def write_file(path: str, text: str) -> bool:
    """Write to a file of the kernel; tell whether it took that."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        os.write(descriptor, text.encode())
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return True
