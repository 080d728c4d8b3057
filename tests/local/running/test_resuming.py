# SPDX-License-Identifier: Apache-2.0
"""Finished runs are kept, equal ones reused, half-done ones started afresh."""

from __future__ import annotations

import json
import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.analysis import Selection, choose
from slamhive.local.running import workbench
from slamhive.local.running.attempt import Attempt
from slamhive.local.running.runner import _LOOK_SECONDS, Job, Runner, RunStep
from slamhive.model.dataset import GroundTruth
from slamhive.model.results import Machine, Phase
from slamhive.plan import Plan, local_uid
from slamhive.tables.reading import read_archive

from .sweeps import Notes, sweep_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.home.folder import Home
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.dataset import Dataset

DEADLINE_SECONDS = 50


def test_running_again_repeats_nothing(run_acts: Callable) -> None:
    run_acts(["good", "crash"])
    job, notes = run_acts(["good", "crash"])
    assert notes.records == []
    assert job.kept == 2


def test_rerun_repeats_all(run_acts: Callable) -> None:
    run_acts(["good", "crash"])
    _, notes = run_acts(["good", "crash"], rerun=True)
    assert len(notes.records) == 2


def test_an_interruption_does_not_wait_for_a_run_when_it_comes_as_the_runner_would_look_up(
    bench: Workbench,
) -> None:
    class Interrupting(Notes):
        def step(self, job: Job, index: int, step: RunStep) -> None:
            if step is RunStep.RUNNING:
                os.kill(os.getpid(), signal.SIGUSR1)

    notes = Interrupting()
    runner = Runner(bench, notes, parallelism=1)

    def interrupt(*_: object) -> None:
        runner.interrupt()
        # What the runner waits for until it looks up is over when this returns.
        threading.Event().wait(2 * _LOOK_SECONDS)

    before = signal.signal(signal.SIGUSR1, interrupt)
    sweep = sweep_of(["noted"], template={"parameters": {"number": 60_000}})
    try:
        assert runner.run([Job(sweep, local_uid(sweep), Plan(sweep, bench.workshop))])
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert notes.records == []


def test_another_sweep_reuses_equal_runs_but_not_failed_ones(run_acts: Callable) -> None:
    first, _ = run_acts(["good", "crash"])
    job, notes = run_acts(["good", "crash"], name="others")
    assert job.reused == 1
    good = next(record for record in notes.records if record.phase is Phase.SUCCEEDED)
    assert good.provenance.reused_from == first.points.point(0).name
    assert good.results
    assert good.usage


@pytest.mark.parametrize("other", [{"cpu_model": "another"}, {"machine": Machine(exclusive_cores=True)}])
def test_usage_that_another_machine_gave_is_not_taken_over(
    run_acts: Callable, bench: Workbench, other: dict[str, Any]
) -> None:
    run_acts(["good"])
    [first] = bench.archive.runs()
    bench.archive.put_run(first.replace(provenance=first.provenance.replace(**other)))
    _, notes = run_acts(["good"], name="others")
    record = notes.records[0]
    assert record.provenance.reused_from == first.name
    assert record.usage is None
    assert other.items() <= dict(record.provenance).items()
    assert (record.trajectory, record.results) == (first.trajectory, first.results)


def test_a_changed_adapter_makes_other_results(run_acts: Callable, home) -> None:  # noqa: ANN001
    run_acts(["good"])
    adapter = home.path / "algorithms/actor/adapter.py"
    adapter.write_text(adapter.read_text() + "\n# changed\n")
    job, _ = run_acts(["good"], name="others")
    assert job.reused == 0


def test_cache_policy_rerun_reuses_nothing(run_acts: Callable) -> None:
    run_acts(["good"])
    job, _ = run_acts(["good"], name="others", cachePolicy="Rerun")
    assert job.reused == 0


def test_an_attempt_that_ended_before_a_crash_is_taken_up(run_acts: Callable, bench) -> None:  # noqa: ANN001
    job, notes = run_acts(["good"])
    before = (Path(notes.records[0].folder) / "summary.json").stat().st_mtime_ns
    bench.archive.remove_run(job.run_uid(0))
    _, again = run_acts(["good"])
    assert (Path(again.records[0].folder) / "summary.json").stat().st_mtime_ns == before
    assert again.records[0].results == notes.records[0].results


def test_an_attempt_without_its_last_word_starts_afresh(run_acts: Callable, bench) -> None:  # noqa: ANN001
    job, notes = run_acts(["good"])
    record = notes.records[0]
    (Path(record.folder) / "summary.json").unlink()
    bench.archive.remove_run(job.run_uid(0))
    attempt = Attempt(Path(record.folder))
    assert not attempt.finished(record.uid, record.provenance.content_hash)
    _, again = run_acts(["good"])
    assert again.records[0].phase is Phase.SUCCEEDED
    assert (Path(record.folder) / "summary.json").exists()


