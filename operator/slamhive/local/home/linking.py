# SPDX-License-Identifier: Apache-2.0
"""Equal files of two versions of a run, kept once on the disk: an edit seldom changes a map of 1 GB.

A run that is done again after an edit has its earlier version beside it, in ``RUN@DIGITS``. Files of both
that have the same path, size and content become one file with two names; either can be removed alone.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

LEAST_BYTES = 1 << 20
"""Bytes from which on a file is worth being compared."""
_MOST_HOLES = 4
"""Times the bytes that a file takes on the disk that it may be long: holes take no room, and long to read."""
_MOST_FILES = 10_000
_CHUNK = 1 << 20


def link_to_earlier(folder: Path) -> int:
    """Keep large files of a finished run once where an earlier version of it has the same.

    What can't be read or linked stays as it is: it only takes more room.

    Args:
        folder: the run's.

    Returns:
        Bytes that are given back.
    """
    saved = 0
    with suppress(OSError):
        earlier = [path for path in folder.parent.glob(f"{folder.name}@*") if path.is_dir()]
        mine = _large_files(folder / "run" / "output") if earlier else {}
        for other in sorted(earlier):
            theirs = _large_files(other / "run" / "output")
            for relative in mine.keys() & theirs.keys():
                own, old = folder / "run" / "output" / relative, other / "run" / "output" / relative
                with suppress(OSError):
                    if _can_be_one(own, old) and _equal(own, old):
                        _link(old, own)
                        saved += own.stat().st_blocks * 512
    return saved


def _large_files(root: Path) -> dict[str, int]:
    """Return the large regular files below a folder with their sizes; no link is followed."""
    found: dict[str, int] = {}
    waiting = [""]
    seen = 0
    # An algorithm can leave millions of files: what is not looked at only takes more room.
    while waiting and seen < _MOST_FILES:
        prefix = waiting.pop()
        with suppress(OSError), os.scandir(root / prefix) as entries:
            for entry in entries:
                seen += 1
                name = f"{prefix}{entry.name}"
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(f"{name}/")
                elif entry.is_file(follow_symlinks=False):
                    known = entry.stat(follow_symlinks=False)
                    if LEAST_BYTES <= known.st_size <= _MOST_HOLES * 512 * known.st_blocks:
                        found[name] = known.st_size
    return found


def _can_be_one(own: Path, old: Path) -> bool:
    mine, theirs = own.lstat(), old.lstat()
    # Mode and owner belong to the file, not to its name: one file has one of each.
    alike = (mine.st_size, mine.st_dev, stat.S_IMODE(mine.st_mode), mine.st_uid) == (
        *(theirs.st_size, theirs.st_dev, stat.S_IMODE(theirs.st_mode), theirs.st_uid),
    )
    return alike and mine.st_ino != theirs.st_ino


def _equal(own: Path, old: Path) -> bool:
    with _opened(own) as first, _opened(old) as second:
        while block := first.read(_CHUNK):
            if block != second.read(_CHUNK):
                return False
        return not second.read(1)


def _opened(path: Path) -> IO[bytes]:
    # What was a file when it was listed can be a link by now, or a pipe that would be waited for: what an
    # algorithm left may still be at work.
    return os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC), "rb", 0)


def _link(old: Path, own: Path) -> None:
    """Give a file a second name in the place of an equal one; it is there whole at every moment."""
    aside = own.with_name(f".{own.name[:200]}.{os.urandom(6).hex()}")
    os.link(old, aside, follow_symlinks=False)
    try:
        aside.replace(own)
    except OSError:
        aside.unlink()
        raise
