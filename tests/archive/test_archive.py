# SPDX-License-Identifier: Apache-2.0
"""Tests that every archive must pass: what it keeps, returns and refuses."""

from __future__ import annotations

import errno
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
import traceback
import uuid
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from datetime import UTC, datetime, timedelta, timezone
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import create_engine, event, exc, inspect, text

from slamhive.archive import Archive, CatalogEntry, SweepRecord, Totals, schema
from slamhive.archive.connection import failures, open_engine, parse
from slamhive.archive.upgrading import upgrade
from slamhive.model.errors import InputError, SystemFault, UnknownNameError
from slamhive.model.results import (
    CpuUsage,
    IntendedEvaluation,
    MemoryUsage,
    Outcome,
    Phase,
    Prepared,
    Provenance,
    Reason,
    TrajectoryInfo,
    Usage,
)
from slamhive.model.search import SearchRecord, Trial

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.model.results import Result, RunRecord

    MakeRun = Callable[..., RunRecord]
    MakeResult = Callable[..., Result]
    PutVersion = Callable[[str, int], None]


def test_a_run_comes_back_as_it_was(archive: Archive, make_run: MakeRun, make_result: MakeResult) -> None:
    record = make_run(
        index=41,
        labels={"a/b": "c"},
        attributes={"loops": 2, "deep": {"x": [1, 2.5, None]}},
        reason=Reason.ALGORITHM_FAILED,
        message="it said: „nein“",
        attempts=3,
        created=datetime(2026, 1, 1, 12, tzinfo=timezone(timedelta(hours=2))),
        usage=Usage(
            cpu=CpuUsage(mean_cores=1 / 3), memory=MemoryUsage(peak_bytes=2**40), includes_reader=True
        ),
        metrics={"framesLost": 3},
        trajectory=TrajectoryInfo(poses=3, duration_seconds=0.1, sha256="0" * 64, path="output/t.txt"),
        results=[make_result("default"), make_result("sim3", Outcome.LOST)],
        provenance=Provenance(content_hash="f" * 64, cpu_model="x"),
        folder="runs/a",
        log_tail="last words",
    )
    archive.put_run(record)
    assert archive.get("u1") == record
    assert archive.get("u2") is None


def test_writing_again_replaces_the_run_and_keeps_other_results(
    archive: Archive, make_run: MakeRun, make_result: MakeResult
) -> None:
    archive.put_run(make_run(results=[make_result("default", rmse=1.0), make_result("sim3")]))
    for _ in range(2):
        archive.put_run(make_run(phase=Phase.FAILED, results=[make_result("default", rmse=2.0)]))
    (record,) = archive.runs()
    assert record.phase is Phase.FAILED
    assert [(r.evaluation, r.values["ate"]["rmse"]) for r in record.results] == [
        ("default", 2.0),
        ("sim3", 0.1 + 0.2),
    ]


def test_runs_are_written_together_with_what_they_used(
    archive: Archive, make_run: MakeRun, make_result: MakeResult
) -> None:
    """Some know their Algorithm and Dataset, some don't any more: what was known stays."""
    old, new = (CatalogEntry(kind="Algorithm", name="kiss-icp", spec={"version": v}) for v in ("1", "2"))
    hall = CatalogEntry(kind="Dataset", name="hall", spec={})
    archive.put_run(make_run("a"), old, hall)
    archive.put_used(
        [
            (make_run("a", results=[make_result()]), None, None),
            (make_run("b", results=[make_result()]), new, hall),
            (make_run("c"), None, hall),
        ]
    )
    assert archive.used(["a", "b", "c"]) == {
        "a": (old.content_hash, hall.content_hash),
        "b": (new.content_hash, hall.content_hash),
        "c": (None, hall.content_hash),
    }
    assert len(archive.catalog("Algorithm")) == 2
    assert [(record.uid, len(record.results)) for record in archive.runs()] == [("a", 1), ("b", 1), ("c", 0)]


