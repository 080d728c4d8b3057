# SPDX-License-Identifier: Apache-2.0
"""The folder in which a workstation keeps everything: ``$SLAMHIVE_HOME``.

::

    archive.sqlite      finished runs (or the database that $SLAMHIVE_ARCHIVE names)
    algorithms/         Algorithm folders added by the user
    datasets/           datasets added or generated
    variants/           prepared recordings, by content
    environments/       virtual environments of algorithms, by content
    runs/SWEEP/RUN/     one folder a run

docs/home.md has all of them, and what may go.
"""

from __future__ import annotations

import fcntl
import os
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator


@dataclass(frozen=True)
class Home:
    """Where things are kept."""

    path: Path
    archive_url: str = field(repr=False)
    """May hold a password: `slamhive.archive.connection.shown` is for printing."""

    @classmethod
    def from_environment(cls) -> Home:
        """Return the home that ``$SLAMHIVE_HOME`` names, or the one in the user's data folder.

        ``$SLAMHIVE_ARCHIVE`` may name another archive as a database URL.
        """
        given = os.environ.get("SLAMHIVE_HOME")
        if given:
            path = Path(given).expanduser().absolute()
        else:
            data = os.environ.get("XDG_DATA_HOME") or Path("~/.local/share").expanduser()
            path = (Path(data) / "slamhive").absolute()
        return cls.at(path)

    @classmethod
    def at(cls, path: Path) -> Home:
        """Return the home at a path; ``$SLAMHIVE_ARCHIVE`` still names another archive.

        Raises:
            InputError: the path can't be one.
        """
        if "?" in str(path):  # what follows it in a database URL would be taken for options
            raise InputError(f"SLAMHIVE_HOME: {path}: a path with a question mark is not allowed")
        url = os.environ.get("SLAMHIVE_ARCHIVE") or f"sqlite:///{path / 'archive.sqlite'}"
        return cls(path, url)

    def folder(self, name: str) -> Path:
        """Return a folder of the home, made when it isn't there.

        Raises:
            InputError: it can't be made.
        """
        folder = self.path / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"SLAMHIVE_HOME: {folder}: {error.strerror}") from None
        return folder

    @contextmanager
    def exclusive(self) -> Iterator[None]:
        """Hold the home's one runner's place.

        Raises:
            InputError: another runner holds it, or the home can't be written.
        """
        place = self.folder(".") / "runner.lock"
        try:
            place.touch()
        except OSError as error:
            raise InputError(f"SLAMHIVE_HOME: {place}: {error.strerror}") from None
        with lock(place, wait=False) as held:
            if held is None:
                raise InputError(
                    f"another slamhive run is at work in {self.path}; wait for it, or set SLAMHIVE_HOME"
                )
            yield


@contextmanager
def lock(path: Path, *, wait: bool = True) -> Iterator[int | None]:
    """Hold a lock file; the kernel lets go of it when the process ends, however it ends.

    Yields:
        The descriptor that holds it: a child given it holds it too. None, when not waiting, if another
        process holds it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            yield None
            return
        yield descriptor
    finally:
        os.close(descriptor)
