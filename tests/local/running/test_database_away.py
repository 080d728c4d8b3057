# SPDX-License-Identifier: Apache-2.0
"""A database server that ends while runs go on: it is waited for, and no run is lost or done again."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive, patience
from slamhive.archive.connection import DatabaseAway
from slamhive.local.running.runner import Job, Runner
from slamhive.local.running.workbench import Workbench
from slamhive.model.results import Phase
from slamhive.plan import Plan, local_uid

from .sweeps import Notes, sweep_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home

COUNT = 4


class Ending(Notes):
    """A watcher that ends a server as soon as the first run has succeeded, and starts it on being told."""

    def __init__(self, server: Any) -> None:
        super().__init__()
        self.said: list[str] = []
        self._server = server
        self._lock = threading.Lock()
        self._ended = False

    def phase(self, job: Job, index: int, phase: Phase) -> None:
        super().phase(job, index, phase)
        with self._lock:
            if phase is Phase.SUCCEEDED and not self._ended:
                self._ended = True
                self._server.kill()

    def tell(self, sentence: str) -> None:
        self.said.append(sentence)
        if "it is waited for" in sentence:
            with self._lock:
                self._server.start()


@pytest.fixture(scope="module")
def server() -> Iterator[Any]:
    pytest.importorskip("psycopg")
    sys.path.append(str(Path(__file__).parents[2] / "archive"))
    from servers import postgresql

    with postgresql() as own:
        if own is None:
            pytest.skip("no PostgreSQL here: apt-get install postgresql")
        yield own


def run(home: Home, workshop: Workshop, url: str, notes: Ending, name: str) -> Job:
    sweep = sweep_of(["good"], name, repetitions=COUNT, cachePolicy="Rerun")
    with Archive.open(url) as archive:
        job = Job(sweep, local_uid(sweep), Plan(sweep, workshop))
        Runner(Workbench(home, workshop, archive, notes.tell), notes, parallelism=2).run([job])
    return job


def kept(url: str, name: str) -> list[Any]:
    with Archive.open(url, read_only=True) as archive:
        return list(archive.runs(sweep=name))


def test_a_server_that_restarts_is_waited_for(
    home: Home, workshop: Workshop, server: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(patience, "PAUSE_SECONDS", 0.0)
    notes = Ending(server)
    job = run(home, workshop, server.url, notes, "restarted")
    assert sum("it is waited for, 10 minutes at most" in one for one in notes.said) == 1
    assert notes.said[-1] == "the archive answers again"
    assert (job.verdict.is_final, len(notes.records)) == (True, COUNT)
    found = kept(server.url, "restarted")
    assert sorted(one.uid for one in found) == sorted(one.uid for one in notes.records)
    assert {(one.phase, one.attempts) for one in found} == {(Phase.SUCCEEDED, 1)}


def test_a_server_that_stays_away_ends_the_command_and_loses_nothing(
    home: Home, workshop: Workshop, server: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(patience, "MOST_SECONDS", 0.0)
    notes = Ending(server)
    with pytest.raises(DatabaseAway, match=r"it was waited for 0 minutes.* the same command goes on"):
        run(home, workshop, server.url, notes, "ended")
    server.start()
    there = list((home.path / "runs" / "ended").glob("*/summary.json"))
    assert there
    written = {path: path.stat().st_mtime_ns for path in there}
    job = run(home, workshop, server.url, notes, "ended")
    assert job.verdict.is_final
    assert {one.phase for one in kept(server.url, "ended")} == {Phase.SUCCEEDED}
    assert len(kept(server.url, "ended")) == COUNT
    assert {path: path.stat().st_mtime_ns for path in there} == written
