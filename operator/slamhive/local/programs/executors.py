# SPDX-License-Identifier: Apache-2.0
"""Executors of a workstation, and which one runs an algorithm: its environment, or its container image.

A `PreparedProgram` is all that an attempt has to know of its executor. To run an algorithm by a named one::

    bench = Workbench(home, workshop, archive, container=ContainerChoice.PODMAN)

runs every Algorithm that has an image as a container, `ContainerChoice.NONE` none, and None (the default)
those alone that have no `spec.local`. `bench.programs.executor(entry)` says which it is, `unavailable(entry)`
why it can't be.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from slamhive.local.programs.containers import Containers
from slamhive.local.programs.engines import ContainerChoice
from slamhive.local.programs.environments import Environments, availability, is_whole
from slamhive.local.programs.unavailable import ImageMissing, Unavailable
from slamhive.model.algorithm import Pace

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from slamhive.local.home.catalog import AlgorithmEntry
    from slamhive.local.home.folder import Home
    from slamhive.local.programs.environments import ProgramPart
    from slamhive.local.programs.prepared import PreparedProgram
    from slamhive.model.algorithm import AlgorithmSpec

PROCESS = "process"
CONTAINER = "container"


class Executor(Protocol):
    """Executor that prepares algorithms' programs, to run as processes or in containers."""

    def digest(self, entry: AlgorithmEntry) -> str:
        """Return the digest of a program: equal ones run the same.

        Raises:
            SlamHiveError: it can't be found out.
        """

    def get(self, entry: AlgorithmEntry, pace: str) -> PreparedProgram:
        """Return an algorithm's program, ready to be started for runs of a pace.

        Raises:
            SlamHiveError: it can't run here.
        """


class Programs:
    """The programs of a home's algorithms.

    Args:
        home: where environments are kept, and whose containers these are.
        container: what the user says of containers; None: they are for algorithms that have nothing else.
        notify: told in a sentence of what takes long.
        making: gets what is being made, in words, and the share of it that is done.
        given_up: tells whether what is being made is wanted no more.
    """

    def __init__(
        self,
        home: Home,
        container: ContainerChoice | None = None,
        notify: Callable[[str], None] = lambda _: None,
        making: dict[str, float] | None = None,
        given_up: Callable[[], bool] = lambda: False,
    ) -> None:
        self._choice = container
        # Both are there whatever the choice: it is made for each algorithm, by what its manifest has.
        self.environments = Environments(home.folder("environments"), notify, making, given_up)
        self.containers = Containers(home, container, notify)

    def executor(self, entry: AlgorithmEntry) -> str:
        """Return the name of the executor that runs an algorithm, ``process`` or ``container``."""
        return CONTAINER if in_container(entry.algorithm.spec, self._choice) else PROCESS

    def digest(self, entry: AlgorithmEntry) -> str:
        """Return the digest of a program: that of an environment and adapter, or of an image."""
        return self._of(entry).digest(entry)

    def parts(self, entry: AlgorithmEntry) -> list[ProgramPart] | None:
        """Return the parts of a program that runs as a process; None for an image.

        Raises:
            Unavailable: it can't run here.
        """
        return None if self.executor(entry) == CONTAINER else self.environments.parts(entry)

    def image_id(self, entry: AlgorithmEntry) -> str | None:
        """Return the identity of the image that runs, None where none does."""
        return self.containers.image_id(entry) if self.executor(entry) == CONTAINER else None

    def get(self, entry: AlgorithmEntry, pace: str = Pace.LOCKSTEP) -> PreparedProgram:
        """Return an algorithm's program, ready to be started for runs of a pace.

        Raises:
            Unavailable: this machine can't run it.
            ImageMissing: its image can't be had.
            SystemFault: it can't be made ready right now.
        """
        return self._of(entry).get(entry, pace)

    def is_to_make(self, entry: AlgorithmEntry) -> bool:
        """Tell whether an algorithm has an environment that isn't there yet.

        Raises:
            Unavailable: this machine can't run it.
        """
        folders = [] if self.executor(entry) == CONTAINER else self.environments.folders_of(entry)
        return not all(map(is_whole, folders))

    def fetch(self, entries: Iterable[AlgorithmEntry]) -> None:
        """Pull the images that aren't there; what can't be pulled is told of by the runs that need it."""
        self.containers.fetch([entry for entry in entries if self.executor(entry) == CONTAINER])

    def unavailable(self, entry: AlgorithmEntry) -> str | None:
        """Say why an algorithm can't run on this machine, as far as that shows without installing it."""
        return unavailable(entry, self._choice)

    def _of(self, entry: AlgorithmEntry) -> Executor:
        return self.containers if self.executor(entry) == CONTAINER else self.environments


def in_container(algorithm: AlgorithmSpec, choice: ContainerChoice | None) -> bool:
    """Tell whether an algorithm runs as a container."""
    if algorithm.image is None:
        return False
    return algorithm.local is None or choice not in {None, ContainerChoice.NONE}


def unavailable(entry: AlgorithmEntry, choice: ContainerChoice | None = None) -> str | None:
    """Say why an algorithm can't run on this machine, as far as that shows without installing it."""
    if not in_container(entry.algorithm.spec, choice):
        return availability(entry)
    try:
        Containers.check(entry, choice)
    except (Unavailable, ImageMissing) as error:
        return str(error)
    return None
