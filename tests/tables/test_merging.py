# SPDX-License-Identifier: Apache-2.0
"""Merging of homes: no run lost, none twice, nothing here replaced, and wherever it is killed it goes on."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import update

from slamhive.archive import Archive, CatalogEntry, schema
from slamhive.archive.connection import open_engine, parse, writing
from slamhive.local.home.folder import lock
from slamhive.local.home.removed import remove_files
from slamhive.local.housekeeping import merging
from slamhive.model.results import Outcome, Result
from slamhive.model.search import SearchRecord, Trial

if TYPE_CHECKING:
    from collections.abc import Callable

VERSION2 = Path(__file__).parents[1] / "archive" / "version2.sql"


def result(evaluation: str, error: float) -> Result:
    return Result(evaluation=evaluation, outcome=Outcome.TRACKED, values={"ate": {"rmse": error}})


@pytest.fixture
def homes(keep: Callable[[str], Any]) -> tuple[Any, Any]:
    """Two homes: a run in both, one with another result there, two of one UID, one of its own in each."""
    mine, anna = keep("mine"), keep("anna")
    fill(mine, anna)
    return mine, anna


def fill(mine: Any, anna: Any) -> None:
    for one in (mine, anna):
        one.run("both")
    mine.run("measured", content="c2", results=[result("se3", 0.1)])
    anna.run("measured", content="c2", results=[result("se3", 0.2), result("sim3", 0.3)])
    mine.run("other", content="c3")
    anna.run("other", content="c4")
    mine.run("only-mine", content="c5")
    first = anna.run("only-theirs", content="c6", sweep="t")
    anna.run("reused", content="c6", sweep="t", folder=first.folder, files=False)


def files(home: Any) -> dict[str, str]:
    """Return the trajectories below ``runs`` with what they say, by their paths from there."""
    root = home.path / "runs"
    return {str(path.relative_to(root)): path.read_text() for path in root.glob("*/*/run/output/*.txt")}


def state(home: Any) -> tuple[Any, Any]:
    return home.records(), files(home)


def test_runs_of_both_are_there_once(homes: tuple[Any, Any], run_command: Callable[..., Any]) -> None:
    mine, anna = homes
    before, theirs = mine.records(), state(anna)
    code, out, err = run_command("archive", "merge", anna.path)
    assert code == 0, err
    now = mine.records()
    assert set(now) == {*before, "other@c4c4c4c4", "only-theirs", "reused"}
    assert "to merge: 3 runs" in out
    assert "merged: 3 runs, 2 results" in out
    assert {uid: now[uid] for uid in before if uid != "measured"} == {
        uid: record for uid, record in before.items() if uid != "measured"
    }
    assert [(one.evaluation, one.values["ate"]["rmse"]) for one in now["measured"].results] == [
        ("se3", 0.1),
        ("se3@anna", 0.2),
        ("sim3", 0.3),
    ]
    assert "evaluation se3 says something else there: it is kept as se3@anna" in " ".join(err.split())
    assert state(anna) == theirs


@pytest.mark.parametrize("side", ["mine", "theirs"])
def test_either_archive_may_be_in_postgresql(
    keep: Callable[[str], Any],
    run_command: Callable[..., Any],
    postgresql_url: str,
    monkeypatch: pytest.MonkeyPatch,
    side: str,
) -> None:
    mine, anna = keep("mine"), keep("anna")
    served = mine if side == "mine" else anna
    served.home = replace(served.home, archive_url=postgresql_url)
    fill(mine, anna)
    if side == "mine":
        monkeypatch.setenv("SLAMHIVE_ARCHIVE", postgresql_url)
    before, theirs = set(mine.records()), anna.records()
    other = anna.path if side == "mine" else f"anna={postgresql_url}"
    code, out, err = run_command("archive", "merge", other)
    assert code == 0, err
    assert "merged: 3 runs, 2 results" in out
    now = mine.records()
    assert set(now) == {*before, "other@c4c4c4c4", "only-theirs", "reused"}
    assert {one.evaluation: one.values["ate"]["rmse"] for one in now["measured"].results} == {
        "se3": 0.1,
        "se3@anna": 0.2,
        "sim3": 0.3,
    }
    # A database alone has no files to bring.
    assert ("t/s-only-theirs/run/output/trajectory.txt" in files(mine)) == (side == "mine")
    assert anna.records() == theirs
    code, _, err = run_command("archive", "merge", other)
    assert code == 0, err
    assert mine.records() == now


def test_files_come_along_under_names_that_are_free(
    homes: tuple[Any, Any], run_command: Callable[..., Any]
) -> None:
    mine, anna = homes
    before = files(mine)
    run_command("archive", "merge", anna.path)
    now = mine.records()
    assert files(mine).items() > before.items()
    for uid, content in (("other@c4c4c4c4", "c4"), ("other", "c3"), ("reused", "c6"), ("both", "c1")):
        record = now[uid]
        assert record.folder.startswith(str(mine.path))
        text = (Path(record.folder) / "run/output/trajectory.txt").read_text()
        assert text.endswith(f"# {content}\n")
        assert uid == "reused" or record.trajectory.path == str(
            Path(record.folder) / "run/output/trajectory.txt"
        )
    assert now["reused"].folder == now["only-theirs"].folder
    assert now["other@c4c4c4c4"].folder.endswith("s-other@c4c4c4c4")


def test_merging_again_or_back_brings_nothing(
    homes: tuple[Any, Any], run_command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, anna = homes
    run_command("archive", "merge", anna.path)
    merged = state(mine)
    _, out, _ = run_command("archive", "merge", anna.path)
    assert "to merge: 0 runs" in out
    assert state(mine) == merged
    monkeypatch.setenv("SLAMHIVE_HOME", str(anna.path))
    _, out, _ = run_command("archive", "merge", mine.path)
    assert "merged: 2 runs" in out  # mine of the UID that both have, and the one that was only here
    assert len(anna.records()) == 7


def test_holes_stay_holes_and_what_is_too_large_is_named(
    keep: Callable[[str], Any], run_command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, anna = keep("mine"), keep("anna")
    monkeypatch.setattr(merging, "_LIMIT_BYTES", 80 << 20)
    output = Path(anna.run("a").folder or "") / "run" / "output"
    with (output / "map.db").open("wb") as file:
        file.write(b"first")
        file.seek(40 << 20)
        file.write(b"second" * 1000)
        file.truncate(64 << 20)
    with (output / "beyond.db").open("wb") as file:
        file.truncate(1 << 40)
    there = (output / "map.db").stat()
    code, _, err = run_command("archive", "merge", anna.path)
    assert code == 0, err
    assert f"{output}/beyond.db: is not copied, as with its 1,048,576 MiB" in " ".join(err.split())
    copied = Path(mine.records()["a"].folder) / "run" / "output"
    assert {path.name for path in copied.iterdir()} == {"map.db", "trajectory.txt"}
    assert (copied / "map.db").read_bytes() == (output / "map.db").read_bytes()
    found = (copied / "map.db").stat()
    assert (found.st_mtime_ns, found.st_mode) == (there.st_mtime_ns, there.st_mode)
    assert found.st_blocks * 512 < 1 << 20


def test_nothing_is_merged_without_room_for_all_of_it(
    homes: tuple[Any, Any], run_command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, anna = homes
    before = state(mine)
    usage = merging.shutil.disk_usage(mine.path)
    monkeypatch.setattr(merging.shutil, "disk_usage", lambda _: usage._replace(free=60))
    code, _, err = run_command("archive", "merge", anna.path)
    assert (code, "nothing was merged" in " ".join(err.split())) == (1, True)
    assert state(mine) == before
    monkeypatch.undo()


def test_a_dry_run_changes_nothing(
    homes: tuple[Any, Any], run_command: Callable[..., Any], keep: Callable[[str], Any]
) -> None:
    mine, anna = homes
    before = state(mine)
    code, out, _ = run_command("archive", "merge", anna.path, "--dry-run")
    assert (code, "to merge: 3 runs" in out) == (0, True)
    assert state(mine) == before
    assert not (mine.path / merging.ASIDE).exists()
    (mine.path / "archive.sqlite").unlink()
    _, out, _ = run_command("archive", "merge", anna.path, "--dry-run")
    assert "to merge: 5 runs" in out
    assert not (mine.path / "archive.sqlite").exists()


class Killed(BaseException):
    """Stands for the end of the process."""


STEPS = [
    (merging.shutil, "copy2"),
    (merging, "write_whole"),
    (merging, "settle"),
    (merging.Path, "rename"),
    (Archive, "put_sweep"),
    (Archive, "put_run"),
    (Archive, "put_result"),
    (merging, "clear"),
]


@pytest.mark.parametrize(("owner", "name"), STEPS, ids=[name for _, name in STEPS])
@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
@pytest.mark.parametrize("number", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_merge_that_was_killed_goes_on(
    homes: tuple[Any, Any],
    run_command: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    owner: Any,
    name: str,
    *,
    after: bool,
    number: int,
) -> None:
    mine, anna = homes
    real, calls = getattr(owner, name), 0

    def killed(*arguments: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == number and not after:
            raise Killed
        done = real(*arguments, **options)
        if calls == number:
            raise Killed
        return done

    with monkeypatch.context() as patch:
        patch.setattr(owner, name, killed)
        try:
            run_command("archive", "merge", anna.path)
        except Killed:
            pass
        else:
            assert calls < number
    for record in mine.records().values():  # whatever is known has its files
        assert Path(record.folder or "").is_dir()
    code, _, err = run_command("archive", "merge", anna.path)
    assert code == 0, err
    assert set(mine.records()) == {
        *("both", "measured", "other", "only-mine"),
        *("other@c4c4c4c4", "only-theirs", "reused"),
    }
    assert len(files(mine)) == 6
    assert len(mine.records()["measured"].results) == 3
    assert not (mine.path / merging.ASIDE).exists()


def test_what_a_killed_merge_left_is_collected(
    homes: tuple[Any, Any], run_command: Callable[..., Any]
) -> None:
    mine, _ = homes
    (mine.path / merging.ASIDE / "run").mkdir(parents=True)
    _, out, _ = run_command("gc", "--yes")
    assert "a merge was interrupted" in " ".join(out.split())
    assert not (mine.path / merging.ASIDE).exists()


@pytest.mark.parametrize("at_work", ["runner.lock", "fetch.lock"])
def test_nothing_is_merged_while_somebody_is_at_work(
    homes: tuple[Any, Any], run_command: Callable[..., Any], at_work: str
) -> None:
    mine, anna = homes
    before = state(mine)
    with lock(mine.path / at_work, shared=True):
        code, _, err = run_command("archive", "merge", anna.path)
    assert (code, "at work" in err) == (2, True)
    assert state(mine) == before


def test_nothing_is_pruned_while_a_merge_is_at_work(
    homes: tuple[Any, Any], run_command: Callable[..., Any]
) -> None:
    mine, _ = homes
    before = state(mine)
    with mine.home.exclusive("slamhive archive merge"):
        code, _, err = run_command("results", "prune", "--sweep", "s", "--yes")
    assert (code, state(mine)) == (2, before)
    assert "slamhive archive merge (process" in err


def test_an_archive_of_an_earlier_version_is_merged_and_stays(
    keep: Callable[[str], Any], run_command: Callable[..., Any], tmp_path: Path
) -> None:
    mine = keep("mine")
    mine.run("a")
    (tmp_path / "old").mkdir()
    file = tmp_path / "old" / "archive.sqlite"
    with closing(sqlite3.connect(file)) as connection:
        connection.executescript(VERSION2.read_text())
        count = connection.execute("SELECT count(*) FROM runs").fetchone()[0]
        connection.commit()
    before = file.read_bytes()
    code, _, err = run_command("archive", "merge", file)
    assert code == 0, err
    assert len(mine.records()) == count + 1
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == ["archive.sqlite"]


def test_a_newer_archive_and_this_home_itself_are_refused(
    homes: tuple[Any, Any], run_command: Callable[..., Any]
) -> None:
    mine, anna = homes
    engine = open_engine(parse(anna.home.archive_url))
    with writing(engine) as connection:
        connection.execute(update(schema.schema_version).values(version=99))
    engine.dispose()
    code, _, err = run_command("archive", "merge", anna.path)
    assert (code, "written by a newer slamhive" in " ".join(err.split())) == (2, True)
    code, _, err = run_command("archive", "merge", "/nowhere")
    assert (code, err.strip()) == (2, "error: /nowhere: no such folder or file")
    code, _, err = run_command("archive", "merge", mine.path)
    assert (code, "is this home itself" in " ".join(err.split())) == (2, True)


def test_sweeps_catalog_and_notes_of_removed_files_come_along(
    keep: Callable[[str], Any], run_command: Callable[..., Any]
) -> None:
    mine, anna = keep("mine"), keep("anna")
    mine.run("a")
    record = anna.run("b", content="c2", sweep="t")
    entry = CatalogEntry(kind="Algorithm", name="icp", spec={"x": 1})
    with Archive.open(anna.home.archive_url) as archive:
        archive.put_run(record, entry)
    remove_files(Path(record.folder), 1000)
    run_command("archive", "merge", anna.path)
    with Archive.open(mine.home.archive_url) as archive:
        assert {one.name for one in archive.sweeps()} == {"s", "t"}
        assert archive.catalog("Algorithm") == [entry]
        assert archive.used(["b"]) == {"b": (entry.content_hash, None)}
    _, out, _ = run_command("results", "show", "b")
    assert "its files were removed on" in out


@pytest.mark.parametrize(
    ("ours", "theirs", "kept"), [([], [1, 2], [1, 2]), ([1], [1, 2], [1, 2]), ([1, 3], [1, 2, 4], [1, 3])]
)
def test_a_search_goes_on_from_where_it_came_furthest(
    keep: Callable[[str], Any],
    run_command: Callable[..., Any],
    ours: list[int],
    theirs: list[int],
    kept: list[int],
) -> None:
    """One that tried something else there stays as it is here, as the runs here are of that."""
    mine, anna = keep("mine"), keep("anna")
    for home, values in ((mine, ours), (anna, theirs)):
        home.run("both")
        with Archive.open(home.home.archive_url) as archive:
            archive.put_search("s-uid", SearchRecord(trials=[Trial(values=[value]) for value in values]))
    assert run_command("archive", "merge", anna.path)[0] == 0
    with Archive.open(mine.home.archive_url) as archive:
        found = archive.sweeps()[0].search
    assert found is not None
    assert [trial.values for trial in found.trials] == [[value] for value in kept]
