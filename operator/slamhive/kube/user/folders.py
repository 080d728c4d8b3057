# SPDX-License-Identifier: Apache-2.0
"""A run's folder here, as it is filled from a cluster: laid out like that of a run on this machine.

It is filled under another name, which is taken up again after an interruption, and gets its own when it is
whole. Names come from pods: whatever they are, nothing outside of the folder is written.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from contextlib import contextmanager
from typing import TYPE_CHECKING

from slamhive.contract.environment import SETTINGS_FOLDER
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

LOG = "log.txt"
TRAJECTORY = "output/trajectory.txt"

_RUN = "run"
_IN_RUN = ("output", "config.yaml", SETTINGS_FOLDER)
_DEPTH = 17
_NAME_BYTES = 255
_CHUNK = 1 << 20
_FLAGS = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | getattr(os, "O_NOFOLLOW", 0)


class Incoming:
    """A file that is being written.

    Args:
        descriptor: where it goes.
        offset: how much of it is there.
    """

    def __init__(self, descriptor: int, offset: int) -> None:
        self._descriptor = descriptor
        self._digest = hashlib.sha256()
        left = offset
        while left:
            data = os.read(descriptor, min(left, _CHUNK))
            if not data:
                raise DataError("the part of it that was here is gone")
            self._digest.update(data)
            left -= len(data)
        os.ftruncate(descriptor, offset)

    def write(self, data: bytes) -> None:
        """Add the next bytes."""
        self._digest.update(data)
        left = memoryview(data)
        while left:
            left = left[os.write(self._descriptor, left) :]

    @property
    def sha256(self) -> str:
        """Return the checksum of all that is there."""
        return self._digest.hexdigest()


class RunFolder:
    """Where a run's files go.

    Args:
        place: the folder of its sweep.
        name: its name.
        uid: its identity: other runs of that name may have been here before.
    """

    def __init__(self, place: Path, name: str, uid: str) -> None:
        # With the uid: the folder of a former run of that name stays what it is.
        title = f"{name}@{uid[:8]}"
        self.path = place / title
        self._making = place / f".{title}.fetching"

    @property
    def trajectory(self) -> Path:
        """Return where its trajectory is when it has one."""
        return self.path / _RUN / TRAJECTORY

    @property
    def is_whole(self) -> bool:
        """Tell whether all of it is here."""
        return self.path.is_dir()

    def held(self) -> dict[str, int]:
        """Return how many bytes are here of each file that is not whole, by its path on the volume."""
        found = {}
        for folder, _, names in os.walk(self._making):
            for name in names:
                file = os.path.join(folder, name)  # noqa: PTH118 - many of them
                path = os.path.relpath(file, self._making)
                if not os.path.islink(file):  # noqa: PTH114
                    found[path.removeprefix(f"{_RUN}/")] = os.path.getsize(file)  # noqa: PTH202
        return found

    @contextmanager
    def incoming(self, path: str, offset: int = 0) -> Iterator[Incoming]:
        """Write a file from an offset on.

        Raises:
            DataError: its path may lead elsewhere, or is no plain one.
            OSError: the disk refuses.
        """
        file = self._file(path)
        file.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(file, _FLAGS, 0o644)
        try:
            yield Incoming(descriptor, offset)
        finally:
            os.close(descriptor)

    def drop(self, path: str) -> None:
        """Remove a file that is not what it should be."""
        self._file(path).unlink(missing_ok=True)

    def finish(self) -> None:
        """Give the folder its name: all of it is there.

        Raises:
            OSError: the disk refuses.
        """
        # Renamed last: a folder under its own name is whole.
        self._making.mkdir(parents=True, exist_ok=True)
        self._making.rename(self.path)

    def forget(self) -> None:
        """Remove what is here of a folder that is not whole."""
        shutil.rmtree(self._making, ignore_errors=True)

    def _file(self, path: str) -> Path:
        parts = path.split("/")
        if path == LOG:
            return self._making / LOG
        if len(parts) > _DEPTH or parts[0] in {_RUN, LOG} or not all(map(_is_plain, parts)):
            raise DataError("its name is not that of a plain file in the folder")
        return self._making.joinpath(*((_RUN,) if parts[0] in _IN_RUN else ()), *parts)


def _is_plain(part: str) -> bool:
    """Tell whether a part of a path names a file or folder, on any system and on a terminal."""
    return (
        part not in {"", ".", ".."}
        and part.isprintable()
        and "\\" not in part
        and len(part.encode("utf-8", "replace")) <= _NAME_BYTES
    )
