# SPDX-License-Identifier: Apache-2.0
"""A cgroup of its own for a run, made where the machine allows it and never left behind.

A mounted cgroup file system says little: version 2 is often mounted without a controller beside a working
version 1, and a user may write only below a delegated directory. So a group is made, its accounts are opened,
and if that fails it is taken away again and the next place is tried.

A group's name holds pid, start time and pid namespace of its supervisor; that tells a group in use from one
whose supervisor was killed.
"""

from __future__ import annotations

import os
import time
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Protocol

from slamhive.monitor.measuring.hierarchy import (
    directory_processes,
    hierarchies_of,
    own_hierarchies,
    read_stat,
    unified_parents,
    write_file,
)
from slamhive.monitor.measuring.processes import (
    ProcessIdentity,
    end_processes,
    identify,
    is_alive,
    pid_namespace,
    read_file,
)
from slamhive.monitor.measuring.sources import CgroupV1Source, CgroupV2Source, UsageSource

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from slamhive.monitor.measuring.hierarchy import Hierarchy

PREFIX = "slamhive"
_REMOVE_SECONDS = 10.0


class RunCgroup(Protocol):
    """The cgroup of one run."""

    @property
    def directories(self) -> Sequence[str]:
        """Its directory in each tree."""

    @property
    def source(self) -> UsageSource:
        """Its account."""

    def limit(self, memory_bytes: int | None, tasks: int | None) -> bool:
        """Limit memory and number of tasks; tell whether the kernel enforces the memory limit."""

    def oom_kills(self) -> int:
        """Return the number of its processes that the kernel killed for want of memory."""

    def throttled(self) -> float | None:
        """Return the seconds in which a CPU quota held its processes back, None where nothing counts that."""

    def kill(self) -> None:
        """Send SIGKILL to all in it; those in it can't fork out of it."""

    def remove(self) -> bool:
        """Remove it; tell whether it is gone."""


class CgroupV1:
    """A run's cgroup in each of the version 1 trees it needs."""

    def __init__(self, directories: dict[str, str]) -> None:
        """Take directories that exist, by controller; cpuacct and memory are needed.

        Raises:
            OSError: There is no account in them.
        """
        self._by_controller = directories
        self.directories = tuple(dict.fromkeys(directories.values()))
        self.source: UsageSource = CgroupV1Source(directories["cpuacct"], directories["memory"])

    def limit(self, memory_bytes: int | None, tasks: int | None) -> bool:
        """Limit memory, with swap where the kernel accounts for it, and the number of tasks."""
        if tasks is not None and "pids" in self._by_controller:
            write_file(f"{self._by_controller['pids']}/pids.max", str(tasks))
        if memory_bytes is None:
            return False
        memory = self._by_controller["memory"]
        limited = write_file(f"{memory}/memory.limit_in_bytes", str(memory_bytes))
        # Without a bound on swap too, a program would go on slowly instead of ending at its limit.
        write_file(f"{memory}/memory.memsw.limit_in_bytes", str(memory_bytes))
        return limited

    def oom_kills(self) -> int:
        """Return oom_kill of memory.oom_control."""
        return read_stat(f"{self._by_controller['memory']}/memory.oom_control", b"oom_kill") or 0

    def throttled(self) -> float | None:
        """Return throttled_time of the cpu controller, which often shares its tree with cpuacct."""
        directory = self._by_controller.get("cpu", self._by_controller["cpuacct"])
        nanoseconds = read_stat(f"{directory}/cpu.stat", b"throttled_time")
        return None if nanoseconds is None else nanoseconds / 1e9

    def kill(self) -> None:
        """Freeze, kill, thaw, so that none forks meanwhile; without a freezer kill again and again."""
        freezer = self._by_controller.get("freezer")
        if freezer is not None:
            write_file(f"{freezer}/freezer.state", "FROZEN")
            _kill_all(self.source.processes)
            write_file(f"{freezer}/freezer.state", "THAWED")
        end_processes(lambda: _identities(self.source.processes), _REMOVE_SECONDS)

    def remove(self) -> bool:
        """Remove its directories."""
        self.source.close()
        return _remove(self.directories)


