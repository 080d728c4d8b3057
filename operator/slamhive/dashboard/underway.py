# SPDX-License-Identifier: Apache-2.0
"""Sweeps of a workstation that are at work, for the pages: looked for now and then, as pages ask often."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from slamhive.local.underway import runs_under_way
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

LOOK_SECONDS = 1.0


class UnderWay:
    """The runs that are at work in a home.

    Args:
        home: the home; None for none.
        clock: monotonic time, s.

    Attributes:
        sweeps: the sweeps at work by (namespace, name), as a snapshot has live ones.
        runs: number of runs at work.
        changes: grows whenever there are others.
    """

    def __init__(self, home: Path | None, clock: Callable[[], float] = time.monotonic) -> None:
        self._runs = home / "runs" if home is not None else None
        self._clock = clock
        self._next = clock()
        self.sweeps: dict[tuple[str, str], dict[str, Any]] = {}
        self.runs = 0
        self.changes = 0

    @property
    def is_due(self) -> bool:
        """Tell whether the last look was a while ago."""
        return self._runs is not None and self._clock() >= self._next

    def look(self) -> None:
        """Look for them, which takes milliseconds."""
        if self._runs is None:
            return
        self._next = self._clock() + LOOK_SECONDS
        counts = runs_under_way(self._runs)
        found = {
            ("", name): {"live": True, "phases": {Phase.RUNNING.value: count}}
            for name, count in counts.items()
        }
        if found != self.sweeps:
            self.sweeps, self.runs = found, counts.total()
            self.changes += 1
