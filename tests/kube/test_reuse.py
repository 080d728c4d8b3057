# SPDX-License-Identifier: Apache-2.0
"""Reuse on a cluster: what a run takes over from an equal one, and which runs may."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from slamhive.engine import AttemptState, LoadConditions, VariantState
from slamhive.kube.api.kinds import Key, Kind, Label
from slamhive.kube.cluster import Cluster
from slamhive.kube.observing import Attempted
from slamhive.kube.reconciling.catalogue import Catalogue, parse
from slamhive.kube.reconciling.reuse import ReusableRuns
from slamhive.kube.reconciling.run_status import RunFacts, reused_fields
from slamhive.kube.reconciling.variants import VariantSeen, Wanted
from slamhive.kube.records import record_of
from slamhive.kube.settings import Settings
from slamhive.model.algorithm import Algorithm
from slamhive.model.dataset import Dataset
from slamhive.model.results import Outcome, Result
from slamhive.plan import resolve

NAMESPACE = "lab"
SETTINGS = Settings.model_validate(
    {
        "namespaces": [NAMESPACE],
        "image": "slamhive",
        "volumes": {"results": {"claim": "r"}, "data": {"claim": "d"}},
    }
)


def manifest(kind: str, name: str, **spec: Any) -> dict[str, Any]:
    meta = {"name": name, "namespace": NAMESPACE, "uid": f"uid-{name}", "resourceVersion": "1"}
    return {"apiVersion": "slamhive.io/v1alpha1", "kind": kind, "metadata": meta, "spec": spec, "status": {}}


IMAGE = f"icp@sha256:{'0' * 64}"
ALGORITHM = manifest("Algorithm", "icp", image=IMAGE, modes=[{"name": "lidar"}], output={"frame": "lidar"})
HALL = manifest(
    "Dataset",
    "hall",
    recording={"files": [{"path": "a.bag"}]},
    sensors={"lidar": {"type": "Lidar", "topic": "/points", "rate": 10}},
)
USAGE = {"cpu": {"meanCores": 1.5}, "memory": {"peakBytes": 2**20}}


def a_run(name: str = "one", sweep: str | None = None) -> dict[str, Any]:
    run = manifest("MappingRun", name, algorithmRef={"name": "icp"}, datasetRef={"name": "hall"})
    run["metadata"]["labels"] = {Label.SWEEP: sweep} if sweep else {}
    return run


def facts(run: dict[str, Any]) -> RunFacts:
    algorithm, dataset = parse(Algorithm, ALGORITHM), parse(Dataset, HALL)
    spec = resolve(run["spec"], algorithm, dataset)
    return RunFacts(
        key=Key(Kind.MAPPING_RUN, NAMESPACE, run["metadata"]["name"]),
        body=run,
        spec=spec,
        spec_hash="5" * 64,
        algorithm=algorithm,
        dataset=dataset,
        wanted=Wanted("v-1", algorithm, dataset, spec),
        variant=VariantSeen(VariantState.READY, {"datasetSha256": "d", "preparationVersion": 1}),
        attempted=Attempted(state=AttemptState.NONE),
        job=None,
    )


CONDITIONS = {LoadConditions("fast"), LoadConditions("other")}


def equal(model: str | None, **provenance: Any) -> dict[str, Any]:
    told = {"phase": "Succeeded", "usage": USAGE, "metrics": {"loops": 3}}
    return a_run("equal") | {"status": told | {"provenance": {"cpuModel": model, **provenance}}}


@pytest.mark.parametrize(("model", "taken"), [("fast", True), ("slow", False), (None, False)])
def test_usage_is_taken_over_from_the_clusters_own_processors_alone(
    *, model: str | None, taken: bool
) -> None:
    fields = reused_fields(
        record_of(equal(model)), facts(a_run()), {LoadConditions("fast"), LoadConditions("other")}
    )
    assert (fields.usage is not None) == taken
    assert (fields.display is not None and fields.display.cpu is not None) == taken
    assert fields.metrics == {"loops": 3}
    assert (fields.provenance.reused_from, fields.provenance.cpu_model) == ("equal", model)


def test_of_an_equal_run_as_many_results_are_taken_over_as_a_status_holds() -> None:
    results = [Result(evaluation=f"e{number}", outcome=Outcome.TRACKED) for number in range(40)]
    status = reused_fields(
        record_of(equal("fast")).replace(results=results), facts(a_run()), {LoadConditions("fast")}
    )
    assert len(status.results) == 32


def cluster_with_sweeps(identity: str | None = "c1") -> Cluster:
    """Return a cluster that has sweeps of each policy."""
    cluster = Cluster(SimpleNamespace(), SETTINGS)  # type: ignore[arg-type]
    cluster.identity = identity
    for name, policy in (("again", "Reuse"), ("anew", "Rerun")):
        cluster.store.put(Kind.SWEEP, manifest("Sweep", name, cachePolicy=policy))
    return cluster


def runs_with(archived: Any) -> ReusableRuns:
    """Return finished runs beside an archive with one more."""
    return ReusableRuns(Catalogue(), SimpleNamespace(find_reusable=lambda _hashed: archived))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("cluster", "ran_on", "namespace", "known"),
    [
        ("c1", "c1", "lab", {"fast"}),
        ("c1", "c2", "lab", set()),
        ("c1", None, "lab", set()),
        (None, None, "lab", {"fast"}),  # clusters have no identity by default
        (None, None, "other", set()),
        (None, None, None, set()),  # a workstation's
    ],
)
async def test_an_archived_runs_processor_is_the_clusters_own_if_it_ran_there(
    cluster: str | None, ran_on: str | None, namespace: str | None, known: set[str]
) -> None:
    archived = record_of(equal("fast")).replace(cluster=ran_on, namespace=namespace)
    reusable = runs_with(archived)
    found = await reusable.find(cluster_with_sweeps(cluster), facts(a_run(sweep="again")))
    assert found == archived
    assert {one.processor for one in reusable.conditions} == known


def test_a_finished_runs_processor_is_the_clusters_own_unless_its_result_is_anothers() -> None:
    reusable = ReusableRuns(Catalogue())
    reusable.learn(equal("elsewhere", contentHash="c" * 64, reusedFrom="x"))
    assert {one.processor for one in reusable.conditions} == set()
    here = equal("here", contentHash="c" * 64)
    here["metadata"] |= {"name": "other", "uid": "uid-other"}
    reusable.learn(here)
    assert {one.processor for one in reusable.conditions} == {"here"}


@pytest.mark.parametrize(("sweep", "reused"), [("again", True), ("anew", False), (None, False)])
async def test_runs_of_sweeps_that_allow_it_are_reused_and_no_run_by_itself(
    *, sweep: str | None, reused: bool
) -> None:
    known = runs_with(record_of(equal("x")))
    found = await known.find(cluster_with_sweeps(), facts(a_run(sweep=sweep)))
    assert (found is not None) == reused


async def test_runs_that_ended_before_the_start_are_known_before_any_is_looked_at() -> None:
    cluster, known = cluster_with_sweeps(), runs_with(None)
    looking = facts(a_run(sweep="again"))
    hashed = known.content_hash(looking, known._image(cluster, looking))
    cluster.store.put(Kind.MAPPING_RUN, equal("here", contentHash=hashed))
    other = equal("there", contentHash="c" * 64)
    other["metadata"] |= {"name": "other", "uid": "uid-other"}
    cluster.store.put(Kind.MAPPING_RUN, other)
    found = await known.find(cluster, looking)
    assert found is not None
    assert found.name == "equal"
    assert {one.processor for one in known.conditions} == {"here", "there"}


def test_what_is_known_of_finished_runs_goes_with_them() -> None:
    """A Sweep of any size leaves behind no more than its live runs."""
    reusable = ReusableRuns(Catalogue())
    keys = []
    for number in range(5):
        run = a_run(f"run-{number}")
        reusable.learn(run)  # as at a start, where all runs are gone through
        run["status"] = {"phase": "Succeeded", "provenance": {"contentHash": f"hash-{number % 2}"}}
        reusable.learn(run)
        keys.append(Key(Kind.MAPPING_RUN, NAMESPACE, f"run-{number}"))
    reusable.forget(keys[1])
    assert reusable._known == {(NAMESPACE, "hash-0"): "run-4", (NAMESPACE, "hash-1"): "run-3"}
    for key in keys:
        reusable.forget(key)
    assert not reusable._known
    assert not reusable._learned
