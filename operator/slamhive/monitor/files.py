# SPDX-License-Identifier: Apache-2.0
"""The files around a run: usage.csv, the pipes from the algorithm into its log, the size of its output."""

from __future__ import annotations

import fcntl
import os
import select
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.monitor.log import TAIL_BYTES, clean_tail

if TYPE_CHECKING:
    from slamhive.monitor.log import BoundedLog
    from slamhive.monitor.sources import Sample

_PIPE_BYTES = 256 << 10
_LINE_BYTES = 64 << 10
_MAX_ENTRIES = 200_000
_COMPRESSED = (b"\x1f\x8b", b"BZh")


class UsageTable:
    """usage.csv: one row a sample, on disk about every second."""

    def __init__(self, path: str, keep_bytes: int = 0) -> None:
        """Begin a table, or go on with one.

        Args:
            path: The file.
            keep_bytes: How much of what is there belongs to this table.

        Raises:
            OSError: The file can't be written.
        """
        self.error: OSError | None = None
        mode = "r+" if keep_bytes else "w"
        self._file = open(path, mode, encoding="ascii", buffering=1 << 16)  # noqa: PTH123, SIM115 - close()
        if keep_bytes:
            self._file.truncate(keep_bytes)
            self._file.seek(0, os.SEEK_END)
        else:
            self._file.write("time_seconds,cpu_cores,resident_bytes,anonymous_bytes,working_set_bytes\n")

    @property
    def size(self) -> int:
        """The file's size at the last flush, bytes."""
        return os.fstat(self._file.fileno()).st_size

    def add(self, seconds: float, cores: float, sample: Sample) -> None:
        """Add a row: time since the start, cores since the row before."""
        memory = f"{sample.resident},{sample.anonymous},{sample.working_set}"
        self._file.write(f"{seconds:.4f},{cores:.4f},{memory}\n")

    def flush(self) -> None:
        """Hand all rows to the kernel; a full disk must not end the supervision."""
        try:
            self._file.flush()
        except OSError as error:
            self.error = error

    def close(self) -> None:
        """Hand all rows to the kernel and close."""
        try:
            self._file.close()
        except OSError as error:
            self.error = error


class OutputPipe:
    """What the algorithm prints to one stream, taken from a pipe so that its size can be bounded.

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
        return clean_tail(self._recent).rpartition("\n")[2].strip()

    def _take(self) -> int:
        try:
            data = os.read(self.descriptor, _PIPE_BYTES)
        except BlockingIOError:
            return 0
        self._recent = (self._recent + data)[-4 * TAIL_BYTES :]
        lines, end, self._rest = (self._rest + data).rpartition(b"\n")
        if len(self._rest) > _LINE_BYTES:
            end, self._rest = end + self._rest, b""
        self._log.write(lines + end)
        return len(data)


def directory_bytes(path: str, enough: int) -> int:
    """Return the size of all files below a directory; stops counting above `enough` or at 200,000 files."""
    total = entries = 0
    waiting = [path]
    while waiting and total <= enough and entries < _MAX_ENTRIES:
        with suppress(OSError), os.scandir(waiting.pop()) as found:
            for entry in found:
                entries += 1
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(entry.path)
                else:
                    with suppress(OSError):
                        total += entry.stat(follow_symlinks=False).st_size
    return total


def compression_problem(descriptor: int, name: str) -> str | None:
    """Return what is wrong with an algorithm's text file that is compressed, None where it is not.

    A megabyte can unpack to gigabytes, so none is unpacked: not in a pod, not on a workstation.

    Args:
        descriptor: The file, open for reading.
        name: What the sentence calls it.
    """
    if os.pread(descriptor, 3, 0).startswith(_COMPRESSED):
        return f"{name} is compressed; it must be plain text"
    return None
