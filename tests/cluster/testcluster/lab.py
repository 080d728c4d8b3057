# SPDX-License-Identifier: Apache-2.0
"""An operator in a test's own process and namespace, and the objects that it works on."""

from __future__ import annotations

import asyncio
import gc
import time
import warnings
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.kube import cluster, handlers
from slamhive.kube.api.client import Api
from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.ending import end_tasks
from slamhive.kube.operator import Operator
from slamhive.kube.reconciling import reconcilers
from slamhive.kube.settings import Settings

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from fakeapi.cluster import FakeCluster
    from testcluster.access import Cluster
    from testcluster.kwok import Pool

    from slamhive.archive import Archive
    from slamhive.sampling import Proposer

SECONDS = 120.0
API_VERSION = "slamhive.io/v1alpha1"


def manifest(kind: str, name: str, **spec: Any) -> dict[str, Any]:
    """Return an object of ours."""
    return {"apiVersion": API_VERSION, "kind": kind, "metadata": {"name": name}, "spec": spec}


def algorithm(name: str = "icp", **changes: Any) -> dict[str, Any]:
    """Return an Algorithm with one parameter."""
    spec = {
        "version": "1",
        "image": f"example.test/{name}:1",
        "modes": [{"name": "lidar", "roles": ["lidar"]}],
        "recording": ["Rosbag1"],
        "parameters": {"size": {"type": "Number", "default": 1, "minimum": 0}},
        "output": {"frame": "lidar"},
        "paces": ["Lockstep"],
    }
    return manifest("Algorithm", name, **(spec | changes))


def dataset(name: str = "hall") -> dict[str, Any]:
    """Return a Dataset with a LiDAR."""
    sensor = {"type": "Lidar", "topic": "/points", "rate": 10}
    return manifest(
        "Dataset",
        name,
        recording={"format": "Rosbag1", "files": [{"path": "a.bag"}]},
        sensors={"lidar": sensor},
        groundTruth={"file": "truth.txt"},
    )


def volumes(namespace: str) -> list[dict[str, Any]]:
    """Return the two volumes of a namespace and the claims on them; no pod that is played writes there."""
    size = {"storage": "1Gi"}
    common = {"accessModes": ["ReadWriteMany"], "storageClassName": ""}
    objects: list[dict[str, Any]] = []
    for claim in ("results", "data"):
        volume = f"{namespace}-{claim}"
        owner = {"namespace": namespace, "name": claim}
        disk = common | {"capacity": size, "claimRef": owner, "hostPath": {"path": f"/var/empty/{volume}"}}
        wish = common | {"resources": {"requests": size}, "volumeName": volume}
        objects += [
            {"apiVersion": "v1", "kind": "PersistentVolume", "metadata": {"name": volume}, "spec": disk},
            {
                "apiVersion": "v1",
                "kind": "PersistentVolumeClaim",
                "metadata": {"name": claim, "namespace": namespace},
                "spec": wish,
            },
        ]
    return objects