def test_poses_that_a_player_wrote_late_count_for_an_attempt_taken_up(run_acts: Callable) -> None:
    """A player that lost its node writes what it heard after the supervisor has looked, and lives on then."""
    _, notes = run_acts(["good"])
    folder = Path(notes.records[0].folder)
    summary = json.loads((folder / "summary.json").read_text())
    early = {key: value for key, value in summary.items() if not key.startswith("trajectory")}
    early["trajectoryProblem"] = "output/trajectory.txt is missing or not a regular file"
    (folder / "summary.json").write_text(json.dumps(early))
    assert Attempt(folder).trajectory() is None
    (folder / "player").mkdir()
    attempt = Attempt(folder)
    assert attempt.trajectory() == notes.records[0].trajectory.replace(
        path=str(attempt.output / "trajectory.txt")
    )
    assert attempt.end().trajectory_problem is None
    # Nobody counts them anew: they are those of the recording.
    assert attempt.frames().offered == summary["frames"]["offered"] == notes.records[0].frames.offered


@pytest.mark.parametrize("name", ["summary.json", "attempt.json"])
@pytest.mark.parametrize("spoil", ["deep", "pipe", "list"])
def test_an_attempt_whose_last_word_was_spoilt_starts_afresh(
    run_acts: Callable, bench: Workbench, name: str, spoil: str
) -> None:
    job, notes = run_acts(["good"])
    record = notes.records[0]
    path = Path(record.folder) / name
    path.unlink()
    if spoil == "pipe":
        os.mkfifo(path)
    else:
        path.write_text("[]" if spoil == "list" else "[" * 200_000)
    bench.archive.remove_run(job.run_uid(0))
    _, again = run_acts(["good"])
    assert again.records[0].phase is Phase.SUCCEEDED
    assert path.is_file()


def test_a_budget_of_cpu_time_counts_what_was_spent_before(run_acts: Callable) -> None:
    for _ in range(2):
        job, _ = run_acts(["good"], repetitions=3, budget={"cpuHours": 1e-9}, parallelism=1)
        assert job.verdict == "BudgetExhausted"
        assert bytes(job.states) == bytes([2, 0, 0])


def test_a_run_without_its_ground_truth_still_says_what_made_it(run_acts: Callable, workshop) -> None:  # noqa: ANN001
    place = workshop.dataset_places["tiny"]
    spec = place.dataset.spec.replace(ground_truth=GroundTruth(file="missing.txt"))
    workshop.dataset_places["tiny"] = type(place)(place.dataset.replace(spec=spec), place.folder)
    _, notes = run_acts(["good"])
    record = notes.records[0]
    assert record.phase is Phase.SUCCEEDED
    assert "missing.txt does not exist" in record.message
    assert record.provenance.environment
    assert record.provenance.cpu_model


def test_making_one_dataset_holds_up_no_other(bench, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: ANN001
    began, done = threading.Event(), threading.Event()
    materialise = workbench.materialise

    def slow(dataset: Dataset, *rest: object) -> object:
        if dataset.name == "other":
            began.set()
            assert done.wait(DEADLINE_SECONDS)
        return materialise(dataset, *rest)

    monkeypatch.setattr(workbench, "materialise", slow)
    place = bench.workshop.dataset_places["tiny"]
    other = place.dataset.replace(metadata=place.dataset.metadata.replace(name="other"))
    bench.workshop.dataset_places["other"] = type(place)(other, place.folder)
    with ThreadPoolExecutor() as pool:
        making = pool.submit(bench.checksum, "other")
        assert began.wait(DEADLINE_SECONDS)
        try:
            assert pool.submit(bench.checksum, "tiny").result(DEADLINE_SECONDS / 2)
        finally:
            done.set()
        assert making.result()


def test_runs_of_a_changed_adapter_are_done_again_and_the_earlier_ones_stay(
    run_acts: Callable, home: Home, bench: Workbench
) -> None:
    first, _ = run_acts(["good"])
    earlier = bench.archive.get(first.run_uid(0))
    adapter = home.path / "algorithms/actor/adapter.py"
    adapter.write_text(adapter.read_text() + "\n# changed\n")
    job, notes = run_acts(["good"])
    assert len(notes.records) == 1
    assert job.kept == 0
    (kept,) = [record for record in bench.archive.runs() if record.uid != job.run_uid(0)]
    assert kept.results == earlier.results
    assert (kept.sweep, kept.sweep_uid) == (earlier.sweep, earlier.sweep_uid)
    chosen = choose(read_archive(home.archive_url), Selection())
    assert chosen.frame.column("uid").tolist() == [job.run_uid(0)]
    assert chosen.notes == ("1 run of earlier versions left out (algorithm changed)",)
    assert (Path(kept.folder) / "run/output/trajectory.txt").is_file()
    assert Path(kept.trajectory.path).is_file()
    again, notes = run_acts(["good"])
    assert (again.kept, notes.records) == (1, [])
