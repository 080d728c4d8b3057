# SPDX-License-Identifier: Apache-2.0
"""What a cluster refuses for good, without a cluster: every object says why it does not go on."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.kube.errors import Forbidden, Invalid
from slamhive.kube.kinds import Key, Kind, key_of
from slamhive.kube.operator import Operator
from slamhive.kube.reconciling import reconcilers
from slamhive.kube.reconciling.catalogue import parse
from slamhive.kube.reconciling.variants import Wanted
from slamhive.kube.settings import Settings
from slamhive.kube.status import iso
from slamhive.model.algorithm import Algorithm
from slamhive.model.dataset import Dataset
from slamhive.plan import resolve

if TYPE_CHECKING:
    from slamhive.kube.errors import ApiError

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
SENTENCE = "cannot create jobs.batch lab/one-1: spec.template.spec.containers[0].image: must not have blanks"
WEBHOOK = 'cannot create jobs.batch lab/one-1: admission webhook "validate.example" denied the request'
QUOTA = "cannot create jobs.batch lab/one-1: exceeded quota: jobs"


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
READY = {
    "format": "Rosbag1",
    "recording": "recording.bag",
    "sensors": {},
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
        refusals: by kind, what creating one is answered with.
        told: Events by (name of the object, reason).
        failed_creates: messages of FailedCreate Events, the newest last.
    """

    def __init__(self) -> None:
        self.objects: dict[Key, dict[str, Any]] = {}
        self.refusals: dict[Kind, ApiError] = {}
        self.told: dict[tuple[str, str], str] = {}
        self.failed_creates: list[str] = []
        self.now = BEGIN
        self.count: Any = None
        self._version = 0
        self.op = Operator(self, SETTINGS, reconcilers(), clock=lambda: self.now)  # type: ignore[arg-type]

    def apply(self, kind: Kind, name: str, spec: dict[str, Any], **status: Any) -> Key:
        body = self._made(manifest(kind, name, copy.deepcopy(spec)) | {"status": status})
        self.objects[key_of(kind, body)] = body
        self.op.observe(kind, "ADDED", body)
        return key_of(kind, body)

    def _made(self, body: dict[str, Any]) -> dict[str, Any]:
        self._version += 1
        meta = {"uid": f"uid-{body['metadata']['name']}", "generation": 1, "creationTimestamp": iso(self.now)}
        return body | {"metadata": meta | body["metadata"] | {"resourceVersion": str(self._version)}}

    async def get(self, key: Key) -> dict[str, Any]:
        return self.objects[key]

    async def create(self, kind: Kind, body: dict[str, Any], _namespace: str | None) -> dict[str, Any]:
        if kind in self.refusals:
            raise self.refusals[kind]
        made = self._made({"status": {}} | body)
        self.objects[key_of(kind, body)] = made
        return made

    async def patch(self, key: Key, body: dict[str, Any], *, subresource: str | None) -> dict[str, Any]:
        present = self.objects[key]
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

    async def event(self, _kind: Kind, regarding: dict[str, Any], _type: str, reason: str, text: str) -> None:
        self.told[regarding["metadata"]["name"], reason] = text

    async def events_of(self, _namespace: str, _uid: str, reason: str) -> list[dict[str, Any]]:
        return [{"message": text} for text in self.failed_creates if reason == "FailedCreate"]

    async def look(self, key: Key, after: float = 0.0) -> dict[str, Any]:
        """Reconcile an object some seconds later, and return its status."""
        self.now += after
        while len(self.op.queue):
            self.op.queue.done(await self.op.queue.get())
        await self.op.handle(key)
        status: dict[str, Any] = self.objects[key]["status"]
        return status


def standing(status: dict[str, Any], kind: str) -> tuple[str, str, str]:
    [found] = [item for item in status["conditions"] if item["type"] == kind]
    return found["status"], found["reason"], found["message"]


@pytest.fixture
async def cluster() -> Cluster:
    return _with_catalogue(ALGORITHM)


def _with_catalogue(algorithm: dict[str, Any]) -> Cluster:
    made = Cluster()
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


async def test_a_run_whose_job_cannot_be_built_fails(cluster: Cluster) -> None:
    text = {f"note{number}": "\N{SNOWMAN}" * 5000 for number in range(14)}
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN | {"parameters": text})
    status = await cluster.look(key)
    assert (status["phase"], status["reason"]) == ("Failed", "InvalidParameters")
    assert "at most 204800 fit into an object" in status["message"]
    assert standing(status, "Accepted") == ("False", "InvalidParameters", status["message"])
    assert cluster.told["one", "InvalidParameters"] == status["message"]