def bound_volumes(namespace: str) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the same as disks, and claims that count as bound: the controller that binds takes up to 15 s.

    The disks are to be available before the claims are made.
    """
    objects = volumes(namespace)
    disks = [body for body in objects if body["kind"] == "PersistentVolume"]
    claims = [body for body in objects if body["kind"] != "PersistentVolume"]
    for body in disks:
        del body["spec"]["claimRef"]
    for body in claims:
        body["metadata"]["annotations"] = {"pv.kubernetes.io/bind-completed": "yes"}
    return disks, claims


def run(name: str = "one", **spec: Any) -> dict[str, Any]:
    """Return a MappingRun that is not evaluated."""
    base = {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}, "evaluate": False}
    return manifest("MappingRun", name, **(base | spec))


def sweep(
    name: str = "study", *, sizes: int = 3, template: dict[str, Any] | None = None, **spec: Any
) -> dict[str, Any]:
    """Return a Sweep over the parameter ``size``."""
    base = {
        "template": {"spec": run()["spec"] | (template or {})},
        "matrix": [{"path": "parameters.size", "values": list(range(1, sizes + 1))}],
        "parallelism": 2,
    }
    return manifest("Sweep", name, **(base | spec))


@dataclass
class Lab:
    """A namespace with a catalog, and the means to run operators in it.

    Attributes:
        cluster: the cluster, real or fake.
        namespace: the test's namespace.
        pool: the played nodes.
        calls: (verb, resource) of each successful write of all operators so far.
    """

    cluster: Cluster | FakeCluster
    namespace: str
    pool: Pool
    calls: list[tuple[str, str]] = field(default_factory=list)

    def settings(self, **changes: Any) -> Settings:
        """Return an operator's settings."""
        return Settings.model_validate(
            {
                "namespaces": [self.namespace],
                "image": "example.test/slamhive:1",
                "volumes": {"results": {"claim": "results"}, "data": {"claim": "data"}},
                "pods": {"nodeSelector": self.pool.node_selector, "tolerations": self.pool.tolerations},
                "sweepWriteSeconds": 0.2,
                "relistSeconds": 5,
                "metrics": {"intervalSeconds": 3600},
            }
            | changes
        )

    def apply(self, *objects: dict[str, Any]) -> None:
        """Apply objects in the namespace."""
        self.cluster.apply(*objects, namespace=self.namespace)

    def delete(self, kind: str, name: str) -> None:
        """Delete an object."""
        self.cluster.delete(kind, name, self.namespace)

    def patch(self, kind: str, name: str, change: dict[str, Any], *, subresource: str = "") -> None:
        """Change an object by a JSON merge patch."""
        self.cluster.patch(kind, name, change, self.namespace, subresource)

    @asynccontextmanager
    async def operator(
        self,
        archive: Archive | None = None,
        fault: Callable[[str, str, str], None] | None = None,
        clock: Callable[[], float] = time.time,
        sampler: Proposer | None = None,
        **settings: Any,
    ) -> AsyncIterator[Operator]:
        """Run an operator as long as the context lasts."""
        api = await Api.connect(self.cluster.kubeconfig, fault=fault)
        op = Operator(cluster.Cluster(api, self.settings(**settings), clock), reconcilers(archive, sampler))
        count = api.count

        def counted(verb: str, resource: str, code: str) -> None:
            if count is not None:
                count(verb, resource, code)
            if verb in {"create", "patch", "delete"} and code.startswith("2"):
                self.calls.append((verb, resource))

        api.count = counted
        watching: asyncio.Task[None] | None = None
        try:
            await op.start()
            watching = asyncio.create_task(handlers.watch(op, asyncio.Event()))
            yield op
        finally:
            if watching is not None:
                await end_tasks([watching], again_seconds=5)
                if watching.done() and not watching.cancelled():
                    watching.result()
            await op.stop()
            await api.close()
            _forget_broken_connections()


def _forget_broken_connections() -> None:
    """Let what kopf leaves half-read when its watches are cancelled go without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


async def until(condition: Callable[[], Any], what: str, seconds: float = SECONDS) -> Any:
    """Return a condition's first true value; the store changes while this waits."""
    deadline = asyncio.get_running_loop().time() + seconds
    while not (value := condition()):
        if asyncio.get_running_loop().time() > deadline:
            pytest.fail(f"waited {seconds:g} s in vain for {what}")
        await asyncio.sleep(0.05)
    return value


async def status_of(
    op: Operator, kind: Kind, name: str, holds: Callable[[dict[str, Any]], Any], seconds: float = SECONDS
) -> dict[str, Any]:
    """Return an object's status as soon as it is as wanted."""
    key = Key(kind, op.cluster.settings.namespaces[0], name)

    def found() -> Any:
        body = op.cluster.store.get(key)
        status = (body or {}).get("status") or {}
        return status if body is not None and holds(status) else None

    try:
        status: dict[str, Any] = await until(found, f"{kind} {name}", seconds)
    except BaseException:
        print((op.cluster.store.get(key) or {}).get("status"))  # noqa: T201 - what a failed test has to show
        raise
    return status


def condition_of(status: dict[str, Any], kind: str) -> dict[str, Any]:
    """Return a condition by its type, empty when it is not there."""
    return next((item for item in status.get("conditions") or () if item["type"] == kind), {})
