# SPDX-License-Identifier: Apache-2.0
"""Files of runs into folders here, from the program that a pod would run; no cluster is needed."""

from __future__ import annotations

import asyncio
import hashlib
import json
import shutil
import subprocess
import sys
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
import yaml

sys.path.append(str(Path(__file__).parents[1] / "storage"))

from buckets import place, s3

from slamhive.jobs.moving import copy_folder
from slamhive.kube.api.errors import NotFound, ServerFault
from slamhive.kube.builders.restoring import store_words
from slamhive.kube.builders.sending import sender_job
from slamhive.kube.user import sending
from slamhive.kube.user.run_files import Filed, Filing, RunFolder, WantedRun
from slamhive.model.errors import DataError, SystemFault

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, AsyncIterator, Callable

    from buckets import Place

    from slamhive.kube.api.transport import Request

__all__ = ["place", "s3"]

POSES = b"0 1 2 3 0 0 0 1\n" * 5000


class Talk:
    """Stand-in for the Session that Filing talks to, with the program as a process here.

    Args:
        process: the program.
        bytes_left: bytes of its output until the connection breaks.
    """

    def __init__(self, process: subprocess.Popen[bytes], bytes_left: int) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._in, self._out = process.stdin, process.stdout
        self._left = bytes_left

    async def send(self, data: bytes) -> None:
        self._in.write(data)
        self._in.flush()

    async def line(self) -> bytes:
        return (await asyncio.to_thread(self._out.readline)).removesuffix(b"\n")

    async def take(self, count: int) -> AsyncGenerator[bytes, None]:
        while count:
            if self._left <= 0:
                raise ServerFault("cut", verb="get", resource="pods/exec")
            data = await asyncio.to_thread(self._out.read, min(count, 4096, self._left))
            count -= len(data)
            self._left -= len(data)
            yield data


class Volume:
    """A results volume and pods that send from it; each conversation breaks after some bytes."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.breaks: list[int] = []
        self.conversations = 0
        self.pods: list[dict[str, Any]] = []
        self.options: tuple[str, ...] = ()

    def put(self, name: str, files: dict[str, bytes] | None = None) -> WantedRun:
        """Write a run's folder and return the run."""
        folder = self.root / "results" / "runs" / f"uid-of-{name}" / "pod"
        whole = {"output/trajectory.txt": POSES, "usage.csv": b"1\n", "config.yaml": b"{}\n"} | (files or {})
        for path, content in whole.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        status = {
            "folder": f"runs/uid-of-{name}/pod",
            "trajectory": {"sha256": hashlib.sha256(POSES).hexdigest()},
            "logTail": "the last line",
        }
        return WantedRun({"metadata": {"name": name, "uid": f"uid-of-{name}"}, "status": status}, "study")

    @asynccontextmanager
    async def session(self) -> AsyncIterator[Talk]:
        """Have a conversation with a new process of the program."""
        self.conversations += 1
        command = [sys.executable, "-m", "slamhive.jobs.send", "--root", str(self.root)]
        command += ["--sign", str(self.root / "sign"), *self.options]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:  # noqa: ASYNC220
            try:
                yield Talk(process, self.breaks.pop(0) if self.breaks else 1 << 40)
            finally:
                process.kill()

    async def list(self, *_: Any, **__: Any) -> tuple[list[dict[str, Any]], str]:
        """Return the pods of a run."""
        return self.pods, ""

    async def log_lines(self, *_: Any) -> AsyncGenerator[tuple[str, str], None]:
        """Yield the lines that an algorithm printed."""
        for text in ("first", "second"):
            yield "", text


@pytest.fixture
def volume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Volume:
    found = Volume(tmp_path / "there")

    @asynccontextmanager
    async def sender(*_: Any) -> AsyncIterator[Volume]:
        yield found

    monkeypatch.setattr("slamhive.kube.user.run_files.sender", sender)
    monkeypatch.setattr("slamhive.kube.user.run_files._PAUSE_SECONDS", 0.0)
    return found


@pytest.fixture
def fetch(tmp_path: Path, volume: Volume) -> Callable[..., Filed]:
    """A function that fetches runs to ``here``, and notes in ``kept`` which."""
    cluster: Any = SimpleNamespace(api=volume, namespace="lab")

    def run(*wanted: WantedRun, kept: list[str] | None = None) -> Filed:
        def keep(item: WantedRun, folder: RunFolder) -> None:
            assert folder.is_whole
            if kept is not None:
                kept.append(item.name)

        filing = Filing(cluster, tmp_path / "here", keep=keep, step=lambda *_: None, tell=print)
        return asyncio.run(filing.fetch(wanted))

    return run


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def here(tmp_path: Path, name: str) -> Path:
    return tmp_path / "here" / "study" / f"{name}@uid-of-{name}"[: len(name) + 9]


