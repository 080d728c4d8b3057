# SPDX-License-Identifier: Apache-2.0
"""Archives that are looked through, copied, brought back, and read where nothing can be written."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import create_engine, event, text

from slamhive.archive import Archive, CatalogEntry, SweepRecord, upgrading
from slamhive.archive.connection import connect, made_aside, open_engine, writing
from slamhive.archive.keeping import backup, check, restore
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.search import SearchRecord, Trial

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from slamhive.model.results import Result, RunRecord

    MakeRun = Callable[..., RunRecord]
    MakeResult = Callable[..., Result]
    PutVersion = Callable[[str, int], None]


@pytest.fixture
def filled(url: str, make_run: MakeRun, make_result: MakeResult) -> str:
    """An archive with runs, results, a sweep and a catalog."""
    with Archive.open(url) as archive:
        tried = SearchRecord(trials=[Trial(values=[1.5, None])], spared=2)
        archive.put_sweep(SweepRecord(uid="s1", name="study", spec={"a": [1.5, None]}, search=tried))
        dataset = CatalogEntry(kind="Dataset", name="hall", attributes={"loops": 1}, spec={})
        archive.put_run(make_run("u0", sweep_uid="s1", results=[make_result()]), None, dataset)
        archive.put_runs(make_run(f"u{k}", sweep_uid="s1", results=[make_result()]) for k in range(1, 5))
    return url


def contents(url: str) -> Any:
    with Archive.open(url, read_only=True) as archive:
        return (
            list(archive.runs()),
            archive.sweeps(),
            archive.catalog("Dataset"),
            archive.catalog("Algorithm"),
        )


def change(url: str, *statements: str) -> None:
    """Do to a database what no program of ours does."""
    engine = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))
    with engine.begin() as connection:
        for statement in statements:
            connection.execute(text(statement))
    engine.dispose()


def test_a_sound_archive_is_found_sound(filled: str) -> None:
    found = check(filled)
    assert (found.faults, found.notes) == ([], [])
    assert (found.counts["runs"], found.counts["results"], found.counts["sweeps"]) == (5, 5, 1)


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("UPDATE runs SET phase = 'Dancing' WHERE uid = 'u3'", "runs: u3: phase: must be"),
        ("UPDATE runs SET spec = '{}' WHERE uid = 'u3'", "column algorithm is 'kiss-icp', where its documen"),
        ("UPDATE results SET outcome = 'x' WHERE run_id = 2", "results: 2 default: 'x' is not a valid Outco"),
        ("UPDATE datasets SET spec = '[1]'", "datasets: hall "),
        ("DELETE FROM datasets", "runs: u0: the dataset that it used is missing"),
    ],
)
def test_a_record_that_was_changed_by_hand_is_named(filled: str, statement: str, said: str) -> None:
    change(filled, statement)
    assert any(said in fault for fault in check(filled).faults)


def test_what_no_rule_of_the_database_keeps_out_is_named(sqlite_url: str, make_run: MakeRun) -> None:
    with Archive.open(sqlite_url) as archive:
        archive.put_runs([make_run("a"), make_run("b", sweep_uid="gone")])
    change(
        sqlite_url,
        "UPDATE runs SET labels = '{broken' WHERE uid = 'a'",
        "INSERT INTO results VALUES (99, 'e', 'Tracked', 1, NULL, NULL, NULL, NULL, '{}')",
        "CREATE TABLE held AS SELECT * FROM runs",
        "DROP TABLE runs",
        "ALTER TABLE held RENAME TO runs",
        "INSERT INTO runs SELECT * FROM runs WHERE uid = 'b'",
    )
    found = check(sqlite_url)
    for said in (
        "a: a document of it is no JSON",
        "99 e: its run is missing",
        "b: stands there 2 times",
    ):
        assert any(said in fault for fault in found.faults)
    assert found.notes == ["2 of the runs belong to a sweep 'study' that is missing"]


@pytest.fixture(params=["sqlite", "postgresql"])
def other_url(request: pytest.FixtureRequest, url: str, tmp_path: Path) -> Iterator[str]:
    """A place for another archive: of each kind for each kind."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'other.sqlite'}"
        return
    own = request.getfixturevalue("postgresql_server")
    name = f"other_{os.urandom(6).hex()}"
    admin = create_engine(own.replace("postgresql://", "postgresql+psycopg://"), isolation_level="AUTOCOMMIT")
    with admin.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}"))
    yield own.replace("/postgres?", f"/{name}?")
    with admin.connect() as connection:
        connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    admin.dispose()


