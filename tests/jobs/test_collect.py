# SPDX-License-Identifier: Apache-2.0
"""What is collected, and above all what is not."""

from __future__ import annotations

import json
import os
import sys
import time
import uuid
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive
from slamhive.data.once import in_use
from slamhive.jobs.known import Known, all_pages, known_to
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


def test_nothing_goes_when_the_api_does_not_answer(volumes: Any, tmp_path: Path) -> None:
    before = volumes.files()
    config = {
        "apiVersion": "v1",
        "kind": "Config",
        "current-context": "c",
        "contexts": [{"name": "c", "context": {"cluster": "k", "user": "u"}}],
        "clusters": [{"name": "k", "cluster": {"server": "http://127.0.0.1:1"}}],
        "users": [{"name": "u", "user": {"token": "t"}}],
    }
    (tmp_path / "config").write_text(json.dumps(config))
    for options in ([], ["--kubeconfig", str(tmp_path / "config")]):
        ended = volumes.run("collect", "--namespace", "lab", *options)
        assert ended.error[0] == "SystemFault"
        assert volumes.files() == before


def test_another_namespace_s_volume_is_left_alone(volumes: Any) -> None:
    (volumes.root / "results" / ".slamhive-namespace").write_text("factory")
    before = volumes.files()
    assert "factory" in collect(volumes).error[1]
    assert volumes.files() == before


def test_archived_runs_keep_their_folders(volumes: Any, tmp_path: Path) -> None:
    (tmp_path / "url").write_text(f"sqlite:///{tmp_path / 'archive.db'}\n")
    options = ("--archive-url-file", str(tmp_path / "url"))
    before = volumes.files()
    assert "does not exist" in collect(volumes, *options).error[1]
    with Archive.open(f"sqlite:///{tmp_path / 'archive.db'}") as archive:
        assert "no run at all" in collect(volumes, *options).error[1]
        assert volumes.files() == before
        for uid in (ARCHIVED, GONE):
            record = RunRecord(
                uid=uid,
                name=uid,
                spec={},
                phase=Phase.SUCCEEDED,
                finished=datetime.now(tz=UTC),
                folder=f"runs/{uid}/pod",
            )
            archive.put_run(record)
        assert collect(volumes, *options).code == 0
        assert before - volumes.files() == {file for file in UNKNOWN if GONE not in file}
        # A record that names no folder is one whose files were not to be kept.
        archive.put_run(RunRecord(uid=GONE, name=GONE, spec={}, phase=Phase.SUCCEEDED))
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
    assert known_to(OBJECTS.__getitem__) == Known(
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
