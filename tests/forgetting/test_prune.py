# SPDX-License-Identifier: Apache-2.0
"""``slamhive results prune``: what goes, what stays readable, and that nothing goes unasked."""

from __future__ import annotations

import os
import re
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive
from slamhive.bridges import slamhive1
from slamhive.dashboard.sources.archived import Workstation
from slamhive.local.home import removed
from slamhive.local.home.extent import DiskTally
from slamhive.local.home.folder import lock
from slamhive.local.home.removed import NOTE, removed_from
from slamhive.local.housekeeping import forgetting
from slamhive.local.running.evaluations import measure_record
from slamhive.local.running.workbench import Workbench
from slamhive.model.evaluation import EvaluationSettings
from thinning import thinned

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def test_files_of_superseded_runs_go_and_every_number_stays(lab: Any, slamhive: Callable[..., Any]) -> None:
    for version in ("v1", "v2"):
        lab.run(f"a-{version}", version=version, size=300_000)
    before, tables = lab.records(), slamhive("results", "table", "--superseded", "--format", "json").out
    said = slamhive("results", "prune", "--superseded", "--yes")
    assert said.code == 0
    assert re.search(r"s 1 [0-9]{3} KiB 4 .*removed: files of 1 run, [0-9]{3} KiB in 4 files", said.out)
    assert lab.files() == {
        f"s/a-v1/{NOTE}",
        *(f"s/a-v2/{name}" for name in ("summary.json", "attempt.json")),
        *(f"s/a-v2/run/output/{name}" for name in ("map.bin", "trajectory.txt")),
    }
    assert lab.records() == before
    assert slamhive("results", "table", "--superseded", "--format", "json").out == tables
    again = slamhive("results", "prune", "--superseded", "--yes")
    assert (again.code, again.out) == (0, "no run has anything to remove")
    assert re.search(r"removed files of runs 1 .*prune --records", slamhive("home", "--size").out)
    assert slamhive("results", "prune", "--superseded", "--records", "--yes").code == 0
    assert f"s/a-v1/{NOTE}" not in lab.files()


def test_nothing_goes_unasked(lab: Any, slamhive: Callable[..., Any]) -> None:
    lab.run("a", failed=True)
    before = lab.files()
    assert "a dry run" in slamhive("results", "prune", "--failed", "--dry-run").err
    unasked = slamhive("results", "prune", "--failed")
    assert (unasked.code, "--yes removes this" in unasked.err) == (2, True)
    assert lab.files() == before


@pytest.mark.parametrize("answer", ["y", "n"])
def test_the_answer_decides(
    lab: Any, slamhive: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, answer: str
) -> None:
    lab.run("a")
    before = lab.files()
    monkeypatch.setattr("sys.stdin", type("Terminal", (), {"isatty": lambda _: True})())
    monkeypatch.setattr("typer.confirm", lambda question, **_: answer == "y" and "1 run?" in question)
    said = slamhive("results", "prune", "--sweep", "s")
    assert said.code == (0 if answer == "y" else 1)
    assert (lab.files() == before) == (answer == "n")


