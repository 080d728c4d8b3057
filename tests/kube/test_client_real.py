# SPDX-License-Identifier: Apache-2.0
"""Watches of the operator on a real API server; what the client relies on in one is in test_api_server.py."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.kube import cluster, handlers
from slamhive.kube.api.client import Api
from slamhive.kube.api.errors import Forbidden
from slamhive.kube.api.kinds import Key, Kind, Label, key_of, reference
from slamhive.kube.operator import Operator
from slamhive.kube.served import what_crds_lack
from slamhive.kube.settings import Settings

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path

    from testcluster.access import Cluster

SPEC = {"algorithmRef": {"name": "kiss-icp"}, "datasetRef": {"name": "demo"}}


@pytest.fixture
async def api(crds: Cluster) -> AsyncIterator[Api]:
    api = await Api.connect(crds.kubeconfig)
    yield api
    await api.close()


async def test_what_kubectl_does_enters_the_store(api: Api, crds: Cluster, namespace: str) -> None:
    settings = Settings.model_validate(
        {
            "namespaces": [namespace],
            "image": "slamhive",
            "volumes": {"results": {"claim": "r"}, "data": {"claim": "d"}},
        }
    )
    seen: list[Key] = []

    async def look(_: object, key: Key) -> float | None:
        seen.append(key)
        return None

    op = Operator(cluster.Cluster(api, settings), {Kind.MAPPING_RUN: look})
    run = await api.create(
        Kind.MAPPING_RUN, {"metadata": {"name": "a", "namespace": namespace}, "spec": SPEC}
    )
    key = key_of(Kind.MAPPING_RUN, run)
    watching = asyncio.create_task(handlers.watch(op))
    try:
        await op.start()
        await until(lambda: seen == [key])
        job = await op.cluster.create(Kind.JOB, suspended_job(run))
        assert [kind for kind, _ in op.cluster.store.owned(run["metadata"]["uid"])] == [Kind.JOB]
        crds.kubectl("-n", namespace, "delete", "mappingrun", "a")
        await until(
            lambda: op.cluster.store.get(key) is None and not op.cluster.store.of(Kind.JOB, namespace)
        )
        assert job["metadata"]["name"] == "a-1"
    finally:
        watching.cancel()
        await asyncio.wait([watching])
        await op.stop()


async def test_an_account_without_rights_is_told_of_them_and_sees_the_crds_schemas(
    crds: Cluster, namespace: str, tmp_path: Path
) -> None:
    kubeconfig = yaml.safe_load(crds.kubeconfig.read_text())
    token = crds.kubectl("create", "token", "default", "-n", namespace).strip()
    kubeconfig["users"] = [one | {"user": {"token": token}} for one in kubeconfig["users"]]
    (tmp_path / "kubeconfig").write_text(yaml.safe_dump(kubeconfig))
    nobody = await Api.connect(tmp_path / "kubeconfig")
    try:
        for asked in (
            nobody.list(Kind.POD, namespace),
            nobody.logs(namespace, "x", "y"),
            nobody.create(Kind.MAPPING_RUN, {"metadata": {"name": "a", "namespace": namespace}}),
            nobody.patch(Key(Kind.SWEEP, namespace, "a"), {"status": {}}, subresource="status"),
        ):
            with pytest.raises(Forbidden) as told:
                await asked
            assert told.value.retryable, told.value
        async with asyncio.timeout(60):  # the server publishes them some seconds after it has taken them
            while await what_crds_lack(nobody) is None:  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        assert await what_crds_lack(nobody) == ""
    finally:
        await nobody.close()


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
