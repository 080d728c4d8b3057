# SPDX-License-Identifier: Apache-2.0
"""The folder in which a workstation keeps everything: ``$SLAMHIVE_HOME``.

::

    archive.sqlite      finished runs (or the database that $SLAMHIVE_ARCHIVE names)
    algorithms/         Algorithm folders added by the user
    datasets/           datasets added or generated
    variants/           prepared recordings, by content
    environments/       virtual environments of algorithms, by content
    runs/SWEEP/RUN/     one folder a run
    runner.lock         held by commands at work here: by many that share the home, or one that is alone
    gates/              when gates that do runs again began (`cli.gating.repeating`)
    leases/             what each of them holds (`local.leases`)

docs/home.md has all of them, and what may go.
"""

from __future__ import annotations

import fcntl
import json
import os
import platform
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from slamhive.local.home.leases import LeaseKind, Leases
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator


@dataclass(frozen=True)
class Home:
    """Folder in which a workstation keeps everything, and the URL of its archive."""

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

    @property
    def missing_archive(self) -> Path | None:
        """Return the file of its archive where that isn't there yet; None where it is, or behind a server.

        Raises:
            InputError: ``$SLAMHIVE_ARCHIVE`` is no database URL.
        """
        file: Path | None = self.path / "archive.sqlite"
        if self.archive_url != f"sqlite:///{file}":
            from slamhive.archive.connection import file_of  # noqa: PLC0415 - SQLAlchemy, a fifth of a second

            file = file_of(self.archive_url)
        return file if file is not None and not file.exists() else None

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

    @property
    def leases(self) -> Leases:
        """Return the leases of runners in this home."""
        return Leases(self.path / "leases")

    @contextmanager
    def sharing(self, what: str = "slamhive run") -> Iterator[None]:
        """Be at work here beside other runners; what each of them holds stands in its leases.

        Args:
            what: the command, for those that have to wait for it.

        Raises:
            InputError: a command is at work that has to be alone, or the home can't be written.
        """
        with self._at_work(what, alone=False):
            yield

    @contextmanager
    def exclusive(self, what: str = "slamhive") -> Iterator[None]:
        """Be at work here alone: no run begins, and nothing is removed or renamed by another command.

        Args:
            what: the command, for those that have to wait for it.

        Raises:
            InputError: another command is at work, or the home can't be written.
        """
        with self._at_work(what, alone=True):
            yield

    def at_work(self) -> list[Worker]:
        """Return the commands that are at work here, the first first.

        Raises:
            InputError: the home can't be written.
        """
        leases, found = self.leases, []
        for name in leases.held(LeaseKind.WORKERS):
            try:
                found.append(Worker.read(leases.text(LeaseKind.WORKERS, name)))
            except (ValueError, KeyError, TypeError):  # it has just begun, or ended
                continue
        return sorted(found, key=lambda worker: worker.since)

    @contextmanager
    def _at_work(self, what: str, *, alone: bool) -> Iterator[None]:
        place = self.folder(".") / "runner.lock"
        try:
            place.touch()
        except OSError as error:
            raise InputError(f"SLAMHIVE_HOME: {place}: {error.strerror}") from None
        # The kernel's lock decides who may work; the leases only tell others who that is.
        # Either ends with the process, also by kill -9.
        with lock(place, wait=False, shared=not alone) as held:
            if held is None:
                raise InputError(self._refusal())
            worker = Worker(os.getpid(), platform.node(), what, datetime.now(UTC))
            leases = self.leases
            taken = leases.take((LeaseKind.WORKERS, f"{worker.node}-{worker.pid}-{held}")) or ()
            try:
                for lease in taken:
                    # On a full disk others hear less of who is at work: what frees it must go on.
                    with suppress(OSError):
                        os.write(lease.descriptor, worker.text().encode())
                yield
            finally:
                leases.give_back(taken)

    def _refusal(self) -> str:
        workers = [worker.sentence for worker in self.at_work()] or ["another slamhive run"]
        verb = "is" if len(workers) == 1 else "are"
        return f"{', '.join(workers)} {verb} at work in {self.path}; wait for it, or set SLAMHIVE_HOME"


class Worker(NamedTuple):
    """A command that is at work in a home.

    Attributes:
        pid: its process.
        node: its machine.
        what: the command.
        since: when it began.
    """

    pid: int
    node: str
    what: str
    since: datetime

    @classmethod
    def read(cls, text: str) -> Worker:
        """Return the worker that a lease names.

        Raises:
            ValueError: it says nothing, or something else.
            KeyError: a field is missing.
            TypeError: it is no object.
        """
        found = json.loads(text)
        since = datetime.fromisoformat(found["since"])
        return cls(int(found["pid"]), str(found["node"]), str(found["what"]), since)

    def text(self) -> str:
        """Return the text of its lease."""
        return json.dumps(self._asdict() | {"since": self.since.isoformat()})

    @property
    def sentence(self) -> str:
        """Return its name, as the subject of a sentence."""
        place = "" if self.node == platform.node() else f" on {self.node}"
        return f"{self.what} (process {self.pid}{place}, since {self.since.astimezone():%H:%M})"


@contextmanager
def lock(path: Path, *, wait: bool = True, shared: bool = False) -> Iterator[int | None]:
    """Hold a lock file; the kernel lets go of it when the process ends, however it ends.

    Args:
        path: the file.
        wait: whether to wait for those that hold it.
        shared: whether others may hold it too that share it.

    Yields:
        The descriptor that holds it: a child given it holds it too. None, when not waiting, if another
        process holds it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # Never removed: who had it open would hold the lock of a file that nobody else can find.
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
            fcntl.flock(descriptor, kind | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            yield None
            return
        yield descriptor
    finally:
        os.close(descriptor)
