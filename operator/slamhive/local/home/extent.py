# SPDX-License-Identifier: Apache-2.0
"""Room that files take on the disk: blocks, not lengths, and a file that has several names once."""

from __future__ import annotations

import os
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

BLOCK_BYTES = 512
"""Bytes of a block as the system counts them."""


class Extent(NamedTuple):
    """Disk space that some files take, and their number.

    Attributes:
        size: bytes of their blocks.
        files: their number; links and whatever else is no folder included.
    """

    size: int = 0
    files: int = 0

    def __add__(self, other: object) -> Extent:
        """Return both together."""
        if not isinstance(other, Extent):
            return NotImplemented
        return Extent(self.size + other.size, self.files + other.files)


class DiskTally:
    """A count of what folders take, or of what removing them gives back; links are not followed.

    Args:
        freed: count a file of several names where the last of them is met, as it takes its room until then;
            otherwise where the first one is.
    """

    def __init__(self, *, freed: bool = False) -> None:
        self._freed = freed
        self._met: dict[tuple[int, int], int] = {}

    def of(self, *paths: Path) -> Extent:
        """Return the room of files and folders beyond what was counted before; none where nothing is."""
        return self.count(status for path in paths for _, status in below(path))

    def count(self, found: Iterable[os.stat_result]) -> Extent:
        """Return the room of files by their states, as ``of``."""
        size = files = 0
        for status in found:
            files += 1
            size += self._counted(status)
        return Extent(size, files)

    def _counted(self, status: os.stat_result) -> int:
        size = status.st_blocks * BLOCK_BYTES
        if status.st_nlink == 1:
            return size
        key = status.st_dev, status.st_ino
        met = self._met[key] = self._met.get(key, 0) + 1
        return size if met == (status.st_nlink if self._freed else 1) else 0


def total(extents: Iterable[Extent]) -> Extent:
    """Return several together."""
    return sum(extents, Extent())


def below(path: Path) -> Iterator[tuple[str, os.stat_result]]:
    """Yield the path and the state of a file, or of all files below a folder, however deep."""
    waiting: list[str] = []
    with suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            waiting.append(str(path))
        else:
            yield str(path), path.lstat()
    while waiting:
        # A folder that an algorithm locked, or that goes meanwhile, counts as empty.
        with suppress(OSError), os.scandir(waiting.pop()) as found:
            for entry in found:
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(entry.path)
                else:
                    with suppress(OSError):
                        yield entry.path, entry.stat(follow_symlinks=False)
