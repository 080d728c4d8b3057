# SPDX-License-Identifier: Apache-2.0
"""Regular files below a run's folder, found without following a link, and what else lies there."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from slamhive.model.base import quantity
from slamhive.monitor.spec import OUTPUT_LIMIT

if TYPE_CHECKING:
    from pathlib import Path

_MOST_LEFT = 20
_DEPTH = 16
_LIMIT_BYTES = int(quantity(OUTPUT_LIMIT))
_FLAGS = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_DIRECTORY


class Listing:
    """The regular files below a folder.

    Args:
        most: files that are taken.

    Attributes:
        files: their paths, in the order in which they were found.
        left: what was left out, and why: 20 at most.
        lost: whether a regular file, or a folder that may hold some, was among it.
    """

    def __init__(self, most: int) -> None:
        self.files: list[str] = []
        self.left: list[tuple[str, str]] = []
        self.lost = False
        self._most = most

    def look(self, root: Path, folder: str) -> None:
        """List a folder below another one that is trusted.

        Raises:
            OSError: it is not there, or not reached through plain folders alone.
        """
        descriptor = os.open(root, os.O_RDONLY | os.O_CLOEXEC | os.O_DIRECTORY)
        try:
            for part in folder.split("/"):
                below = os.open(part, _FLAGS, dir_fd=descriptor)
                os.close(descriptor)
                descriptor = below
            self._list(descriptor, "", _DEPTH)
        finally:
            os.close(descriptor)

    def leave(self, path: str, why: str, *, lost: bool = True) -> None:
        """Note that something is left out."""
        self.lost |= lost
        if len(self.left) < _MOST_LEFT:
            self.left.append((path.encode("utf-8", "backslashreplace").decode(), why))

    def _list(self, descriptor: int, prefix: str, depth: int) -> None:
        with os.scandir(descriptor) as entries:
            ordered = sorted(entries, key=lambda entry: entry.name)
        for entry in ordered:
            path = prefix + entry.name
            try:
                path.encode()
            except UnicodeEncodeError:
                self.leave(path, "its name is no UTF-8")
                continue
            if entry.is_dir(follow_symlinks=False):
                self._enter(descriptor, entry.name, path, depth - 1)
            elif not entry.is_file(follow_symlinks=False):
                what = "is a symbolic link" if entry.is_symlink() else "is no regular file"
                self.leave(path, what, lost=False)
            elif len(self.files) >= self._most:
                self.leave(path, f"there are more than {self._most} files")
            elif _is_hollow(entry):
                self.leave(path, "is larger than an output may be, and most of it are holes")
            else:
                self.files.append(path)

    def _enter(self, descriptor: int, name: str, path: str, depth: int) -> None:
        if depth <= 0:
            self.leave(path, "is nested too deeply")
            return
        try:
            below = os.open(name, _FLAGS, dir_fd=descriptor)
        except OSError as error:
            self.leave(path, error.strerror or str(error))
            return
        try:
            self._list(below, f"{path}/", depth)
        finally:
            os.close(below)


def _is_hollow(entry: os.DirEntry[str]) -> bool:
    """Tell whether sending a file would send terabytes of zeros that take no room where they are."""
    try:
        status = entry.stat(follow_symlinks=False)
    except OSError:  # gone since it was listed, as whoever opens it finds out
        return False
    return status.st_size > max(_LIMIT_BYTES, 2 * 512 * status.st_blocks)
