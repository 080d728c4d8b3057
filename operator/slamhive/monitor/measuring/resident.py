# SPDX-License-Identifier: Apache-2.0
"""Resident memory of some processes, and its peaks between two readings.

The kernel keeps a high-water mark of each process, so no peak of one process is lost between two readings.
Peaks of several processes count as simultaneous only where they fell between the same two readings. Whoever
forked and runs nothing new shares its parent's pages; of it only what is its own counts. Programs that map
the same library count it each.
"""

from __future__ import annotations

import os
import resource
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.monitor.measuring.processes import read_file, stat_fields

if TYPE_CHECKING:
    from collections.abc import Sequence

# Reading many processes, and what is a forked one's own, may each take this share of a processor; the former
# is done at least this often, s.
_SHARE = 0.004
_LONGEST_SECONDS = 1.0
# A run may be over before that share allows a second reading: these first ones are all done.
_FIRST_READINGS = 4
# Of more processes the files are opened for each reading: descriptors are few.
_MOST_FILES = 64
_FORKED_NO_EXEC = 0x40  # PF_FORKNOEXEC of the kernel's include/linux/sched.h


class ResidentMemory:
    """Resident memory of a process tree."""

    def __init__(self) -> None:
        """Begin without processes."""
        self._processes: dict[int, _ResidentProcess] = {}
        self._bytes = 0
        self._readings = 0
        self._due = self._own_due = 0.0

    def read(self, pids: Sequence[int]) -> int:
        """Return the most that these processes had since the reading before, bytes.

        Args:
            pids: All of the tree.
        """
        now = time.monotonic()
        if pids and now < self._due and self._readings >= _FIRST_READINGS:
            return self._bytes
        self._readings += 1
        for pid in self._processes.keys() - pids:
            self._processes.pop(pid).close()
        look = now >= self._own_due
        began = time.thread_time()
        total, searched = 0, 0.0
        for pid in pids:
            try:
                process = self._processes.get(pid) or self._add(pid)
                if look and process.forked and process.seen:
                    searched -= time.thread_time()
                    process.look()
                    searched += time.thread_time()
                total += process.read()
            except OSError:
                if pid in self._processes:
                    self._processes.pop(pid).close()
        self._bytes = total
        taken = time.thread_time() - began - searched
        self._due = now + min(taken / _SHARE, _LONGEST_SECONDS)
        if searched > 0:
            self._own_due = now + searched / _SHARE
        return total

    def close(self) -> None:
        """Let go of open files."""
        for process in self._processes.values():
            process.close()
        self._processes.clear()

    def _add(self, pid: int) -> _ResidentProcess:
        process = _ResidentProcess(pid, keep=len(self._processes) < _MOST_FILES)
        self._processes[pid] = process
        return process


class _ResidentProcess:
    """One process; a file that stays open fails once it is gone, whoever has its pid by then."""

    def __init__(self, pid: int, *, keep: bool) -> None:
        self._path = f"/proc/{pid}"
        self._file = os.open(f"{self._path}/status", os.O_RDONLY | os.O_CLOEXEC) if keep else None
        self._mark = self._shared = 0
        self.forked = True
        self.seen = False

    def read(self) -> int:
        """Return the most of its own memory since the reading before, bytes."""
        path = f"{self._path}/status"
        status = read_file(path) if self._file is None else os.pread(self._file, 8192, 0)
        resident, mark = _bytes_of(status, b"\nVmRSS:"), _bytes_of(status, b"\nVmHWM:")
        # Another mark than before: it was reached since, or belongs to a program started since.
        peak = resident if mark == self._mark else mark
        self._mark = mark
        if self.forked:
            self.forked = bool(int(stat_fields(read_file(f"{self._path}/stat"))[6]) & _FORKED_NO_EXEC)
        if not self.forked:
            return peak
        if not self.seen:
            # About to run a program, as most who are met like this; else it has had little time for its own.
            self.seen, self._shared = True, peak
        return max(peak - self._shared, 0)

    def look(self) -> None:
        """Find what is its own; where that is not ours to see, all that it was born with stays shared."""
        with suppress(PermissionError):
            rollup = read_file(f"{self._path}/smaps_rollup")
            private = _bytes_of(rollup, b"\nPrivate_Clean:") + _bytes_of(rollup, b"\nPrivate_Dirty:")
            self._shared = _bytes_of(rollup, b"\nRss:") - private

    def close(self) -> None:
        if self._file is not None:
            os.close(self._file)


def largest_ended() -> int | None:
    """Return the peak of the largest process that we, or those we waited for, waited for, bytes.

    It is exact to the last moment, which no sample is. A child begins with the peak of who forked it, so that
    a figure that isn't above our own peak says nothing: then it is None. Our own is that of our program: the
    kernel's ru_maxrss of us would still know the peak of who started us.
    """
    largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    own = _bytes_of(read_file("/proc/self/status"), b"\nVmHWM:")
    return largest if largest > own else None


def _bytes_of(text: bytes, key: bytes) -> int:
    """Return a figure of /proc in kB, as bytes; 0 where there is no such line, as of a process that ended."""
    _, found, rest = text.partition(key)
    return int(rest[: rest.index(b"\n")].split()[0]) * 1024 if found else 0
