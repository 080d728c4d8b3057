# SPDX-License-Identifier: Apache-2.0
"""The files around a run: usage.csv, the pipes from the algorithm into its log, the size of its output."""

from __future__ import annotations

import fcntl
import os
import select
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.contract.lines import telling_line
from slamhive.monitor.programs.log import TAIL_BYTES, clean_tail

if TYPE_CHECKING:
    from slamhive.monitor.measuring.sources import Sample
    from slamhive.monitor.programs.log import BoundedLog

_PIPE_BYTES = 256 << 10
_LINE_BYTES = 64 << 10
_WAITING_BYTES = 2 << 20


class UsageTable:
    """usage.csv: one row a sample, on disk about every second."""

    def __init__(self, path: str) -> None:
        """Begin a table.

        Raises:
            OSError: The file can't be written.
        """
        self.error: OSError | None = None
        """Reason that rows are missing in the file, None when it has all."""
        self.touched = False
        self._path = path
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        self._waiting = bytearray(
            b"time_seconds,cpu_cores,resident_bytes,anonymous_bytes,working_set_bytes\n"
        )
        self._lost: OSError | None = None
        self._seen: tuple[int, int, int] | None = None
        self._size = 0

    def add(self, seconds: float, cores: float, sample: Sample) -> None:
        """Add a row: time since the start, cores since the row before."""
        memory = f"{sample.resident},{sample.anonymous},{sample.working_set}"
        row = f"{seconds:.4f},{cores:.4f},{memory}\n".encode("ascii")
        if len(self._waiting) + len(row) <= _WAITING_BYTES:
            self._waiting += row
        else:  # the disk has refused for an hour
            self._lost = self._lost or self.error

    def flush(self) -> None:
        """Hand all rows to the kernel; while the disk is full they wait, and the supervision goes on."""
        self._look()
        try:
            while self._waiting:
                count = os.write(self._file, self._waiting)
                self._size += count
                del self._waiting[:count]
        except OSError as error:
            self.error = error
        else:
            self.error = self._lost
        # By the open file, not by its path: that may be another one's by now.
        self._seen = _state(os.fstat(self._file))
        if self._seen[1] != self._size:
            self.touched = True

    def close(self) -> None:
        """Hand all rows to the kernel and close."""
        self.flush()
        try:
            os.close(self._file)
        except OSError as error:
            self.error = error

    def _look(self) -> None:
        """Note whether another one wrote into the file or put another in its place since the last flush."""
        if self._seen is None:
            return
        try:
            there = _state(os.lstat(self._path))
        except OSError:
            there = None
        if there != self._seen:
            self.touched = True


def _state(found: os.stat_result) -> tuple[int, int, int]:
    """Return inode, size and time of change of a file; the last can't be set back."""
    return found.st_ino, found.st_size, found.st_ctime_ns


class OutputPipe:
    """Pipe from stdout or stderr of the algorithm into its log, so that the log's size can be bounded.

    Each stream has a pipe of its own, so that what stderr ends with is known; lines go into the log whole.

    The pipe is emptied with every sample. Only while it fills up between two samples does it wake us by
    itself: waking for every line would cost a core's percent.
    """

    def __init__(self, log: BoundedLog, poll: select.poll) -> None:
        """Make a pipe into a log; `poll` watches it when needed."""
        self._log = log
        self._poll = poll
        self.descriptor, self.writer = os.pipe()
        self._watched = False
        self._rest = self._recent = b""
        os.set_blocking(self.descriptor, False)
        with suppress(OSError):  # a user may have used up what pipes may hold
            fcntl.fcntl(self.descriptor, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)

    def drain(self) -> None:
        """Take what was printed since."""
        taken = 0
        # Bounded, so that a program that prints without end does not keep us from sampling.
        while taken < 16 * _PIPE_BYTES and (count := self._take()):
            taken += count
        watch = taken > _PIPE_BYTES // 8
        if watch and not self._watched:
            self._poll.register(self.descriptor, select.POLLIN)
        elif self._watched and not watch:
            self._poll.unregister(self.descriptor)
        self._watched = watch

    def close(self) -> None:
        """Take the rest, when nobody writes any more."""
        while self._take():
            pass
        self._log.write(self._rest)
        os.close(self.descriptor)

    def last_line(self) -> str:
        """Return the last line that says something, without control characters; empty if there is none."""
        return telling_line(clean_tail(self._recent))

    def _take(self) -> int:
        try:
            data = os.read(self.descriptor, _PIPE_BYTES)
        except BlockingIOError:
            return 0
        self._recent = (self._recent + data)[-4 * TAIL_BYTES :]
        lines, end, self._rest = (self._rest + data).rpartition(b"\n")
        # A line without an end is passed on in pieces: it must not fill our memory.
        if len(self._rest) > _LINE_BYTES:
            end, self._rest = end + self._rest, b""
        self._log.write(lines + end)
        return len(data)
