# SPDX-License-Identifier: Apache-2.0
"""The algorithm's container as its neighbour in the pod sees it: found, accounted for, ended.

The containers of the pod share one namespace of processes. A container's first process comes from outside, so
its parent is 0; what it was given as SLAMHIVE_CONTAINER says whose it is. Its cgroup is seen through its root
directory. The directories stay open: through them the account can be read as long as the kernel keeps it,
also when the process that led there is gone.
"""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.monitor.measuring.cgroup import CgroupV1, CgroupV2
from slamhive.monitor.measuring.hierarchy import cpuset, directory_processes
from slamhive.monitor.measuring.proc import ProcSource
from slamhive.monitor.measuring.processes import (
    ProcessIdentity,
    descendants,
    end_processes,
    identify,
    read_file,
    send,
    stat_fields,
)
from slamhive.monitor.measuring.sources import read_number

if TYPE_CHECKING:
    from collections.abc import Iterable

    from slamhive.monitor.measuring.cgroup import RunCgroup
    from slamhive.monitor.measuring.sources import UsageSource

MARK = "SLAMHIVE_CONTAINER"
_PAUSE = 1
# How often to look: while a process is becoming a container, at first, and when an image takes minutes, s.
_EXPECTING_INTERVAL, _FIRST_INTERVAL, _LATER_INTERVAL = 0.002, 0.01, 0.02
_EXPECTING_SECONDS = 10.0
_FIRST_SECONDS = 60.0
# How long a process may stay unreadable before it is taken for a program that hides itself, s.
_HIDDEN_SECONDS = 5.0
# Programs of container runtimes, which become the container's first process at any moment.
_RUNTIMES = (b"runc", b"crun", b"youki")


class Finder:
    """Looks for the first process of a container, cheaply enough to do so a hundred times a second."""

    def __init__(self, container: str, companions: int = 0) -> None:
        """Look for a container.

        Args:
            container: Its name.
            companions: How many others start before it and may hide what they are, as the player does.
        """
        self._companions = companions
        self._known: dict[int, float] = {}
        self._mark = f"{MARK}={container}".encode()
        self._begin: float | None = None
        self._elsewhere: set[int] = {_PAUSE, os.getpid()}
        self._waiting: dict[int, float] = {}
        self._newest = b""
        self._load = os.open("/proc/loadavg", os.O_RDONLY | os.O_CLOEXEC)
        self.by_exclusion = False

    def interval(self, now: float) -> float:
        """Return the seconds until it is worth to look again."""
        if any(now - since < _EXPECTING_SECONDS for since in self._waiting.values()):
            return _EXPECTING_INTERVAL
        self._begin = now if self._begin is None else self._begin
        return _FIRST_INTERVAL if now - self._begin < _FIRST_SECONDS else _LATER_INTERVAL

    def look(self, now: float) -> ProcessIdentity | None:
        """Return the container's first process, None while it isn't there."""
        # The last number tells the newest process of our namespace: only when it changes is there a new one.
        newest = os.pread(self._load, 128, 0).rpartition(b" ")[2]
        if newest != self._newest:
            self._newest = newest
            self._note_new(now)
        others = self._lasting(now)
        for pid, since in list(self._waiting.items()):
            # They wait in the order of their starts, and companions start first.
            hidden = now - since > _HIDDEN_SECONDS
            found = self._judge(pid, hidden=hidden, companion=others < self._companions)
            if found is not None:
                return found
            others += hidden and pid in self._waiting
        return None

    def _lasting(self, now: float) -> int:
        """Return the number of other containers that are known; what a probe runs in one ends at once."""
        lasting = [pid for pid, since in self._known.items() if now - since > _HIDDEN_SECONDS]
        return sum(identify(pid) is not None for pid in lasting)

    def close(self) -> None:
        """Let go of open files."""
        os.close(self._load)

    def _note_new(self, now: float) -> None:
        present = {int(name) for name in os.listdir("/proc") if name.isdigit()}  # noqa: PTH208
        self._elsewhere &= present
        for pid in sorted(present - self._elsewhere - self._waiting.keys()):
            with suppress(OSError, ValueError):
                if stat_fields(read_file(f"/proc/{pid}/stat"))[1] == b"0":
                    self._waiting[pid] = now
                else:
                    self._elsewhere.add(pid)

    def _judge(self, pid: int, *, hidden: bool, companion: bool) -> ProcessIdentity | None:
        """Tell whether a process is the one; a runtime's program that has yet to become it stays waiting."""
        process = identify(pid)
        if process is None:
            del self._waiting[pid]
            return None
        try:
            environment = read_file(f"/proc/{pid}/environ").split(b"\0")
        except OSError:
            self.by_exclusion = hidden and not companion and _hides(pid)
            return process if self.by_exclusion else None
        if self._mark in environment:
            return process
        if any(item.startswith(f"{MARK}=".encode()) for item in environment):
            self._known[pid] = self._waiting.pop(pid)
            self._elsewhere.add(pid)
        return None


def _hides(pid: int) -> bool:
    """Tell whether a process of our own user won't be read, which is a program's own will."""
    try:
        name = read_file(f"/proc/{pid}/comm")
        user = read_file(f"/proc/{pid}/status").partition(b"\nUid:")[2].split()[0]
    except (OSError, IndexError):
        return False
    return int(user) == os.getuid() and not name.startswith(_RUNTIMES)