@pytest.mark.parametrize(
    ("words", "gone"),
    [
        (("--failed",), {"failed"}),
        (("--older-than", "30d"), {"old"}),
        (("--older-than", "2w"), {"old", "middle"}),
        (("--older-than", "2w", "--larger-than", "1Mi"), {"old"}),
        (("--larger-than", "1Mi"), {"old", "other"}),
        (("--sweep", "t"), {"other"}),
        (("--where", "algorithm == 'orb' or phase == 'Failed'"), {"other", "failed"}),
        (("--where", "algorithm == 'orb'", "--failed"), set()),
    ],
)
def test_what_is_chosen(
    lab: Any, slamhive: Callable[..., Any], words: tuple[str, ...], gone: set[str]
) -> None:
    long_ago = datetime.now(UTC)
    for name, days, fields in (
        ("old", 60, {"size": 2 << 20}),
        ("middle", 20, {}),
        ("failed", 0, {"failed": True}),
        ("other", 0, {"sweep": "t", "algorithm": "orb", "size": 2 << 20}),
    ):
        lab.run(name, finished=long_ago - timedelta(days=days), **fields)
    assert slamhive("results", "prune", *words, "--yes").code == 0
    assert {path.parent.name for path in (lab.home.path / "runs").glob(f"*/*/{NOTE}")} == gone


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((), "say which runs: --superseded, --failed"),
        (("--older-than", "soon"), "--older-than: expected an age such as 30d"),
        (("--larger-than", "100MB"), "--larger-than: expected a size such as 100Mi"),
        (("--where", "nothing == 1"), "unknown column 'nothing'"),
        (("--sweep", "nosuch"), "unknown sweep 'nosuch'"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(
    lab: Any, slamhive: Callable[..., Any], words: tuple[str, ...], sentence: str
) -> None:
    lab.run("a")
    said = slamhive("results", "prune", *words, "--yes")
    assert (said.code, sentence in said.err) == (2, True), said.err
    assert not list(lab.home.path.glob(f"runs/*/*/{NOTE}"))


def test_readers_say_when_the_files_were_removed(lab: Any, slamhive: Callable[..., Any]) -> None:
    record = lab.run("a")
    slamhive("results", "prune", "--sweep", "s", "--yes")
    said = re.search(r"its files were removed on \d{4}-\d\d-\d\d", slamhive("results", "show", "a").out)
    assert said is not None
    sentence = said[0]
    assert sentence in slamhive("results", "show", "a", "--json").out
    source = Workstation(lab.home.archive_url, lab.home.path)
    assert source.place(record) is None
    assert str(source.absence(record)).startswith(sentence)
    with lab.archive() as archive:
        bench = Workbench(lab.home, None, archive)  # type: ignore[arg-type]
        problem = measure_record(bench, record, EvaluationSettings())
    assert str(problem).partition("'")[2].startswith(sentence)


def test_files_that_another_run_refers_to_stay_and_are_named(lab: Any, slamhive: Callable[..., Any]) -> None:
    first = lab.run("first", size=MOST)
    lab.run("second", sweep="t", files=False, folder=first.folder, provenance=first.provenance)
    before = lab.files()
    said = slamhive("results", "prune", "--sweep", "s", "--yes")
    assert lab.files() == before
    assert "files of 1 run stay" in said.err
    assert "not chosen took their results" in said.err
    # With its record the run goes, and the files stay all the same.
    slamhive("results", "prune", "--sweep", "s", "--records", "--yes")
    assert (lab.files(), set(lab.records())) == (before, {"u-second"})
    slamhive("results", "prune", "--sweep", "t", "--records", "--yes")
    assert (lab.files(), lab.records()) == (set(), {})


MOST = 100_000


def test_records_go_when_told_to(lab: Any, slamhive: Callable[..., Any]) -> None:
    lab.run("v1", version="v1")
    lab.run("v2", version="v2")
    said = slamhive("results", "prune", "--where", "name == 'v2'", "--records", "--yes")
    assert "removed: files and records of 1 run" in said.out
    assert "1 run of earlier versions will count as current again" in said.err
    assert set(lab.records()) == {"u-v1"}
    assert not lab.folder("v2").exists()


def test_imported_files_are_never_touched(lab: Any, slamhive: Callable[..., Any], tmp_path: Path) -> None:
    # Even where a folder of the home is called like the imported one.
    theirs = tmp_path / "original" / "s" / "a"
    theirs.mkdir(parents=True)
    (theirs / "traj.txt").write_text("0 0 0 0 0 0 0 1\n")
    lab.run("a", labels={"source": slamhive1.SOURCE}, folder=str(theirs))
    before = lab.files()
    said = slamhive("results", "prune", "--sweep", "s", "--yes")
    assert "1 imported run" in said.err
    assert (lab.files(), (theirs / "traj.txt").exists()) == (before, True)


@pytest.mark.parametrize("at_work", ["runner.lock", "fetch.lock"])
def test_nothing_goes_while_a_runner_is_at_work(lab: Any, slamhive: Callable[..., Any], at_work: str) -> None:
    lab.run("a")
    before = lab.files()
    with lock(lab.home.path / at_work):
        said = slamhive("results", "prune", "--sweep", "s", "--yes")
    assert (said.code, "at work" in said.err, lab.files()) == (2, True, before)


def test_what_a_killed_slamhive_left_at_work_is_left_alone(lab: Any, slamhive: Callable[..., Any]) -> None:
    lab.run("a")
    (lab.folder("a") / "summary.json").unlink()
    (lab.folder("a") / "process.json").write_text("{}")
    before = lab.files()
    assert "left programs" in slamhive("results", "prune", "--sweep", "s", "--yes").err.replace("have ", "")
    assert lab.files() == before


class Killed(BaseException):
    """The end of the process."""


@pytest.mark.parametrize(
    ("steps", "records"),
    [*((step, False) for step in (1, 4, 8)), *thinned((step, True) for step in range(13))],
)
def test_wherever_it_is_killed_the_home_reads_right_and_a_second_call_goes_on(
    lab: Any, slamhive: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, steps: int, records: bool
) -> None:
    for name in ("a", "b"):
        lab.run(name, age=timedelta(days=900))
    left = steps

    def dying(call: Callable[..., Any]) -> Callable[..., Any]:
        def step(*given: Any, **more: Any) -> Any:
            nonlocal left
            if left == 0:
                raise Killed
            left -= 1
            return call(*given, **more)

        return step

    words = ("results", "prune", "--older-than", "0m", "--yes", *(["--records"] if records else []))
    with monkeypatch.context() as patched:
        patched.setattr(removed, "remove", dying(removed.remove))
        patched.setattr(forgetting, "remove", dying(forgetting.remove))
        patched.setattr(removed, "write_whole", dying(removed.write_whole))
        patched.setattr(Archive, "remove_runs", dying(Archive.remove_runs))
        try:
            slamhive(*words)
        except Killed:
            pass
        else:
            assert left > 0 or steps >= 8
    for record in lab.records().values():
        folder = lab.folder(record.name)
        whole = (folder / "run" / "output" / "map.bin").exists() and (folder / "summary.json").exists()
        assert whole or removed_from(folder) is not None
        assert slamhive("results", "show", record.name).code == 0
    assert slamhive(*words).code == 0
    assert bool(lab.records()) != records
    assert {path.rpartition("/")[2] for path in lab.files()} <= {NOTE}


def test_a_home_without_archive_loses_nothing(lab: Any, slamhive: Callable[..., Any]) -> None:
    lab.run("a")
    before = lab.files()
    (lab.home.path / "archive.sqlite").unlink()
    said = slamhive("results", "prune", "--older-than", "1m", "--yes")
    assert (said.code, "nothing is known of any run" in said.err, lab.files()) == (2, True, before)


def test_a_home_of_a_newer_version_is_refused(
    lab: Any, slamhive: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    lab.run("a")
    before = lab.files()
    monkeypatch.setattr("slamhive.archive.schema.VERSION", 2)
    said = slamhive("results", "prune", "--sweep", "s", "--yes")
    assert (said.code, "written by a newer slamhive" in said.err) == (2, True)
    assert lab.files() == before


def test_what_has_come_since_it_was_shown_stays(
    lab: Any, slamhive: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    lab.run("a")

    def late(*_: Any, **__: Any) -> bool:
        lab.run("b")
        return True

    monkeypatch.setattr("slamhive.cli.forgetting.agreed", late)
    assert slamhive("results", "prune", "--sweep", "s").code == 0
    assert (lab.folder("b") / "run").exists()
    assert not (lab.folder("a") / "run").exists()


def test_room_is_counted_by_blocks_and_names(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "map").write_bytes(b"m" * 40_960)
    os.link(tmp_path / "a" / "map", tmp_path / "b")
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(1 << 30)
    (tmp_path / "link").symlink_to(tmp_path)
    size = (tmp_path / "b").stat().st_blocks * 512
    taken = DiskTally()
    assert [taken.of(tmp_path / name).size for name in ("a", "b")] == [size, 0]
    assert [DiskTally().of(tmp_path / name).size for name in ("sparse", "nothing")] == [0, 0]
    freed = DiskTally(freed=True)
    assert [freed.of(tmp_path / name).size for name in ("a", "b")] == [0, size]
    assert DiskTally().of(tmp_path).files == 4


@pytest.mark.parametrize(
    "text", ["", "{}", '{"removed": 1, "bytes": 2}', '{"removed": "x", "bytes": 2}', "[" * 99]
)
def test_a_note_that_says_nothing_counts_as_none(tmp_path: Path, text: str) -> None:
    (tmp_path / NOTE).write_text(text)
    assert removed_from(tmp_path) is None


def test_folders_that_an_algorithm_locked_or_nested_go_too(tmp_path: Path) -> None:
    deep = tmp_path / "deep"
    deep.mkdir()
    os.chdir(deep)
    for _ in range(1500):
        os.mkdir("d")  # noqa: PTH102 - a path of its own would be too long
        os.chdir("d")
    os.chdir(tmp_path)
    locked = tmp_path / "locked"
    (locked / "in").mkdir(parents=True)
    locked.chmod(0)
    for path in (deep, locked):
        removed.remove(path)
        assert not path.exists()
