# SPDX-License-Identifier: Apache-2.0
"""The client and the watches against a real API server."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.kube import errors, handlers
from slamhive.kube.client import Api
from slamhive.kube.kinds import Key, Kind, Label, key_of, reference
from slamhive.kube.operator import Operator
from slamhive.kube.settings import Settings

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from testcluster.access import Cluster

SPEC = {"algorithmRef": {"name": "kiss-icp"}, "datasetRef": {"name": "demo"}}


@pytest.fixture
async def api(crds: Cluster) -> AsyncIterator[Api]:
    api = await Api.connect(crds.kubeconfig)
    yield api
    await api.close()


@pytest.fixture
def run(namespace: str) -> dict[str, Any]:
    return {"metadata": {"name": "demo", "namespace": namespace}, "spec": SPEC}


async def test_a_run_is_made_changed_and_taken_away(api: Api, run: dict[str, Any]) -> None:
    made = await api.create(Kind.MAPPING_RUN, run)
    key = key_of(Kind.MAPPING_RUN, made)
    with pytest.raises(errors.AlreadyExists):
        await api.create(Kind.MAPPING_RUN, run)
    version = made["metadata"]["resourceVersion"]
    checked = {"metadata": {"resourceVersion": version}, "status": {"phase": "Running"}}
    changed = await api.patch(key, checked, subresource="status")
    assert changed["status"]["phase"] == "Running"
    with pytest.raises(errors.Conflict):
        await api.patch(key, checked, subresource="status")
    with pytest.raises(errors.Conflict):
        await api.delete(key, uid="00000000-0000-0000-0000-000000000000")
    with pytest.raises(errors.Conflict):
        await api.delete(key, resource_version=version)
    assert await api.delete(key, uid=made["metadata"]["uid"]) is None
    assert await api.delete(key) is None
    with pytest.raises(errors.NotFound):
        await api.get(key)


async def test_the_server_s_sentences_name_the_field(api: Api, run: dict[str, Any]) -> None:
    run["spec"] = SPEC | {"retries": 99, "timeout": "soon"}
    with pytest.raises(errors.Invalid) as caught:
        await api.create(Kind.MAPPING_RUN, run)
    assert "spec.retries: " in str(caught.value)
    assert "spec.timeout: " in str(caught.value)
    assert "<nil>" not in str(caught.value)


async def test_a_used_up_quota_is_known(api: Api, crds: Cluster, namespace: str) -> None:
    crds.kubectl("-n", namespace, "create", "quota", "none", "--hard=count/jobs.batch=0")
    pod = {"restartPolicy": "Never", "containers": [{"name": "a", "image": "a"}]}
    job = {"metadata": {"name": "demo", "namespace": namespace}, "spec": {"template": {"spec": pod}}}

    async def refused() -> bool:
        try:
            await api.create(Kind.JOB, job)
        except errors.Forbidden as error:
            return error.is_quota
        await api.delete(Key(Kind.JOB, namespace, "demo"))
        return False

    async with asyncio.timeout(60):
        while not await refused():  # noqa: ASYNC110 - its first count comes a moment after the quota
            await asyncio.sleep(0.1)


async def test_pages_make_one_list(api: Api, namespace: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamhive.kube.client.PAGE", 2)
    for number in range(5):
        labels = {Label.SWEEP: "even" if number % 2 == 0 else "odd"}
        metadata = {"name": f"run-{number}", "namespace": namespace, "labels": labels}
        await api.create(Kind.MAPPING_RUN, {"metadata": metadata, "spec": SPEC})
    items, version = await api.list(Kind.MAPPING_RUN, namespace, labels=f"{Label.SWEEP}=even")
    assert [obj["metadata"]["name"] for obj in items] == ["run-0", "run-2", "run-4"]
    assert int(version) >= max(int(obj["metadata"]["resourceVersion"]) for obj in items)


async def test_events_are_counted(api: Api, crds: Cluster, run: dict[str, Any]) -> None:
    made = await api.create(Kind.MAPPING_RUN, run)
    for _ in range(3):
        assert await api.event(Kind.MAPPING_RUN, made, "Warning", "Unschedulable", "no node has a GPU")
    where = ("-n", made["metadata"]["namespace"], "get", "events", "-o", "jsonpath={.items[*].count}")
    assert crds.kubectl(*where) == "3"


async def test_what_kubectl_does_enters_the_store(api: Api, crds: Cluster, namespace: str) -> None:
    settings = Settings.model_validate(
        {
            "namespaces": [namespace],
            "image": "slamhive",
            "volumes": {"results": {"claim": "r"}, "data": {"claim": "d"}},
        }
    )
    seen: list[Key] = []

    async def look(op: Operator, key: Key) -> float | None:
        seen.append(key)
        return None

    op = Operator(api, settings, {Kind.MAPPING_RUN: look})
    run = await api.create(
        Kind.MAPPING_RUN, {"metadata": {"name": "a", "namespace": namespace}, "spec": SPEC}
    )
    key = key_of(Kind.MAPPING_RUN, run)
    watching = asyncio.create_task(handlers.watch(op))
    try:
        await op.start()
        await until(lambda: seen == [key])
        job = await op.create(Kind.JOB, suspended_job(run))
        assert [kind for kind, _ in op.store.owned(run["metadata"]["uid"])] == [Kind.JOB]
        crds.kubectl("-n", namespace, "delete", "mappingrun", "a")
        await until(lambda: op.store.get(key) is None and not op.store.of(Kind.JOB, namespace))
        assert job["metadata"]["name"] == "a-1"
    finally:
        watching.cancel()
        await asyncio.wait([watching])
        await op.stop()


def suspended_job(run: dict[str, Any]) -> dict[str, Any]:
    labels = {Label.MANAGED_BY: "slamhive", Label.ROLE: "run", Label.RUN: "a"}
    owners = [reference(Kind.MAPPING_RUN, run, controller=True)]
    container = {"name": "algorithm", "image": "none"}
    pod = {"restartPolicy": "Never", "containers": [container]}
    namespace = run["metadata"]["namespace"]
    return {
        "metadata": {"name": "a-1", "namespace": namespace, "labels": labels, "ownerReferences": owners},
        "spec": {"suspend": True, "template": {"metadata": {"labels": labels}, "spec": pod}},
    }


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(60):
        while not condition():  # noqa: ASYNC110 - what happens is on the other side of a connection
            await asyncio.sleep(0.05)