@pytest.mark.parametrize("error", [Invalid(SENTENCE), Forbidden(WEBHOOK)])
async def test_a_run_whose_job_is_refused_for_long_fails(cluster: Cluster, error: ApiError) -> None:
    cluster.refusals[Kind.JOB] = error
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN)
    status = await cluster.look(key)
    assert status["phase"] == "Pending"
    assert standing(status, "Admitted") == ("False", "JobRefused", str(error))
    assert cluster.told["one", "JobRefused"] == str(error)
    assert cluster.op.queue.delayed == 1
    assert (await cluster.look(key, GRACE - 1))["phase"] == "Pending"
    status = await cluster.look(key, 2)
    assert (status["phase"], status["reason"], status["message"]) == ("Failed", "SystemFault", str(error))
    assert standing(status, "Complete")[0] == "True"
    assert cluster.told["one", "SystemFault"] == str(error)


async def test_a_run_whose_job_is_taken_at_last_goes_on(cluster: Cluster) -> None:
    cluster.refusals[Kind.JOB] = Forbidden(WEBHOOK)
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN)
    await cluster.look(key)
    cluster.refusals.clear()
    await cluster.look(key, 10)
    status = await cluster.look(key, 10)
    assert (status["phase"], status["attempts"]) == ("Pending", 1)
    assert standing(status, "Admitted")[0] == "True"


async def test_a_used_up_quota_is_waited_for(cluster: Cluster) -> None:
    cluster.refusals[Kind.JOB] = Forbidden(QUOTA)
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN)
    await cluster.look(key)
    status = await cluster.look(key, 100 * GRACE)
    assert "phase" not in status
    assert standing(status, "Scheduled") == ("False", "QuotaExceeded", QUOTA)


async def test_a_preparation_that_is_refused_fails_its_run(cluster: Cluster) -> None:
    cluster.refusals[Kind.JOB] = Forbidden(WEBHOOK)
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN | {"input": {"duration": "5s"}})
    await cluster.look(key)
    status = await cluster.look(key, GRACE + 1)
    assert (status["phase"], status["message"]) == ("Failed", WEBHOOK)


REFUSED_POD = 'pods "one-1-x" is forbidden: maximum cpu usage per Container is 500m, but limit is 1'


async def test_a_run_whose_pod_is_refused_for_long_fails_with_the_reason(cluster: Cluster) -> None:
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN)
    await cluster.look(key)
    cluster.failed_creates = ["Error creating: an old story", f"Error creating: {REFUSED_POD}"]
    status = await cluster.look(key, 10)
    told = f"its pod is refused: {REFUSED_POD}"
    assert standing(status, "Scheduled") == ("False", "PodRefused", told)
    status = await cluster.look(key, GRACE)
    assert (status["phase"], status["reason"], status["message"]) == ("Failed", "SystemFault", told)
    assert not [found for found in cluster.objects if found.kind is Kind.JOB]


@pytest.mark.parametrize(
    ("messages", "reason"),
    [([], "NoPod"), (["Error creating: pods is forbidden: exceeded quota: pods"], "QuotaExceeded")],
)
async def test_a_pod_that_may_still_come_is_waited_for(
    cluster: Cluster, messages: list[str], reason: str
) -> None:
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN)
    await cluster.look(key)
    cluster.failed_creates = messages
    status = await cluster.look(key, 100 * GRACE)
    assert status["phase"] == "Pending"
    assert standing(status, "Scheduled")[1] == reason
    assert cluster.op.queue.delayed == 1


async def test_a_sweep_whose_runs_are_refused_ends(cluster: Cluster) -> None:
    cluster.refusals[Kind.JOB] = Invalid(SENTENCE)
    names = {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}}
    sweep = cluster.apply(Kind.SWEEP, "study", {"template": {"spec": names}, "repetitions": 2})
    for _ in range(4):
        await cluster.look(sweep, 1)
        for run in [key for key in cluster.objects if key.kind is Kind.MAPPING_RUN]:
            await cluster.look(run, GRACE)
    status = await cluster.look(sweep, 1)
    assert (status["failed"], status["progress"]) == (2, "2/2")
    assert standing(status, "Complete")[0] == "True"


async def test_a_sweep_says_why_its_runs_are_refused(cluster: Cluster) -> None:
    cluster.refusals[Kind.MAPPING_RUN] = Forbidden("cannot create mappingruns lab/study: policy says no")
    names = {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}}
    sweep = cluster.apply(Kind.SWEEP, "study", {"template": {"spec": names}})
    status = await cluster.look(sweep)
    assert standing(status, "Blocked") == (
        "True",
        "CannotCreate",
        "cannot create mappingruns lab/study: policy says no",
    )
    assert cluster.told["study", "CannotCreate"].endswith("policy says no")
