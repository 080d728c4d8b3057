# SPDX-License-Identifier: Apache-2.0
"""Claims of one runner on runs: which runs, run folders and contents no other runner touches meanwhile."""

from __future__ import annotations

import threading
from collections import defaultdict
from typing import TYPE_CHECKING

from slamhive.local.home.leases import LeaseKind

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.local.home.leases import Lease, Leases


class Claims:
    """Leases that one runner holds on runs, their folders and contents, by sweep and point.

    Args:
        leases: of the home.
    """

    def __init__(self, leases: Leases) -> None:
        self._leases = leases
        self._mine: dict[tuple[str, int], list[Lease]] = defaultdict(list)
        self._lock = threading.Lock()

    def run(self, key: tuple[str, int], uid: str, folder: str) -> bool:
        """Claim a run and its folder, and tell whether they are ours.

        Args:
            key: the sweep's identity and the point.
            uid: the run's identity.
            folder: the run's, as SWEEP/RUN: runs of different versions of a sweep may share one.
        """
        wanted = (LeaseKind.RUNS, uid), (LeaseKind.FOLDERS, _folder_name(folder))
        return self._claim(key, *wanted)

    def content(self, key: tuple[str, int], content: str) -> bool:
        """Claim a content hash for a run that is ours, and tell whether nobody else computes it."""
        with self._lock:
            if any(lease.kind is LeaseKind.CONTENTS and lease.name == content for lease in self._mine[key]):
                return True
        return self._claim(key, (LeaseKind.CONTENTS, content))

    def give_back(self, key: tuple[str, int]) -> None:
        """Give back what is held for a point."""
        with self._lock:
            leases = self._mine.pop(key, [])
        self._leases.give_back(leases)

    def give_back_all(self) -> None:
        """Give back what is held for any point."""
        for key in list(self._mine):
            self.give_back(key)

    def is_held(self, kind: LeaseKind, name: str) -> bool:
        """Tell whether anyone holds something."""
        return self._leases.is_held(kind, name)

    def is_at_work(self, folder: Path) -> bool:
        """Tell whether a runner is at work in a run's folder."""
        return self._leases.is_held(LeaseKind.FOLDERS, _folder_name("/".join(folder.parts[-2:])))

    def runs_at_work(self) -> set[str]:
        """Return the identities of the runs that runners are at work on."""
        return self._leases.held(LeaseKind.RUNS)

    def _claim(self, key: tuple[str, int], *wanted: tuple[LeaseKind, str]) -> bool:
        taken = self._leases.take(*wanted)
        if taken is None:
            return False
        with self._lock:
            self._mine[key] += taken
        return True


def _folder_name(folder: str) -> str:
    return folder.replace("/", ",")