def test_a_backup_is_an_archive_and_goes_back_into_any_database(
    filled: str, other_url: str, tmp_path: Path, make_run: MakeRun
) -> None:
    copy = tmp_path / "copy.sqlite"
    before = contents(filled)
    backup(filled, copy)
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == ["copy.sqlite"]
    assert contents(f"sqlite:///{copy}") == before
    with pytest.raises(InputError, match="exists already; a backup never replaces a file"):
        backup(filled, copy)
    assert restore(other_url, copy)["runs"] == 5
    assert contents(other_url) == before
    assert check(other_url).faults == []
    with Archive.open(other_url) as archive:
        archive.put_run(make_run("new"))  # gets a number that no restored run has
        assert archive.count() == 6


def test_a_backup_is_of_one_moment_while_others_write(
    filled: str, tmp_path: Path, make_run: MakeRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.archive.upgrading._PAGES", 1)
    told: list[tuple[str, float]] = []
    with Archive.open(filled) as archive:

        def write(what: str, share: float) -> None:
            told.append((what, share))
            archive.put_run(make_run(f"later-{len(told)}"))

        counts = backup(filled, tmp_path / "copy.sqlite", write)
        assert archive.count() == 5 + len(told)
    assert counts["runs"] == counts["results"] == 5
    shares = [share for what, share in told if what == "copying the archive"]
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert len(shares) > 3
    with Archive.open(f"sqlite:///{tmp_path / 'copy.sqlite'}", read_only=True) as copy:
        assert {one.uid for one in copy.runs()} == {f"u{k}" for k in range(5)}


def test_a_backup_of_a_damaged_archive_is_kept_and_told(filled: str, tmp_path: Path) -> None:
    change(filled, "UPDATE runs SET phase = 'Dancing' WHERE uid = 'u3'")
    with pytest.raises(
        InputError, match=r"copy\.sqlite: is a copy of what there is, but damaged .*u3: phase"
    ):
        backup(filled, tmp_path / "copy.sqlite")
    with pytest.raises(InputError, match="is damaged, so nothing was restored"):
        restore(filled, tmp_path / "copy.sqlite", force=True)


def test_a_restored_archive_is_another_one(filled: str, tmp_path: Path) -> None:
    """Whoever removes what an archive doesn't know must not take it for the one that knew more."""
    with Archive.open(filled) as archive:
        before = archive.identity
    backup(filled, tmp_path / "copy.sqlite")
    restore(filled, tmp_path / "copy.sqlite", force=True)
    with Archive.open(filled) as archive:
        assert archive.identity != before


def test_a_restore_replaces_nothing_unasked(filled: str, tmp_path: Path, make_run: MakeRun) -> None:
    backup(filled, tmp_path / "copy.sqlite")
    with Archive.open(filled) as archive:
        archive.put_run(make_run("later"))
    with pytest.raises(InputError, match="holds runs or sweeps already; --force"):
        restore(filled, tmp_path / "copy.sqlite")
    with Archive.open(filled) as archive:
        assert archive.count() == 6
    restore(filled, tmp_path / "copy.sqlite", force=True)
    with Archive.open(filled) as archive:
        assert {one.uid for one in archive.runs()} == {f"u{k}" for k in range(5)}


def test_a_restore_that_breaks_off_changes_nothing(
    filled: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    backup(filled, tmp_path / "copy.sqlite")
    before = contents(filled)
    inserted = []

    def refuse(_connection: Any, _cursor: Any, statement: str, *_others: Any) -> None:
        inserted.append(statement)
        if "INSERT INTO results" in statement:
            raise OSError(5, "the power went")

    def tapped(given: str, **options: Any) -> Any:
        engine = connect(given, **options)
        if given == filled and not options:
            event.listen(engine, "before_cursor_execute", refuse)
        return engine

    monkeypatch.setattr("slamhive.archive.keeping.connect", tapped)
    with pytest.raises(OSError, match="the power went"):
        restore(filled, tmp_path / "copy.sqlite", force=True)
    assert any("DELETE FROM runs" in statement for statement in inserted)
    assert contents(filled) == before


@pytest.mark.parametrize("version", [1, 2, 3, 4, 5])
def test_a_backup_of_an_earlier_version_is_restored(
    url: str, tmp_path: Path, version: int, put_version: PutVersion
) -> None:
    put_version(f"sqlite:///{tmp_path / 'old' / 'old.sqlite'}", version)
    assert restore(url, tmp_path / "old" / "old.sqlite")["runs"] == 6
    assert check(url).faults == []
    assert [path.name for path in (tmp_path / "old").iterdir()] == ["old.sqlite"]


@pytest.mark.parametrize("content", [None, b"", b"no database" * 100])
def test_what_is_no_backup_is_refused(filled: str, tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "copy").write_bytes(content)
    with pytest.raises((InputError, SystemFault), match=str(tmp_path / "copy")):
        restore(filled, tmp_path / "copy", force=True)
    assert check(filled).counts["runs"] == 5


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A database of another program."""
    with closing(sqlite3.connect(tmp_path / "foreign.sqlite")) as connection:
        connection.execute("CREATE TABLE customers (name TEXT)")
        connection.commit()
    return tmp_path / "foreign.sqlite"


def test_a_database_of_another_program_is_named_by_what_it_holds(
    filled: str, foreign: Path, tmp_path: Path
) -> None:
    known = foreign.read_bytes()
    with pytest.raises(InputError, match=r"holds no archive, but tables of another program: 'customers'$"):
        Archive.open(f"sqlite:///{foreign}", read_only=True)
    with pytest.raises(InputError, match=r"is no backup: it holds no archive, but tables .* 'customers'$"):
        restore(filled, foreign, force=True)
    with pytest.raises(InputError, match="a folder; name the backup in it"):
        restore(filled, tmp_path, force=True)
    assert (foreign.read_bytes(), check(filled).counts["runs"]) == (known, 5)


def file_of(url: str) -> Path:
    return Path(url.removeprefix("sqlite:///"))


def test_a_damaged_file_is_said_to_be_and_trying_again_is_not_advised(
    sqlite_url: str, make_run: MakeRun
) -> None:
    with Archive.open(sqlite_url) as archive:
        archive.put_runs(make_run(f"u{k}", log_tail="x" * 500) for k in range(500))
    file = file_of(sqlite_url)
    with file.open("r+b") as stream:
        stream.seek(file.stat().st_size // 2)
        stream.write(os.urandom(16384))
    with (
        Archive.open(sqlite_url) as archive,
        pytest.raises(InputError, match="the file is damaged") as caught,
    ):
        list(archive.runs())
    assert not caught.value.retryable
    try:
        faults = check(sqlite_url).faults
    except InputError as error:
        faults = [str(error)]
    assert faults


@pytest.mark.parametrize("content", [b"", b"no database" * 1000, None])
def test_a_backup_takes_the_place_of_a_file_that_is_lost(
    sqlite_url: str, tmp_path: Path, make_run: MakeRun, content: bytes | None
) -> None:
    with Archive.open(sqlite_url) as archive:
        archive.put_runs(make_run(f"u{k}", log_tail="x" * 500) for k in range(500))
    file = file_of(sqlite_url)
    backup(sqlite_url, tmp_path / "copy.sqlite")
    damaged = bytearray(file.read_bytes())
    damaged[len(damaged) // 2 : len(damaged) // 2 + 16384] = os.urandom(16384)
    file.write_bytes(bytes(damaged) if content is None else content)
    file.with_name(f"{file.name}-wal").write_bytes(b"what was last written")
    assert restore(sqlite_url, tmp_path / "copy.sqlite", force=content != b"")["runs"] == 500
    assert check(sqlite_url).faults == []
    assert file.with_name(f"{file.name}.damaged").exists()


@pytest.mark.parametrize("read_only", [True, False])
def test_an_emptied_file_is_no_new_archive(sqlite_url: str, make_run: MakeRun, read_only: bool) -> None:
    with Archive.open(sqlite_url) as archive:
        archive.put_run(make_run())
    os.truncate(file_of(sqlite_url), 0)
    with pytest.raises(InputError, match="the file is empty, so what it held is lost"):
        Archive.open(sqlite_url, read_only=read_only)
    assert file_of(sqlite_url).stat().st_size == 0


def test_a_version_that_is_none_is_damage(sqlite_url: str) -> None:
    Archive.open(sqlite_url).close()
    change(sqlite_url, "UPDATE slamhive_schema SET version = 'x'")
    for attempt in (Archive.open, upgrading.upgrade):
        with pytest.raises(InputError, match="the version of its tables is 'x'"):
            attempt(sqlite_url)


def test_a_new_archive_is_whole_from_its_first_moment(
    sqlite_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = file_of(sqlite_url)
    seen = []
    link = os.link

    def looking(source: Any, target: Any) -> None:
        seen.append(file.exists())
        link(source, target)
        seen.append(file.stat().st_size > 0)

    monkeypatch.setattr(os, "link", looking)
    Archive.open(sqlite_url).close()
    assert seen == [False, True]
    assert [path.name for path in file.parent.iterdir()] == [file.name]


@contextmanager
def unwritable(folder: Path) -> Iterator[None]:
    """Let nobody write to a folder: as another user where we are the one whom nothing is refused."""
    folder.chmod(0o555)
    is_root = os.geteuid() == 0
    if is_root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if is_root:
            os.seteuid(0)
        folder.chmod(0o755)


@pytest.fixture
def visible_folder() -> Iterator[Path]:
    """A folder that other users reach, as pytest's are not."""
    folder = Path(tempfile.mkdtemp(prefix="slamhive-archive-"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


def test_an_archive_is_read_where_nothing_can_be_written(visible_folder: Path, make_run: MakeRun) -> None:
    url = f"sqlite:///{visible_folder / 'a b#.sqlite'}"
    with Archive.open(url) as archive:
        archive.put_runs(make_run(f"u{k}") for k in range(3))
    with unwritable(visible_folder):
        with Archive.open(url, read_only=True) as archive:
            assert len(list(archive.runs())) == 3
        assert check(url).faults == []
        with pytest.raises((InputError, SystemFault), match="sqlite"):
            Archive.open(url).put_run(make_run("new"))
    assert [path.name for path in visible_folder.iterdir()] == ["a b#.sqlite"]


def test_what_another_one_has_just_written_is_not_overlooked(visible_folder: Path, make_run: MakeRun) -> None:
    """The file alone is not the whole archive while somebody works with it."""
    url = f"sqlite:///{visible_folder / 'archive.sqlite'}"
    with Archive.open(url) as archive:
        archive.put_run(make_run("a"))
        with unwritable(visible_folder), Archive.open(url, read_only=True) as reader:
            assert [one.uid for one in reader.runs()] == ["a"]


def test_who_only_reads_can_not_write(filled: str, make_run: MakeRun) -> None:
    with Archive.open(filled, read_only=True) as archive, pytest.raises(SystemFault, match=r"(?i)read.?only"):
        archive.put_run(make_run("new"))


def test_who_only_reads_makes_no_archive(url: str) -> None:
    with pytest.raises(InputError, match=r"no archive at|holds no archive"):
        Archive.open(url, read_only=True)


def files_in(folder: Path) -> frozenset[tuple[str, bytes]]:
    """Return the names and bytes of a folder's files: most statements change none of them."""
    return frozenset((path.name, path.read_bytes()) for path in folder.iterdir())


def lay_out(files: frozenset[tuple[str, bytes]], folder: Path) -> Path:
    """Write files into a new folder and return that."""
    folder.mkdir()
    for name, content in files:
        (folder / name).write_bytes(content)
    return folder


def test_power_loss_at_any_write_keeps_each_committed_run_once(
    sqlite_url: str, tmp_path: Path, make_run: MakeRun, make_result: MakeResult
) -> None:
    """The files as they are after each statement, opened again as after a power cut."""
    file = file_of(sqlite_url)
    committed: set[str] = set()
    moments: list[frozenset[tuple[str, bytes]]] = []
    known_at: dict[frozenset[tuple[str, bytes]], set[str]] = {}

    def cut(*_: Any) -> None:
        moments.append(files_in(file.parent))
        known_at[moments[-1]] = {*committed}

    with Archive.open(sqlite_url) as archive:
        for name in ("before_cursor_execute", "after_cursor_execute", "commit"):
            event.listen(archive._engine, name, cut)
        archive.put_sweep(SweepRecord(uid="s1", name="study", spec={}))
        for uid in ("a", "b", "a", "c"):
            archive.put_run(make_run(uid, sweep_uid="s1", results=[make_result()]))
            committed.add(uid)
            cut()
        archive.remove_run("c")
        committed.discard("c")
        cut()
    assert len(moments) > 40
    assert len(known_at) > 8
    for number, (files, known) in enumerate(known_at.items()):
        url = f"sqlite:///{lay_out(files, tmp_path / str(number)) / file.name}"
        assert check(url).faults == []
        with Archive.open(url) as archive:
            found = [one.uid for one in archive.runs()]
            assert len(found) == len(set(found))
            assert known - {"c"} <= set(found) <= {"a", "b", "c"}
            assert all(len(one.results) == 1 for one in archive.runs())
            archive.put_run(make_run("after"))


def test_power_loss_during_an_upgrade_leaves_one_version_or_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, put_version: PutVersion
) -> None:
    place = tmp_path / "home"
    url = f"sqlite:///{place / 'archive.sqlite'}"
    put_version(url, 1)
    taken: list[frozenset[tuple[str, bytes]]] = []

    def cut(*_: Any) -> None:
        taken.append(files_in(place))

    opened = open_engine

    def tapped(*given: Any, **options: Any) -> Any:
        engine = opened(*given, **options)
        for name in ("after_cursor_execute", "commit"):
            event.listen(engine, name, cut)
        return engine

    monkeypatch.setattr(upgrading, "open_engine", tapped)
    upgrading.upgrade(url)
    monkeypatch.undo()
    assert len(taken) > 10
    for number, files in enumerate(dict.fromkeys(taken)):
        again = f"sqlite:///{lay_out(files, tmp_path / str(number)) / 'archive.sqlite'}"
        upgrading.upgrade(again)
        assert check(again).faults == []
        with Archive.open(again) as archive:
            assert archive.count() == 6


KILLED = """
import os, signal
from slamhive.archive import upgrading
upgrading.{step} = lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)
upgrading.upgrade({url!r})
"""


@pytest.mark.parametrize("steps", [["publish", "publish"], ["migrate", "migrate"], ["publish", "migrate"]])
def test_what_killed_upgrades_left_goes_with_the_next(
    sqlite_url: str, put_version: PutVersion, steps: list[str]
) -> None:
    place = file_of(sqlite_url).parent
    put_version(sqlite_url, 1)
    for step in steps:
        ended = subprocess.run(
            [sys.executable, "-c", KILLED.format(step=step, url=sqlite_url)], check=False, timeout=300
        )
        assert ended.returncode == -signal.SIGKILL
    copied = f".{file_of(sqlite_url).name}.schema-1.0123456789ab.making"
    (place / copied).write_text("nobody's lock says whose this is")
    done = upgrading.upgrade(sqlite_url)
    assert done is not None
    kept = file_of(sqlite_url).with_name("archive.sqlite.schema-1")
    assert done.copy == kept
    assert {path.name for path in place.iterdir()} == {"archive.sqlite", kept.name, copied}
    assert check(sqlite_url).counts["runs"] == 6


def test_what_somebody_makes_is_no_leftover(tmp_path: Path) -> None:
    file = tmp_path / "archive.sqlite"
    with made_aside(file) as first, made_aside(file) as second:
        first.write_text("one")
        second.write_text("two")
        with made_aside(file):
            assert (first.read_text(), second.read_text()) == ("one", "two")
    assert list(tmp_path.iterdir()) == []


def test_writing_waits_its_turn_by_one_statement_more(sqlite_url: str) -> None:
    """The check of the archive's version before each write is one query inside its transaction."""
    engine = connect(sqlite_url)
    statements: list[str] = []
    event.listen(engine, "before_cursor_execute", lambda *told: statements.append(told[2]))
    with writing(engine):
        pass
    engine.dispose()
    assert [words.split()[0] for words in statements] == ["BEGIN", "SELECT"]


def test_the_commands_say_what_they_did(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, put_version: PutVersion
) -> None:
    from typer.testing import CliRunner

    from slamhive.cli.main import app

    home = tmp_path / "home"
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    monkeypatch.delenv("SLAMHIVE_ARCHIVE", raising=False)
    url = f"sqlite:///{home / 'archive.sqlite'}"

    def call(*words: str) -> tuple[int, str]:
        told = CliRunner().invoke(app, ["archive", *words])
        return told.exit_code, " ".join(told.output.split())

    put_version(url, 2)
    code, said = call("upgrade")
    assert code == 0
    assert "brought from schema 2 to 6; as it was:" in said
    assert call("upgrade")[1].endswith("nothing to do")
    assert "6 runs, 5 results, 3 sweeps: sound" in call("check")[1]
    assert call("backup", str(tmp_path / "copy"))[0] == 0
    with closing(sqlite3.connect(home / "archive.sqlite")) as held:
        held.execute("UPDATE runs SET phase = 'Dancing'")
        held.commit()
    code, said = call("check")
    assert code == 1
    assert "phase" in said
    assert (
        "6 runs, 5 results, 3 sweeps restored from" in call("restore", str(tmp_path / "copy"), "--force")[1]
    )
    assert call("check")[0] == 0


def test_a_home_s_own_file_is_brought_along_and_a_team_s_server_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, postgresql_url: str, put_version: PutVersion
) -> None:
    from slamhive.cli.parts.console import open_archive
    from slamhive.local.home.folder import Home

    monkeypatch.delenv("SLAMHIVE_ARCHIVE", raising=False)
    put_version(f"sqlite:///{tmp_path / 'home' / 'archive.sqlite'}", 2)
    for _ in range(2):
        with open_archive(Home.at(tmp_path / "home")) as archive:
            assert archive.count() == 6
    kept = {path.name for path in (tmp_path / "home").iterdir()}
    assert kept == {"archive.sqlite", "archive.sqlite.schema-2"}
    monkeypatch.setenv("SLAMHIVE_ARCHIVE", postgresql_url)
    put_version(postgresql_url, 2)
    with pytest.raises(InputError, match="`slamhive archive upgrade` brings it up to date"):
        open_archive(Home.at(tmp_path / "home"))
