# SPDX-License-Identifier: Apache-2.0
"""Measuring again takes the trajectory that a run wrote, and no other one that lies in its place."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive
from slamhive.local.home.folder import Home
from slamhive.local.running import measuring_apart
from slamhive.local.running.evaluating import TrajectoryEvaluator
from slamhive.local.running.evaluations import (
    Unmeasured,
    bring_up_to_date,
    measure_outdated,
    measure_record,
)
from slamhive.local.running.execution import RunDriver
from slamhive.local.running.workbench import Workbench
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.results import Phase
from slamhive.model.sweep import Sweep
from slamhive.monitor.measuring.bounded import BoundedProcess

from .sweeps import sweep_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.home.catalog import Workshop

ORIGIN = EvaluationSettings.model_validate({"alignment": "Origin"})


def trajectory(folder: str | None) -> Path:
    return Path(folder or "") / "run/output/trajectory.txt"


def test_a_trajectory_that_was_replaced_is_not_measured(run_acts: Callable, bench: Workbench) -> None:
    job, notes = run_acts(["good"])
    path = trajectory(notes.records[0].folder)
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:50]))
    assert "trajectory" in str(measure_record(bench, notes.records[0], ORIGIN))
    assert [one.evaluation for one in bench.archive.get(job.run_uid(0)).results] == ["se3"]


def test_a_run_done_again_keeps_no_result_of_its_earlier_trajectory(
    run_acts: Callable, bench: Workbench
) -> None:
    """Notes on it stay, when it is measured and when it is done again."""
    job, notes = run_acts(["good"])
    uid = job.run_uid(0)
    bench.archive.annotate([uid], lambda had: had.changed("tried a robust kernel", ["robust"], []))
    assert measure_record(bench, notes.records[0], ORIGIN, "mine") is None
    assert [bench.archive.get(uid).note, len(bench.archive.get(uid).results)] == ["tried a robust kernel", 2]
    run_acts(["good"], rerun=True)
    again = bench.archive.get(uid)
    assert [one.evaluation for one in again.results] == ["se3"]
    assert (again.note, again.tags) == ("tried a robust kernel", ["robust"])


def test_a_sweep_s_template_gives_its_runs_a_note_and_tags(run_sweep: Callable, bench: Workbench) -> None:
    body = sweep_of(["good"]).as_json()
    annotations = {"slamhive.io/note": "the baseline", "slamhive.io/tags": "b, a"}
    body["spec"]["template"]["metadata"] = {"annotations": annotations}
    job, _ = run_sweep(Sweep.model_validate(body))
    record = bench.archive.get(job.run_uid(0))
    assert (record.note, record.tags, record.noted) == ("the baseline", ["a", "b"], None)


def outdated(bench: Workbench, uid: str) -> None:
    """Make the results of a run those of the first version of the evaluation, which named itself nowhere."""
    for result in bench.archive.get(uid).results:
        values = {**result.values, "ate": {"rmse": 9.0}}
        del values["evaluationVersion"]
        bench.archive.put_result(uid, result.replace(values=values))


def errors(bench: Workbench, uid: str) -> dict[str, float]:
    return {one.evaluation: one.values["ate"]["rmse"] for one in bench.archive.get(uid).results}


def test_results_of_an_earlier_version_of_the_evaluation_are_brought_up_to_date(
    run_acts: Callable, bench: Workbench
) -> None:
    """By their settings: those of their sweep, or the usual ones; others nobody knows any more."""
    job, notes = run_acts(["good"], evaluation={"alignment": "Origin"})
    uid = job.run_uid(0)
    forgotten = EvaluationSettings.model_validate({"association": {"maxDifference": "11ms"}})
    for settings, name in ((EvaluationSettings(), "mine"), (forgotten, "forgotten")):
        assert measure_record(bench, notes.records[0], settings, name) is None
    before = errors(bench, uid)
    assert measure_outdated(bench, {uid}) == (0, [])
    outdated(bench, uid)
    assert measure_outdated(bench, set()) == (0, [])
    done, [problem] = measure_outdated(bench, {uid})
    assert (done, problem.is_fault) == (0, False)
    assert "the settings of evaluation 'forgotten' are not known here: run its file" in problem.sentence
    assert errors(bench, uid) == before | {"forgotten": 9.0}


def test_a_sweep_that_is_run_again_is_measured_by_the_latest_version(
    run_acts: Callable, bench: Workbench
) -> None:
    """A run that takes over an equal one takes no old figure; what is gone can't be measured."""
    job, notes = run_acts(["good"])
    uid = job.run_uid(0)
    before = errors(bench, uid)
    outdated(bench, uid)
    other, again = run_acts(["good"], name="same")
    assert other.reused == 1
    assert again.records[0].results[0].values["ate"]["rmse"] == before["se3"]
    assert bring_up_to_date(bench, job.uid, EvaluationSettings()) == []
    assert errors(bench, uid) == before
    outdated(bench, uid)
    shutil.rmtree(notes.records[0].folder)
    assert bring_up_to_date(bench, job.uid, EvaluationSettings()) == []
    done, [problem] = measure_outdated(bench, {uid})
    assert (done, errors(bench, uid)) == (0, {"se3": 9.0})
    assert "its trajectory" in problem.sentence


