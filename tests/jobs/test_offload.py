# SPDX-License-Identifier: Apache-2.0
"""Tests of the offloader, and of who brings folders back: nothing is lost, whatever happens on the way."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
import uuid
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from buckets import S3, make_place

from slamhive.archive import Archive
from slamhive.jobs import collect, moving, offload
from slamhive.model.results import Phase, RunRecord
from slamhive.storage.state import read_state
from slamhive.storage.store import PART_BYTES, ObjectStorage, StorageUnavailable

if TYPE_CHECKING:
    from collections.abc import Callable

    from buckets import Place

OLD, YOUNG, ALIVE, UNKNOWN, RELEASED = (str(uuid.UUID(int=number)) for number in range(1, 6))
POD = "pod-1"
EMPTY = hashlib.sha256(b"").hexdigest()


def write_run(results: Path, uid: str, hours: float = 48.0, size: int = 1000) -> Path:
    """Make a run's folder whose files are some hours old."""
    folder = results / "runs" / uid
    for name, content in {
        "summary.json": b"{}",
        "output/trajectory.txt": f"{uid} 1 2 3\n".encode() * (size // 40),
        "output/empty": b"",
        "output/maps/a b?*[1].bin": b"map",
        "output/maps/line\nbreak": b"line",
    }.items():
        path = folder / POD / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    then = time.time() - 3600 * hours
    for path in (*folder.rglob("*"), folder):
        os.utime(path, (then, then))
    return folder


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.is_symlink()
    }


@pytest.fixture
def lab(pod: Any, place: Place) -> Any:
    """A volume with folders of every standing, an archive, and a place for objects."""
    return make_lab(pod, place)


def make_lab(pod: Any, place: Place) -> Any:
    results = pod.root / "results"
    hours = {OLD: 48, YOUNG: 2, ALIVE: 48, UNKNOWN: 48, RELEASED: 48}
    pod.results, pod.place = results, place
    pod.before = {uid: files_of(write_run(results, uid, hours[uid])) for uid in hours}
    url = f"sqlite:///{pod.root / 'archive.db'}"
    (pod.root / "url").write_text(url)
    with Archive.open(url) as archive:
        for uid in (OLD, YOUNG, ALIVE, RELEASED):
            archive.put_run(a_record(uid, None if uid == RELEASED else f"runs/{uid}/{POD}"))
    know(pod, ALIVE)
    pod.store_options = place.settings(pod.root / "settings")
    return pod


def a_record(uid: str, folder: str | None) -> RunRecord:
    now = datetime.now(tz=UTC)
    return RunRecord(uid=uid, name=uid, spec={}, phase=Phase.SUCCEEDED, finished=now, folder=folder)


def know(pod: Any, *runs: str) -> None:
    known = {"runs": runs, "datasets": [], "variants": [], "assets": []}
    (pod.root / "known.json").write_text(json.dumps(known))


def words(lab: Any) -> tuple[str, ...]:
    files = ("--known", str(lab.root / "known.json"), "--archive-url-file", str(lab.root / "url"))
    return ("--namespace", "lab", *files, *lab.store_options, "--full", "100")


def run(lab: Any, *options: str) -> Any:
    return lab.run("offload", *words(lab), *options)


def restore(lab: Any, *uids: str) -> Any:
    request = {"folders": [f"runs/{uid}/{POD}" for uid in uids]}
    return lab.run("restore", *lab.store_options, request=request)


def on_volume(lab: Any) -> set[str]:
    return {path.name for path in (lab.results / "runs").iterdir()}


def test_what_is_archived_and_old_moves_and_comes_back_the_same(lab: Any) -> None:
    ended = run(lab, "--dry-run")
    assert on_volume(lab) == set(lab.before)
    assert f"would move runs/{OLD}\n" in ended.stdout
    ended = run(lab)
    assert ended.code == 0, ended.stderr
    assert ended.told == {
        "v": 1,
        "found": 1,
        "moved": 1,
        "stays": 0,
        "dryRun": False,
        "bytes": sum(map(len, lab.before[OLD].values())),
    }
    assert on_volume(lab) == set(lab.before) - {OLD}
    [trash] = (lab.results / ".trash").glob("*-offloaded/runs/*")
    assert files_of(trash) == lab.before[OLD]
    assert read_state(lab.results).sentence() is None
    assert run(lab).told["found"] == 0
    ended = restore(lab, OLD, ALIVE, OLD)
    assert ended.told == {"v": 1, "runs": 2, "brought": 1, "left": {}}
    assert files_of(lab.results / "runs" / OLD) == lab.before[OLD]
    assert restore(lab, OLD).told["brought"] == 0


