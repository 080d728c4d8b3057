# SPDX-License-Identifier: Apache-2.0
"""Tests of the collector: what it removes and, above all, what it keeps."""

from __future__ import annotations

import http.server
import json
import os
import sys
import threading
import time
import uuid
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any, ClassVar

import pytest

from slamhive.archive import Archive
from slamhive.archive.keeping import backup, restore
from slamhive.data.files.once import in_use
from slamhive.jobs.known import NamesInUse, all_pages, known_to
from slamhive.model.errors import SystemFault
from slamhive.model.results import Phase, RunRecord

if TYPE_CHECKING:
    from pathlib import Path

ALIVE, GONE, ARCHIVED = (str(uuid.UUID(int=number)) for number in (1, 2, 3))
KEEP, DROP = "a" * 32, "b" * 32


def age(path: Path, seconds: float = 7200.0) -> Path:
    """Make a tree look as old as it says."""
    then = time.time() - seconds
    for place in (path, *path.rglob("*")):
        os.utime(place, (then, then), follow_symlinks=False)
    return path


@pytest.fixture
def volumes(pod: Any) -> Any:
    """Volumes on which half of everything is known."""
    files = [
        *(f"results/runs/{uid}/pod/output/trajectory.txt" for uid in (ALIVE, GONE)),
        *(f"data/variants/{key}/recording.bag" for key in (KEEP, DROP)),
        *(
            f"data/groundtruth/{name}"
            for name in ("hall.txt", "old.txt", "old.relations", "old.rotations.npy")
        ),
        *(f"data/assets/{letter * 64}" for letter in "cd"),
        *(f"data/generated/{name}-{'0' * 16}/recording.bag" for name in ("hall", "old")),
        "data/datasets/old/recording.bag",
        "data/generated/truths/x/groundtruth.txt",
        "data/variants/notes/mine.txt",
        "results/runs/mine/notes.txt",
        "results/evaluations/old/results.jsonl",
    ]
    for file in files:
        path = pod.root / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")
    age(pod.root)
    known = {"runs": [ALIVE], "datasets": ["hall"], "variants": [KEEP], "assets": ["c" * 64]}
    (pod.root / "known.json").write_text(json.dumps(known))
    pod.files = lambda: {file for file in files if (pod.root / file).exists()}
    return pod


def a_record(uid: str, folder: str | None = "runs/it/pod") -> RunRecord:
    now = datetime.now(tz=UTC)
    return RunRecord(uid=uid, name=uid, spec={}, phase=Phase.SUCCEEDED, finished=now, folder=folder)


UNKNOWN = {
    f"results/runs/{GONE}/pod/output/trajectory.txt",
    f"data/variants/{DROP}/recording.bag",
    "data/groundtruth/old.txt",
    "data/groundtruth/old.relations",
    "data/groundtruth/old.rotations.npy",
    f"data/assets/{'d' * 64}",
    f"data/generated/old-{'0' * 16}/recording.bag",
}


def collect(pod: Any, *options: str) -> Any:
    known = ("--known", str(pod.root / "known.json"))
    return pod.run("collect", "--namespace", "lab", *known, *options)


def test_what_nobody_knows_goes_and_all_else_stays(volumes: Any) -> None:
    before = volumes.files()
    ended = collect(volumes, "--dry-run")
    assert volumes.files() == before
    assert ended.told == {"v": 1, "found": 12, "removed": 7, "dryRun": True}
    ended = collect(volumes)
    assert ended.code == 0, ended.stderr
    assert before - volumes.files() == UNKNOWN
    assert ended.told["removed"] == 7
    assert collect(volumes).told["removed"] == 0


def test_what_is_young_stays(volumes: Any) -> None:
    os.utime(volumes.root / "results/runs" / GONE / "pod/output/trajectory.txt")
    lock = volumes.root / "data/variants" / f".{DROP}.lock"
    lock.touch()  # somebody has just asked for it
    collect(volumes)
    stays = {f"results/runs/{GONE}/pod/output/trajectory.txt", f"data/variants/{DROP}/recording.bag"}
    assert stays <= volumes.files()
    collect(volumes, "--grace", "0s")
    assert not stays & volumes.files()


