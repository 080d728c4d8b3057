# SPDX-License-Identifier: Apache-2.0
"""Seam between an attempt and its executor: what is run, and the program that was made ready for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from slamhive.local.home.catalog import AlgorithmEntry
    from slamhive.model.configuration import RunConfiguration


@dataclass(frozen=True)
class AttemptOrder:
    """Program, configuration, prepared recording and resources of one attempt of a run.

    Attributes:
        uid: the run's identity.
        content_hash: what makes this attempt's result what it is.
        configuration: the unified configuration.
        entry: the algorithm with its folder.
        program: its program, by the executor that runs it.
        dataset: folder of the prepared recording.
        frames: how many it has.
        spec: the run's resolved spec, for resources and timeout.
        cpus: logical processors it is pinned to.
        holding: open files that its supervisor holds as long as it lives: the leases of its cores.
    """

    uid: str
    content_hash: str
    configuration: RunConfiguration
    entry: AlgorithmEntry
    program: PreparedProgram
    dataset: Path
    frames: int
    spec: Mapping[str, Any]
    cpus: tuple[int, ...]
    holding: tuple[int, ...] = ()


@dataclass(frozen=True)
class PreparedPlayer:
    """A player that can be started beside a program.

    Attributes:
        supervision: fields of a SupervisorSpec that say what is started and how.
        ready: a file that is there once a node may be started.
        variables: returns, once it is ready, what the program gets to find it.
    """

    supervision: Mapping[str, Any]
    ready: Path
    variables: Callable[[], dict[str, str]]


class PreparedProgram(Protocol):
    """A program that can be started: what differs between executors."""

    def run_folder(self, run: Path) -> str:
        """Return the path of the run folder as the program sees it."""

    def lay_out(self, order: AttemptOrder, folder: Path) -> None:
        """Lay into an attempt's folder what this executor needs there beside the contract's files.

        Raises:
            SlamHiveError: a file is missing or can't be had.
        """

    def player(self, order: AttemptOrder, folder: Path) -> PreparedPlayer | None:
        """Lay out a player in a folder and return it; None where nothing is played to the program.

        Raises:
            SlamHiveError: it can't be started here.
        """

    def supervision(
        self, order: AttemptOrder, folder: Path, variables: Mapping[str, str]
    ) -> Mapping[str, Any]:
        """Return the fields of a SupervisorSpec that say what is started and how.

        Args:
            order: what is run.
            folder: the attempt's folder.
            variables: what a player adds to the program's variables.

        Raises:
            SlamHiveError: it can't be started here.
        """

    def abandon(self, folder: Path) -> None:
        """End what a supervisor left that did not end by itself."""
