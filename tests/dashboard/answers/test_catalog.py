# SPDX-License-Identifier: Apache-2.0
"""Sweeps, evaluations, algorithms, datasets, the state in short, and live events."""

from __future__ import annotations

import asyncio
import json
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive, SweepRecord
from slamhive.dashboard.server.events import Events
from slamhive.dashboard.server.service import Service
from slamhive.dashboard.sources.archived import Workstation

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.model.results import RunRecord


async def test_what_there_is_in_numbers(api: Any) -> None:
    answer = await api.get("")
    assert answer["counts"] == {
        "runs": 30,
        "rows": 31,
        "sweeps": 1,
        "algorithms": 2,
        "datasets": 3,
        "evaluations": 2,
        "superseded": 0,
        "live": 0,
    }
    assert answer["statuses"]["OutOfMemory"] == 1
    assert answer["problems"] == []


async def test_sweeps_count_runs_once(api: Any) -> None:
    (item,) = (await api.get("/sweeps"))["items"]
    assert (item["name"], item["runs"], item["phases"]) == ("study", 30, {"Succeeded": 29, "Failed": 1})
    assert item["started"] == "2026-01-02T03:04:00.250000+00:00"
    assert item["axes"] == [{"name": "dataset", "count": 1}, {"name": "nFeatures", "count": 2}]
    one = await api.get("/sweeps/study")
    assert "kind: Sweep" in one["manifest"]
    assert "did you mean 'study'" in (await api.get("/sweeps/studdy", 404))["error"]