def test_a_time_in_the_future_keeps_nothing(volumes: Any) -> None:
    age(volumes.root / "results/runs" / GONE, -1e8)
    collect(volumes)
    assert f"results/runs/{GONE}/pod/output/trajectory.txt" not in volumes.files()


def test_a_variant_in_use_stays(volumes: Any) -> None:
    with in_use(volumes.root / "data/variants" / DROP):
        age(volumes.root / "data/variants")
        ended = collect(volumes)
    assert "in use" in ended.stdout
    assert f"data/variants/{DROP}/recording.bag" in volumes.files()


@pytest.mark.parametrize(
    "content", [None, "", "{}", '{"runs": [], "datasets": [], "variants": 3, "assets": []}']
)
def test_nothing_goes_when_it_is_not_sure_what_is_known(volumes: Any, content: str | None) -> None:
    before, path = volumes.files(), volumes.root / "known.json"
    path.unlink() if content is None else path.write_text(content)
    assert collect(volumes).code == 1
    assert volumes.files() == before


def kubeconfig(server: str) -> dict[str, Any]:
    return {
        "apiVersion": "v1",
        "kind": "Config",
        "current-context": "c",
        "contexts": [{"name": "c", "context": {"cluster": "k", "user": "u"}}],
        "clusters": [{"name": "k", "cluster": {"server": server}}],
        "users": [{"name": "u", "user": {"token": "t"}}],
    }


def test_nothing_goes_when_the_api_does_not_answer(volumes: Any, tmp_path: Path) -> None:
    before = volumes.files()
    (tmp_path / "config").write_text(json.dumps(kubeconfig("http://127.0.0.1:1")))
    for options in ([], ["--kubeconfig", str(tmp_path / "config")]):
        ended = volumes.run("collect", "--namespace", "lab", *options)
        assert ended.error[0] == "SystemFault"
        assert volumes.files() == before


def fill(volumes: Any, count: int) -> list[Path]:
    """Make old run folders that nobody knows."""
    folders = []
    for number in range(count):
        folders.append(volumes.root / "results/runs" / str(uuid.UUID(int=100 + number)))
        (folders[-1] / "pod").mkdir(parents=True)
        (folders[-1] / "pod" / "trajectory.txt").write_text("x")
    age(volumes.root / "results/runs")
    return folders


def know(volumes: Any, **changes: Any) -> None:
    path = volumes.root / "known.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def trash(volumes: Any) -> list[Path]:
    return sorted((volumes.root / "results/.trash").glob("*/*/*"))


@pytest.mark.parametrize(
    "lost", ["objects", "the namespace", "the archive", "its content", "its secret", "the datasets"]
)
def test_nothing_is_deleted_because_something_else_was_lost(volumes: Any, tmp_path: Path, lost: str) -> None:
    """Objects or archive of the runs are gone: made anew under old names, restored, or no longer named."""
    folders = fill(volumes, 60)
    url = f"sqlite:///{tmp_path / 'archive.db'}"
    (tmp_path / "url").write_text(url)
    options = ("--archive-url-file", str(tmp_path / "url"))
    live, archived = folders[:30], folders[30:]
    uids = [ALIVE, GONE, *(folder.name for folder in live)]
    datasets = [f"d{number}" for number in range(30)]
    for name in datasets:
        (volumes.root / "data/groundtruth" / f"{name}.txt").write_text("x")
    age(volumes.root / "data")
    know(volumes, runs=uids, datasets=["hall", "old", *datasets], namespaceUid="u-1")
    with Archive.open(url) as archive:
        for folder in archived:
            archive.put_run(a_record(folder.name))
    backup(url, tmp_path / "copy.db")
    assert collect(volumes, *options).code == 0
    match lost:
        case "objects":
            know(volumes, runs=[])
        case "the namespace":
            know(volumes, runs=[], namespaceUid="u-2")
        case "the archive":
            (tmp_path / "archive.db").unlink()
            with Archive.open(url) as archive:
                archive.put_run(a_record(GONE))
        case "its content":
            restore(url, tmp_path / "copy.db", force=True)
        case "its secret":
            options = ()
        case "the datasets":
            know(volumes, datasets=[])
    ended = collect(volumes, *options)
    assert ended.error[0] == "SystemFault"
    assert "nothing is removed" in ended.error[1]
    assert "start the collector once with --" in ended.error[1]
    assert all(folder.exists() for folder in folders)
    assert len(list((volumes.root / "data/groundtruth").glob("d*.txt"))) == 30
    assert trash(volumes) == []
    if lost not in {"objects", "the datasets"}:
        # Taken over, it still stops before all that goes at once, and then has a week.
        again = collect(volumes, *options, "--adopt")
        expected = 0 if lost == "its content" else 1
        assert again.code == expected
    forced = collect(volumes, *options, "--force", "--adopt")
    assert forced.code == 0
    gone = {folder.name for folder in folders if not folder.exists()}
    assert gone == {path.name for path in trash(volumes)} - {ALIVE, GONE}