def test_what_an_earlier_version_measured_is_marked_until_it_is_measured_again(
    run_acts: Callable, bench: Workbench, run_command: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(bench.home.path))
    _, notes = run_acts(["good", "noted"])
    record = notes.records[0]
    before = errors(bench, record.uid)["se3"]
    outdated(bench, record.uid)
    for words in (("results", "table"), ("results", "list")):
        _, _, said = run_command(*words)
        assert "1 run was measured by an earlier version of the evaluation" in " ".join(said.split())
    _, out, _ = run_command("results", "table", "--rows", "algorithm", "--format", "json")
    assert [(row["evaluationVersion"], row["n"]) for row in json.loads(out)] == [(1, 1), (2, 1)]
    _, _, said = run_command("results", "show", record.name)
    assert "se3: measured by version 1 of the evaluation, 2 is current" in " ".join(said.split())

    code, out, _ = run_command("results", "measure", "--where", "run == 'nobody'")
    assert code == 2
    code, out, _ = run_command("results", "measure")
    assert (code, out.strip()) == (0, "1 run measured again")
    assert errors(bench, record.uid)["se3"] == before
    code, out, _ = run_command("results", "measure")
    assert (code, out.strip()) == (0, "all results are up to date")
    _, _, said = run_command("results", "table")
    assert "earlier version" not in said