def test_folders_are_laid_out_as_those_of_this_machine(
    tmp_path: Path, volume: Volume, fetch: Callable[..., Filed]
) -> None:
    names = [f"run-{number}" for number in range(9)]
    kept: list[str] = []
    filed = fetch(
        *(
            volume.put(name, {"output/map/a.ply": b"map", "files/config/vins.yaml": b"%YAML"})
            for name in names
        ),
        kept=kept,
    )
    assert (filed.runs, filed.problems, filed.remarks, volume.conversations) == (9, [], [], 1)
    assert kept == names
    assert files(here(tmp_path, "run-3")) == {
        "run/output/trajectory.txt": POSES,
        "run/output/map/a.ply": b"map",
        "run/config.yaml": b"{}\n",
        "run/files/config/vins.yaml": b"%YAML",
        "usage.csv": b"1\n",
        "log.txt": b"the last line\n",
    }


def test_a_hole_is_one_again(tmp_path: Path, volume: Volume, fetch: Callable[..., Filed]) -> None:
    content = b"first" + bytes(4 << 20) + b"last" + bytes(3 << 20)
    assert fetch(volume.put("one", {"output/map.db": content})).problems == []
    file = here(tmp_path, "one") / "run" / "output" / "map.db"
    assert file.read_bytes() == content
    assert file.stat().st_blocks * 512 < 1 << 20


def test_nothing_is_fetched_twice(volume: Volume, fetch: Callable[..., Filed]) -> None:
    one, two, kept = volume.put("one"), volume.put("two"), []
    fetch(one)
    assert fetch(one, two, kept=kept).runs == 1
    assert kept == ["one", "two"]


@pytest.mark.parametrize("breaks", [[1], [5000, 40_000, 3], [4096 * 3, 0, 0, 70_000]])
def test_broken_connections_are_gone_on_from(
    tmp_path: Path, volume: Volume, fetch: Callable[..., Filed], breaks: list[int]
) -> None:
    volume.breaks = [*breaks]
    filed = fetch(volume.put("one"), volume.put("two"))
    assert (filed.runs, filed.problems) == (2, [])
    assert volume.conversations == len(breaks) + 1
    assert files(here(tmp_path, "two"))["run/output/trajectory.txt"] == POSES
    assert filed.size == 2 * (len(POSES) + 5)  # nothing came twice


def test_an_interrupted_command_is_taken_up_again(
    tmp_path: Path, volume: Volume, fetch: Callable[..., Filed]
) -> None:
    one = volume.put("one")
    volume.breaks = [50_000, 0, 0, 0]
    with pytest.raises(ServerFault, match="cut"):
        fetch(one)
    assert not here(tmp_path, "one").exists()
    filed = fetch(one)
    assert filed.size < len(POSES)
    assert files(here(tmp_path, "one"))["run/output/trajectory.txt"] == POSES
    assert [path.name for path in (tmp_path / "here" / "study").iterdir()] == ["one@uid-of-o"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"trajectory": {"sha256": "0" * 64}}, "not the one that the run reported"),
        ({"folder": "runs/elsewhere/pod"}, "No such file"),
    ],
)
def test_what_cannot_be_had_is_a_problem_of_that_run_alone(
    tmp_path: Path, volume: Volume, fetch: Callable[..., Filed], change: dict[str, Any], said: str
) -> None:
    bad, good = volume.put("bad"), volume.put("good")
    bad.run["status"].update(change)
    filed = fetch(bad, good)
    assert filed.runs == 1
    assert len(filed.problems) == 1
    assert filed.problems[0].startswith("bad: ")
    assert said in filed.problems[0]
    assert not here(tmp_path, "bad").exists()


def test_what_was_here_and_is_damaged_comes_anew(
    tmp_path: Path, volume: Volume, fetch: Callable[..., Filed]
) -> None:
    one = volume.put("one")
    place = tmp_path / "here" / "study" / ".one@uid-of-o.fetching" / "run" / "output" / "trajectory.txt"
    place.parent.mkdir(parents=True)
    place.write_bytes(b"9" * 100)
    assert "damaged" in fetch(one).problems[0]
    assert fetch(one).problems == []
    assert files(here(tmp_path, "one"))["run/output/trajectory.txt"] == POSES