def test_the_trash_can_be_moved_back_for_a_week(volumes: Any) -> None:
    (folder,) = fill(volumes, 1)
    collect(volumes)
    (thrown,) = (path for path in trash(volumes) if path.name == folder.name)
    assert (thrown / "pod/trajectory.txt").read_text() == "x"
    thrown.rename(folder)
    know(volumes, runs=[ALIVE, folder.name])
    collect(volumes)
    assert folder.exists()
    know(volumes, runs=[ALIVE])
    collect(volumes)
    (thrown,) = (path for path in trash(volumes) if path.name == folder.name)
    day = thrown.parents[1]
    mine = day.with_name("mine")
    mine.mkdir()
    earlier = datetime.now(tz=UTC) - timedelta(days=8)
    # Moved by itself: what went within the same second lies in the same folder.
    old = day.with_name(earlier.strftime("%Y%m%dT%H%M%SZ")) / thrown.parent.name
    old.mkdir(parents=True)
    thrown.rename(old / thrown.name)
    collect(volumes)
    assert [path.name for path in trash(volumes)] == [GONE]
    assert mine.exists()


def test_the_brake_is_as_strong_as_it_is_told(volumes: Any) -> None:
    folders = fill(volumes, 30)
    assert "refers to 31 of 32 runs, more than 20 and 20 %" in collect(volumes).error[1]
    ended = collect(volumes, "--dry-run")
    assert ended.code == 0
    assert "refers to 31 of 32 runs" in ended.stdout
    assert collect(volumes, "--most", "10", "90").code == 1
    assert all(folder.exists() for folder in folders)
    assert collect(volumes, "--most", "31", "20").code == 0
    assert not any(folder.exists() for folder in folders)


def test_what_was_not_to_be_kept_goes_at_once_and_however_much_it_is(volumes: Any, tmp_path: Path) -> None:
    folders = fill(volumes, 50)
    (tmp_path / "url").write_text(f"sqlite:///{tmp_path / 'archive.db'}")
    know(volumes, released=[folder.name for folder in folders[:25]])
    with Archive.open(f"sqlite:///{tmp_path / 'archive.db'}") as archive:
        for folder in folders[25:]:
            archive.put_run(a_record(folder.name, folder=None))
    assert collect(volumes, "--archive-url-file", str(tmp_path / "url")).code == 0
    assert not any(folder.exists() for folder in folders)
    assert [path.name for path in trash(volumes)] == [GONE]


def test_a_mark_of_an_earlier_version_is_taken_over(volumes: Any) -> None:
    mark = volumes.root / "results" / ".slamhive-namespace"
    mark.write_text("lab")
    know(volumes, namespaceUid="u-1")
    assert collect(volumes).code == 0
    assert json.loads(mark.read_text()) == {"namespace": "lab", "uid": "u-1", "archive": None}


class FakeApi(http.server.BaseHTTPRequestHandler):
    """A Kubernetes API with a namespace, a CronJob and no objects; keeps the Events that are posted."""

    posted: ClassVar[list[Any]] = []

    def answer(self, body: Any) -> None:
        data = json.dumps(body).encode()
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def do_GET(self) -> None:
        name = self.path.partition("?")[0].rpartition("/")[2]
        self.answer({"items": [], "metadata": {"name": name, "uid": f"uid-{name}"}})

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.posted.append(body)
        self.answer(body)

    def log_message(self, *_: object) -> None:
        pass


