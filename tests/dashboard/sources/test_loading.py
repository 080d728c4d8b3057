# SPDX-License-Identifier: Apache-2.0
"""The table of columns says what the archive holds of each run, and follows it."""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive, SweepRecord
from slamhive.archive.connection import connect
from slamhive.dashboard.sources.archived import ArchiveData
from slamhive.model.results import IntendedEvaluation, Outcome, Phase, Result
from slamhive.tables.helping import ReadingHelper
from slamhive.tables.loading import load
from slamhive.tables.snapshots import Loaded

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.analysis.frame import Frame
    from slamhive.model.results import RunRecord

FIRST = {
    "id": 1,
    "uid": "uid-000",
    "name": "run-000",
    "run": "run-000",
    "sweep": "study",
    "algorithm": "algorithm-0",
    "sensors": "stereo",
    "dataset": "dataset-0",
    "repetition": 0,
    "seed": 0,
    "attempts": 0,
    "phase": "Succeeded",
    "status": "Tracked",
    "parameters.nFeatures": 500,
    "parameters.loop": True,
    "input.pace": "Lockstep",
    "evaluation": "se3",
    "alignment": "se3",
    "outcome": "Tracked",
    "coverage": 0.95,
    "scale": 1.0,
    "ate.rmse": 0.01,
    "rpe[0].rmse": 1 / 3,
    "ate.extended": 0.01,
    "disturbed": False,
    "usage.cpu.meanCores": 1.5,
    "usage.cpu.seconds": 10.0,
    "usage.wallSeconds": 20.0,
    "usage.undisturbedSeconds": 20.0,
    "trajectory.poses": 10,
    "trajectory.durationSeconds": 1.0,
    "trajectory.path": "x",
    "trajectory.sha256": "0" * 64,
    "dataset.attributes.loops": 0,
    "started": "2026-01-02T03:04:00.250000+00:00",
}
"""All that the table has of the first run."""

SHOWN = ("uid", "evaluation", "alignment", "outcome", "ate.rmse", "seed", "sweep", "phase", "reason")


def rows_of(frame: Frame) -> list[dict[str, Any]]:
    rows = frame.records(frame.names)
    return [{name: value for name, value in row.items() if value is not None} for row in rows]


def lines_of(record: RunRecord) -> list[tuple[Any, ...]]:
    """Return the values that a run's rows must have in the columns SHOWN."""
    have = {
        one.evaluation: (one.values.get("alignment"), one.outcome, (one.values.get("ate") or {}).get("rmse"))
        for one in record.results
    }
    wanted = {one.evaluation: (one.alignment, None, None) for one in record.evaluations}
    shared = (record.spec["seed"], record.sweep, record.phase, record.reason)
    measured = (wanted | have) or {None: (None, None, None)}
    return [(record.uid, name, *found, *shared) for name, found in measured.items()]


def assert_holds(frame: Frame, archive: Archive) -> None:
    found = [tuple(row.values()) for row in frame.records(SHOWN)]
    assert found == [line for record in archive.runs() for line in lines_of(record)]


def test_a_run_s_row_has_all_that_is_recorded_of_it(assorted: str) -> None:
    assert rows_of(load(connect(assorted)).frame)[0] == FIRST


def test_each_run_has_a_row_for_each_evaluation(assorted: str) -> None:
    frame = load(connect(assorted)).frame
    with Archive.open(assorted) as archive:
        assert_holds(frame, archive)
    names = ("uid", "evaluation", "status")
    rows = [tuple(row.values()) for row in frame.records(names)]
    assert rows[24:28] == [
        ("uid-024", "se3", "OutOfMemory"),
        ("uid-025", "se3", "Lost"),
        ("uid-025", "sim3", "Tracked"),
        ("uid-026", None, "NotEvaluated"),
    ]


def change_result(archive: Archive, _: Callable[..., RunRecord]) -> None:
    archive.put_result("uid-003", Result(evaluation="se3", outcome=Outcome.LOST, coverage=0.1))


def add_evaluation(archive: Archive, _: Callable[..., RunRecord]) -> None:
    archive.put_result("uid-026", Result(evaluation="new", outcome=Outcome.TRACKED, values={"own": {"x": 1}}))


def add_runs(archive: Archive, make_run: Callable[..., RunRecord]) -> None:
    archive.put_runs(make_run(number) for number in range(100, 103))


def replace_run(archive: Archive, make_run: Callable[..., RunRecord]) -> None:
    archive.put_run(make_run(5, phase=Phase.FAILED, results=[]))


def remove_run(archive: Archive, _: Callable[..., RunRecord]) -> None:
    archive.remove_run("uid-007")


def intend_evaluation(archive: Archive, _: Callable[..., RunRecord]) -> None:
    archive.put_evaluations("uid-024", [IntendedEvaluation(evaluation="later", alignment="sim3")])