class CgroupV2:
    """A run's cgroup in the unified tree."""

    def __init__(self, directory: str) -> None:
        """Take a directory that exists.

        Raises:
            OSError: Its parent passes on no memory controller.
        """
        self.directories = (directory,)
        self._directory = directory
        self.source: UsageSource = CgroupV2Source(directory)

    def limit(self, memory_bytes: int | None, tasks: int | None) -> bool:
        """Limit memory without swap, all to be killed together, and the number of tasks."""
        if tasks is not None:
            write_file(f"{self._directory}/pids.max", str(tasks))
        if memory_bytes is None:
            return False
        write_file(f"{self._directory}/memory.swap.max", "0")
        write_file(f"{self._directory}/memory.oom.group", "1")
        return write_file(f"{self._directory}/memory.max", str(memory_bytes))

    def oom_kills(self) -> int:
        """Return oom_kill of memory.events."""
        return read_stat(f"{self._directory}/memory.events", b"oom_kill") or 0

    def throttled(self) -> float | None:
        """Return throttled_usec of cpu.stat, which is there with the cpu controller alone."""
        microseconds = read_stat(f"{self._directory}/cpu.stat", b"throttled_usec")
        return None if microseconds is None else microseconds / 1e6

    def kill(self) -> None:
        """Write cgroup.kill, or before Linux 5.14 freeze and kill."""
        if not write_file(f"{self._directory}/cgroup.kill", "1"):
            write_file(f"{self._directory}/cgroup.freeze", "1")
            _kill_all(self.source.processes)
            write_file(f"{self._directory}/cgroup.freeze", "0")
        end_processes(lambda: _identities(self.source.processes), _REMOVE_SECONDS)

    def remove(self) -> bool:
        """Remove its directory."""
        self.source.close()
        return _remove(self.directories)


def make_run_cgroup(
    owner: ProcessIdentity, hierarchies: Sequence[Hierarchy] | None = None
) -> RunCgroup | None:
    """Make a cgroup below the one we are in.

    Args:
        owner: The supervisor it belongs to.
        hierarchies: The trees to try; those we are in if None.

    Returns:
        The group, None where none with accounts of CPU and memory can be made.
    """
    trees = own_hierarchies() if hierarchies is None else hierarchies
    # By the name anyone can tell whether the supervisor lives, without a file that could be lost.
    name = f"{PREFIX}-{owner.pid}-{owner.start}-{pid_namespace()}"
    return _make_v1(name, trees) or _make_v2(name, trees)


def _make_v1(name: str, trees: Sequence[Hierarchy]) -> RunCgroup | None:
    parents = {controller: tree.directory for tree in trees for controller in tree.controllers}
    if not {"cpuacct", "memory"} <= parents.keys():
        return None
    made: dict[str, str] = {}
    for controller in ("cpuacct", "memory", "freezer", "pids"):
        if controller in parents:
            directory = f"{parents[controller]}/{name}"
            with suppress(OSError):
                if directory not in made.values():
                    os.mkdir(directory)  # noqa: PTH102
                made[controller] = directory
    try:
        return CgroupV1(made)
    except (OSError, KeyError):
        _remove(made.values())
        return None


def _make_v2(name: str, trees: Sequence[Hierarchy]) -> RunCgroup | None:
    for parent in unified_parents(trees):
        directory = f"{parent}/{name}"
        try:
            if b"memory" not in read_file(f"{parent}/cgroup.subtree_control").split():
                # Refused while the parent itself holds processes, and then nothing has changed.
                write_file(f"{parent}/cgroup.subtree_control", "+memory +pids")
            os.mkdir(directory)  # noqa: PTH102
        except OSError:
            continue
        try:
            return CgroupV2(directory)
        except OSError:
            _remove([directory])
    return None


