# SPDX-License-Identifier: Apache-2.0
"""The dashboard over a real API server: what is live, what is archived, and what happens when either goes."""

from __future__ import annotations

import asyncio
import time
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive
from slamhive.dashboard.sources.cluster import ClusterSource
from slamhive.kube.api.client import Api
from slamhive.kube.api.kinds import Key, Kind, Label
from slamhive.kube.records import record_of
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable
    from pathlib import Path

    from testcluster.access import Cluster

pytestmark = pytest.mark.cluster

RESULT = {
    "evaluation": "se3",
    "outcome": "Tracked",
    "coverage": 0.97,
    "alignment": "se3",
    "ate": {"rmse": 0.123456789012345},
}
STATUS = {
    "phase": "Succeeded",
    "completionTime": "2026-01-02T03:04:05.25Z",
    "usage": {"cpu": {"meanCores": 1.5}, "wallSeconds": 20.0},
    "results": [RESULT],
    "logTail": "bye",
}


async def until(found: Callable[[], Awaitable[Any]], seconds: float = 60) -> Any:
    """Wait until something is so, and return it."""
    deadline = time.monotonic() + seconds
    while True:
        value = await found()
        if value or time.monotonic() > deadline:
            assert value
            return value
        await asyncio.sleep(0.1)


@pytest.fixture
async def kube(crds: Cluster) -> AsyncIterator[Api]:
    api = await Api.connect(crds.kubeconfig)
    yield api
    await api.close()


@pytest.fixture
def make(kube: Api, namespace: str) -> Callable[..., Awaitable[dict[str, Any]]]:
    """Make a run with a status."""

    async def make(name: str, **status: Any) -> dict[str, Any]:
        labels = {str(Label.SWEEP): "study", str(Label.POINT): "0"}
        body = {
            "metadata": {"name": name, "namespace": namespace, "labels": labels},
            "spec": {
                "algorithmRef": {"name": "kiss-icp"},
                "datasetRef": {"name": "hall"},
                "parameters": {"voxelSize": 0.5},
            },
        }
        await kube.create(Kind.MAPPING_RUN, body)
        return await set_status(kube, namespace, name, **status)

    return make


async def set_status(kube: Api, namespace: str, name: str, **status: Any) -> dict[str, Any]:
    key = Key(Kind.MAPPING_RUN, namespace, name)
    return await kube.patch(key, {"status": status}, subresource="status")


@pytest.fixture
def source(crds: Cluster, namespace: str, url: str, tmp_path: Path) -> ClusterSource:
    return ClusterSource(
        [namespace],
        archive_url=url,
        results=tmp_path / "results",
        name="lab",
        connect=partial(Api.connect, crds.kubeconfig),
    )


async def test_a_run_is_seen_from_its_beginning_to_the_archive(
    source: ClusterSource,
    open_app: Callable[..., Any],
    kube: Api,
    make: Callable[..., Awaitable[dict[str, Any]]],
    url: str,
) -> None:
    made = await make("one", phase="Running")
    namespace, results = made["metadata"]["namespace"], source._results
    assert results is not None
    uid = made["metadata"]["uid"]
    folder = f"runs/{uid}/pod"
    async with open_app(source) as client:

        async def answering() -> bool:
            return bool((await client.raw.get("/readyz")).status_code == 200)

        async def shown(**expected: Any) -> Any:
            answer = await client.get("/runs")
            items = [item for item in answer["items"] if expected.items() <= item.items()]
            return items if answer["total"] == 1 else None

        await until(answering)
        (item,) = await until(partial(shown, phase="Running", status="Running"))
        assert (item["uid"], item["algorithm"], item["sweep"]) == (uid, "kiss-icp", "study")
        assert item["id"] < 0
        index = await client.get("")
        assert (index["counts"]["live"], index["source"]["name"]) == (1, "lab")
        assert (await client.get("/sweeps"))["items"][0]["live"] is True

        finished = await set_status(kube, namespace, "one", **STATUS, folder=folder)
        (item,) = await until(partial(shown, outcome="Tracked"))
        assert item["ate.rmse"] == 0.123456789012345
        detail = await client.get(f"/runs/{uid}")
        assert detail["logTail"] == "bye"
        assert detail["configuration"]["parameters"] == {"voxelSize": 0.5}
        (results / folder).mkdir(parents=True)
        (results / folder / "usage.csv").write_text("t,c,m\n0,1,2\n")
        assert (await client.get(f"/runs/{uid}/usage"))["cpu"] == [1.0]

        with Archive.open(url) as archive:
            archive.put_run(record_of(finished))
        await kube.delete(Key(Kind.MAPPING_RUN, namespace, "one"), uid=uid)
        (item,) = await until(partial(shown, outcome="Tracked", id=1))
        assert item["uid"] == uid
        assert (await client.get(f"/runs/{uid}"))["logTail"] == "bye"