def test_a_result_is_keyed_by_evaluation(
    archive: Archive, make_run: MakeRun, make_result: MakeResult
) -> None:
    archive.put_run(make_run())
    archive.put_result("u1", make_result("default"))
    archive.put_result("u1", make_result("default", Outcome.DIVERGED))
    archive.put_result("u1", make_result("sim3"))
    record = archive.get("u1")
    assert record is not None
    assert [(r.evaluation, r.outcome) for r in record.results] == [
        ("default", Outcome.DIVERGED),
        ("sim3", Outcome.TRACKED),
    ]
    with pytest.raises(UnknownNameError, match="unknown run UID 'nobody'"):
        archive.put_result("nobody", make_result())


def test_odd_values_do_not_break_the_database(
    archive: Archive, make_run: MakeRun, make_result: MakeResult
) -> None:
    archive.put_run(
        make_run(
            log_tail="a\0b\udcff",
            metrics={"t": float("nan"), "n\0": ["\udc80", float("inf")]},
            results=[make_result(rmse=float("nan"))],
        )
    )
    record = archive.get("u1")
    assert record is not None
    assert record.log_tail == "ab?"
    assert record.metrics == {"t": None, "n": ["?", None]}
    assert record.results[0].values["ate"] == {"rmse": None}


def test_iteration_is_stable_filtered_and_limited(
    archive: Archive, make_run: MakeRun, make_result: MakeResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.archive.archive.BATCH", 3)
    phases = [Phase.SUCCEEDED, Phase.FAILED]
    records = [make_run(f"u{k}", index=k, phase=phases[k % 2], results=[make_result()]) for k in range(10)]
    assert archive.put_runs(records) == 10
    archive.put_run(make_run("other", sweep=None))
    archive.put_run(records[0])
    assert list(archive.runs(sweep="study")) == records
    assert [r.uid for r in archive.runs(limit=4)] == ["u0", "u1", "u2", "u3"]
    assert [r.uid for r in archive.runs({"phase": "Failed"}, limit=2)] == ["u1", "u3"]
    assert [r.uid for r in archive.runs({"outcome": ["Lost"]})] == []
    assert [r.uid for r in archive.by_names(["run-u7", "nobody", "run-u2"])] == ["u2", "u7"]
    assert (archive.count(), archive.count({"phase": ["Failed", "Cancelled"]}, sweep="study")) == (11, 5)
    with pytest.raises(UnknownNameError, match="unknown filter 'algoritm'; did you mean 'algorithm'"):
        archive.runs({"algoritm": "x"})


def test_a_batch_takes_three_queries(archive: Archive, make_run: MakeRun, make_result: MakeResult) -> None:
    archive.put_runs(make_run(f"u{k}", results=[make_result("a"), make_result("b")]) for k in range(100))
    statements: list[str] = []
    event.listen(archive._engine, "before_cursor_execute", lambda *event: statements.append(event[2]))
    assert sum(len(record.results) for record in archive.runs()) == 200
    assert len([text for text in statements if text.startswith("SELECT")]) == 3


@pytest.mark.parametrize("at_once", [1, 2, 5000])
def test_finished_points_of_a_sweep(
    at_once: int,
    archive: Archive,
    make_run: MakeRun,
    make_result: MakeResult,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("slamhive.archive.archive._ENDS_AT_ONCE", at_once)
    archive.put_run(
        make_run("a", index=3, sweep_uid="s", results=[make_result("x"), make_result("y", Outcome.LOST)])
    )
    archive.put_run(make_run("b", index=4, sweep_uid="s", phase=Phase.FAILED, reason=Reason.NO_TRAJECTORY))
    archive.put_run(make_run("c", index=5, sweep_uid="s", phase=Phase.RUNNING))
    archive.put_run(make_run("d", sweep_uid="another"))
    found = dict(archive.finished("s"))
    assert set(found) == {"a", "b"}
    assert (found["a"].index, found["a"].phase, found["a"].reason) == (3, Phase.SUCCEEDED, None)
    assert (found["b"].phase, found["b"].reason) == (Phase.FAILED, Reason.NO_TRAJECTORY)


def test_totals_of_a_sweep_leave_out_what_is_asked(
    archive: Archive, make_run: MakeRun, make_result: MakeResult
) -> None:
    usage = Usage(cpu=CpuUsage(seconds=2.5))
    archive.put_run(make_run("a", sweep_uid="s", usage=usage, results=[make_result("x"), make_result("y")]))
    archive.put_run(make_run("b", sweep_uid="s", usage=usage, provenance=Provenance(reused_from="run-a")))
    archive.put_run(make_run("c", sweep_uid="s", usage=usage, phase=Phase.FAILED))
    archive.put_run(make_run("d", sweep_uid="s", usage=usage, phase=Phase.RUNNING))
    assert archive.totals("s") == Totals(runs=3, reused=1, evaluated=1, cpu_seconds=5.0)
    assert archive.totals("s", ["a"]) == Totals(runs=2, reused=1, evaluated=0, cpu_seconds=2.5)
    assert archive.totals("nobody") == Totals(0, 0, 0, 0.0)


def test_sweeps_of_one_name_are_told_apart(
    archive: Archive, make_run: MakeRun, make_result: MakeResult
) -> None:
    usage = Usage(cpu=CpuUsage(seconds=2.5))
    for uid, place in (("u-lab", "lab"), ("u-students", "students")):
        archive.put_sweep(SweepRecord(uid=uid, name="study", spec={}, namespace=place))
    archive.put_run(make_run("a", index=0, sweep_uid="u-lab", usage=usage, results=[make_result()]))
    archive.put_run(make_run("b", index=0, sweep_uid="u-students", phase=Phase.FAILED))
    assert {uid: {run for run, _ in archive.finished(uid)} for uid in ("u-lab", "u-students", "study")} == {
        "u-lab": {"a"},
        "u-students": {"b"},
        "study": set(),
    }
    assert archive.totals("u-students") == Totals(1, 0, 0, 0.0)
    assert (archive.cpu_seconds("u-lab"), archive.cpu_seconds("u-students")) == (2.5, 0.0)
    for place in ("lab", "students"):
        found = archive.sweep("study", namespace=place)
        assert found is not None
        assert found.uid == f"u-{place}"
    assert archive.sweep("study") is None


def test_an_intended_evaluation_is_added_once(archive: Archive, make_run: MakeRun) -> None:
    first = IntendedEvaluation(evaluation="se3", alignment="se3", settings="a")
    archive.put_run(make_run("a", evaluations=[first]))
    archive.put_evaluations("a", [IntendedEvaluation(evaluation="yaw"), first.replace(settings="b")])
    record = archive.get("a")
    assert record is not None
    assert [(one.evaluation, one.settings) for one in record.evaluations] == [("se3", "b"), ("yaw", None)]
    with pytest.raises(UnknownNameError, match="unknown run UID 'nobody'"):
        archive.put_evaluations("nobody", [first])


def test_a_run_that_is_called_otherwise_keeps_its_results(
    archive: Archive, make_run: MakeRun, make_result: MakeResult
) -> None:
    archive.put_run(make_run("a", results=[make_result()]))
    record = archive.get("a")
    assert record is not None
    archive.rename_run(record.replace(uid="a@1"), "a")
    assert [one.uid for one in archive.runs()] == ["a@1"]
    assert archive.get("a@1") == record.replace(uid="a@1")


@pytest.mark.parametrize("outcome", list(Outcome))
def test_judged_runs_are_reused(
    archive: Archive, make_run: MakeRun, make_result: MakeResult, outcome: Outcome
) -> None:
    content = Provenance(content_hash="a" * 64)
    archive.put_run(make_run(provenance=content, results=[make_result(outcome=outcome)]))
    found = archive.find_reusable("a" * 64)
    assert found is not None
    assert found.results[0].outcome is outcome
    assert archive.find_reusable("b" * 64) is None


def test_failures_and_unjudged_runs_are_never_reused(
    archive: Archive, make_run: MakeRun, make_result: MakeResult
) -> None:
    content = Provenance(content_hash="a" * 64)
    archive.put_run(make_run("a", provenance=content))
    for phase in (Phase.FAILED, Phase.CANCELLED, Phase.RUNNING):
        archive.put_run(make_run(phase.value, phase=phase, provenance=content, results=[make_result()]))
    assert archive.find_reusable("a" * 64) is None


def test_computed_runs_are_reused_before_copies(
    archive: Archive, make_run: MakeRun, make_result: MakeResult
) -> None:
    for uid, hour, source in (("old", 1, None), ("new", 2, None), ("copy", 3, "old")):
        provenance = Provenance(content_hash="a" * 64, reused_from=source)
        finished = datetime(2026, 1, 1, hour, tzinfo=UTC)
        archive.put_run(make_run(uid, finished=finished, provenance=provenance, results=[make_result()]))
    found = archive.find_reusable("a" * 64)
    assert found is not None
    assert found.uid == "new"


def test_costs_are_the_latest_computed_ones_of_each_algorithm_and_dataset(
    archive: Archive, make_run: MakeRun
) -> None:
    def put(uid: str, algorithm: str = "icp", dataset: str = "hall", **changes: Any) -> None:
        usage = changes.pop("usage", Usage(cpu=CpuUsage(seconds=2.0), wall_seconds=1.0))
        spec = {"algorithmRef": {"name": algorithm}, "datasetRef": {"name": dataset}, "sensors": "lidar"}
        archive.put_run(make_run(uid, spec=spec, usage=usage, **changes))

    begun = datetime(2026, 1, 1, tzinfo=UTC)
    prepared = Provenance(
        algorithm_hash="a", dataset_sha256="d", prepared=Prepared(frames=100, duration_seconds=9.9)
    )
    put("1")
    put("2", created=begun, started=begun + timedelta(seconds=3), provenance=prepared)
    put("3", phase=Phase.FAILED, reason=Reason.DEADLINE_EXCEEDED, namespace="team", created=begun)
    put("4", algorithm="other")
    put("5", algorithm="other", dataset="yard")
    put("copy", provenance=Provenance(reused_from="1"))
    put("unmeasured", usage=Usage())
    put("running", phase=Phase.RUNNING)
    found = {cost.uid: cost for cost in archive.costs(["icp"], ["hall"], each=2)}
    assert list(found) == ["4", "3", "2"]
    assert (found["2"].cpu_seconds, found["2"].wall_seconds) == (2.0, 1.0)
    assert found["2"].prepared == {"frames": 100, "durationSeconds": 9.9}
    assert (found["2"].algorithm_hash, found["2"].dataset_sha256) == ("a", "d")
    assert (found["2"].created, found["3"].created) == (begun, None)
    assert found["3"].reason == Reason.DEADLINE_EXCEEDED
    assert [cost.uid for cost in archive.costs(["icp"], [], most=1)] == ["3"]


def test_sweeps_and_catalog(archive: Archive, make_run: MakeRun) -> None:
    first = SweepRecord(uid="s1", name="study", spec={"matrix": []}, created=datetime(2026, 1, 1, tzinfo=UTC))
    later = SweepRecord(
        uid="s2",
        name="study",
        spec={},
        evaluation={"alignment": "SE3"},
        created=datetime(2026, 1, 2, tzinfo=UTC),
    )
    for sweep in (later, first, later):
        archive.put_sweep(sweep)
    assert archive.sweep("study") == later
    assert archive.sweeps() == [first, later]
    assert archive.sweep("nobody") is None
    one = CatalogEntry(kind="Dataset", name="hall", attributes={"loops": 1}, spec={})
    two = CatalogEntry(kind="Dataset", name="hall", attributes={"loops": 2}, spec={})
    algorithm = CatalogEntry(kind="Algorithm", name="kiss-icp", labels={"kind": "lidar"}, spec={"a": None})
    archive.put_run(make_run(), algorithm, one)
    archive.put_catalog(one, two, algorithm)
    assert archive.catalog("Dataset") == [one, two]
    assert archive.catalog("Algorithm") == [algorithm]


def test_removing_a_run_removes_its_results(
    archive: Archive, make_run: MakeRun, make_result: MakeResult
) -> None:
    archive.put_run(make_run(results=[make_result()]))
    assert archive.remove_run("u1")
    assert not archive.remove_run("u1")
    archive.put_run(make_run())
    record = archive.get("u1")
    assert record is not None
    assert record.results == []


def test_digests_tell_what_differs_and_not_when_it_was_written(
    archive: Archive, make_run: MakeRun, make_result: MakeResult
) -> None:
    runs = [
        make_run("a", results=[make_result()]),
        make_run("b", results=[make_result(), make_result("sim3")]),
    ]
    archive.put_runs(runs)
    first = archive.digests()
    archive.put_runs(reversed(runs))
    assert archive.digests() == first
    archive.put_result("b", make_result("sim3", rmse=2.0))
    second = archive.digests()
    assert second.runs["a"] == first.runs["a"]
    assert second.runs["b"] != first.runs["b"]
    archive.put_run(make_run("a", phase=Phase.FAILED))
    archive.put_sweep(SweepRecord(uid="s", name="s", spec={}))
    third = archive.digests()
    assert third.runs["a"] != second.runs["a"]
    assert (second.rest == first.rest, third.rest == second.rest) == (True, False)


def test_opening_again_finds_everything(url: str, make_run: MakeRun) -> None:
    for uid in ("a", "b"):
        with Archive.open(url) as archive:
            archive.put_run(make_run(uid))
    with Archive.open(url) as archive:
        assert archive.count() == 2


def test_what_a_search_tried_stays_when_its_sweep_is_asked_for_again(url: str) -> None:
    sweep = SweepRecord(uid="s1", name="study", spec={"matrix": []})
    trials = [Trial(values=[0.1 + 0.2, None, {"a": None}]), Trial(values=["x"], told=1, origin="Known")]
    with Archive.open(url) as archive:
        archive.put_sweep(sweep)
        assert archive.sweeps()[0].search is None
        archive.put_search("s1", SearchRecord(trials=trials[:1], spared=3))
        archive.put_sweep(sweep.replace(spec={"matrix": [1]}))
        longer = archive.change_search("s1", lambda had: had.replace(trials=[*had.trials, trials[1]]))
        assert longer == SearchRecord(trials=trials, spared=3)
        assert archive.sweeps() == [sweep.replace(spec={"matrix": [1]}, search=longer)]
        with pytest.raises(UnknownNameError, match="sweep UID"):
            archive.put_search("nobody", longer)


def test_who_adds_to_a_search_waits_for_who_does(url: str) -> None:
    """Two runners of a search are never to give one number to two settings."""
    with Archive.open(url) as archive:
        archive.put_sweep(SweepRecord(uid="s1", name="study", spec={}))

    def draw(value: int) -> SearchRecord:
        with Archive.open(url) as one:
            return one.change_search(
                "s1", lambda had: had.replace(trials=[*had.trials, Trial(values=[value])])
            )

    with ThreadPoolExecutor(4) as threads:
        found = sorted(threads.map(draw, range(4)), key=lambda one: len(one.trials))
    tried = found[-1].trials
    assert [one.trials for one in found] == [tried[:number] for number in range(1, 5)]


def test_an_archive_of_version_1_is_migrated(url: str, put_version: PutVersion) -> None:
    """The archive was written by the last version that knew sweeps by their names alone."""
    put_version(url, 1)
    for _ in range(2):
        upgrade(url)
        with Archive.open(url) as archive:
            found = {record.uid: record for record in archive.runs()}
            sweeps = {sweep.uid: sweep.name for sweep in archive.sweeps()}
    now, before, elsewhere = "1a2b3c4d5e6f7081", "ffffeeeeddddcccc", "0a1b2c3d-0000-4000-8000-000000000000"
    assert set(sweeps.values()) == {"study"}
    assert {uid: (record.sweep, (record.sweep_uid or "")[:16]) for uid, record in found.items()} == {
        f"{before}-0": ("study", before),
        f"{now}-0@c1c1c1c1": ("study", now),
        f"{now}-0": ("study", now),
        f"{now}-1": ("study", now),
        "99992c3d-0000-4000-8000-000000000000": ("study", elsewhere[:16]),
        "slam-hive-abc": ("slam-hive", ""),
    }
    (failed,) = (record for record in found.values() if record.phase is Phase.FAILED)
    (meant,) = failed.evaluations
    assert (meant.evaluation, meant.alignment) == ("se3", "se3")
    assert failed.provenance.algorithm_hash is not None
    assert found[f"{now}-0"].results[0].values["ate"] == {"rmse": 0.1}
    assert found["slam-hive-abc"].evaluations == []


def test_a_newer_archive_is_refused(url: str, make_run: MakeRun, monkeypatch: pytest.MonkeyPatch) -> None:
    with Archive.open(url) as archive:
        archive.put_run(make_run())
    monkeypatch.setattr(schema, "VERSION", 2)
    for attempt in (Archive.open, upgrade):
        with pytest.raises(InputError, match=r"newer slamhive \(schema 6; this one knows up to 2\)"):
            attempt(url)


@pytest.mark.parametrize("version", [1, 2, 3, 4, 5])
def test_an_archive_of_an_earlier_version_waits_for_its_upgrade(
    url: str, version: int, put_version: PutVersion
) -> None:
    """Only who is asked to changes the tables of a team: nobody who opens them."""
    put_version(url, version)
    for read_only in (True, False):
        with pytest.raises(
            InputError, match=rf"schema {version}; this one needs 6\); `slamhive archive upgr"
        ):
            Archive.open(url, read_only=read_only)
    done = upgrade(url)
    assert done is not None
    assert (done.before, done.after) == (version, 6)
    assert upgrade(url) is None
    with Archive.open(url) as archive:
        assert archive.count() == 6
        assert uuid.UUID(archive.identity)
    if "sqlite" in url:
        assert done.copy is not None
        with closing(sqlite3.connect(done.copy)) as copy:
            assert copy.execute("SELECT version FROM slamhive_schema").fetchall() == [(version,)]
            assert copy.execute("SELECT count(*) FROM runs").fetchall() == [(6,)]


def test_a_running_slamhive_stops_writing_when_a_newer_one_takes_the_archive(
    url: str, make_run: MakeRun
) -> None:
    with Archive.open(url) as old:
        old.put_run(make_run("a"))
        engine = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))
        with engine.begin() as connection:
            connection.execute(text("UPDATE slamhive_schema SET version = 7"))
        engine.dispose()
        with pytest.raises(InputError, match="newer slamhive"):
            old.put_run(make_run("b"))
        assert [one.uid for one in old.runs()] == ["a"]


