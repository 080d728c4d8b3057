# SPDX-License-Identifier: Apache-2.0
"""Sweeps of a workstation that are at work, for the pages: looked for now and then, as pages ask often."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any

from slamhive.local.underway import runs_under_way
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Executor
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
    """

    def __init__(self, home: Path | None, clock: Callable[[], float] = time.monotonic) -> None:
        self._runs = home / "runs" if home is not None else None
        self._clock = clock
        self._next = clock()
        self.sweeps: dict[tuple[str, str], dict[str, Any]] = {}
        self._changes = 0
        self.runs = 0

    @property
    def mark(self) -> str:
        """What differs whenever other runs are at work; empty before there were any."""
        return f"-{self._changes}" if self._changes else ""

    async def follow(self, executor: Executor | None) -> None:
        """Look for them in a thread if the last look was a while ago."""
        if self._runs is not None and self._clock() >= self._next:
            await asyncio.get_running_loop().run_in_executor(executor, self._look, self._runs)

    def _look(self, runs: Path) -> None:
        self._next = self._clock() + LOOK_SECONDS
        counts = runs_under_way(runs)
        found = {
            ("", name): {"live": True, "phases": {Phase.RUNNING.value: count}}
            for name, count in counts.items()
        }
        if found != self.sweeps:
            self.sweeps, self.runs = found, counts.total()
            self._changes += 1
