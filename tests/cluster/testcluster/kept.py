# SPDX-License-Identifier: Apache-2.0
"""An operator with all its reconcilers on an API that only keeps what is written: no cluster, no waiting."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

from slamhive.kube import cluster
from slamhive.kube.api.errors import NotFound
from slamhive.kube.api.kinds import Key, Kind, key_of
from slamhive.kube.loop import Loop
from slamhive.kube.reconciling import reconcilers
from slamhive.kube.reconciling.catalogue import parse
from slamhive.kube.reconciling.variants import Wanted
from slamhive.kube.settings import Settings
from slamhive.kube.status import iso
from slamhive.model.algorithm import Algorithm
from slamhive.model.dataset import Dataset
from slamhive.plan import resolve

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.archive import Archive
    from slamhive.kube.api.errors import ApiError

NAMESPACE = "lab"
GRACE = 60.0
BEGIN = 1.8e9
SETTINGS = Settings.model_validate(
    {
        "namespaces": [NAMESPACE],
        "image": "slamhive",
        "volumes": {"results": {"claim": "r"}, "data": {"claim": "d"}},
        "sweepWriteSeconds": 0,
        "refusalGraceSeconds": GRACE,
        "evaluation": {"delaySeconds": 0},
    }
)


def manifest(kind: Kind, name: str, spec: dict[str, Any]) -> dict[str, Any]:
    return {"metadata": {"name": name, "namespace": NAMESPACE}, "spec": spec} | {
        "apiVersion": kind.api_version,
        "kind": str(kind),
    }


ALGORITHM: dict[str, Any] = {
    "image": "icp:1",
    "modes": [{"name": "lidar"}],
    "output": {"frame": "lidar"},
    "parameters": {f"note{number}": {"type": "String", "default": ""} for number in range(14)},
}
DATASET = {
    "recording": {"files": [{"path": "a.bag"}]},
    "sensors": {"lidar": {"type": "Lidar", "topic": "/points", "rate": 10}},
}
RUN: dict[str, Any] = {
    "algorithmRef": {"name": "icp"},
    "datasetRef": {"name": "hall"},
    "retries": 0,
    "evaluate": False,
}
READY: dict[str, Any] = {
    "format": "Rosbag1",
    "recording": "recording.bag",
    "sensors": {"lidar": {"name": "lidar", "type": "Lidar", "topic": "/points", "rate": 10}},
    "startTime": 0.0,
    "durationSeconds": 10.0,
    "frameRate": 10.0,
    "resolution": 1.0,
    "folder": "a" * 32,
    "frames": 10,
    "key": "k",
    "sourceSha256": "s",
    "datasetSha256": "d",
}


class Cluster:
    """An API that keeps what is written, and an operator on it whose time is the test's.

    Attributes:
        seen: the cluster as the operator sees it.
        loop: the operator's reconcilers.
        refusals: by kind, what creating one is answered with.
        told: Events by (name of the object, reason).
        check: raises what a patch is answered with.
        printed: logs by pod.
        failed_creates: messages of FailedCreate Events, the newest last.
    """

    def __init__(self, archive: Archive | None = None) -> None:
        self.objects: dict[Key, dict[str, Any]] = {}
        self.refusals: dict[Kind, ApiError] = {}
        self.told: dict[tuple[str, str], str] = {}
        self.failed_creates: list[str] = []
        self.printed: dict[str, str] = {}
        self.check: Callable[[Key, dict[str, Any]], None] | None = None
        self.evaluation: Any = None
        self.now = BEGIN
        self.count: Any = None
        self._version = 0
        self.seen = cluster.Cluster(self, SETTINGS, lambda: self.now)  # type: ignore[arg-type]
        self.loop = Loop(self.seen, reconcilers(archive))

    def apply(
        self,
        kind: Kind,
        name: str,
        spec: dict[str, Any],
        *,
        labels: dict[str, str] | None = None,
        annotations: dict[str, str] | None = None,
        owner: dict[str, str] | None = None,
        **status: Any,
    ) -> Key:
        """Have an object, seen by the operator."""
        body = self._made(manifest(kind, name, copy.deepcopy(spec)) | {"status": status})
        body["metadata"] |= {"labels": labels or {}, "annotations": annotations or {}}
        body["metadata"] |= {"ownerReferences": [owner]} if owner else {}
        self.objects[key_of(kind, body)] = body
        self.seen.observe(kind, "ADDED", body)
        return key_of(kind, body)

    def described(self) -> None:
        """Have the variant "v" known, with a ground truth, so that runs can be measured."""
        key = Key(Kind.DATASET, NAMESPACE, "hall")
        variants = [{"name": "v", "phase": "Ready", "description": READY | {"groundTruth": "poses"}}]
        self.apply(Kind.DATASET, "hall", self.objects[key]["spec"], variants=variants)

    def _made(self, body: dict[str, Any]) -> dict[str, Any]:
        self._version += 1
        meta = {"uid": f"uid-{body['metadata']['name']}", "generation": 1, "creationTimestamp": iso(self.now)}
        return body | {"metadata": meta | body["metadata"] | {"resourceVersion": str(self._version)}}

    async def get(self, key: Key) -> dict[str, Any]:
        if key not in self.objects:
            raise NotFound(f"{key} not found", status=404)
        return self.objects[key]

    async def create(self, kind: Kind, body: dict[str, Any], _namespace: str | None) -> dict[str, Any]:
        if kind in self.refusals:
            raise self.refusals[kind]
        made = self._made({"status": {}} | body)
        self.objects[key_of(kind, body)] = made
        return made

    async def patch(self, key: Key, body: dict[str, Any], *, subresource: str | None) -> dict[str, Any]:
        present = self.objects[key]
        if self.check is not None:
            self.check(key, body)
        left = present["status"] | body.get("status", {})
        status = {name: value for name, value in left.items() if value is not None}
        noted = (present["metadata"].get("annotations") or {}) | (body.get("metadata") or {}).get(
            "annotations", {}
        )
        meta = present["metadata"] | ({"annotations": noted} if noted else {})
        self.objects[key] = self._made(present | {"metadata": meta, "status": status})
        return self.objects[key]

    async def delete(self, key: Key, **_: Any) -> None:
        self.objects.pop(key)

    async def logs(self, _namespace: str, pod: str, _container: str) -> str:
        return self.printed[pod]

    async def event(self, _kind: Kind, regarding: dict[str, Any], _type: str, reason: str, text: str) -> None:
        self.told[regarding["metadata"]["name"], reason] = text

    async def quotas(self, _namespace: str) -> list[dict[str, Any]]:
        return []

    async def events(self, _namespace: str, reason: str) -> list[dict[str, Any]]:
        jobs = [body["metadata"]["uid"] for key, body in self.objects.items() if key.kind is Kind.JOB]
        return [
            {"involvedObject": {"uid": uid}, "message": text}
            for text in self.failed_creates
            for uid in jobs
            if reason == "FailedCreate"
        ]

    async def look(self, key: Key, after: float = 0.0) -> dict[str, Any]:
        """Reconcile an object some seconds later, and return its status."""
        self.now += after
        while len(self.seen.queue):
            self.seen.queue.done(await self.seen.queue.get())
        await self.loop.handle(key)
        status: dict[str, Any] = self.objects[key]["status"]
        return status


def standing(status: dict[str, Any], kind: str) -> tuple[str, str, str]:
    [found] = [item for item in status["conditions"] if item["type"] == kind]
    return found["status"], found["reason"], found["message"]


def catalogued(algorithm: dict[str, Any] = ALGORITHM, archive: Archive | None = None) -> Cluster:
    """Return a cluster with an Algorithm and a Dataset, whose variant for RUN is ready."""
    made = Cluster(archive)
    known = parse(Algorithm, manifest(Kind.ALGORITHM, "icp", algorithm))
    dataset = parse(Dataset, manifest(Kind.DATASET, "hall", DATASET))
    variant = {
        "name": Wanted.by(resolve(RUN, known, dataset), known, dataset).name,
        "phase": "Ready",
        "description": READY,
        "lastUsedTime": iso(BEGIN),
    }
    made.apply(Kind.ALGORITHM, "icp", algorithm)
    made.apply(Kind.DATASET, "hall", DATASET, variants=[variant])
    return made