def test_who_upgrades_waits_for_who_writes(postgresql_url: str, put_version: PutVersion) -> None:
    """A writer that has seen the old version must not find new tables under it."""
    put_version(postgresql_url, 2)
    engine = create_engine(postgresql_url.replace("postgresql://", "postgresql+psycopg://"))
    with engine.connect() as writer, ThreadPoolExecutor(1) as threads:
        writer.execute(text("SELECT version FROM slamhive_schema FOR SHARE"))
        waiting = threads.submit(upgrade, postgresql_url)
        asked = "SELECT count(*) FROM pg_stat_activity WHERE wait_event_type = 'Lock'"
        with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as looker:
            deadline = time.monotonic() + 60
            while looker.execute(text(asked)).scalar() == 0:
                assert time.monotonic() < deadline
                assert not waiting.done()
        writer.commit()
        done = waiting.result()
    assert done is not None
    engine.dispose()


def test_every_archive_has_an_identity(url: str, sqlite_url: str) -> None:
    with Archive.open(url) as archive:
        first = archive.identity
    with Archive.open(url, read_only=True) as archive:
        assert archive.identity == first
    with Archive.open(sqlite_url.replace("archive.sqlite", "other.sqlite")) as archive:
        assert archive.identity != first


@pytest.mark.parametrize("bad", ["", "archive.db", "mysql://x/y", "sqlite:://", "postgresql://h:port/x"])
def test_urls_that_cannot_be_used(bad: str) -> None:
    with pytest.raises(InputError, match="is not a database URL; allowed are sqlite:///PATH"):
        Archive.open(bad)