def cgroup_of(process: int) -> RunCgroup | None:
    """Return the cgroup that another program made for a process, as of a container; it is not ours to remove.

    Args:
        process: A process that is in it.

    Returns:
        The group, None where the process is gone, where there is no account of CPU and memory, or where we
        are in the same group.
    """
    try:
        trees, ours = hierarchies_of(process), {tree.directory for tree in own_hierarchies()}
    except OSError:
        return None
    found = {controller: tree.directory for tree in trees for controller in tree.controllers}
    if {"cpuacct", "memory"} <= found.keys() and not ours & {found["cpuacct"], found["memory"]}:
        with suppress(OSError):
            return CgroupV1(found)
    for tree in trees:
        if tree.version == 2 and tree.directory not in ours:
            with suppress(OSError):
                return CgroupV2(tree.directory)
    return None


def sweep_stale_cgroups() -> list[str]:
    """Remove the cgroups of supervisors that live no more, ending what still runs in them.

    Groups of another pid namespace are left alone: whether their supervisor lives can't be told from here.

    Returns:
        The directories removed.
    """
    removed, stale = [], []
    for directory in sorted(path for tree in own_hierarchies() for path in _groups(tree.mount)):
        owner = _owner(directory.rpartition("/")[2])
        if owner is not None and not is_alive(owner):
            stale.append(directory)
    kill_frozen(stale)
    for directory in stale:
        end_directory(directory)
        # A directory that stays (a process in an uninterruptible sleep) is found again by the next run.
        if _remove([directory]):
            removed.append(directory)
    return removed


def kill_frozen(directories: Iterable[str]) -> None:
    """Kill what a supervisor left frozen, and thaw it: only then can it die."""
    for directory in directories:
        state = f"{directory}/freezer.state"
        if os.path.exists(state):  # noqa: PTH110
            _kill_all(partial(directory_processes, directory))
            write_file(state, "THAWED")


def end_directory(directory: str) -> None:
    """End all processes of a cgroup directory, if it is still there."""
    end_processes(lambda: _identities(lambda: directory_processes(directory)), _REMOVE_SECONDS)


def remove_directories(directories: Iterable[str]) -> bool:
    """Remove cgroup directories of ours; tell whether they are gone."""
    return _remove([path for path in directories if _owner(path.rpartition("/")[2]) is not None])


def _owner(name: str) -> ProcessIdentity | None:
    """Return the supervisor a group's name tells, None if it is not for us to judge."""
    parts = name.split("-")
    if len(parts) != 4 or parts[0] != PREFIX or not all(part.isdigit() for part in parts[1:]):
        return None
    pid, start, namespace = map(int, parts[1:])
    return ProcessIdentity(pid, start) if namespace == pid_namespace() else None


def _groups(mount: str) -> list[str]:
    """Return the groups of ours in a tree; a dead supervisor may have been elsewhere in it than we are."""
    found = []
    for directory, names, _ in os.walk(mount):
        found += [f"{directory}/{name}" for name in names if name.startswith(f"{PREFIX}-")]
    return found


def _identities(processes: Callable[[], Sequence[int]]) -> list[ProcessIdentity]:
    try:
        pids = processes()
    except OSError:  # the group is gone, and all in it
        return []
    return [found for found in map(identify, pids) if found is not None]


def _kill_all(processes: Callable[[], Sequence[int]]) -> None:
    for process in _identities(processes):
        with suppress(OSError):
            os.kill(process.pid, 9)


def _remove(directories: Iterable[str]) -> bool:
    """Remove cgroups; the kernel calls them busy for a moment after their last process ended."""
    deadline = time.monotonic() + _REMOVE_SECONDS
    left = set(directories)
    while left:
        for directory in list(left):
            try:
                os.rmdir(directory)  # noqa: PTH106
            except FileNotFoundError:
                pass
            except OSError:
                continue
            left.discard(directory)
        if time.monotonic() > deadline:
            break
        if left:
            time.sleep(0.002)
    return not left
