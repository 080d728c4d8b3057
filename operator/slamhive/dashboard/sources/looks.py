# SPDX-License-Identifier: Apache-2.0
"""Looks of runs: texts that are equal where nothing differs in the archive's rows or the files of a run.

Rows count by their content (``archive.digests``); files by their names and sizes, as those of a run that has
ended are not written again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from slamhive.archive.digests import ArchiveDigests
    from slamhive.runfiles.homefiles import HomeFiles


class Looks(Protocol):
    """Looks of a source's runs, and of what else its archives hold."""

    @property
    def rest(self) -> str:
        """Return the look of everything but runs."""

    def of(self, uid: str) -> tuple[str, str]:
        """Return the look of a run of the table, and of its files: '' where there are none."""


@dataclass(frozen=True)
class HomeLooks:
    """Looks of one home's runs.

    Attributes:
        digests: of its archive, from before the table was read: what is written meanwhile is news next time.
        files: of its runs.
    """

    digests: ArchiveDigests
    files: HomeFiles

    @property
    def rest(self) -> str:
        """Return the look of everything but runs."""
        return self.digests.rest

    def of(self, uid: str) -> tuple[str, str]:
        """Return the look of a run, and of its files."""
        return self.digests.runs.get(uid, ""), self.files.seen(self.digests.folders.get(uid))


@dataclass(frozen=True)
class HomesLooks:
    """Looks of several homes' runs.

    Attributes:
        homes: of each home, by its label.
        whose: tells a run's home by its UID in the table, and its UID there.
    """

    homes: Mapping[str, HomeLooks]
    whose: Callable[[str], tuple[str, str]]

    @property
    def rest(self) -> str:
        """Return the look of everything but runs."""
        return " ".join(f"{label}={looks.rest}" for label, looks in self.homes.items())

    def of(self, uid: str) -> tuple[str, str]:
        """Return the look of a run, and of its files."""
        label, plain = self.whose(uid)
        return self.homes[label].of(plain)