class Container:
    """A container whose first process runs."""

    def __init__(self, first: ProcessIdentity) -> None:
        """Attach to it.

        Raises:
            OSError: The process is gone.
        """
        self.first = first
        self.pidfd = os.pidfd_open(first.pid)
        # Checked after the pidfd was opened: between the two the pid may have become another process.
        if identify(first.pid) != first:
            os.close(self.pidfd)
            raise ProcessLookupError(f"process {first.pid} is gone")
        self._mounts = _mount_namespace(first.pid)
        # Through the container's own root: there its cgroup is mounted, whichever path it has on the machine.
        its_files = f"/proc/{first.pid}/root"
        self._group = attach_cgroup(f"{its_files}/sys/fs/cgroup", first.pid)
        self._known = [first]
        try:
            self.source: UsageSource = (
                self._group.source if self._group else ProcSource(first.pid, self._related)
            )
        except OSError:
            os.close(self.pidfd)
            raise

    @property
    def exact(self) -> bool:
        """The kernel keeps an account of the whole container."""
        return self._group is not None

    def processors(self) -> set[int]:
        """Return the processors it may use, none if it is gone."""
        with suppress(OSError):
            return os.sched_getaffinity(self.first.pid)
        return set()

    def cpuset(self) -> set[int] | None:
        """Return the processors that its cgroup lets it use, whatever it chose; None where nothing tells."""
        found = map(cpuset, self._group.directories if self._group else ())
        return next((one for one in found if one), None)

    def tasks(self) -> int:
        """Return the number of processes and, where the kernel counts them, threads."""
        if self._group is not None:
            for directory in self._group.directories:
                if (count := read_number(f"{directory}/pids.current")) is not None:
                    return count
        return len(self.source.processes())

    def oom_kills(self) -> int:
        """Return the number of its processes that the kernel killed for want of memory."""
        return self._group.oom_kills() if self._group else 0

    def throttled(self) -> float | None:
        """Return the seconds in which its CPU limit held it back, None where nothing counts that."""
        return self._group.throttled() if self._group else None

    def processes(self) -> list[ProcessIdentity]:
        """Return its living processes, never one of another container."""
        if self._group is not None:
            pids = [
                pid for directory in self._group.directories[:1] for pid in directory_processes(directory)
            ]
        else:
            pids = [self.first.pid, *self._related()]
        spared = _spared()
        return [found for found in map(identify, dict.fromkeys(pids)) if found and found.pid not in spared]

    def ask_to_end(self) -> None:
        """Send SIGTERM to all of it, stopped ones included."""
        for process in self.processes():
            send(process, signal.SIGTERM)
            send(process, signal.SIGCONT)

    def end(self, seconds: float) -> list[ProcessIdentity]:
        """End all of it by force; return what could not be ended in this time."""
        return end_processes(self.processes, seconds)

    def close(self) -> None:
        """Let go of open files."""
        self.source.close()
        os.close(self.pidfd)
        _let_go(self._group.directories if self._group else ())

    def _related(self) -> list[int]:
        """Find its processes in /proc: those that see its files and those that descend from known ones."""
        spared = _spared()
        pids = [known.pid for known in self._known if identify(known.pid) == known]
        # A process that left its session and its parent still sees the container's files: by that it is
        # found.
        if self._mounts is not None and self._mounts != _mount_namespace(os.getpid()):
            names = (int(name) for name in os.listdir("/proc") if name.isdigit())  # noqa: PTH208
            pids += [pid for pid in names if pid not in spared and _mount_namespace(pid) == self._mounts]
        everyone = dict.fromkeys([*pids, *descendants(pids)])
        self._known = [found for found in map(identify, everyone) if found and found.pid not in spared]
        return [known.pid for known in self._known]


def attach_cgroup(root: str, pid: int) -> RunCgroup | None:
    """Open a container's own cgroup; its directories are held open.

    Args:
        root: Where its file system is seen.
        pid: A process that must be in it, and we mustn't: a container that sees the machine's cgroups, not
            its own, tells nothing of itself there.

    Returns:
        The group, None where there is no account of CPU and memory.
    """
    for make in (_attach_v1, _attach_v2):
        group = make(root)
        if group is not None:
            inside = directory_processes(group.directories[0])
            if pid in inside and not {_PAUSE, os.getpid()} & set(inside):
                return group
            group.source.close()
            _let_go(group.directories)
    return None


def _attach_v1(root: str) -> RunCgroup | None:
    held: dict[str, str] = {}
    for controller in ("cpuacct", "memory", "cpu", "pids", "cpuset"):
        names = ("cpu,cpuacct", "cpuacct,cpu") if controller in ("cpu", "cpuacct") else ()
        for name in (controller, *names):
            if controller not in held and (directory := _hold(f"{root}/{name}")) is not None:
                held[controller] = directory
    try:
        return CgroupV1(held)
    except (OSError, KeyError):
        _let_go(held.values())
        return None


def _attach_v2(root: str) -> RunCgroup | None:
    directory = _hold(root)
    if directory is None:
        return None
    try:
        return CgroupV2(directory)
    except OSError:
        _let_go([directory])
        return None


def _hold(path: str) -> str | None:
    """Open a directory and return the path that leads to it for as long as it is open."""
    try:
        return f"/proc/self/fd/{os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)}"
    except OSError:
        return None


def _let_go(directories: Iterable[str]) -> None:
    for directory in directories:
        os.close(int(directory.rpartition("/")[2]))


def _mount_namespace(pid: int) -> int | None:
    """Return the mount namespace of a process, None if it is gone or not ours to know."""
    with suppress(OSError):
        return os.stat(f"/proc/{pid}/ns/mnt").st_ino  # noqa: PTH116
    return None


def _spared() -> set[int]:
    """Return the processes that we never end: the pod's first, ourselves, those above and below us."""
    mine, pid = {_PAUSE, os.getpid()}, os.getpid()
    with suppress(OSError, ValueError):
        while pid > _PAUSE:
            pid = int(stat_fields(read_file(f"/proc/{pid}/stat"))[1])
            mine.add(pid)
    return mine.union(descendants([os.getpid()]))