def note_run(archive: Archive, _: Callable[..., RunRecord]) -> None:
    archive.annotate(["uid-003"], lambda had: had.changed("tried a robust kernel", ["robust"], []))


CHANGES = (change_result, add_evaluation, add_runs, replace_run, remove_run, intend_evaluation, note_run)


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_is_seen_as_if_all_were_read_again(
    change: Callable[..., None], assorted: str, make_run: Callable[..., RunRecord]
) -> None:
    engine = connect(assorted)
    before = load(engine)
    with Archive.open(assorted) as archive:
        change(archive, make_run)
        after = load(engine, before)
        assert after is not before
        assert rows_of(after.frame) == rows_of(load(engine).frame)
        assert_holds(after.frame, archive)


@pytest.mark.parametrize("change", CHANGES)
def test_a_look_for_newer_runs_finds_those_alone_and_the_next_one_all(
    change: Callable[..., None], assorted: str, make_run: Callable[..., RunRecord]
) -> None:
    engine = connect(assorted)
    before = load(engine)
    with Archive.open(assorted) as archive:
        change(archive, make_run)
    newer, whole = load(engine, before, newer=True), rows_of(load(engine).frame)
    more = whole[len(before.frame) :] if change is add_runs else []
    assert rows_of(newer.frame) == [*rows_of(before.frame), *more]
    assert rows_of(load(engine, newer).frame) == whole


def test_after_a_long_look_new_runs_come_at_once_and_removals_with_the_next_one(
    assorted: str, make_run: Callable[..., RunRecord]
) -> None:
    ticks = count(0.0, 2.0)
    data = ArchiveData(assorted, clock=lambda: next(ticks))
    data.look()
    with Archive.open(assorted) as archive:
        archive.put_run(make_run(100))
        archive.remove_run("uid-007")
    data.look(again=True)
    assert {"uid-100", "uid-007"} <= set(data.frame.column("uid").tolist())
    assert "removed and edited runs are shown as they were for up to 1 min" in data.said[0]
    while "uid-007" in data.frame.column("uid").tolist():
        assert next(ticks) < 200
        data.look(again=True)
    assert rows_of(data.frame) == rows_of(load(connect(assorted)).frame.without(["folder"]))
    assert data.said == ()
    data.close()


def test_a_new_version_of_a_sweep_supersedes_the_runs_of_the_one_before(
    url: str, make_run: Callable[..., RunRecord]
) -> None:
    with Archive.open(url) as archive:
        archive.put_sweep(SweepRecord(uid="old", name="study", spec={}, created="2026-01-01T00:00:00Z"))
        archive.put_runs(make_run(number, sweep_uid="old") for number in range(3))
        before = load(connect(url))
        archive.put_sweep(SweepRecord(uid="new", name="study", spec={}, created="2026-02-01T00:00:00Z"))
        after = load(connect(url), before)
    assert before.frame.column("superseded").tolist() == [None] * 3
    assert after.frame.column("superseded").tolist() == ["sweep edited"] * 3


def test_nothing_is_read_again_without_a_change(assorted: str) -> None:
    engine = connect(assorted)
    before = load(engine)
    assert load(engine, before).frame is before.frame


def test_an_empty_archive_is_an_empty_table(url: str) -> None:
    assert len(load(connect(url), Loaded()).frame) == 0


def test_many_small_batches_make_the_same_table(assorted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = load(connect(assorted))
    monkeypatch.setattr("slamhive.tables.batches.BATCH", 4)
    found = load(connect(assorted))
    assert rows_of(found.frame) == rows_of(whole.frame)
    # Among other rows a run looks the same, so that only what has changed is read again.
    assert found.marks.same_as(whole.marks)
    monkeypatch.setattr("slamhive.tables.loading._STREAMED", 3)
    assert load(connect(assorted), found).frame is found.frame


@pytest.mark.parametrize("program", [None, "/bin/true"], ids=["helps", "ends"])
def test_a_helper_makes_no_difference(
    assorted: str, monkeypatch: pytest.MonkeyPatch, program: str | None
) -> None:
    whole = load(connect(assorted))
    monkeypatch.setattr("slamhive.tables.batches.BATCH", 3)
    monkeypatch.setattr("slamhive.tables.helping.LEAST_HELPED", 2)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1})
    if program is not None:
        monkeypatch.setattr("slamhive.tables.helping.sys.executable", program)
    found = load(connect(assorted))
    assert rows_of(found.frame) == rows_of(whole.frame)
    assert found.marks.same_as(whole.marks)


def test_a_helper_takes_no_module_of_the_working_folder(
    assorted: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sqlalchemy.py").write_text("raise SystemExit")
    monkeypatch.chdir(tmp_path)
    with ReadingHelper(assorted) as helper:
        helper.ask(0, 1, 2)
        [(_, batch)] = helper.answers(lambda *_: pytest.fail("it does not answer"), [(1, 2)], 1)
    assert len(batch.marks) == 2
