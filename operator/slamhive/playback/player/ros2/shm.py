# SPDX-License-Identifier: Apache-2.0
"""Removal of shared memory that killed processes of Fast DDS left. Standard library alone.

::

    fastdds_0123456789abcdef      a participant's messages, up to some 30 MB; its owner locks ..._el
    fastdds_port7411              where others put word of them; its owner locks ..._el, or readers ..._sl
    sem.fastdds_port7411_mutex    held while a port is opened

Processes that end by themselves remove theirs, killed ones leave them, and their locks (flock) are free then.
A segment's lock is there before it, a port's after it, but both while the semaphore is held.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import re
import stat
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

FOLDER = "/dev/shm"  # noqa: S108 - where POSIX's shared memory is
_KIND = re.compile(r"(?P<name>fast(?:dds|rtps)_(?:port\d+|[0-9a-f]{16}))(?:_[es]l)?")
_SEMAPHORE = re.compile(r"sem\.(?P<name>fast(?:dds|rtps)_port\d+)_mutex")
_LOCKS = ("_el", "_sl")
_OLD_SECONDS = 10.0
"""Age at which nobody is still about to lock what he made, or to post a semaphore that he made."""
_OPENED_SECONDS = 1.0
"""Time that opening a port takes at most: so long does Fast DDS wait for one who does."""


def remove_dead_segments(folder: str = FOLDER) -> int:
    """Remove segments, ports and semaphores of Fast DDS that are our user's and whose owners are gone.

    Args:
        folder: Where shared memory lies; semaphores are looked at in the system's own alone.

    Returns:
        Number of files that were removed. Files of others, of living processes, and those that can't be
        removed are left, without a word.
    """
    place = Path(folder)
    try:
        names = sorted(entry.name for entry in place.iterdir())
    except OSError:
        return 0
    found = {
        match["name"] for name in names if (match := _KIND.fullmatch(name) or _SEMAPHORE.fullmatch(name))
    }
    return sum(_remove_if_dead(place, name) for name in sorted(found))


def _remove_if_dead(place: Path, name: str) -> int:
    """Remove a segment or port with its locks and semaphore if its owner is gone; return how many files."""
    memory = place / name
    locks = [path for path in (place / f"{name}{end}" for end in _LOCKS) if path.exists()]
    semaphore = place / f"sem.{name}_mutex"
    files = [path for path in (memory, *locks, semaphore) if path.exists()]
    if not files or not all(map(_is_ours, files)):
        return 0
    with _nobody_opens(semaphore) as free:
        # Fast DDS makes a segment without a lock for a moment, to try whether one can be made. A port without
        # one is read by nobody: who writes to a reader that is gone makes it again.
        young = not locks and "_port" not in name and not _is_old(files)
        if not free or young or not all(map(_is_free, locks)):
            return 0
        # The memory first: its lock is what tells others that it is dead.
        return sum(map(_unlink, files))


def _is_ours(path: Path) -> bool:
    try:
        about = path.lstat()
    except OSError:
        return False
    return stat.S_ISREG(about.st_mode) and about.st_uid == os.geteuid()


def _is_old(files: list[Path]) -> bool:
    times = []
    for path in files:
        with suppress(OSError):
            times.append(path.stat().st_ctime)
    return time.time() - max(times, default=0.0) > _OLD_SECONDS


def _is_free(lock: Path) -> bool:
    """Tell whether nobody holds a lock; one that is gone is held by nobody."""
    try:
        descriptor = os.open(lock, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return True


def _unlink(path: Path) -> bool:
    try:
        path.unlink()
    except OSError:
        return False
    return True


@contextmanager
def _nobody_opens(semaphore: Path) -> Iterator[bool]:
    """Hold a port's semaphore, so that nobody opens the port meanwhile; yields whether nobody did."""
    if not semaphore.exists() or semaphore.parent != Path(FOLDER):
        yield True
        return
    libc = ctypes.CDLL(None, use_errno=True)
    libc.sem_open.restype = ctypes.c_void_p
    name = semaphore.name.removeprefix("sem.")
    opened = libc.sem_open(f"/{name}".encode(), 0)
    if opened is None:
        yield ctypes.get_errno() == errno.ENOENT
        return
    handle = ctypes.c_void_p(opened)
    held = libc.sem_trywait(handle) == 0
    old = _is_old([semaphore])
    deadline = time.monotonic() + (_OPENED_SECONDS if old else 0.0)
    while not held and time.monotonic() < deadline:
        time.sleep(0.02)
        held = libc.sem_trywait(handle) == 0
    try:
        # One that died with the semaphore in its hands never posts it.
        yield held or old
    finally:
        if held:
            libc.sem_post(handle)
        libc.sem_close(handle)