def test_a_folder_that_came_back_goes_again_without_being_copied(lab: Any) -> None:
    run(lab)
    restore(lab, OLD)
    folder = lab.results / "runs" / OLD
    for path in (folder, *folder.rglob("*")):
        os.utime(path, (1, 1))
    name = f"runs/{OLD}/{POD}/output/empty"
    lab.place.remove(name)  # would be there again if it were copied
    assert run(lab).told["moved"] == 1
    with pytest.raises(FileNotFoundError):
        lab.place.store().read(name)


def test_moved_folders_leave_the_trash_when_their_time_is_over(lab: Any) -> None:
    run(lab)
    [trash] = (lab.results / ".trash").iterdir()
    run(lab)
    assert trash.exists()
    trash.rename(trash.with_name("20200101T000000Z-offloaded"))
    run(lab)
    assert not list((lab.results / ".trash").iterdir())


def test_without_a_trash_a_moved_folder_is_erased(lab: Any) -> None:
    assert run(lab, "--trash", "0s").told["moved"] == 1
    assert on_volume(lab) == set(lab.before) - {OLD}
    assert not list((lab.results / ".trash").glob("*/*/*"))


def test_on_a_full_volume_younger_folders_go_too_and_nothing_rests(lab: Any) -> None:
    ended = run(lab, "--full", "-1")
    assert ended.told["moved"] == 2
    assert "full: folders younger than --after go too" in ended.stdout
    assert on_volume(lab) == {ALIVE, UNKNOWN, RELEASED}
    assert not list((lab.results / ".trash").glob("*/*/*"))


