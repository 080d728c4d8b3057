# SPDX-License-Identifier: Apache-2.0
"""Folders that are made once, are never seen half made, and go when nobody uses them.

A folder ``NAME`` is whole when it exists: it is made as ``.NAME.making`` under an exclusive lock on
``.NAME.lock``, flushed to disk, and renamed. Who works with it holds the lock shared; who evicts
needs it exclusively. The kernel lets go of locks when a process ends, so what is still called
``.making`` under a free lock is the leftover of a dead process.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING

from slamhive.model.errors import SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

_FLUSHERS = 8
_FEW = 32
GRACE_SECONDS = 600.0
"""A folder asked for this recently is not evicted: its user may be about to take the lock."""


def make_once(
    folder: Path, make: Callable[[Path], None], is_sound: Callable[[Path], bool] | None = None
) -> bool:
    """Make a folder unless it is there, however many processes want it at the same time.

    Args:
        folder: The folder.
        make: Fills an empty folder that it is given.
        is_sound: Tells whether an existing folder may still be used; one that may not is made again.

    Returns:
        Whether this call made it.

    Raises:
        SystemFault: The disk refuses.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        # First shared, which waits for a maker but not for users.
        with _locked(folder, fcntl.LOCK_SH):
            if _is_whole(folder, is_sound):
                return False
        with _locked(folder, fcntl.LOCK_EX):
            if _is_whole(folder, is_sound):
                return False
            _remove(folder)
            _make(folder, make)
            return True
    except OSError as error:
        raise SystemFault(f"{folder}: {error.strerror or error}") from error


@contextmanager
def in_use(folder: Path) -> Iterator[None]:
    """Keep a folder from being evicted.

    Raises:
        SystemFault: It is gone already.
    """
    with _locked(folder, fcntl.LOCK_SH):
        if not folder.is_dir():
            raise SystemFault(f"{folder}: was evicted before it was used; it will be made again")
        yield


def evict(parent: Path, limit_bytes: int, now: float | None = None) -> list[str]:
    """Remove unused folders, least recently used first, until the rest is small enough.

    Also removes what dead processes left half made.

    Args:
        parent: The folder of the folders.
        limit_bytes: Size allowed for all together.
        now: The time, s since the epoch.

    Returns:
        Names of what was removed.
    """
    now = time.time() if now is None else now
    for leftover in leftovers(parent):
        remove_leftover(leftover)
    folders = [folder for folder in parent.iterdir() if folder.is_dir() and not folder.name.startswith(".")]
    sizes = {folder: _size(folder) for folder in folders}
    total = sum(sizes.values())
    removed = []
    for folder in sorted(folders, key=last_use):
        if total <= limit_bytes:
            break
        if now - last_use(folder) >= GRACE_SECONDS and remove_free(folder):
            total -= sizes[folder]
            removed.append(folder.name)
    return removed


def leftovers(parent: Path) -> list[Path]:
    """Return the folders of a folder that are being made, or were left half made by dead processes."""
    return sorted(parent.glob(".*.making"))


def remove_leftover(leftover: Path) -> bool:
    """Remove what was left half made unless somebody makes it, and tell whether it was removed."""
    return _remove_free(leftover.with_name(leftover.name[1:].removesuffix(".making")), leftover)


def remove_free(folder: Path) -> bool:
    """Remove a folder unless somebody works with it, and tell whether it was removed."""
    return _remove_free(folder, folder)


def last_use(folder: Path) -> float:
    """Return the time a folder was last asked for, s since the epoch; 0 when it never was."""
    try:
        return folder.with_name(f".{folder.name}.lock").stat().st_mtime
    except FileNotFoundError:
        return 0.0


def _is_whole(folder: Path, is_sound: Callable[[Path], bool] | None) -> bool:
    return folder.is_dir() and (is_sound is None or is_sound(folder))


def _make(folder: Path, make: Callable[[Path], None]) -> None:
    aside = folder.with_name(f".{folder.name}.making")
    _remove(aside)
    aside.mkdir()
    try:
        make(aside)
        settle(aside, read_only=True)
        aside.replace(folder)
        flush(folder.parent)
    except BaseException:
        _remove(aside)
        raise


def settle(folder: Path, *, read_only: bool) -> None:
    """Bring all of a folder to disk.

    Args:
        folder: The folder.
        read_only: Whether its files become read-only.

    Raises:
        OSError: The disk refuses.
    """
    paths = sorted(folder.rglob("*"), reverse=True)
    # Alone each waits for the disk's journal; together, thousands of images take an eighth of the time.
    with ThreadPoolExecutor(_FLUSHERS if len(paths) > _FEW else 1) as pool:
        for _ in pool.map(partial(_settle, read_only=read_only), paths):
            pass
    flush(folder)


def _settle(path: Path, *, read_only: bool) -> None:
    """Bring a file to disk; a linked one is someone else's and stays as it is."""
    if path.is_symlink():
        return
    if path.is_file():
        if path.stat().st_nlink > 1:
            return
        if read_only:
            path.chmod(0o444)
    flush(path)


def flush(path: Path) -> None:
    """Bring a file, or the names in a folder, to disk.

    Raises:
        OSError: the disk refuses.
    """
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def _locked(folder: Path, operation: int) -> Iterator[None]:
    path = folder.with_name(f".{folder.name}.lock")
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(descriptor, operation)
        # The time of last use only orders what is evicted: no reason to fail.
        with suppress(OSError):
            os.utime(descriptor)
        yield
    finally:
        os.close(descriptor)


def _remove_free(folder: Path, victim: Path) -> bool:
    path = folder.with_name(f".{folder.name}.lock")
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    else:
        _remove(victim)
        return True
    finally:
        os.close(descriptor)


def _remove(folder: Path) -> None:
    """Remove a folder so that no moment shows a half of it under its own name."""
    aside = folder
    if not folder.name.startswith("."):
        aside = folder.with_name(f".{folder.name}.making")
        with suppress(FileNotFoundError):
            shutil.rmtree(aside)
        with suppress(FileNotFoundError):
            folder.rename(aside)
    with suppress(FileNotFoundError):
        shutil.rmtree(aside)


def _size(folder: Path) -> int:
    files = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
    return sum(path.stat().st_size for path in files if path.stat().st_nlink == 1)
