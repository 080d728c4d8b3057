# SPDX-License-Identifier: Apache-2.0
"""The account of a process tree from /proc alone, where no cgroup can be made.

CPU is that of the living (their process clocks, in ns), of the children they waited for (cutime and cstime)
and, where the tree's root is ourselves, of all we reaped (getrusage, exact). Parents are read before their
children: a child that ends in between is missing from one sample instead of being counted twice.
What is lost: children of a program that ignores SIGCHLD, which the kernel charges to nobody.
"""

from __future__ import annotations

import os
import resource
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.monitor.measuring.processes import (
    children,
    identify,
    kernel_lists_children,
    read_file,
    stat_fields,
)
from slamhive.monitor.measuring.resident import ResidentMemory, largest_ended
from slamhive.monitor.measuring.sources import Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

_TICK = os.sysconf("SC_CLK_TCK")
_PAGE = os.sysconf("SC_PAGE_SIZE")
# Looking for new processes may take this share of a processor, so that large trees aren't disturbed by it;
# but it is done at least this often, s.
_SEARCH_SHARE = 0.004
_SEARCH_SECONDS = 1.0


class ProcSource:
    """A process and its descendants, or the descendants of ourselves."""

    name = "proc"

    def __init__(self, root: int | None = None, others: Callable[[], Iterable[int]] | None = None) -> None:
        """Watch a tree.

        Args:
            root: Its first process. None for all descendants of the calling process, which must be a
                subreaper and have no other children; only then is the CPU of all that ended exact.
            others: Finds processes that belong to it although they descend from it no more.

        Raises:
            ProcessLookupError: The first process is gone.
        """
        self._others = others
        self._self = os.getpid() if root is None else None
        self._members: dict[int, _Member] = {}
        self._search_at = 0.0
        self._cpu = 0.0
        self._left_out = 0.0
        self._resident = ResidentMemory()
        if root is not None and not self._add(root):
            raise ProcessLookupError(f"process {root} is gone")

    def read(self) -> Sample:
        """Read the present figures; the working set is the sum of resident memory, shared pages repeated."""
        now = time.monotonic()
        cpu = 0.0
        if self._self is not None:
            ended = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = ended.ru_utime + ended.ru_stime
        resident = anonymous = 0
        if now >= self._search_at:
            self._search()
            self._search_at = now + min((time.monotonic() - now) / _SEARCH_SHARE, _SEARCH_SECONDS)
        for pid, member in list(self._members.items()):
            try:
                cpu += member.cpu()
                pages, shared = member.memory()
            except OSError:
                self._drop(pid)
                continue
            resident += pages
            anonymous += pages - shared
        # A process that ends while the tree is read can be missing in the sum, which must not go down.
        self._cpu = max(self._cpu, cpu - self._left_out)
        return Sample(
            time.monotonic(),
            self._cpu,
            resident * _PAGE,
            max(anonymous, 0) * _PAGE,
            self._resident.read(list(self._members)),
        )

    def leave_out(self, cpu_seconds: float) -> None:
        """Leave out CPU seconds that were used before the tree's first process became what is watched."""
        self._left_out = cpu_seconds

    def processes(self) -> list[int]:
        """Return the ids of the tree's processes as last seen."""
        return list(self._members)

    def kernel_peak(self) -> int | None:
        """Return the resident peak of the largest single process we waited for."""
        return None if self._self is None else largest_ended()

    def pressure(self) -> float | None:
        """/proc has no pressure of a tree."""
        return None

    def close(self) -> None:
        """Let go of open files."""
        for pid in list(self._members):
            self._drop(pid)
        self._resident.close()

    def _search(self) -> None:
        """Find new members, each process's children behind it; members keep this order."""
        known, self._members = self._members, {}
        waiting = [self._self] if self._self is not None else list(known)[:1]
        if self._others is not None:
            waiting.extend(self._others())
        for pid in waiting:
            member = known.pop(pid, None)
            if member is not None:
                self._members[pid] = member
            elif pid != self._self and (pid in self._members or not self._add(pid)):
                continue
            waiting.extend(self._children(pid))
        for pid, member in known.items():
            # Gone, or moved to another parent while we looked: the next read tells.
            self._members.setdefault(pid, member)

    def _children(self, pid: int) -> list[int]:
        member = self._members.get(pid)
        try:
            return children(pid) if member is None else member.children()
        except OSError:
            return []

    def _add(self, pid: int) -> bool:
        if identify(pid) is None:
            return False
        try:
            self._members[pid] = _Member(pid)
        except OSError:
            return False
        return True

    def _drop(self, pid: int) -> None:
        self._members.pop(pid).close()


class _Member:
    """One process, by files that stay open: once it is gone they fail, whoever has its pid by then."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._threads = 1
        # The kernel's MAKE_PROCESS_CPUCLOCK(pid, CPUCLOCK_SCHED).
        self._clock = (~pid << 3) | 2
        self._files: list[int] = []
        try:
            names = ["stat", "statm", f"task/{pid}/children"]
            for name in names if kernel_lists_children() else names[:2]:
                self._files.append(os.open(f"/proc/{pid}/{name}", os.O_RDONLY | os.O_CLOEXEC))
        except OSError:
            self.close()
            raise

    def cpu(self) -> float:
        """Return the CPU seconds of the process and of the children it waited for."""
        fields = stat_fields(os.pread(self._files[0], 1024, 0))
        self._threads = int(fields[17])
        ended = (int(fields[13]) + int(fields[14])) / _TICK
        return time.clock_gettime(self._clock) + ended

    def memory(self) -> tuple[int, int]:
        """Return resident and shared (file or shared memory) pages."""
        parts = os.pread(self._files[1], 256, 0).split()
        return int(parts[1]), int(parts[2])

    def children(self) -> list[int]:
        """Return the children of all its threads."""
        if len(self._files) < 3:
            return children(self._pid)
        found = os.pread(self._files[2], 65536, 0).split()
        if self._threads > 1:
            for task in os.listdir(f"/proc/{self._pid}/task"):  # noqa: PTH208
                if task != str(self._pid):
                    with suppress(OSError):
                        found += read_file(f"/proc/{self._pid}/task/{task}/children").split()
        return [int(pid) for pid in found]

    def close(self) -> None:
        while self._files:
            os.close(self._files.pop())
