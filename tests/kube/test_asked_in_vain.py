# SPDX-License-Identifier: Apache-2.0
"""Tests of options that a recording can't satisfy.

The operator refuses them, records them for the runs of a Sweep, and runs equal runs once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.engine import AttemptState, VariantState
from slamhive.kube.api.kinds import Key, Kind, key_of
from slamhive.kube.cluster import Cluster
from slamhive.kube.observing import Attempted
from slamhive.kube.reconciling import sweep_state
from slamhive.kube.reconciling.catalogue import Catalogue, parse
from slamhive.kube.reconciling.reuse import ReusableRuns
from slamhive.kube.reconciling.run import RunReconciler
from slamhive.kube.reconciling.run_status import RunFacts, provenance, reused_fields
from slamhive.kube.reconciling.sweep import SweepReconciler
from slamhive.kube.reconciling.variants import VariantSeen, Wanted
from slamhive.kube.records import record_of
from slamhive.kube.settings import Settings
from slamhive.model.algorithm import Algorithm
from slamhive.model.dataset import Dataset
from slamhive.plan import resolve

if TYPE_CHECKING:
    from collections.abc import Callable

NAMESPACE = "lab"
SETTINGS = Settings.model_validate(
    {
        "namespaces": [NAMESPACE],
        "image": "slamhive",
        "volumes": {"results": {"claim": "r"}, "data": {"claim": "d"}},
        "sweepWriteSeconds": 0.1,
    }
)


def manifest(kind: str, name: str, **spec: Any) -> dict[str, Any]:
    meta = {
        "name": name,
        "namespace": NAMESPACE,
        "uid": f"uid-{name}",
        "resourceVersion": "1",
        "generation": 1,
    }
    head = {"apiVersion": "slamhive.io/v1alpha1", "kind": kind}
    return head | {"metadata": meta, "spec": spec, "status": {}}


def hall(name: str, rate: float) -> dict[str, Any]:
    sensors = {"lidar": {"type": "Lidar", "topic": "/points", "rate": rate}}
    return manifest("Dataset", name, recording={"files": [{"path": "a.bag"}]}, sensors=sensors)


ALGORITHM = manifest("Algorithm", "icp", image="icp:1", modes=[{"name": "lidar"}], output={"frame": "lidar"})


class Kept:
    """An API that keeps what is written."""

    def __init__(self) -> None:
        self.objects: dict[Key, dict[str, Any]] = {}
        self.count: Any = None
        self.version = 1

    async def get(self, key: Key) -> dict[str, Any]:
        return self.objects[key]

    async def quotas(self, _namespace: str) -> list[dict[str, Any]]:
        return []

    async def create(self, kind: Kind, body: dict[str, Any], _namespace: str | None) -> dict[str, Any]:
        self.version += 1
        meta = body["metadata"] | {
            "uid": f"uid-{body['metadata']['name']}",
            "resourceVersion": str(self.version),
        }
        self.objects[key_of(kind, body)] = body | {"metadata": meta, "status": {}}
        return self.objects[key_of(kind, body)]

    async def patch(self, key: Key, body: dict[str, Any], *, subresource: str | None) -> dict[str, Any]:
        self.version += 1
        present = self.objects[key]
        meta = present["metadata"] | {"resourceVersion": str(self.version)}
        status = present["status"] | body.get("status", {})
        self.objects[key] = present | {"metadata": meta, "status": status}
        return self.objects[key]

    async def event(self, *_: Any) -> None:
        """Tell nobody."""


class Clock:
    """Time that passes by a second whenever it is asked for."""

    def __init__(self) -> None:
        self.now = 1.8e9

    def __call__(self) -> float:
        self.now += 1.0
        return self.now


@pytest.fixture
def cluster() -> Cluster:
    made = Cluster(Kept(), SETTINGS, Clock())  # type: ignore[arg-type]
    for kind, body in (
        (Kind.ALGORITHM, ALGORITHM),
        (Kind.DATASET, hall("slow", 10)),
        (Kind.DATASET, hall("fast", 20.02)),
    ):
        made.store.put(kind, body)
    return made


@pytest.fixture
def apply(cluster: Cluster) -> Callable[[Kind, dict[str, Any]], Key]:
    def put(kind: Kind, body: dict[str, Any]) -> Key:
        cluster.api.objects[key_of(kind, body)] = body  # type: ignore[attr-defined]
        cluster.store.put(kind, body)
        return key_of(kind, body)

    return put


def accepted(body: dict[str, Any]) -> tuple[str, str]:
    [found] = [item for item in body["status"]["conditions"] if item["type"] == "Accepted"]
    return found["status"], found["message"]


def a_run(rate: float, dataset: str = "slow") -> dict[str, Any]:
    names = {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": dataset}}
    return manifest("MappingRun", "one", **names, input={"frameRate": rate})


async def test_a_run_that_asks_for_more_is_refused(cluster: Cluster, apply: Callable[..., Key]) -> None:
    catalogue = Catalogue()
    key = apply(Kind.MAPPING_RUN, a_run(30))
    await RunReconciler(catalogue, None, ReusableRuns(catalogue))(cluster, key)  # type: ignore[arg-type]
    run = cluster.store.get(key)
    assert run is not None
    assert (run["status"]["phase"], run["status"]["reason"]) == ("Failed", "InvalidParameters")
    assert accepted(run) == ("False", "spec.input.frameRate: 30 Hz is asked, slow's lidar has 10 Hz")


def a_sweep(datasets: list[str], **more: Any) -> dict[str, Any]:
    matrix = [
        {"path": "dataset", "values": datasets},
        {"path": "input.frameRate", "values": [10, 15]},
    ]
    return manifest(
        "Sweep", "rates", template={"spec": {"algorithmRef": {"name": "icp"}}}, matrix=matrix, **more
    )


async def test_a_sweep_that_asks_in_vain_is_refused(cluster: Cluster, apply: Callable[..., Key]) -> None:
    key = apply(Kind.SWEEP, a_sweep(["slow"]))
    await SweepReconciler(Catalogue())(cluster, key)
    sweep = cluster.store.get(key)
    assert sweep is not None
    assert accepted(sweep) == (
        "False",
        "spec.matrix[1].values[1]: input.frameRate: 15 Hz is asked, slow's lidar has 10 Hz",
    )
    assert not cluster.store.of(Kind.MAPPING_RUN, NAMESPACE)


async def test_a_sweep_that_chooses_more_than_an_object_holds_is_refused(
    cluster: Cluster, apply: Callable[..., Key], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep_state, "LIST_BYTES", 10)
    labelled = hall("slow", 10)
    labelled["metadata"]["labels"] = {"place": "hall"}
    apply(Kind.DATASET, labelled)
    axis = {"path": "dataset", "selector": {"matchLabels": {"place": "hall"}}}
    spec = {"template": {"spec": {"algorithmRef": {"name": "icp"}}}, "matrix": [axis]}
    await SweepReconciler(Catalogue())(cluster, key := apply(Kind.SWEEP, manifest("Sweep", "rates", **spec)))
    sweep = cluster.store.get(key)
    assert sweep is not None
    assert accepted(sweep)[0] == "False"
    assert "its selectors choose have 23 bytes, a Sweep can note 10: divide it" in accepted(sweep)[1]


def by_point(cluster: Cluster) -> dict[int, dict[str, Any]]:
    runs = cluster.store.of(Kind.MAPPING_RUN, NAMESPACE)
    return {int(run["metadata"]["labels"]["slamhive.io/point"]): run for run in runs}


async def test_a_sweep_over_several_recordings_runs_what_comes_out_equal_once(
    cluster: Cluster, apply: Callable[..., Key]
) -> None:
    reconcile = SweepReconciler(Catalogue())
    key = apply(Kind.SWEEP, a_sweep(["slow", "fast"], parallelism=4))
    await reconcile(cluster, key)
    runs = by_point(cluster)
    assert sorted(runs) == [0, 2, 3]
    newer = runs[0]["metadata"] | {"resourceVersion": "90"}
    apply(Kind.MAPPING_RUN, runs[0] | {"metadata": newer, "status": {"phase": "Succeeded"}})
    await reconcile(cluster, key)
    runs = by_point(cluster)
    assert [runs[index]["spec"]["input"]["frameRate"] for index in range(4)] == [10, 10, 10, 15]
    annotations = {index: run["metadata"]["annotations"] for index, run in runs.items()}
    own = {"slamhive.io/asked": '{"frameRate": 15}', "slamhive.io/same-as": runs[0]["metadata"]["name"]}
    assert annotations == {0: {}, 1: own, 2: {}, 3: {}}
    sweep = cluster.store.get(key)
    assert sweep is not None
    standing, message = accepted(sweep)
    assert standing == "True"
    assert message.splitlines() == [
        "input.frameRate: 15 Hz is asked, slow's lidar has 10 Hz; runs as 10",
        "1 of 4 runs are equal to others and are not run again",
    ]


def facts(run: dict[str, Any], description: dict[str, Any]) -> RunFacts:
    algorithm, dataset = parse(Algorithm, ALGORITHM), parse(Dataset, hall("slow", 10))
    spec = resolve(run["spec"], algorithm, dataset)
    wanted = Wanted("v-1", algorithm, dataset, spec)
    variant = VariantSeen(VariantState.READY, description)
    body = {"key": Key(Kind.MAPPING_RUN, NAMESPACE, "one"), "body": run, "spec": spec, "spec_hash": "5" * 64}
    seen = Attempted(state=AttemptState.ENDED)
    return RunFacts(
        **body, algorithm=algorithm, dataset=dataset, wanted=wanted, variant=variant, attempted=seen, job=None
    )


DESCRIPTION = {
    "key": "k",
    "datasetSha256": "d",
    "frameRate": 10.01,
    "durationSeconds": 9.9,
    "resolution": 1.0,
    "frames": 100,
    "recordedFrameRate": 10.01,
    "recordedSeconds": 9.9,
}


@pytest.mark.parametrize("reused", [False, True])
def test_a_runs_record_tells_what_was_asked_and_what_it_was_given(*, reused: bool) -> None:
    run = a_run(10)
    run["spec"]["input"]["duration"] = "1m"
    run["metadata"]["annotations"] = {"slamhive.io/asked": '{"frameRate": 30}'}
    known = facts(run, DESCRIPTION)
    told = provenance(known.attempted, known, algorithm_hash="a" * 64, content_hash="c" * 64).as_json()
    if reused:
        other = record_of(
            a_run(10) | {"status": {"phase": "Succeeded", "provenance": told | {"asked": {"rate": 2}}}}
        )
        told = reused_fields(other, known, []).as_json()["provenance"]
        assert told["reusedFrom"] == "one"
    assert told["asked"] == {"frameRate": 30, "duration": "1m"}
    assert told["effective"] == {"frameRate": 10, "duration": "9s900ms"}
    assert told["prepared"] == {
        "frameRate": 10.01,
        "resolution": 1.0,
        "durationSeconds": 9.9,
        "frames": 100,
        "recordedFrameRate": 10.01,
        "recordedSeconds": 9.9,
    }