def test_a_run_being_done_again_is_not_finished(
    run_acts: Callable, bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    job, notes = run_acts(["good"])

    def killed(self: RunDriver, *_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(RunDriver, "_record", killed)
        with pytest.raises(KeyboardInterrupt):
            run_acts(["good"], rerun=True)
    again = (Path(notes.records[0].folder) / "summary.json").stat().st_mtime_ns
    assert bench.archive.get(job.run_uid(0)) is None
    _, kept = run_acts(["good"])
    assert (Path(kept.records[0].folder) / "summary.json").stat().st_mtime_ns == again


def test_what_is_taken_up_counts_as_one_attempt_with_its_frames(run_acts: Callable, bench: Workbench) -> None:
    job, notes = run_acts(["good"])
    bench.archive.remove_run(job.run_uid(0))
    _, again = run_acts(["good"])
    assert (again.records[0].attempts, again.records[0].frames) == (1, notes.records[0].frames)


def test_a_home_may_move(run_acts: Callable, home: Home, workshop: Workshop, bench: Workbench) -> None:
    jobs = [run_acts(["good"])[0], run_acts(["good"], name="others")[0]]
    bench.archive.close()
    moved = home.path.rename(home.path.with_name("elsewhere"))
    with Archive.open(Home.at(moved).archive_url) as archive:
        there = Workbench(Home.at(moved), workshop, archive)
        for place in [*workshop.algorithm_entries.values(), *workshop.dataset_places.values()]:
            object.__setattr__(place, "folder", moved / place.folder.relative_to(home.path))
        for job in jobs:
            assert bring_up_to_date(there, job.uid, ORIGIN) == []
            assert [len(record.results) for record in archive.runs({"sweep_uid": job.uid})] == [2]


def test_an_equal_run_whose_files_are_gone_serves_its_own_settings_alone(run_acts: Callable) -> None:
    _, notes = run_acts(["good"])
    shutil.rmtree(notes.records[0].folder)
    same, _ = run_acts(["good"], name="same")
    assert same.reused == 1
    other, records = run_acts(["good"], name="other", evaluation={"alignment": "Origin"})
    assert other.reused == 0
    assert [one.evaluation for one in records.records[0].results] == ["origin"]


def test_settings_that_do_not_fit_an_equal_run_are_told(run_acts: Callable) -> None:
    run_acts(["good"])
    job, notes = run_acts(
        ["good"], name="others", evaluation={"success": {"maxAte": 1e-12}, "alignment": "Yaw"}
    )
    assert job.reused == 1
    record = notes.records[0]
    assert (record.phase, record.results) == (Phase.SUCCEEDED, [])
    assert "gravityAligned" in record.message


def test_a_run_is_not_measured_on_another_dataset_of_its_name(
    run_acts: Callable, bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, notes = run_acts(["good"])
    monkeypatch.setattr(bench, "checksum", lambda _: "0" * 64)
    assert "dataset 'tiny'" in str(measure_record(bench, notes.records[0], ORIGIN))


def test_a_disk_that_fails_is_told_from_a_run_that_has_nothing_to_measure(
    run_acts: Callable, bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, notes = run_acts(["good", "crash"])
    good, crashed = sorted(notes.records, key=lambda record: record.phase is not Phase.SUCCEEDED)

    def broken(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(TrajectoryEvaluator, "measure_file", broken)
    found = measure_record(bench, good, ORIGIN)
    assert found == Unmeasured("Read-only file system", is_fault=True)
    assert measure_record(bench, crashed, ORIGIN) == Unmeasured("Failed, it has no trajectory")


def test_what_takes_too_much_to_measure_is_noted_and_not_tried_again(
    run_acts: Callable, bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = bench.home.path / "tried"

    def answer(question: tuple[Any, ...], truths: dict[str, Any]) -> Any:
        if "/greedy/" in str(question[0]) and question[2] != ORIGIN:
            with tried.open("a") as file:
                file.write("x")
            return bytes(1 << 30)
        return measuring_apart.measure_output(question, truths)

    monkeypatch.setattr(bench, "measuring", BoundedProcess(answer, 60, 256 << 20))
    why = "can't be measured here: it takes more than 256 MiB of memory"
    _, good = run_acts(["good"])
    job, notes = run_acts(["good"], name="greedy", cachePolicy="Rerun")
    record = notes.records[0]
    assert (record.phase, record.results) == (Phase.SUCCEEDED, [])
    assert record.message.endswith(f"not evaluated: {why}")
    assert [one.evaluation for one in good.records[0].results] == ["se3"]

    for _ in range(2):
        assert bring_up_to_date(bench, job.uid, EvaluationSettings()) == [Unmeasured(f"{record.name}: {why}")]
    assert tried.read_text() == "x"

    looser = EvaluationSettings.model_validate({"association": {"maxDifference": "20ms"}})
    for _ in range(2):
        assert bring_up_to_date(bench, job.uid, looser) == [Unmeasured(f"{record.name}: {why}")]
    assert tried.read_text() == "xx"

    assert bring_up_to_date(bench, job.uid, ORIGIN) == []
    found = bench.archive.get(job.run_uid(0))
    assert [one.evaluation for one in found.results] == ["origin"]
    assert "not evaluated" not in (found.message or "")


def test_a_measuring_that_was_killed_is_tried_again(
    run_acts: Callable, bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    job, _ = run_acts(["good"])
    with monkeypatch.context() as patch:
        patch.setattr(bench, "measuring", BoundedProcess(killed, 60, None))
        [problem] = bring_up_to_date(bench, job.uid, ORIGIN)
    assert problem.is_fault
    assert bring_up_to_date(bench, job.uid, ORIGIN) == []
