# SPDX-License-Identifier: Apache-2.0
"""Two runners in one home: no run twice, each finishing what the other left."""

from __future__ import annotations

import shutil
import threading
import time
from typing import TYPE_CHECKING

import pytest

from slamhive.archive import Archive
from slamhive.engine import PointState
from slamhive.local.home.claims import Claims
from slamhive.local.home.leases import LeaseKind
from slamhive.local.programs.cores import whole_cores
from slamhive.local.running.choosing import RunChoice
from slamhive.local.running.runner import Job, Runner
from slamhive.local.running.workbench import Workbench
from slamhive.plan import local_uid, plan_of

from .sweeps import Notes, sweep_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home
    from slamhive.model.results import RunRecord
    from slamhive.model.sweep import Sweep

DEADLINE_SECONDS = 50
ACTS = ("good", "forks", "crash", "nothing")


class Working(threading.Thread):
    """A runner with a workbench of its own, in a thread."""

    def __init__(self, home: Home, workshop: Workshop, sweep: Sweep, *, rerun: bool = False) -> None:
        super().__init__(daemon=True)
        self.job = Job(sweep, local_uid(sweep), plan_of(sweep, workshop))
        self.notes = Notes()
        self._home, self._workshop, self._wish = home, workshop, RunChoice(rerun=rerun)
        self.start()

    def run(self) -> None:
        with Archive.open(self._home.archive_url) as archive:
            bench = Workbench(self._home, self._workshop, archive)
            Runner(bench, self.notes, wish=self._wish).run([self.job])

    def end(self) -> list[RunRecord]:
        """Wait for its end, and return what it finished."""
        self.join(DEADLINE_SECONDS)
        assert not self.is_alive()
        return self.notes.records

    def wait_elsewhere(self) -> None:
        """Wait until it has nothing left to do but to wait for another runner."""
        deadline = time.monotonic() + DEADLINE_SECONDS
        while not self._only_waits():
            assert time.monotonic() < deadline
            assert self.is_alive()
            time.sleep(0.01)

    def _only_waits(self) -> bool:
        job, waits = self.job, len(self.job.elsewhere)
        return bool(waits) and (job.count(PointState.PENDING), job.count(PointState.ACTIVE)) == (0, waits)


def both(home: Home, workshop: Workshop, sweeps: Sequence[Sweep]) -> list[Working]:
    """Have two runners at work at once, to their end."""
    working = [Working(home, workshop, sweep) for sweep in sweeps]
    for one in working:
        one.end()
    return working


def test_of_equal_sweeps_no_run_is_done_twice(home: Home, workshop: Workshop, bench: Workbench) -> None:
    sweep = sweep_of(ACTS, repetitions=2)
    one, other = both(home, workshop, [sweep, sweep])
    done = [record.name for working in (one, other) for record in working.notes.records]
    assert sorted(done) == sorted(record.name for record in bench.archive.runs())
    assert len(done) == 8
    for working in (one, other):
        assert working.job.count(PointState.SUCCEEDED) == 4
        assert working.job.count(PointState.FAILED) == 4
        assert working.job.done_elsewhere + working.job.kept + len(working.notes.records) == 8


def test_equal_runs_of_other_sweeps_are_computed_once(
    home: Home, workshop: Workshop, bench: Workbench
) -> None:
    both(home, workshop, [sweep_of(("good", "forks"), name=name, repetitions=2) for name in ("a", "b")])
    records = list(bench.archive.runs())
    computed = [record for record in records if record.provenance.reused_from is None]
    assert (len(records), len(computed)) == (8, 4)
    assert len({record.provenance.content_hash for record in computed}) == 4


def test_runs_that_ask_for_the_machine_alone_have_it_from_another_runners_too(
    home: Home, workshop: Workshop, bench: Workbench
) -> None:
    alone = {"resources": {"exclusiveNodes": True}}
    both(
        home,
        workshop,
        [
            sweep_of(("good", "forks"), name="alone", repetitions=2, template=alone),
            sweep_of(("good", "forks"), name="others", repetitions=2),
        ],
    )
    records = list(bench.archive.runs())
    assert len(records) == 8
    for one in (record for record in records if record.sweep == "alone"):
        assert one.usage
        assert len(str(one.usage.processors).split(",")) == len(whole_cores()[0])
        for other in records:
            assert other is one or other.finished <= one.started or one.finished <= other.started


@pytest.mark.parametrize("kind", [LeaseKind.RUNS, LeaseKind.CONTENTS])
def test_what_a_killed_runner_was_at_is_done_by_the_other(
    home: Home, workshop: Workshop, bench: Workbench, kind: LeaseKind
) -> None:
    sweep = sweep_of(["good", "forks"])
    job = Job(sweep, local_uid(sweep), plan_of(sweep, workshop))
    point = job.points.point(0)
    program = bench.program("actor")
    content = bench.provenance(point.spec, point.spec_hash, program).content_hash
    assert content
    held = home.leases.take((kind, job.run_uid(0) if kind is LeaseKind.RUNS else content))
    assert held
    working = Working(home, workshop, sweep)
    working.wait_elsewhere()
    home.leases.give_back(held)
    assert [record.index for record in working.end()] == [1, 0]


def test_an_attempt_that_a_killed_runner_finished_is_taken_up(
    home: Home, workshop: Workshop, bench: Workbench
) -> None:
    sweep = sweep_of(["good", "forks"])
    [uid, _] = [record.uid for record in Working(home, workshop, sweep).end()]
    [record] = bench.archive.runs({"uid": uid})
    bench.archive.remove_run(uid)
    held = home.leases.take((LeaseKind.RUNS, uid))
    assert held
    working = Working(home, workshop, sweep)
    working.wait_elsewhere()
    home.leases.give_back(held)
    [again] = working.end()
    assert (again.started, again.finished) == (record.started, record.finished)


def test_what_another_runner_finished_meanwhile_is_done(
    home: Home, workshop: Workshop, bench: Workbench
) -> None:
    sweep = sweep_of(["good", "forks"])
    [first, _] = Working(home, workshop, sweep).end()
    bench.archive.remove_run(first.uid)
    shutil.rmtree(first.folder or "")
    held = home.leases.take((LeaseKind.RUNS, first.uid))
    assert held
    working = Working(home, workshop, sweep)
    working.wait_elsewhere()
    bench.archive.put_run(first)
    home.leases.give_back(held)
    assert working.end() == []
    assert (working.job.done_elsewhere, working.job.kept) == (1, 1)


def test_programs_of_a_runner_that_lives_are_left_alone(home: Home, workshop: Workshop) -> None:
    sweep = sweep_of(["second"])
    working = Working(home, workshop, sweep)
    deadline = time.monotonic() + DEADLINE_SECONDS
    while not list(home.path.glob("runs/acts/*/process.json")):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    Working(home, workshop, sweep_of(["good"], name="other")).end()
    [record] = working.end()
    assert (record.attempts, record.reason) == (1, None)


def test_versions_of_a_sweep_do_not_share_a_folder_at_once(home: Home) -> None:
    one, other = Claims(home.leases), Claims(home.leases)
    assert one.run(("v1", 0), "v1-0", "s/s-1234")
    assert not other.run(("v2", 3), "v2-3", "s/s-1234")
    assert other.is_at_work(home.path / "runs" / "s" / "s-1234")
    one.give_back(("v1", 0))
    assert other.run(("v2", 3), "v2-3", "s/s-1234")