CANARY = "S3cret-canary"


@pytest.mark.parametrize(
    "url",
    [
        "postgresql://slam:{}@db.example:54 32/slam",
        "mysql://slam:{}@db.example/slam",
        "jdbc:postgresql://slam:{}@db.example/slam",
        " postgresql://slam:{}@127.0.0.1:1/slam",
        "postgresql://slam:p@{}@127.0.0.1:1/slam",
        "postgresql://sl/am:{}@127.0.0.1:1/slam",
        "postgresql://slam:{}",
        "postgresql://slam@127.0.0.1:1/slam?password={}",
        "sqlite://slam:{}@db.example/slam",
        "host=127.0.0.1 port=1 password={}",
        "slam:{}@db.example",
    ],
)
def test_no_error_tells_a_password(url: str) -> None:
    pytest.importorskip("psycopg")
    with pytest.raises((InputError, SystemFault)) as caught:
        Archive.open(url.format(CANARY))
    assert CANARY not in "".join(traceback.format_exception(caught.value))


def test_a_file_that_is_no_database(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("not a database, but long enough to be looked at as one" * 20)
    with pytest.raises(InputError, match=r"notes\.txt: the file is not an SQLite database"):
        Archive.open(f"sqlite:///{file}")


def test_a_database_of_another_program_is_not_touched(tmp_path: Path) -> None:
    """MLflow, too, has a table `runs`."""
    sqlite_url = f"sqlite:///{tmp_path / 'mlflow.db'}"
    engine = create_engine(sqlite_url)
    with engine.begin() as connection:
        connection.execute(text("CREATE TABLE runs (run_uuid TEXT)"))
    with pytest.raises(InputError, match="another program's table 'runs', which has no id; name another"):
        Archive.open(sqlite_url)
    assert inspect(engine).get_table_names() == ["runs"]
    engine.dispose()


def test_a_table_that_is_gone_is_damage(sqlite_url: str) -> None:
    Archive.open(sqlite_url).close()
    engine = create_engine(sqlite_url)
    with engine.begin() as connection:
        connection.execute(text("DROP TABLE runs"))
    engine.dispose()
    with (
        Archive.open(sqlite_url, read_only=True) as archive,
        pytest.raises(InputError, match=r"damaged .no such table: runs"),
    ):
        list(archive.runs())


@pytest.mark.parametrize("read_only", [False, True])
def test_a_folder_in_the_archives_place_is_no_archive(tmp_path: Path, read_only: bool) -> None:
    with pytest.raises(InputError, match="is no file; name another"):
        Archive.open(f"sqlite:///{tmp_path}", read_only=read_only)


def test_a_full_disk_is_said_with_what_helps(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'archive.sqlite'}"
    Archive.open(url).close()
    engine = open_engine(parse(url))
    large = text("CREATE TABLE maps AS SELECT zeroblob(10000000)")
    disk = rf"the disk of {re.escape(str(tmp_path))} is full"
    helps = rf"{disk}; what it holds stays: make room \(`slamhive home --size`"
    with engine.begin() as connection:
        connection.execute(text("PRAGMA max_page_count = 1"))  # of those that are there already
        with pytest.raises(SystemFault, match=rf"archive\.sqlite: {helps}"), failures(engine.url):
            connection.execute(large)
    engine.dispose()


@pytest.mark.parametrize("free", [0, 1 << 30])
def test_a_disk_without_room_for_the_files_beside_an_archive_is_full_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free: int
) -> None:
    url = parse(f"sqlite:///{tmp_path / 'archive.sqlite'}")
    error = sqlite3.OperationalError("disk I/O error")
    error.sqlite_errorcode = sqlite3.SQLITE_IOERR  # SQLite says no more where it can't make its log's index
    usage = shutil.disk_usage(tmp_path)._replace(free=free)
    monkeypatch.setattr("slamhive.archive.connection.shutil.disk_usage", lambda _: usage)
    with pytest.raises(SystemFault) as refused, failures(url):
        raise exc.OperationalError("", None, error)
    assert ("is full" in str(refused.value)) == (not free)


