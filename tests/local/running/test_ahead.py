# SPDX-License-Identifier: Apache-2.0
"""Environments of a sweep's algorithms, made while the recording is generated that its runs wait for."""

from __future__ import annotations

import shutil
import threading
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.local.programs.cores import CorePool, whole_cores
from slamhive.local.programs.making import MARKER, Making
from slamhive.local.programs.unavailable import GivenUp, Unavailable
from slamhive.local.running import workbench
from slamhive.local.running.ahead import make_ahead, missing
from slamhive.local.running.runner import Job, Runner
from slamhive.model.loading import load_file
from slamhive.model.results import Phase, Reason
from slamhive.plan import Plan, local_uid

from .sweeps import Notes, sweep_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home
    from slamhive.local.running.workbench import Workbench

DEADLINE_SECONDS = 50
NAMES = ["first", "second", "third"]

pytestmark = pytest.mark.skipif(len(whole_cores()) < 2, reason="needs two cores")


@pytest.fixture
def environments(tmp_path: Path) -> Path:
    """A folder of this test alone, in which none is made yet."""
    folder = tmp_path / "environments"
    folder.mkdir()
    return folder


@pytest.fixture(autouse=True)
def _three(home: Home, workshop: Workshop) -> None:
    """Three algorithms with an environment each."""
    for name in NAMES:
        folder = home.path / "algorithms" / name
        shutil.copytree(home.path / "algorithms/actor", folder)
        text = (folder / "algorithm.yaml").read_text()
        (folder / "algorithm.yaml").write_text(text.replace("name: actor", f"name: {name}"))
        (folder / "requirements.txt").write_text(f"# {name}\n")
        workshop.add(load_file(folder / "algorithm.yaml"), folder)


def job_of(bench: Workbench) -> Job:
    """Return a job that runs each of them once."""
    sweep = sweep_of((), matrix=[{"path": "algorithm", "values": NAMES}])
    return Job(sweep, local_uid(sweep), Plan(sweep, bench.workshop))


def do_instead(monkeypatch: pytest.MonkeyPatch, act: Callable[[Making, str], None]) -> list[str]:
    """Have something done before an environment is made; returns the names of those that were made."""
    made, make = [], Making.make

    def instead(making: Making, path: Path) -> None:
        act(making, making._name)
        make(making, path)
        made.append(making._name)

    monkeypatch.setattr(Making, "make", instead)
    return made


def test_all_are_there_when_the_recording_is(bench: Workbench, monkeypatch: pytest.MonkeyPatch) -> None:
    three, materialise = threading.Event(), workbench.materialise
    made = do_instead(monkeypatch, lambda _, name: three.set() if name == "third" else None)

    def generate(*arguments: Any) -> Any:
        assert three.wait(DEADLINE_SECONDS)
        return materialise(*arguments)

    monkeypatch.setattr(workbench, "materialise", generate)
    job, notes = job_of(bench), Notes()
    Runner(bench, notes, parallelism=2).run([job])
    assert [record.phase for record in notes.records] == [Phase.SUCCEEDED] * 3
    assert made == NAMES


def test_one_that_can_not_be_made_fails_its_own_runs(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: Making, name: str) -> None:
        if name == "first":
            raise Unavailable("no packages")

    do_instead(monkeypatch, refuse)
    notes = Notes()
    Runner(bench, notes, parallelism=2).run([job_of(bench)])
    found = {record.spec["algorithmRef"]["name"]: (record.reason, record.message) for record in notes.records}
    assert found["first"] == (Reason.ALGORITHM_UNAVAILABLE, "no packages")
    assert [reason for reason, _ in found.values()].count(None) == 2


def test_an_interruption_ends_them(
    bench: Workbench, environments: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runner = Runner(bench, Notes(), parallelism=2)

    def wait(making: Making, _: str) -> None:
        runner.interrupt()
        assert making._given_up()
        raise GivenUp("it")

    assert do_instead(monkeypatch, wait) == []
    assert runner.run([job_of(bench)])
    assert not list(environments.rglob(MARKER))


def test_what_runs_one_at_a_time_is_left_to_its_runs(bench: Workbench, home: Home) -> None:
    cores = CorePool(home.leases)
    assert missing(bench, NAMES) == set(NAMES)
    assert make_ahead(NAMES, bench, cores, 0, lambda: False) == []
    threads = make_ahead(NAMES, bench, cores, 1, lambda: False)
    for thread in threads:
        thread.join()
    assert (len(threads), missing(bench, NAMES)) == (1, set())


def test_the_next_to_run_is_made_first(bench: Workbench) -> None:
    job = job_of(bench)
    assert job.next_of(NAMES[::-1]) == NAMES
    job.order = job.order[::-1]
    assert job.next_of({"first", "third", "not of this sweep"}) == ["third", "first"]
