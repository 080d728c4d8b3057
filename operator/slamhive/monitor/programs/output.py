# SPDX-License-Identifier: Apache-2.0
"""The size of an algorithm's output: bytes, files, what is deleted but held open, and the volume's own room.

All runs of a namespace share a volume, so that one that fills it would cost the others their results.
"""

from __future__ import annotations

import os
import stat
import time
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

from slamhive.monitor.outcome import StopDecision
from slamhive.monitor.summary import Reason

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from contextlib import AbstractContextManager

# Measuring may take this share of a processor, but it is done at least this often, s.
_SHARE = 0.005
_SECONDS = 60.0
# Below so much room on the volume, runs that wrote more than what is left are ended.
_ROOM_BYTES = 1 << 30
_ROOM_SHARE = 50
_MIB = 1 << 20


class OutputExtent(NamedTuple):
    """Size of what is below a folder: bytes, and number of files and folders.

    Attributes:
        size: Bytes of all files.
        entries: Files and folders.
        closed: A folder that could not be looked into, None if there is none.
    """

    size: int
    entries: int
    closed: str | None = None


class Held(NamedTuple):
    """Files that have no name any more but are open.

    Attributes:
        size: Bytes on the volume.
        hidden: A process doesn't let us see what it holds.
    """

    size: int
    hidden: bool


class OutputMeter:
    """Tells when a run has written too much."""

    def __init__(self, directory: str | None, limit_bytes: int | None, limit_files: int | None) -> None:
        """Watch a folder.

        Args:
            directory: Where the algorithm writes, None for nothing to watch.
            limit_bytes: Size to which it may grow.
            limit_files: How many files and folders it may hold.
        """
        self._directory = directory
        self._bytes = limit_bytes
        self._files = limit_files
        self._due = 0.0
        self._used_before = _used(directory) if directory is not None else 0

    def problem(self, now: float, processes: Iterable[int]) -> StopDecision | None:
        """Measure if it is time to, and return why the run must end.

        Args:
            now: Monotonic clock, s.
            processes: Those of the run.
        """
        if self._directory is None or self._bytes is None or now < self._due:
            return None
        found = self._measure(self._directory, self._bytes, processes)
        taken = time.monotonic() - now
        self._due = now + min(max(1.0, taken / _SHARE), _SECONDS)
        return None if found is None else StopDecision(Reason.OUTPUT_TOO_LARGE, found, at_once=True)

    def _measure(self, directory: str, limit: int, processes: Iterable[int]) -> str | None:
        extent = measure(directory, limit, self._files)
        most = f"its output grew beyond the limit of {limit / _MIB:.0f} MiB"
        if extent.size > limit:
            return most
        if self._files is not None and extent.entries > self._files:
            return f"its output has more than {self._files} files and folders"
        if extent.closed is not None:
            return f"its output can't be measured: {extent.closed[:200]!r} can't be looked into"
        held = held_open(directory, processes)
        size = extent.size + held.size
        if size > limit:
            return f"{most}, files that it deleted but holds open included"
        if held.hidden and _used(directory) - self._used_before > limit:
            return f"the volume grew by more than {limit / _MIB:.0f} MiB while it hid the files it holds open"
        return _lack_of_room(directory, size, extent.entries)


def measure(directory: str, most_bytes: int, most_entries: int | None) -> OutputExtent:
    """Measure what is below a folder; stops counting beyond either limit. Links are not followed."""
    size = entries = 0
    waiting = [directory]
    while waiting and size <= most_bytes and (most_entries is None or entries <= most_entries):
        folder = waiting.pop()
        try:
            with _listing(folder) as found:
                for entry in found:
                    entries += 1
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append(entry.path)
                    else:
                        with suppress(OSError):
                            size += entry.stat(follow_symlinks=False).st_size
                    if most_entries is not None and entries > most_entries:
                        break
        except (FileNotFoundError, NotADirectoryError):
            continue  # removed, or the folder itself replaced, since it was seen
        except OSError:
            return OutputExtent(size, entries, os.path.basename(folder))  # noqa: PTH119
    return OutputExtent(size, entries)


def _listing(folder: str) -> AbstractContextManager[Iterator[os.DirEntry[str]]]:
    """Return an open listing of a folder; a locked one that belongs to our user is unlocked first.

    Otherwise it would depend on the moment of looking whether a run that ends with a locked folder is one
    that hides its output.
    """
    with suppress(PermissionError):
        return os.scandir(folder)
    # By descriptor: the name may be a link to somewhere else by now.
    place = os.open(folder, os.O_PATH | os.O_NOFOLLOW | os.O_DIRECTORY)
    try:
        os.chmod(f"/proc/self/fd/{place}", stat.S_IMODE(os.fstat(place).st_mode) | stat.S_IRWXU)  # noqa: PTH101
    finally:
        os.close(place)
    return os.scandir(folder)


def held_open(directory: str, processes: Iterable[int]) -> Held:
    """Return the bytes that processes hold open of a folder's volume and no folder has any more."""
    try:
        device = os.stat(directory).st_dev  # noqa: PTH116
    except OSError:
        return Held(0, hidden=False)
    sizes: dict[int, int] = {}
    hidden = False
    for process in processes:
        try:
            names = os.listdir(f"/proc/{process}/fd")  # noqa: PTH208
        except PermissionError:
            hidden = True
            continue
        except OSError:
            continue
        for name in names:
            with suppress(OSError):
                found = os.stat(f"/proc/{process}/fd/{name}")  # noqa: PTH116
                if found.st_nlink == 0 and found.st_dev == device and stat.S_ISREG(found.st_mode):
                    sizes[found.st_ino] = found.st_blocks * 512
    return Held(sum(sizes.values()), hidden)


def _used(directory: str) -> int:
    """Return the number of its volume's bytes that are used, 0 where that is unknown."""
    with suppress(OSError):
        volume = os.statvfs(directory)
        return (volume.f_blocks - volume.f_bfree) * volume.f_frsize
    return 0


def _lack_of_room(directory: str, size: int, entries: int) -> str | None:
    """Return the complaint that the volume is nearly full, where this run has more of it than is left."""
    with suppress(OSError):
        volume = os.statvfs(directory)
        total, free = volume.f_blocks * volume.f_frsize, volume.f_bavail * volume.f_frsize
        if free < min(_ROOM_BYTES, total // _ROOM_SHARE) and size > free:
            room = f"{free / _MIB:.0f} MiB"
            return f"the volume has {room} left, and its output takes {size / _MIB:.0f} MiB"
        if volume.f_files and volume.f_favail < volume.f_files // _ROOM_SHARE and entries > volume.f_favail:
            return f"the volume has room for {volume.f_favail} files, and its output has {entries}"
    return None
