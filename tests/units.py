# SPDX-License-Identifier: Apache-2.0
"""Units of tests: a file, a folder whose files share much, or a test. What took longest goes first."""

from __future__ import annotations

import json
import os
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

SPLIT_SECONDS = 15.0
"""Files that take longer are shared out by the test, where their tests share nothing."""
SHORT_SECONDS = 5.0
"""Units that take less come in the seed's order, behind the others."""
UNKNOWN_SECONDS = {"slow": 20.0, "image": 20.0, "cluster": 5.0, "ros": 5.0, "container": 5.0, "browser": 1.0}
"""Guesses for tests that never ran on this machine, by their markers."""
OTHERS_SECONDS = 0.1
"""Guess for all others."""
STORY = "tests/e2e/"
"""A folder whose tests follow one installation from its first sweep to its end, in the order of the files."""
TOGETHER = (STORY, "tests/dashboard_pages/", "tests/docs/", "tests/jobs/")
"""Folders whose files share what takes seconds to start: one worker takes all of them."""
CLUSTER_WORKERS = 2
"""Workers that begin with a cluster: one has the story, the other one all else."""


class Durations:
    """Seconds that tests took when they ran last, in a file that outlives sessions.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._now: defaultdict[str, float] = defaultdict(float)
        self._before = self._read()

    def _read(self) -> dict[str, float]:
        with suppress(OSError, ValueError):
            return dict(json.loads(self._path.read_text(encoding="utf-8")))
        return {}

    def of(self, item: pytest.Item, unknown: float) -> float:
        """Return the seconds of a test; a guess where it never ran."""
        return self._before.get(item.nodeid, unknown)

    def add(self, report: pytest.TestReport) -> None:
        """Take in a phase of a test."""
        self._now[report.nodeid] += report.duration

    def keep(self, root: Path) -> None:
        """Write them beside those that others wrote meanwhile, without those of files that are gone."""
        found = self._read() | {name: round(seconds, 3) for name, seconds in self._now.items()}
        files = {file for file in {name.partition("::")[0] for name in found} if (root / file).exists()}
        kept = {name: seconds for name, seconds in found.items() if name.partition("::")[0] in files}
        new = self._path.with_name(f"{self._path.name}.{os.getpid()}")
        with suppress(OSError):
            new.write_text(json.dumps(kept), encoding="utf-8")
            new.replace(self._path)


@dataclass(eq=False)
class Unit:
    """Tests that one worker runs one after the other.

    Attributes:
        name: file, folder or test.
        on_cluster: its tests need a Kubernetes cluster.
        numbers: its tests' places among all.
        seconds: how long they are thought to take.
    """

    name: str
    on_cluster: bool = False
    numbers: list[int] = field(default_factory=list)
    seconds: float = 0.0


class Units:
    """All units of a session, and who takes which of them.

    A worker that has begun with a cluster goes on with it, and the others come to clusters last: each starts
    one, which takes processor time until the session ends, and what waits goes best beside what computes.

    Args:
        durations: what tests took.
    """

    def __init__(self, durations: Durations) -> None:
        self._durations = durations
        self._with_cluster: set[int] = set()
        self.waiting: list[Unit] = []

    def make(self, items: list[pytest.Item]) -> None:
        """Divide tests into units, the longest first."""
        files: defaultdict[str, list[Any]] = defaultdict(list)
        for number, item in enumerate(items):
            files[item.nodeid.partition("::")[0]].append((number, item, self._seconds(item)))
        found: dict[tuple[str, bool], Unit] = {}
        for file, tests in files.items():
            folder = next(filter(file.startswith, TOGETHER), None)
            takes_long = sum(seconds for *_, seconds in tests) > SPLIT_SECONDS
            is_split = takes_long and folder is None and not any(_shares(item) for _, item, _ in tests)
            for number, item, seconds in tests:
                on_cluster = item.get_closest_marker("cluster") is not None
                name = item.nodeid if is_split and not on_cluster else folder or file
                unit = found.setdefault((name, on_cluster), Unit(name, on_cluster))
                unit.numbers.append(number)
                unit.seconds += seconds
        self.waiting = sorted(found.values(), key=lambda unit: -max(unit.seconds, SHORT_SECONDS))

    def next(self, worker: int, workers: int) -> Unit:
        """Take the next unit for one of so many workers."""
        most = max(1, min(CLUSTER_WORKERS, workers - 1))
        wanted = worker in self._with_cluster or len(self._with_cluster) < most
        fitting = (unit for unit in self.waiting if unit.on_cluster == wanted)
        unit = next(fitting, self.waiting[0])
        self.waiting.remove(unit)
        if unit.on_cluster:
            self._with_cluster.add(worker)
        return unit

    def _seconds(self, item: pytest.Item) -> float:
        names = {marker.name for marker in item.iter_markers()}
        unknown = max(
            (UNKNOWN_SECONDS[name] for name in names & UNKNOWN_SECONDS.keys()), default=OTHERS_SECONDS
        )
        return self._durations.of(item, unknown)


def _shares(item: pytest.Item) -> bool:
    """Tell whether a test uses what is made once for its file."""
    used = getattr(item, "_fixtureinfo", None)
    definitions = used.name2fixturedefs.values() if used else ()
    return any(one.scope in {"module", "class", "package"} for known in definitions for one in known)
