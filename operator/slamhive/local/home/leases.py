# SPDX-License-Identifier: Apache-2.0
"""Leases: what one of several runners in a home holds while it works, as locks of the kernel on small files.

::

    leases/gate             held for a moment, by whoever takes or gives back leases
    leases/workers/         one a command at work in the home, with what it is
    leases/cores/           one a core of a machine
    leases/queue/           tickets of those that wait for cores: the lowest has the next ones
    leases/runs/            one a run at work, by its identity
    leases/folders/         one a run folder in use: versions of a sweep may share one
    leases/contents/        one a content that is being computed: nobody computes an equal run meanwhile

The kernel lets go of a lock when the last process that holds its file ends, however it ends: nothing has to
be given back after a crash. Supervisors hold the cores of their runs too, so that those of a killed runner
are free once nothing works on them any more. All files are opened, tried and removed behind the gate, so that
nobody holds one that is no longer there.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import re
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.model.base import Choice
from slamhive.model.errors import InputError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

_LONGEST = 200
_OF_THE_MACHINE = {errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.ENOLCK}
_OTHERS = re.compile(r"[^A-Za-z0-9@._,-]")


class LeaseKind(Choice):
    """Kinds of things in a home that a runner can hold a lease on."""

    WORKERS = "workers"
    CORES = "cores"
    QUEUE = "queue"
    RUNS = "runs"
    FOLDERS = "folders"
    CONTENTS = "contents"


@dataclass(frozen=True)
class Lease:
    """Something that is held until it is given back, or the processes that hold it have ended.

    Attributes:
        kind: what it is.
        name: which one.
        descriptor: the open file: a child given it holds it too.
    """

    kind: LeaseKind
    name: str
    descriptor: int


class Leases:
    """The leases of a home, for this process.

    Args:
        folder: where their files are.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def take(self, *wanted: tuple[LeaseKind, str]) -> tuple[Lease, ...] | None:
        """Take leases, all of them or none; None where another one holds one.

        Raises:
            InputError: the home can't be written.
            SystemFault: the disk refuses, or its file system has no locks.
        """
        with self._gate():
            taken: list[Lease] = []
            for kind, name in wanted:
                lease = self._try(kind, name)
                if lease is None:
                    self._let_go(taken)
                    return None
                taken.append(lease)
        return tuple(taken)

    def take_some(self, kind: LeaseKind, names: Iterable[str], most: int, ticket: Lease) -> list[Lease]:
        """Take what is free of several, so many at most; nothing while another ticket is before one's own.

        Raises:
            InputError: the home can't be written.
        """
        taken: list[Lease] = []
        with self._gate():
            if not self._is_next(ticket):
                return taken
            for name in names:
                if len(taken) >= most:
                    break
                lease = self._try(kind, name)
                if lease is not None:
                    taken.append(lease)
        return taken

    def queue(self) -> Lease:
        """Take a ticket, behind all others.

        Raises:
            InputError: the home can't be written.
        """
        with self._gate():
            # Behind those of killed runners too: their tickets are passed over when it is their turn.
            last = max((int(name) for name in self._names(LeaseKind.QUEUE)), default=0)
            while True:
                last += 1
                lease = self._try(LeaseKind.QUEUE, f"{last:012}")
                if lease is not None:
                    return lease

    def give_back(self, leases: Iterable[Lease]) -> None:
        """Give back what was taken.

        Raises:
            InputError: the home can't be written.
        """
        with self._gate():
            self._let_go(leases)

    def held(self, kind: LeaseKind, names: Iterable[str] | None = None) -> set[str]:
        """Return the names that are held, by anyone; files that nobody holds are removed on the way.

        Args:
            kind: what they are.
            names: only these; None for all.

        Raises:
            InputError: the home can't be written.
        """
        found = set()
        with self._gate():
            there = self._names(kind)
            wanted = there if names is None else there & {_file_name(name) for name in names}
            for name in wanted:
                lease = self._try(kind, name)
                if lease is None:
                    found.add(name)
                else:
                    self._let_go([lease])
        return found

    def tidy(self) -> None:
        """Remove the files of what nobody holds any more, as killed processes leave them.

        Raises:
            InputError: the home can't be written.
        """
        for kind in LeaseKind:
            self.held(kind)

    def is_held(self, kind: LeaseKind, name: str) -> bool:
        """Tell whether anyone holds one."""
        return bool(self.held(kind, [name]))

    def text(self, kind: LeaseKind, name: str) -> str:
        """Return the text of a lease; empty where it is gone."""
        try:
            return (self._folder / kind / name).read_text(encoding="utf-8")
        except (OSError, ValueError):
            return ""

    def _is_next(self, ticket: Lease) -> bool:
        for name in sorted(self._names(LeaseKind.QUEUE)):
            if name >= ticket.name:
                return True
            lease = self._try(LeaseKind.QUEUE, name)
            if lease is None:
                return False
            self._let_go([lease])  # of one that was killed
        return True

    def _names(self, kind: LeaseKind) -> set[str]:
        try:
            return set(os.listdir(self._folder / kind))  # noqa: PTH208
        except FileNotFoundError:
            return set()

    def _try(self, kind: LeaseKind, name: str) -> Lease | None:
        folder = self._folder / kind
        folder.mkdir(exist_ok=True)
        path = folder / _file_name(name)
        # Closed on exec: else any program that is started meanwhile would hold the lease until it ends. A
        # supervisor that is to hold it is given the descriptor.
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            # flock, as locks of POSIX belong to a process: no child could hold one, and closing any other
            # descriptor of the file would let go of it.
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            return None
        except OSError:
            os.close(descriptor)
            raise
        return Lease(kind, path.name, descriptor)

    def _let_go(self, leases: Iterable[Lease]) -> None:
        for lease in leases:
            # The name goes while the lock is held: if we are killed in between, the file is gone already.
            with suppress(OSError):  # an empty file that stays is nobody's lease
                (self._folder / lease.kind / lease.name).unlink()
            with suppress(OSError):
                os.close(lease.descriptor)

    @contextmanager
    def _gate(self) -> Iterator[None]:
        path = self._folder / "gate"
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX)
                yield
            finally:
                os.close(descriptor)
        except OSError as error:
            place = error.filename or path
            kind = SystemFault if error.errno in _OF_THE_MACHINE else InputError
            raise kind(f"SLAMHIVE_HOME: {place}: {error.strerror or error}") from None


def _file_name(name: str) -> str:
    if len(name) > _LONGEST:
        return hashlib.sha256(name.encode()).hexdigest()
    return _OTHERS.sub("_", name)