async def test_live_runs_stand_beside_archived_ones_and_before_their_likeness(
    source: ClusterSource,
    open_app: Callable[..., Any],
    make: Callable[..., Awaitable[dict[str, Any]]],
    make_run: Callable[..., Any],
    url: str,
) -> None:
    made = await make("both", **STATUS)
    old = record_of(made).replace(results=[], log_tail="old")
    # As one beyond its Sweep's retention is, for a moment.
    untold = record_of(await make("untold", phase="Running")).replace(phase=Phase.FAILED)
    with Archive.open(url) as archive:
        archive.put_runs([old, untold, *(make_run(number) for number in range(5))])
    async with open_app(source) as client:

        async def complete() -> bool:
            answer = await client.raw.get("/api/v1/runs?sort=uid")
            return bool(answer.status_code == 200 and answer.json()["total"] == 7)

        await until(complete)
        (item,) = (await client.get("/runs?name=both"))["items"]
        assert (item["outcome"], item["id"] < 0) == ("Tracked", True)
        (item,) = (await client.get("/runs?name=untold"))["items"]
        assert (item["phase"], item["id"] < 0) == ("Failed", False)
        assert (await client.get(f"/runs/{item['uid']}"))["phase"] == "Failed"
        board = (await client.get("/analysis/aggregate?by=algorithm&metrics=ate.rmse"))["groups"]
        assert sum(group["runs"] for group in board) == 7


async def test_an_archive_that_is_away_is_said_and_the_rest_goes_on(
    crds: Cluster,
    namespace: str,
    open_app: Callable[..., Any],
    make: Callable[..., Awaitable[dict[str, Any]]],
    tmp_path: Path,
) -> None:
    await make("one", **STATUS)
    file = tmp_path / "away.sqlite"
    file.write_bytes(b"this is no database" * 100)
    source = ClusterSource(
        [namespace], archive_url=f"sqlite:///{file}", connect=partial(Api.connect, crds.kubeconfig)
    )
    async with open_app(source) as client:

        async def shown() -> bool:
            answer = await client.raw.get("/api/v1/runs")
            return bool(answer.status_code == 200 and answer.json()["total"] == 1)

        await until(shown)
        assert "not an SQLite database" in (await client.get(""))["problems"][0]
        file.unlink()

        async def well() -> bool:
            return not (await client.get(""))["problems"]

        await until(well)


async def test_an_api_server_that_was_away_is_followed_again(
    local_cluster: Any,
    source: ClusterSource,
    open_app: Callable[..., Any],
    make: Callable[..., Awaitable[dict[str, Any]]],
) -> None:
    await make("before", phase="Running")
    async with open_app(source) as client:

        async def shown(count: int) -> bool:
            answer = await client.raw.get("/api/v1/runs")
            return bool(answer.status_code == 200 and answer.json()["total"] == count)

        async def troubled() -> bool:
            return any("does not answer" in sentence for sentence in (await client.get(""))["problems"])

        await until(partial(shown, 1))
        await asyncio.to_thread(local_cluster.stop, "apiserver")
        try:
            await until(troubled, 90)
            assert (await client.get("/runs"))["total"] == 1
        finally:
            await asyncio.to_thread(local_cluster.start, "apiserver")

        async def made() -> bool:
            try:
                await make("after", phase="Running")
            except Exception:  # noqa: BLE001 - not up yet
                return False
            return True

        await until(made, 90)
        await until(partial(shown, 2), 90)
