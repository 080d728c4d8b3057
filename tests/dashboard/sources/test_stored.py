# SPDX-License-Identifier: Apache-2.0
"""Runs whose folders were moved to object storage: pages show what they showed, or say why they can't."""

from __future__ import annotations

import math
import shutil
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

sys.path.append(str(Path(__file__).parents[2] / "storage"))

from buckets import S3, make_place, place, s3

from slamhive.archive import Archive
from slamhive.dashboard.sources.archived import Workstation
from slamhive.dashboard.sources.cluster import ClusterSource
from slamhive.jobs.moving import copy_folder
from slamhive.model.results import Outcome, Result
from slamhive.runfiles.stored import Shelf
from slamhive.storage.offloaded import look_up
from slamhive.storage.state import STATE, OffloadState
from slamhive_eval import Options, evaluate, read_tum

if TYPE_CHECKING:
    from collections.abc import Callable

    from buckets import Place as Bucket

    from slamhive.model.results import RunRecord
    from slamhive.runfiles.artifacts import ArtifactFolder

__all__ = ["place", "s3"]

FOLDER = "runs/uid-000/pod-1"
LIMIT = 1 << 20
ASKED = (
    "/runs/uid-000",
    "/runs/uid-000/files",
    "/runs/uid-000/settings-files",
    "/runs/uid-000/trajectory?points=50",
    "/runs/uid-000/usage?points=50",
    "/analysis/common",
    "/analysis/paths?points=50",
)


def write_poses(path: Path, offset: float) -> None:
    lines = [f"{k / 10} {math.cos(k / 50)} {math.sin(k / 50)} {offset * (k % 3)} 0 0 0 1" for k in range(400)]
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture
def volume(tmp_path: Path, url: str, make_run: Callable[..., RunRecord]) -> Path:
    """A results volume with the folder of a run, and its record."""
    folder = tmp_path / "results" / FOLDER
    for name in ("output", "files/config"):
        (folder / name).mkdir(parents=True)
    write_poses(folder / "output/trajectory.txt", 0.1)
    (folder / "config.yaml").write_text("dataset: {}\n")
    (folder / "files/config/slam.yaml").write_text("features: 3\n")
    (folder / "output/map.bin").write_bytes(bytes(LIMIT + 1))
    samples = "".join(f"{k / 10},{k % 2},{k * 100},{k * 50}\n" for k in range(100))
    (folder / "usage.csv").write_text(f"time_seconds,cpu_cores,memory_bytes,anonymous_bytes\n{samples}")
    (tmp_path / "truth").mkdir()
    write_poses(tmp_path / "truth/dataset-0.txt", 0.0)
    truth, estimate = tmp_path / "truth/dataset-0.txt", folder / "output/trajectory.txt"
    found = evaluate(read_tum(truth), read_tum(estimate), Options()).as_dict()
    outcome, coverage = found.pop("outcome"), found.pop("coverage")
    result = Result(evaluation="se3", outcome=Outcome(outcome), coverage=coverage, values=found)
    with Archive.open(url) as archive:
        archive.put_run(make_run(0, folder=FOLDER, results=[result]))
    return tmp_path / "results"


class Source(Workstation):
    """The archive alone, with folders as a cluster has them."""

    def __init__(self, url: str, volume: Path, shelf: Shelf) -> None:
        super().__init__(url, None, volume.parent / "truth")
        self._cluster = ClusterSource([], results=volume, shelf=shelf)

    def place(self, record: RunRecord) -> ArtifactFolder | None:
        return self._cluster.place(record)


def source(url: str, volume: Path, bucket: Bucket, limit: int = LIMIT) -> Source:
    return Source(url, volume, Shelf(bucket.store(), volume.parent / "cache", limit))


def move(volume: Path, bucket: Bucket) -> None:
    copy_folder(volume, "uid-000", bucket.store())
    shutil.rmtree(volume / "runs/uid-000")


def told(answer: Any) -> Any:
    """Return an answer without what is no matter of the run."""
    if isinstance(answer, dict):
        return {name: told(value) for name, value in answer.items() if name != "revision"}
    return [told(item) for item in answer] if isinstance(answer, list) else answer