def test_an_archive_on_a_full_disk_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    url = f"sqlite:///{tmp_path / 'archive.sqlite'}"
    with Archive.open(url) as archive:
        archive.put_sweep(SweepRecord(uid="s", name="study", spec={}))
    usage = shutil.disk_usage(tmp_path)._replace(free=0)
    monkeypatch.setattr("slamhive.archive.connection.shutil.disk_usage", lambda _: usage)
    (tmp_path / "archive.sqlite-wal").touch()  # of a command that could do no more
    with Archive.open(url, read_only=True) as archive:
        assert [one.name for one in archive.sweeps()] == ["study"]
        assert not (tmp_path / "archive.sqlite-shm").exists()


def test_a_disk_that_an_archive_does_not_fit_on_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("slamhive.archive.connection.publish", refuse)
    with pytest.raises(
        SystemFault, match=rf"archive\.sqlite: the disk of {re.escape(str(tmp_path))} is full"
    ):
        Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}")
    assert list(tmp_path.iterdir()) == []


def test_a_server_that_does_not_answer() -> None:
    pytest.importorskip("psycopg")
    with pytest.raises(SystemFault, match=r"archive postgresql\+psycopg://me:\*\*\*@127\.0\.0\.1:1/x: "):
        Archive.open("postgresql://me:secret@127.0.0.1:1/x")