def test_the_log_is_whole_while_its_pod_is_there(
    tmp_path: Path, volume: Volume, fetch: Callable[..., Filed]
) -> None:
    volume.pods = [{"metadata": {"uid": uid, "name": "p"}} for uid in ("another", "pod")]
    fetch(volume.put("one"))
    assert files(here(tmp_path, "one"))["log.txt"] == b"first\nsecond\n"


def test_links_stay_where_they_are(tmp_path: Path, volume: Volume, fetch: Callable[..., Filed]) -> None:
    one = volume.put("one")
    output = volume.root / "results" / "runs" / "uid-of-one" / "pod" / "output"
    (output / "link").symlink_to("/etc/passwd")
    (output / "\x1b[2J").write_text("a name that clears terminals")
    filed = fetch(one)
    assert filed.runs == 1
    assert any("link" in sentence and "symbolic link" in sentence for sentence in filed.remarks)
    assert any(r"\x1b[2J" in sentence for sentence in filed.remarks)
    assert [*files(here(tmp_path, "one"))].count("run/output/trajectory.txt") == 1


BAD = ["..", "../x", "output/../../x", "/etc/x", "output//x", "output/.", "", "run/x", "a\\b", "a\0b", "a\nb"]


@pytest.mark.parametrize("path", [*BAD, "x" * 256, "/".join("d" * 18), "log.txt/x"])
def test_no_name_leads_out_of_the_folder(tmp_path: Path, path: str) -> None:
    folder = RunFolder(tmp_path / "study", "one", "u-1")
    with pytest.raises(DataError, match="plain file"), folder.incoming(path):
        pass
    assert not [*tmp_path.iterdir()]


def test_no_link_that_lies_in_the_way_is_followed(tmp_path: Path) -> None:
    making = tmp_path / "study" / ".one@u-1.fetching"
    making.mkdir(parents=True)
    (making / "usage.csv").symlink_to(tmp_path / "elsewhere")
    folder = RunFolder(tmp_path / "study", "one", "u-1")
    assert folder.held() == {}
    with pytest.raises(OSError, match="symbolic"), folder.incoming("usage.csv"):
        pass
    assert not (tmp_path / "elsewhere").exists()