async def test_pages_show_the_same_from_the_volume_and_from_the_bucket(
    volume: Path, url: str, place: Bucket, open_app: Callable[..., Any]
) -> None:
    async with open_app(source(url, volume, place)) as client:
        before = {path: told(await client.get(path)) for path in ASKED}
        content = (await client.raw.get("/api/v1/runs/uid-000/files/output/trajectory.txt")).content
    assert before["/runs/uid-000/usage?points=50"]["samples"] == 100
    move(volume, place)
    async with open_app(source(url, volume, place)) as client:
        for path in ASKED:
            assert told(await client.get(path)) == before[path], path
        answer = await client.raw.get("/api/v1/runs/uid-000/files/output/trajectory.txt")
        assert answer.content == content
        assert "slamhive fetch" in (await client.get("/runs/uid-000/files/output/map.bin", 413))["error"]
        for path, status in {
            "none": 404,
            "output": 404,
            "%2e%2e/x": 400,
            "output/%2e%2e/usage.csv": 400,
        }.items():
            await client.get(f"/runs/uid-000/files/{path}", status)


async def test_a_changed_object_is_told_and_no_part_of_it_is_shown(
    volume: Path, url: str, place: Bucket, open_app: Callable[..., Any]
) -> None:
    move(volume, place)
    place.change(f"{FOLDER}/output/trajectory.txt", b"0 1 2 3 0 0 0 1\n")
    async with open_app(source(url, volume, place)) as client:
        for path in ("/runs/uid-000/trajectory", "/runs/uid-000/files/output/trajectory.txt"):
            assert "trajectory.txt was changed" in (await client.get(path, 503))["error"]
        await client.get("/runs/uid-000/usage")
        paths = await client.get("/analysis/paths")
        assert "trajectory.txt was changed" in paths["groups"][0]["runs"][0]["problem"]
    assert not any(path.name[0] == "." for path in (volume.parent / "cache").iterdir())


async def test_a_bucket_that_is_away_leaves_all_that_the_archive_knows(
    volume: Path, url: str, tmp_path: Path, open_app: Callable[..., Any]
) -> None:
    server = S3()
    bucket = make_place("s3", tmp_path / "bucket", server)
    move(volume, bucket)
    server.stop()
    async with open_app(source(url, volume, bucket)) as client:
        assert (await client.get("/runs/uid-000"))["files"] is True
        for path in ("/runs/uid-000/files", "/runs/uid-000/trajectory", "/runs/uid-000/usage"):
            answer = await client.raw.get(f"/api/v1{path}")
            assert answer.status_code == 503
            assert f"storage {bucket.url}" in answer.json()["error"]
        paths = await client.get("/analysis/paths")
        assert f"storage {bucket.url}" in paths["groups"][0]["runs"][0]["problem"]


async def test_a_run_that_is_in_neither_place_has_no_files(
    volume: Path, url: str, place: Bucket, open_app: Callable[..., Any]
) -> None:
    shutil.rmtree(volume / "runs/uid-000")
    async with open_app(source(url, volume, place)) as client:
        assert (await client.get("/runs/uid-000"))["files"] is False
        assert "none is here" in (await client.get("/runs/uid-000/files", 404))["error"]


def test_what_is_kept_here_stays_within_its_limit(volume: Path, place: Bucket, tmp_path: Path) -> None:
    for name in "abc":
        (volume / FOLDER / name).write_bytes(name.encode() * 400)
    move(volume, place)
    shelf = Shelf(place.store(), tmp_path / "cache", 1000)
    found = shelf.place(tuple(FOLDER.split("/")))
    assert found is not None
    sums = {file.path[-1]: file.sha256 for file in look_up(place.store(), "uid-000").files}  # type: ignore[union-attr]
    for name in "abac":
        found.bring([name])
        with found.open(name) as descriptor, open(descriptor, "rb", closefd=False) as file:
            assert file.read() == name.encode() * 400
        held = {path.name for path in (tmp_path / "cache").iterdir()}
        assert sums[name] in held
        assert sum(path.stat().st_size for path in (tmp_path / "cache").iterdir()) <= 1000
    place.remove(f"{FOLDER}/c")
    with found.open("c"):
        pass  # it is here


def test_why_nothing_is_moved_stands_on_the_pages(tmp_path: Path, place: Bucket) -> None:
    results = tmp_path / "results"
    results.mkdir()
    told = {
        "since": datetime(2026, 1, 2, 3, 4, tzinfo=UTC),
        "reason": "StorageUnavailable",
        "problem": "the keys are wrong",
        "waiting": 1234,
    }
    state = OffloadState(url=place.url, **told)
    (results / STATE).write_text(state.model_dump_json(by_alias=True))
    shelf = Shelf(place.store(), tmp_path / "cache", LIMIT)
    [shown] = ClusterSource([], results=results, shelf=shelf)._problems()
    assert shown == (
        "StorageUnavailable since 2026-01-02 03:04 UTC: run folders stay on the results volume "
        "(1,234 wait): the keys are wrong"
    )
    (results / STATE).write_text("nonsense")
    assert ClusterSource([], results=results, shelf=shelf)._problems() == ()
