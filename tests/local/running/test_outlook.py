# SPDX-License-Identifier: Apache-2.0
"""Outlook on a sweep: what an edit makes stale and why is known before anything is done."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.data.store.datasets import made_folder
from slamhive.local.running.choosing import RunChoice
from slamhive.local.running.outlook import Looking, RunStanding, moment_text, sentences
from slamhive.local.running.runner import Job, Runner
from slamhive.local.running.workbench import Workbench
from slamhive.model.results import Phase, Reason
from slamhive.plan import Plan, local_uid

from .sweeps import Notes, edit_recording, sweep_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home
    from slamhive.local.running.outlook import Outlook
    from slamhive.model.sweep import Sweep


def edit(home: Home, name: str = "adapter.py", text: str = "\n# changed\n") -> str:
    """Change a file of the actor, and return what it was."""
    path = home.path / "algorithms/actor" / name
    before = path.read_text() if path.exists() else ""
    path.write_text(before + text)
    return before


@pytest.fixture
def look(bench: Workbench) -> Callable[[Sweep], tuple[Outlook, str]]:
    """Looks at a sweep as `slamhive plan` does, and returns what was found, in words too."""

    def found(sweep: Sweep) -> tuple[Outlook, str]:
        points = Plan(sweep, bench.workshop)
        job = Job(sweep, local_uid(sweep), points)
        outlook = Looking(bench, making=False).look(sweep.name, job.uid, points, job.run_uid)
        return outlook, "; ".join(sentences(outlook, points))

    return found


def numbered(*numbers: int, **fields: Any) -> Sweep:
    matrix = [{"path": "parameters.number", "values": list(numbers)}]
    return sweep_of([], matrix=matrix, **fields)


def test_everything_is_new_before_the_first_run_and_as_before_after_it(run_sweep, look) -> None:  # noqa: ANN001
    assert look(numbered(1, 2))[1] == "2 runs, all new"
    run_sweep(numbered(1, 2))
    assert look(numbered(1, 2))[1] == "2 runs are as before"


def test_an_edit_names_its_file_and_its_runs_and_looking_changes_nothing(
    run_sweep: Callable, look: Callable, home: Home, bench: Workbench
) -> None:
    run_sweep(numbered(1, 2))
    before = [record.uid for record in bench.archive.runs()]
    edit(home)
    edit(home, "helper.py")
    outlook, told = look(numbered(1, 2))
    assert told.startswith("2 runs of actor are stale: adapter.py and helper.py changed since ")
    assert outlook.of(RunStanding.STALE) == [0, 1]
    assert [record.uid for record in bench.archive.runs()] == before


def test_a_value_that_is_added_is_told_apart_from_what_an_edit_made_stale(
    run_sweep: Callable, look: Callable, home: Home
) -> None:
    run_sweep(numbered(1, 2))
    edit(home)
    _, told = look(numbered(1, 2, 15))
    assert told.startswith("2 runs of actor are stale: adapter.py changed since ")
    assert told.endswith("; 1 of parameters.number 15 is new")


def test_values_that_are_new_are_named_in_one_sentence(run_sweep: Callable, look: Callable) -> None:
    run_sweep(numbered(1))
    told = look(numbered(1, 2, 3, 4, 5, 6, 7))[1]
    assert told == "4 of parameters.number 2, 3, 4, 5 are new; 2 more are new; 1 takes over an equal result"


def test_a_repetition_that_is_added_is_new_and_the_others_take_over_equal_results(
    run_sweep: Callable, look: Callable
) -> None:
    run_sweep(numbered(1, 2))
    assert look(numbered(1, 2, repetitions=2))[1] == "2 of repetition 1 are new; 2 take over an equal result"


def test_an_edit_that_is_taken_back_takes_over_what_was_before_it(
    run_sweep: Callable, look: Callable, home: Home
) -> None:
    run_sweep(numbered(1))
    before = edit(home)
    run_sweep(numbered(1))
    (home.path / "algorithms/actor/adapter.py").write_text(before)
    outlook, told = look(numbered(1))
    assert told == "1 takes over an equal result"
    assert list(outlook.replaced) == [0]
    job, _ = run_sweep(numbered(1))
    assert job.reused == 1


def test_without_notes_of_what_a_version_was_made_of_the_program_has_changed(
    run_sweep: Callable, look: Callable, home: Home
) -> None:
    run_sweep(numbered(1))
    for path in (home.path / "versions").iterdir():
        path.write_text("[")
    edit(home)
    assert look(numbered(1))[1].startswith("1 run of actor is stale: its program changed since ")


def test_failed_runs_stay_and_those_that_the_machine_failed_are_tried_again(
    run_acts: Callable, look: Callable, bench: Workbench
) -> None:
    job, _ = run_acts(["good", "crash", "noted"])
    record = bench.archive.get(job.run_uid(2))
    bench.archive.put_run(record.replace(phase=Phase.FAILED, reason=Reason.SYSTEM_FAULT, results=[]))
    _, told = look(sweep_of(["good", "crash", "noted"]))
    assert told == "2 runs are as before (1 of them failed); 1 that the machine failed is tried again"


def test_a_dataset_that_is_not_made_is_not_made_to_look(look: Callable, workshop, bench) -> None:  # noqa: ANN001
    edit_recording(workshop, bench.home, seed=99)
    folders = set((bench.home.path / "datasets").iterdir())
    assert look(numbered(1))[1] == "1 new run"
    assert set((bench.home.path / "datasets").iterdir()) == folders


def test_plan_and_run_agree_on_a_synthetic_dataset_that_was_edited_in_place(
    run_sweep: Callable, look: Callable, workshop: Workshop, bench: Workbench
) -> None:
    sweep = numbered(1, 2)
    run_sweep(sweep)
    before = edit_recording(workshop, bench.home, seed=99)
    datasets = bench.home.path / "datasets"
    folders = set(datasets.iterdir())
    planned = look(sweep)[1]
    assert planned.startswith("2 runs of actor are stale: the dataset tiny changed since ")
    assert set(datasets.iterdir()) == folders
    points = Plan(sweep, workshop)
    job = Job(sweep, local_uid(sweep), points)
    fresh = Workbench(bench.home, workshop, bench.archive)
    found = Looking(fresh, making=True).look(sweep.name, job.uid, points, job.run_uid)
    assert "; ".join(sentences(found, points)) == planned
    # What is gone and would be generated by the same recipe is what it was.
    workshop.dataset_places["tiny"] = before
    shutil.rmtree(made_folder(before.dataset, datasets))
    assert look(sweep)[1] == "2 runs are as before"


def run_some(
    bench: Workbench, sweep: Sweep, wish: RunChoice, asked: set[int] | None = None
) -> tuple[Job, Notes]:
    job, notes = Job(sweep, local_uid(sweep), Plan(sweep, bench.workshop)), Notes()
    job.asked = asked
    Runner(bench, notes, parallelism=1, wish=wish).run([job])
    return job, notes


def test_the_first_runs_are_one_of_each_setting(bench: Workbench) -> None:
    job, notes = run_some(bench, numbered(1, 2, repetitions=3), RunChoice(first=3))
    assert [(record.spec["parameters"]["number"], record.spec["repetition"]) for record in notes.records] == [
        *((1, 0), (2, 0), (1, 1)),
    ]
    assert (job.verdict, job.left_out) == ("Complete", 3)


def test_what_is_left_out_after_an_edit_stays_where_it_was(bench: Workbench, home: Home) -> None:
    job, _ = run_some(bench, numbered(1, 2), RunChoice())
    folders = {index: bench.archive.get(job.run_uid(index)).folder for index in range(2)}
    edit(home)
    again, notes = run_some(bench, numbered(1, 2), RunChoice(), asked={1})
    assert [record.index for record in notes.records] == [1]
    assert bench.archive.get(again.run_uid(0)).folder == folders[0]
    assert Path(folders[0]).is_dir()
    asides = [record for record in bench.archive.runs() if "@" in record.uid]
    assert [record.index for record in asides] == [1]
    assert Path(asides[0].folder).is_dir()


def test_runs_that_are_asked_for_again_are_done_again_and_no_others(bench: Workbench) -> None:
    run_some(bench, numbered(1, 2, 3), RunChoice())
    job, notes = run_some(bench, numbered(1, 2, 3), RunChoice(rerun=True), asked={1})
    assert ([record.index for record in notes.records], job.kept) == ([1], 2)


def test_a_moment_of_today_is_a_time_of_day() -> None:
    now = datetime(2026, 5, 3, 12, 30, tzinfo=UTC).astimezone()
    assert moment_text(now - timedelta(hours=1), now) == f"{now - timedelta(hours=1):%H:%M}"
    assert moment_text(now - timedelta(days=2), now) == f"{now - timedelta(days=2):%Y-%m-%d %H:%M}"
