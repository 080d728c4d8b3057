# SPDX-License-Identifier: Apache-2.0
"""Runs and sweeps of a workstation that are at work, for the pages: looked for now and then."""

from __future__ import annotations

import asyncio
import json
import platform
import time
from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from slamhive.contract.files import read_regular
from slamhive.local.home.underway import runs_under_way
from slamhive.model.results import Phase
from slamhive.monitor.measuring.machine import processors_text
from slamhive.runfiles.artifacts import ArtifactFolder
from slamhive.runfiles.clocks import configuration_of

if TYPE_CHECKING:
    from concurrent.futures import Executor
    from pathlib import Path

LOOK_SECONDS = 1.0
_MOST_BYTES = 2**20
_SETTINGS = ("parameters", "input", "seed")


class UnderWay:
    """The runs that are at work in a home.

    Args:
        home: the home; None for none.

    Attributes:
        sweeps: the sweeps at work by (namespace, name), as a snapshot has live ones.
        runs: what is known of each run at work, a document in the names of the table of runs.
    """

    def __init__(self, home: Path | None) -> None:
        self._runs = home / "runs" if home is not None else None
        self._next = time.monotonic()
        self.sweeps: dict[tuple[str, str], dict[str, Any]] = {}
        self._changes = 0
        self.runs: tuple[dict[str, Any], ...] = ()

    @property
    def mark(self) -> str:
        """Text that differs whenever other runs are at work; empty before there were any."""
        return f"-{self._changes}" if self._changes else ""

    async def follow(self, executor: Executor | None) -> None:
        """Look for them in a thread if the last look was a while ago."""
        if self._runs is not None and time.monotonic() >= self._next:
            await asyncio.get_running_loop().run_in_executor(executor, self._look, self._runs)

    def _look(self, runs: Path) -> None:
        self._next = time.monotonic() + LOOK_SECONDS
        found = tuple(_told(runs, sweep, run) for sweep, run in sorted(runs_under_way(runs)))
        if found != self.runs:
            counts = Counter(str(told["sweep"]) for told in found)
            self.sweeps = {
                ("", name): {"live": True, "phases": {Phase.RUNNING.value: count}}
                for name, count in counts.items()
            }
            self.runs = found
            self._changes += 1


def _told(runs: Path, sweep: str, run: str) -> dict[str, Any]:
    """Return the facts that the folder of a run tells that is at work."""
    folder = runs / sweep / run
    given = configuration_of(ArtifactFolder(runs, (sweep, run)))
    dataset = given.get("dataset")
    uid, processors = _read(folder / "attempt.json").get("uid"), _read(folder / "supervisor.json").get("cpus")
    return {
        "uid": str(uid or run),
        "run": run,
        "sweep": sweep,
        "algorithm": given.get("algorithm"),
        "dataset": dataset.get("name") if isinstance(dataset, dict) else None,
        "sensors": given.get("mode"),
        "phase": Phase.RUNNING.value,
        "status": Phase.RUNNING.value,
        "created": _changed(folder / "attempt.json"),
        "started": _changed(folder / "process.json"),
        "provenance.node": platform.node(),
        "usage.processors": processors_text(processors),
        **{name: given[name] for name in _SETTINGS if name in given},
    }


def _read(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file that a program may have written; empty where there is none."""
    with suppress(OSError, ValueError, RecursionError):
        found = json.loads(read_regular(str(path), _MOST_BYTES))
        return found if isinstance(found, dict) else {}
    return {}


def _changed(path: Path) -> float | None:
    with suppress(OSError):
        return path.stat().st_mtime
    return None