async def test_51_single_runs_are_one_group_and_a_sweep_says_how_its_errors_spread(
    tmp_path: Path, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> None:
    url = f"sqlite:///{tmp_path / 'archive.sqlite'}"
    whole = {"algorithmRef": {"name": "a"}, "datasetRef": {"name": "d"}, "sensors": "lidar"}
    bad = {"phase": "Failed", "reason": "OutOfMemory", "results": []}
    bad["evaluations"] = [{"evaluation": "se3", "alignment": "se3"}]
    with Archive.open(url) as archive:
        for number in range(51):
            name = f"try-{number}".ljust(63, "x")
            archive.put_sweep(SweepRecord(uid=name, name=name, spec={"template": {"spec": whole}}))
            archive.put_run(make_run(number, sweep=name, **(bad if number % 3 == 0 else {})))
        for number in range(60, 64):
            archive.put_run(make_run(number, sweep="study"))
            archive.put_run(make_run(100 + number, sweep="failing", **bad))
    async with open_app(Workstation(url, tmp_path)) as client:
        answer = await client.get("/sweeps")
    assert answer["single"]["runs"] == sum(item["single"] for item in answer["items"]) == 51
    assert answer["single"]["statuses"] == {"Tracked": 34, "OutOfMemory": 17}
    several = {item["name"]: item for item in answer["items"] if not item["single"]}
    assert sorted(several) == ["failing", "study"]
    assert all(one["low"] is None and one["failed"] == 2 for one in several["failing"]["spread"])
    # Runs 60 to 63: dataset-0 has 0.61 and 0.62 m, dataset-1 0.63 and 0.64 m; each is over its own best.
    spread = {one["algorithm"]: one for one in several["study"]["spread"]}
    assert spread["algorithm-0"] == {
        "algorithm": "algorithm-0", "low": 1.0, "median": 1.0, "high": 1.0, "failed": 0
    }  # fmt: skip
    assert spread["algorithm-1"]["high"] == pytest.approx(0.62 / 0.61)
    assert [(one["dataset"], round(one["ate"], 2)) for one in several["study"]["best"]] == [
        ("dataset-0", 0.61),
        ("dataset-1", 0.63),
    ]


async def test_evaluations_and_the_catalog(api: Any) -> None:
    evaluations = (await api.get("/evaluations"))["items"]
    assert [(item["name"], item["rows"]) for item in evaluations] == [("se3", 29), ("sim3", 1)]
    assert sum(evaluations[0]["outcomes"].values()) == 28, "a run that failed has no outcome"
    algorithms = {item["name"]: item for item in (await api.get("/algorithms"))["items"]}
    assert algorithms["algorithm-0"]["description"] == "the first"
    assert sum(item["runs"] for item in algorithms.values()) == 30
    assert "kind: Algorithm" in (await api.get("/algorithms/algorithm-0"))["manifest"]
    assert (await api.get("/algorithms/algorithm-1"))["manifest"] is None
    assert (await api.get("/datasets/dataset-1"))["algorithms"] == ["algorithm-0", "algorithm-1"]
    assert not any(item["attributes"] for item in algorithms.values()), "they are the datasets'"
    assert (await api.get("/datasets/nothing", 404))["field"] == "name"


@pytest.mark.parametrize(
    "path",
    [
        "",
        "/runs",
        "/columns",
        "/sweeps",
        "/evaluations",
        "/algorithms",
        "/datasets",
        "/analysis/points?x=ate.rmse&y=coverage",
        "/analysis/aggregate",
        "/analysis/leaderboard",
        "/analysis/compare",
        "/analysis/pareto",
        "/analysis/importance",
        "/analysis/repeatability",
        "/analysis/suspects",
    ],
)
async def test_nothing_is_there_yet(tmp_path: Path, open_app: Callable[..., Any], path: str) -> None:
    async with open_app(Workstation(f"sqlite:///{tmp_path / 'none.sqlite'}", tmp_path)) as client:
        answer = await client.get(path)
        assert not answer.get("items")
    assert not (tmp_path / "none.sqlite").exists()


@pytest.mark.usefixtures("looks_at_once")
async def test_an_archive_that_comes_later_is_found(
    url: str, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> None:
    async with open_app(Workstation(url)) as client:
        assert (await client.get("/runs"))["total"] == 0
        with Archive.open(url) as archive:
            archive.put_run(make_run(1))
        assert (await client.get("/runs"))["total"] == 1


@pytest.mark.usefixtures("looks_at_once")
async def test_a_damaged_archive_is_said_and_survived(tmp_path: Path, open_app: Callable[..., Any]) -> None:
    file = tmp_path / "archive.sqlite"
    file.write_bytes(b"this is no database" * 100)
    async with open_app(Workstation(f"sqlite:///{file}")) as client:
        assert "not an SQLite database" in (await client.get("/runs", 503))["error"]
        file.unlink()
        assert (await client.get("/runs"))["total"] == 0


@pytest.mark.usefixtures("looks_at_once")
async def test_listeners_hear_of_each_change(
    assorted: str, make_run: Callable[..., RunRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.dashboard.server.events.CHECK_SECONDS", 0.0)
    service = Service(Workstation(assorted))
    await service.start()
    events = Events(service)
    stream = events.stream()

    async def following() -> dict[str, Any]:
        async for part in stream:
            if part.startswith(b"event: revision"):
                return dict(json.loads(part.partition(b"data: ")[2]))
        raise AssertionError

    try:
        async with asyncio.timeout(60):
            first = await following()
            with Archive.open(assorted) as archive:
                archive.put_run(make_run(100))
            second = await following()
    finally:
        await events.stop()
        await stream.aclose()
        await service.stop()
    assert (first["counts"]["runs"], second["counts"]["runs"]) == (30, 31)
    assert first["revision"] != second["revision"]


async def test_pages_lead_to_the_index_and_files_do_not(api: Any) -> None:
    page = await api.raw.get("/runs/uid-000")
    assert page.headers["content-type"].startswith("text/html")
    again = await api.raw.get("/runs/uid-000", headers={"If-None-Match": page.headers["etag"]})
    assert again.status_code == 304
    for path in ("/nothing.js", "/vendor/x", "/api/v1/nothing", "/../pyproject.toml", "/%2e%2e/app.py"):
        answer = await api.raw.get(path)
        assert answer.status_code == 404 or answer.headers["content-type"].startswith("text/html")
        assert "import" not in answer.text or "<html" in answer.text


async def test_the_picture_of_a_recording_is_the_kept_one(
    open_app: Callable[..., Any], tmp_path: Path
) -> None:
    url, kept = f"sqlite:///{tmp_path / 'none.sqlite'}", tmp_path / "cache" / "overviews"
    kept.mkdir(parents=True)
    overview = {"version": 1, "name": "hall", "start": 5.0, "seconds": 1.0, "sensors": [], "notes": []}
    (kept / "hall-0123456789abcdef.json").write_text(json.dumps(overview))
    async with open_app(Workstation(url, tmp_path)) as client:
        assert (await client.get("/datasets/hall/overview"))["start"] == 5.0
        missing = await client.get("/datasets/hal/overview", 404)
        assert "slamhive dataset show hal --html" in missing["error"]
    async with open_app(Workstation(url)) as client:
        assert "not at hand" in (await client.get("/datasets/hall/overview", 404))["error"]