def test_a_pod_that_talks_nonsense_is_not_listened_to(
    volume: Volume, fetch: Callable[..., Filed], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def line(_: Talk) -> bytes:
        return json.dumps({"path": "usage.csv", "size": -1, "offset": 0}).encode()

    monkeypatch.setattr(Talk, "line", line)
    with pytest.raises(ServerFault, match="can't be understood"):
        fetch(volume.put("one"))


def test_a_full_disk_ends_it_in_a_sentence(
    volume: Volume, fetch: Callable[..., Filed], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("slamhive.kube.user.run_files.Incoming.write", full)
    with pytest.raises(SystemFault, match="No space left"):
        fetch(volume.put("one"))


@pytest.fixture
def moved(volume: Volume, place: Place, tmp_path: Path) -> Callable[..., WantedRun]:
    """A function that puts a run's files into object storage alone."""

    def move(name: str) -> WantedRun:
        found = volume.put(name, {"output/map/a.ply": b"map", "output/line\nbreak": b"x"})
        (volume.root / "results" / found.folder / "output" / "link").symlink_to("/etc/passwd")
        copy_folder(volume.root / "results", found.uid, place.store())
        shutil.rmtree(volume.root / "results" / "runs" / found.uid)
        return found

    volume.options = place.settings(tmp_path / "settings")
    return move


@pytest.mark.parametrize("breaks", [[], [5000, 40_000, 3]])
def test_folders_come_from_object_storage_as_from_the_volume(
    tmp_path: Path,
    volume: Volume,
    fetch: Callable[..., Filed],
    moved: Callable[..., WantedRun],
    breaks: list[int],
) -> None:
    volume.breaks = [*breaks]
    there = volume.put("there")
    filed = fetch(moved("one"), there, moved("two"))
    assert (filed.runs, filed.problems) == (3, [])
    assert volume.conversations == len(breaks) + 1
    assert filed.size == 3 * (len(POSES) + 5) + 2 * 3
    assert "one: 'output/link' is left out: is a symbolic link" in filed.remarks
    assert files(here(tmp_path, "one")) == {
        "run/output/trajectory.txt": POSES,
        "run/output/map/a.ply": b"map",
        "run/config.yaml": b"{}\n",
        "usage.csv": b"1\n",
        "log.txt": b"the last line\n",
    }


@pytest.mark.slow
def test_a_changed_object_is_a_problem_of_its_run_alone(
    tmp_path: Path, volume: Volume, fetch: Callable[..., Filed], moved: Callable[..., WantedRun], place: Place
) -> None:
    bad, good = moved("bad"), moved("good")
    place.change(f"{bad.folder}/usage.csv", b"2\n")
    place.change(f"{bad.folder}/output/trajectory.txt", POSES[:-16])
    filed = fetch(bad, good)
    assert filed.runs == 1
    [problem] = filed.problems
    assert "usage.csv was changed" in problem
    assert "trajectory.txt was changed" in problem
    assert files(here(tmp_path, "good"))["run/output/trajectory.txt"] == POSES
    assert not here(tmp_path, "bad").exists()
    place.remove(f"{bad.folder}/usage.csv")
    assert "usage.csv is gone" in fetch(bad).problems[0]


CHART = Path(__file__).parents[1] / "helm" / "golden" / "default.yaml"


async def test_where_the_jobs_are_gone_the_collector_shows_how_pods_are() -> None:
    [collector] = [one for one in yaml.safe_load_all(CHART.read_text()) if one and one["kind"] == "CronJob"]
    asked: list[Request] = []

    class Api:
        async def get(self, *_: Any) -> Any:
            raise NotFound("gone", verb="get", resource="jobs.batch")

        async def json(self, request: Request) -> Any:
            asked.append(request)
            return {"items": [collector]}

    cluster: Any = SimpleNamespace(api=Api(), namespace="lab")
    run = {"metadata": {"name": "one"}, "status": {"attempts": 1}}
    body = sender_job("lab", "fetch-1", await sending._like(cluster, [run]))
    assert asked[0].query is not None
    wanted = dict(pair.split("=") for pair in asked[0].query["labelSelector"].split(","))
    assert wanted.items() <= collector["metadata"]["labels"].items()
    template = collector["spec"]["jobTemplate"]["spec"]["template"]["spec"]
    pod = body["spec"]["template"]["spec"]
    assert pod["containers"][0]["image"] == template["containers"][0]["image"]
    assert pod["securityContext"] == template["securityContext"]
    assert pod["volumes"][0]["persistentVolumeClaim"] == {"claimName": "slamhive-results", "readOnly": True}
    assert "serviceAccountName" not in pod
    assert body["spec"]["ttlSecondsAfterFinished"] <= 60


TEAM = Path(__file__).parents[1] / "helm" / "golden" / "team.yaml"


async def test_the_offloader_tells_which_storage_files_are_read_from() -> None:
    objects = [one for one in yaml.safe_load_all(TEAM.read_text()) if one and one["kind"] == "CronJob"]
    [offloader] = [
        one
        for one in objects
        if one["metadata"]["name"] == "hive-offloader" and one["metadata"]["namespace"] == "lab"
    ]

    class Api:
        items: list[Any] = [offloader]  # noqa: RUF012

        async def json(self, request: Request) -> Any:
            assert request.query is not None
            wanted = dict(pair.split("=") for pair in request.query["labelSelector"].split(","))
            return {
                "items": [one for one in self.items if wanted.items() <= one["metadata"]["labels"].items()]
            }

    api = Api()
    cluster: Any = SimpleNamespace(api=api, namespace="lab")
    store = await sending._store(cluster)
    assert store is not None
    like = offloader["spec"]["jobTemplate"]["spec"]["template"]["spec"]
    body = sender_job("lab", "fetch-1", like, store)
    pod = body["spec"]["template"]["spec"]
    volumes = {volume["name"]: volume for volume in pod["volumes"]}
    assert volumes["store"]["configMap"]["name"] == "hive-store"
    assert volumes["store-secret"]["secret"]["secretName"] == "bucket-reader"
    assert body["metadata"]["labels"]["slamhive.io/role"] == "send"
    mounts = {mount["mountPath"] for mount in pod["containers"][0]["volumeMounts"]}
    assert {word for word in store_words(store) if word[0] == "/"} <= mounts | {
        "/etc/slamhive-store/store.yaml"
    }
    api.items = []
    assert await sending._store(cluster) is None
    plain = sender_job("lab", "fetch-1", like)
    assert [volume["name"] for volume in plain["spec"]["template"]["spec"]["volumes"]] == ["results", "tmp"]