def test_the_cronjob_says_why_nothing_is_removed(volumes: Any, tmp_path: Path) -> None:
    folders = fill(volumes, 30)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), FakeApi)
    with server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        config = tmp_path / "config"
        config.write_text(json.dumps(kubeconfig(f"http://127.0.0.1:{server.server_port}")))
        words = ("--namespace", "lab", "--kubeconfig", str(config), "--cronjob", "slamhive-collector")
        ended = volumes.run("collect", *words)
        assert volumes.run("collect", *words, "--force").code == 0
        server.shutdown()
        thread.join()
    assert "refers to 32 of 32 runs" in ended.error[1]
    assert ended.error[1] in ended.stderr
    assert "can't be told" not in ended.stdout
    [event] = FakeApi.posted
    assert event["message"] == ended.error[1]
    assert (event["type"], event["reason"]) == ("Warning", "NothingRemoved")
    about = event["involvedObject"]
    assert (about["kind"], about["name"], about["uid"]) == (
        "CronJob",
        "slamhive-collector",
        "uid-slamhive-collector",
    )
    assert not any(folder.exists() for folder in folders)
    assert json.loads((volumes.root / "results/.slamhive-namespace").read_text())["uid"] == "uid-lab"


def test_what_the_offloader_left_in_the_trash_goes_in_the_end(volumes: Any) -> None:
    # Where results are moved no more, nobody else would.
    left = volumes.root / "results/.trash"
    now = datetime.now(UTC)
    for days in (1, 8):
        stamp = (now - timedelta(days=days)).strftime("%Y%m%dT%H%M%SZ")
        (left / f"{stamp}-offloaded" / "runs" / GONE).mkdir(parents=True)
    collect(volumes)
    [kept] = left.glob("*-offloaded")
    assert kept.name.startswith((now - timedelta(days=1)).strftime("%Y%m%d"))


def test_another_namespace_s_volume_is_left_alone(volumes: Any) -> None:
    (volumes.root / "results" / ".slamhive-namespace").write_text("factory")
    before = volumes.files()
    assert "factory" in collect(volumes).error[1]
    assert volumes.files() == before


def test_archived_runs_keep_their_folders(volumes: Any, tmp_path: Path) -> None:
    (tmp_path / "url").write_text(f"sqlite:///{tmp_path / 'archive.db'}\n")
    options = ("--archive-url-file", str(tmp_path / "url"))
    before = volumes.files()
    assert "no archive at" in collect(volumes, *options).error[1]
    with Archive.open(f"sqlite:///{tmp_path / 'archive.db'}") as archive:
        assert "no run at all" in collect(volumes, *options).error[1]
        assert volumes.files() == before
        for uid in (ARCHIVED, GONE):
            archive.put_run(a_record(uid))
        assert collect(volumes, *options).code == 0
        assert before - volumes.files() == {file for file in UNKNOWN if GONE not in file}
        # A record that names no folder is one whose files were not to be kept.
        archive.put_run(a_record(GONE, folder=None))
        collect(volumes, *options)
    assert before - volumes.files() == UNKNOWN


def test_hostile_folders_go_and_lead_nowhere(volumes: Any, tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "data").write_text("x")
    output = volumes.root / "results/runs" / GONE / "pod/output"
    (output / "link").symlink_to(precious)
    locked = output / "locked"
    locked.mkdir()
    (locked / "file").write_text("x")
    locked.chmod(0)
    place = os.open(output, os.O_RDONLY)
    for _ in range(1500):
        os.mkdir("d", dir_fd=place)
        below = os.open("d", os.O_RDONLY, dir_fd=place)
        os.close(place)
        place = below
    os.close(place)
    linked = volumes.root / "results/runs" / str(uuid.UUID(int=9))
    linked.symlink_to(precious)
    for link in (volumes.root / "data/variants" / ("e" * 32), volumes.root / "data/groundtruth/linked.txt"):
        link.symlink_to(precious)
    ended = collect(volumes, "--grace", "0s")
    assert ended.code == 0, ended.stderr
    assert not list((volumes.root / "results/runs").glob(f"*{GONE}*"))
    assert collect(volumes, "--grace", "0s", "--trash", "0s").code == 0
    assert list((volumes.root / "results/.trash").iterdir()) == []
    assert (precious / "data").read_text() == "x"