def test_a_folder_that_a_run_took_over_meanwhile_stays(
    lab: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    copy = moving.copy_folder

    def taken_over(*given: Any) -> Any:
        know(lab, ALIVE, OLD)
        return copy(*given)

    monkeypatch.setattr(offload, "copy_folder", taken_over)
    monkeypatch.setenv("SLAMHIVE_TERMINATION_LOG", str(tmp_path / "last"))
    assert offload.main(["--root", str(lab.root), *words(lab)]) == 0
    assert files_of(lab.results / "runs" / OLD) == lab.before[OLD]


def hostile(folder: Path, what: str) -> None:
    output = folder / POD / "output"
    match what:
        case "link":
            (output / "link").symlink_to("/etc/passwd")
        case "folder link":
            (output / "way").symlink_to("/etc")
        case "pipe":
            os.mkfifo(output / "pipe")
        case "deep":
            (output / "/".join("d" * 17)).mkdir(parents=True)
        case "no UTF-8":
            (output / os.fsdecode(b"\xff")).write_bytes(b"x")
        case "the note":
            (folder / "offloaded.json").write_text("{}")


@pytest.mark.parametrize("what", ["link", "folder link", "pipe"])
def test_what_is_no_file_is_left_out_and_noted(lab: Any, what: str) -> None:
    hostile(lab.results / "runs" / OLD, what)
    assert run(lab, "--after", "0s").told["stays"] == 0
    note = json.loads(lab.place.store().read(f"runs/{OLD}/offloaded.json"))
    assert len(note["left"]) == 1
    restore(lab, OLD)
    assert files_of(lab.results / "runs" / OLD) == lab.before[OLD]
    assert not any(path.is_symlink() for path in (lab.results / "runs" / OLD).rglob("*"))


@pytest.mark.parametrize("what", ["deep", "no UTF-8", "the note"])
def test_a_folder_that_can_not_be_copied_whole_stays_and_stops_no_other(lab: Any, what: str) -> None:
    hostile(lab.results / "runs" / OLD, what)
    ended = run(lab, "--after", "0s")
    assert (ended.code, ended.told["stays"], ended.told["moved"]) == (0, 1, 1)
    assert f"runs/{OLD} stays on the volume, as not all of it can be copied" in ended.stdout
    assert OLD in on_volume(lab)
    assert YOUNG not in on_volume(lab)
    assert "1 run folders can't be moved" in read_state(lab.results).sentence()


def test_what_another_put_into_the_bucket_is_told_and_keeps_no_other_away(lab: Any) -> None:
    run(lab, "--after", "0s")
    lab.place.change(f"runs/{OLD}/{POD}/summary.json", b"[]")
    told = restore(lab, OLD, YOUNG).told
    assert "summary.json was changed" in told["left"][OLD]
    assert (told["brought"], [*told["left"]]) == (1, [OLD])
    assert on_volume(lab) == set(lab.before) - {OLD}
    lab.place.change(f"runs/{OLD}/offloaded.json", b"{}")
    assert "offloaded.json is not what was written there" in restore(lab, OLD).told["left"][OLD]
    for path in ("../x", "/etc/x", "a/../../x", "a\0b", "", "a//b"):
        evil = {"v": 1, "uid": OLD, "files": [{"path": path, "size": 0, "sha256": EMPTY}]}
        lab.place.change(f"runs/{OLD}/offloaded.json", json.dumps(evil).encode())
        assert "offloaded.json is not what was written" in restore(lab, OLD).told["left"][OLD], path
    lab.place.remove(f"runs/{OLD}/offloaded.json")
    assert "neither on the results volume nor in the object storage" in restore(lab, OLD).told["left"][OLD]
    assert on_volume(lab) == set(lab.before) - {OLD}


def test_a_copy_that_somebody_changed_is_made_anew(lab: Any) -> None:
    run(lab)
    restore(lab, OLD)
    lab.place.change(f"runs/{OLD}/offloaded.json", b"{}")
    lab.place.change(f"runs/{OLD}/{POD}/summary.json", b"[]")
    assert run(lab, "--after", "0s").told["moved"] == 2
    restore(lab, OLD)
    assert files_of(lab.results / "runs" / OLD) == lab.before[OLD]


def operations(monkeypatch: pytest.MonkeyPatch, before: Callable[[], None]) -> None:
    """Have something done before each write to the store and each change of the volume."""

    def preceded(method: Any) -> Any:
        def call(*given: Any, **named: Any) -> Any:
            before()
            return method(*given, **named)

        return call

    monkeypatch.setattr(ObjectStorage, "write", preceded(ObjectStorage.write))
    monkeypatch.setattr(Path, "rename", preceded(Path.rename))
    monkeypatch.setattr(Path, "replace", preceded(Path.replace))


@pytest.mark.slow
def test_killed_at_each_write_the_next_one_has_all_of_it(
    lab: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    shutil.copytree(lab.results, tmp_path / "first")
    number = 0
    while True:
        number += 1
        pid = os.fork()
        if pid == 0:
            left = [number]

            def counted(left: list[int] = left) -> None:
                left[0] -= 1
                if left[0] == 0:
                    os._exit(9)

            operations(monkeypatch, counted)
            os.environ["SLAMHIVE_TERMINATION_LOG"] = str(tmp_path / "last")
            os._exit(offload.main(["--root", str(lab.root), *words(lab), "--trash", "0s"]))
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        if OLD in on_volume(lab):
            assert files_of(lab.results / "runs" / OLD) == lab.before[OLD], number
        assert run(lab, "--trash", "0s").code == 0
        assert OLD not in on_volume(lab)
        assert restore(lab, OLD).code == 0
        assert files_of(lab.results / "runs" / OLD) == lab.before[OLD], number
        if code == 0:
            break
        assert code == 9
        shutil.rmtree(lab.results)
        shutil.copytree(tmp_path / "first", lab.results)
        lab.place = lab.place.below(str(number))
        lab.store_options = lab.place.settings(lab.root / "settings")
    assert number > 7  # five files, the note, the folder, what the volume says of it


def test_a_bucket_that_goes_away_in_the_middle_keeps_everything_on_the_volume(
    pod: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    s3 = S3()
    lab = make_lab(pod, make_place("s3", tmp_path / "bucket", s3))
    left = [3]

    def away() -> None:
        left[0] -= 1
        if left[0] == 0:
            s3.stop()

    operations(monkeypatch, away)
    monkeypatch.setenv("SLAMHIVE_TERMINATION_LOG", str(tmp_path / "last"))
    assert offload.main(["--root", str(lab.root), *words(lab)]) == 1
    monkeypatch.undo()
    assert f"storage {lab.place.url}" in json.loads((tmp_path / "last").read_text())["error"]["message"]
    assert {uid: files_of(lab.results / "runs" / uid) for uid in lab.before} == lab.before
    state = read_state(lab.results)
    assert (state.waiting, state.moved) == (1, 0)
    assert "StorageUnavailable" in state.sentence()
    since = state.since
    assert run(lab).code == 1
    assert read_state(lab.results).since == since
    s3.start()
    lab.place.s3.client().create_bucket(Bucket=lab.place.url.split("/")[2])
    assert run(lab).told["moved"] == 1
    assert read_state(lab.results).problem is None
    s3.stop()


def test_wrong_keys_move_nothing_and_are_told_where_the_owner_looks(pod: Any, tmp_path: Path) -> None:
    s3 = S3()
    lab = make_lab(pod, make_place("s3", tmp_path / "bucket", s3))
    s3.demand_keys(after="0")
    try:
        ended = run(lab)
    finally:
        s3.demand_keys(after="inf")
        s3.stop()
    assert "Access" in ended.error[1]
    assert on_volume(lab) == set(lab.before)
    assert ended.error[1] in read_state(lab.results).sentence()


@pytest.mark.parametrize(
    ("gone", "reason"), [("the bucket", "StorageUnavailable"), ("the archive", "NothingMoved")]
)
def test_the_cronjob_says_why_nothing_is_moved(
    lab: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, gone: str, reason: str
) -> None:
    told: list[tuple[Any, ...]] = []
    monkeypatch.setattr(collect, "tell_cronjob", lambda *given, **named: told.append((*given, named)))
    monkeypatch.setenv("SLAMHIVE_TERMINATION_LOG", str(tmp_path / "last"))
    if gone == "the bucket":
        lab.store_options = replace(lab.place, url=f"{lab.place.url}-none".replace("lab-", "no-")).settings(
            tmp_path
        )
    else:
        (lab.root / "archive.db").unlink()
    assert offload.main(["--root", str(lab.root), *words(lab), "--cronjob", "slamhive-offloader"]) == 1
    [(namespace, name, message, _, named)] = told
    assert (namespace, name, named) == ("lab", "slamhive-offloader", {"reason": reason})
    assert json.loads((tmp_path / "last").read_text())["error"]["message"] == message
    assert read_state(lab.results).reason == reason
    assert on_volume(lab) == set(lab.before)


@pytest.mark.parametrize("lost", ["archive", "known", "an empty archive", "settings"])
def test_nothing_moves_when_it_is_not_sure_what_is_known(lab: Any, lost: str) -> None:
    match lost:
        case "archive":
            (lab.root / "archive.db").unlink()
        case "known":
            (lab.root / "known.json").unlink()
        case "an empty archive":
            (lab.root / "archive.db").unlink()
            Archive.open(f"sqlite:///{lab.root / 'archive.db'}").close()
        case "settings":
            Path(lab.store_options[1]).write_text("url: lab")
    ended = run(lab)
    assert ended.error[1]
    assert on_volume(lab) == set(lab.before)
    assert read_state(lab.results).problem == ended.error[1]


def test_a_file_that_is_written_meanwhile_keeps_its_folder(
    lab: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    target = lab.results / "runs" / OLD / POD / "output/trajectory.txt"
    with target.open("ab") as file:
        file.write(bytes(2 * PART_BYTES))
    os.utime(target, (1, 1))
    write = ObjectStorage.write

    def written(store: ObjectStorage, name: str, pieces: Any) -> None:
        if name.endswith("trajectory.txt"):
            target.write_bytes(b"short")
        write(store, name, pieces)

    monkeypatch.setattr(ObjectStorage, "write", written)
    monkeypatch.setenv("SLAMHIVE_TERMINATION_LOG", str(tmp_path / "last"))
    assert offload.main(["--root", str(lab.root), *words(lab)]) == 0
    assert target.read_bytes() == b"short"


def test_an_object_of_another_size_is_noticed_before_anything_goes(
    lab: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ObjectStorage, "sizes", lambda *_: {})
    with pytest.raises(StorageUnavailable, match="were written"):
        moving.copy_folder(lab.results, OLD, lab.place.store())
    with pytest.raises(FileNotFoundError):
        lab.place.store().read(f"runs/{OLD}/offloaded.json")