_WRITER = """
import sys
from slamhive.archive import Archive
from slamhive.model.results import Phase, Result, RunRecord
archive = Archive.open(sys.argv[1])
for number in range(100_000):
    result = Result(evaluation="e", outcome="Tracked", values={})
    uid = f"{sys.argv[2]}-{number}"
    archive.put_run(RunRecord(uid=uid, name="x", spec={}, phase=Phase.SUCCEEDED, results=[result]))
    print(uid, flush=True)
"""


def test_kill_9_loses_no_committed_run(url: str) -> None:
    writers = [
        subprocess.Popen([sys.executable, "-c", _WRITER, url, name], stdout=subprocess.PIPE, text=True)
        for name in ("a", "b")
    ]
    committed = []
    for _ in range(20):
        for writer in writers:
            assert writer.stdout is not None
            committed.append(writer.stdout.readline().strip())
    for writer in writers:
        writer.kill()
        assert writer.stdout is not None
        committed += writer.stdout.read().split()
        writer.stdout.close()
        assert writer.wait() == -signal.SIGKILL
    with Archive.open(url) as archive:
        found = {record.uid: record for record in archive.runs()}
        assert set(committed) <= set(found)
        assert all(len(record.results) == 1 for record in found.values())
        archive.put_run(next(iter(found.values())))


def test_sqlite_does_without_what_postgresql_needs(sqlite_url: str) -> None:
    code = (
        f"import sys\nfrom slamhive.archive import Archive\nwith Archive.open({sqlite_url!r}) as one: "
        "one.count()\nprint([name for name in sys.modules if 'postgresql' in name or 'psycopg' in name])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