def test_what_died_half_made_is_swept(volumes: Any) -> None:
    leftovers = [
        volumes.root / "data/variants" / f".{KEEP}.making" / "recording.bag",
        volumes.root / "data/groundtruth/.hall.txt.0123456789ab.making",
        volumes.root / "results/runs" / f".{GONE}.removing" / "x",
    ]
    for path in leftovers:
        path.parent.mkdir(exist_ok=True)
        path.write_text("x")
    age(volumes.root)
    collect(volumes)
    assert [path for path in leftovers if path.exists()] == []


OBJECTS: dict[str, Any] = {
    "algorithms": [{"spec": {"assets": [{"name": "a", "sha256": "c" * 64}, {"name": "b", "path": "b"}]}}, {}],
    "datasets": [
        {"metadata": {"name": "hall"}, "status": {"variants": [{"name": "v", "folder": f"variants/{KEEP}"}]}},
        {
            "metadata": {"name": "new"},
            "status": {"variants": [{"description": {"folder": DROP}}, {"name": "w"}]},
        },
        {"metadata": {"name": "bare"}},
    ],
    "mappingruns": [{"metadata": {"uid": ALIVE}}],
}


def a_run(uid: str, *, files: str | None = None, **status: Any) -> dict[str, Any]:
    annotations = {"slamhive.io/files": files} if files else {}
    return {"metadata": {"uid": uid, "annotations": annotations}, "spec": {}, "status": status}


@pytest.mark.parametrize(
    ("run", "known"),
    [
        (a_run(ALIVE, phase="Running"), {ALIVE}),
        (a_run(ALIVE, folder=f"runs/{GONE}/pod"), {ALIVE, GONE}),
        (a_run(ALIVE, files="Delete", phase="Running"), {ALIVE}),
        (a_run(ALIVE, files="Delete", phase="Succeeded", trajectory={"poses": 1}), {ALIVE}),
        (a_run(ALIVE, files="Delete", phase="Succeeded", trajectory={"poses": 1}, results=[{}]), set()),
        (a_run(ALIVE, files="Delete", phase="Failed"), set()),
    ],
)
def test_a_run_needs_the_folder_of_its_result_until_it_may_go(run: Any, known: set[str]) -> None:
    listed = {"algorithms": [], "datasets": [], "mappingruns": [run]}
    assert known_to(listed.__getitem__).runs == known


def test_objects_say_what_is_known() -> None:
    assert known_to(OBJECTS.__getitem__) == NamesInUse(
        frozenset({ALIVE}), frozenset({"hall", "new", "bare"}), frozenset({KEEP, DROP}), frozenset({"c" * 64})
    )


@pytest.mark.parametrize("plural", list(OBJECTS))
def test_what_may_not_be_listed_is_not_taken_for_unknown(plural: str) -> None:
    def listing(wanted: str) -> Any:
        if wanted == plural:
            raise PermissionError(plural)
        return OBJECTS[wanted]

    if plural == "algorithms":
        assert known_to(listing).assets is None
    else:
        with pytest.raises(SystemFault, match=plural):
            known_to(listing)


def test_a_list_of_many_pages_is_read_to_its_end_or_not_at_all() -> None:
    calls = []

    def page(token: str | None, expires: int) -> Any:
        number = int(token or 0)
        calls.append(number)
        if number == 2 and calls.count(2) <= expires:
            raise TimeoutError
        return {"items": [number], "metadata": {"continue": str(number + 1) if number < 3 else ""}}

    assert all_pages(lambda token: page(token, 0), "runs") == [0, 1, 2, 3]
    calls.clear()
    assert all_pages(lambda token: page(token, 1), "runs") == [0, 1, 2, 3]
    calls.clear()
    with pytest.raises(SystemFault, match="too old"):
        all_pages(lambda token: page(token, sys.maxsize), "runs")
    with pytest.raises(SystemFault, match="no list"):
        all_pages(lambda _: {}, "runs")
