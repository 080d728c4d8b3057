# SPDX-License-Identifier: Apache-2.0
"""Files of runs, read where they lie and nowhere else.

Every part of a path is opened by itself without following links, from the run's folder on, so that no name
leads out of it: neither ``..`` nor a symbolic link that an algorithm left among its output.
"""

from __future__ import annotations

import os
import stat
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from slamhive.runfiles.errors import FileMissingError, FileTooLargeError, RunPathError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator
    from pathlib import Path

MAX_FILES = 1000
MAX_DEPTH = 6
_FLAGS = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK


@dataclass(frozen=True)
class ArtifactFolder:
    """A run's folder.

    Attributes:
        root: a folder that is trusted, links in its own path and all.
        parts: the way from there to the run's folder.
        allowed: names that may be read in it; None for all.
    """

    root: Path
    parts: tuple[str, ...] = ()
    allowed: Collection[str] | None = None

    def files(self) -> list[dict[str, Any]]:
        """Return the regular files below it, sorted, at most 1,000."""
        found: list[dict[str, Any]] = []
        with suppress(FileMissingError), self._folder() as folder:
            self._list(folder, "", found, MAX_DEPTH)
        return sorted(found, key=lambda item: str(item["path"]))

    @contextmanager
    def open(self, path: str) -> Iterator[int]:
        """Open a regular file.

        Yields:
            Its descriptor.

        Raises:
            RunPathError: the path leads elsewhere.
            FileMissingError: there is no such file.
        """
        parts = split(path)
        if self.allowed is not None and path not in self.allowed:
            raise FileMissingError(f"the run has no file {path[:200]!r}", "path")
        with self._folder() as folder:
            descriptor = folder
            opened: list[int] = []
            try:
                for number, part in enumerate(parts):
                    last = number == len(parts) - 1
                    descriptor = _open(part, descriptor, folder=not last, shown=path)
                    opened.append(descriptor)
                if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                    raise FileMissingError(f"{path[:200]!r} is no regular file", "path")
                yield descriptor
            finally:
                for item in opened:
                    os.close(item)

    def bring(self, names: Iterable[str]) -> None:
        """Have files at hand that are read next: those of a folder are."""

    def read(self, path: str, most: int) -> bytes:
        """Return a file's content.

        Args:
            path: of the file.
            most: bytes that it may have.

        Raises:
            FileMissingError: there is no such file.
            FileTooLargeError: it has more.
        """
        with self.open(path) as descriptor, os.fdopen(os.dup(descriptor), "rb") as stream:
            content = stream.read(most + 1)
        if len(content) > most:
            raise FileTooLargeError(f"{path}: more than {most:,} bytes: download it", "path")
        return content

    @contextmanager
    def _folder(self) -> Iterator[int]:
        try:
            descriptor = os.open(self.root, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except OSError as error:
            raise FileMissingError(f"the run's files are not there: {error.strerror}") from None
        try:
            for part in self.parts:
                inner = _open(part, descriptor, folder=True, shown="/".join(self.parts))
                os.close(descriptor)
                descriptor = inner
            yield descriptor
        finally:
            os.close(descriptor)

    def _list(self, folder: int, prefix: str, found: list[dict[str, Any]], depth: int) -> None:
        try:
            entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
        except OSError:
            return
        for entry in entries:
            path = f"{prefix}{entry.name}"
            with suppress(OSError):
                status = entry.stat(follow_symlinks=False)
                if stat.S_ISREG(status.st_mode) and (self.allowed is None or path in self.allowed):
                    if len(found) >= MAX_FILES:
                        return
                    modified = datetime.fromtimestamp(status.st_mtime, UTC).isoformat()
                    found.append({"path": path, "size": status.st_size, "modified": modified})
                elif stat.S_ISDIR(status.st_mode) and depth and self.allowed is None:
                    inner = _open(entry.name, folder, folder=True, shown=path)
                    try:
                        self._list(inner, f"{path}/", found, depth - 1)
                    finally:
                        os.close(inner)


def split(path: str) -> tuple[str, ...]:
    """Return the parts of a relative path.

    Raises:
        RunPathError: it has a part that leads elsewhere.
    """
    parts = tuple(path.split("/"))
    if any(part in {"", ".", ".."} or "\0" in part or len(part) > 255 for part in parts):
        raise RunPathError(
            "path: expected a path below the run's folder, such as output/trajectory.txt", "path"
        )
    return parts


def _open(name: str, inside: int, *, folder: bool, shown: str) -> int:
    flags = _FLAGS | (os.O_DIRECTORY if folder else 0)
    try:
        return os.open(name, flags, dir_fd=inside)
    except OSError:
        raise FileMissingError(
            f"there is no file {shown[:200]!r} of the run here (links are not followed)", "path"
        ) from None
