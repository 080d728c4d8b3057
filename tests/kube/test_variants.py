# SPDX-License-Identifier: Apache-2.0
"""Tests of a variant's entry in its Dataset's status, without a cluster."""

from __future__ import annotations

from typing import Any

import pytest
from testcluster.kept import BEGIN, DATASET, READY, RUN, Cluster, catalogued

from slamhive.kube.api.encoding import encode
from slamhive.kube.api.kinds import Key, Kind, Label
from slamhive.kube.reconciling import variants
from slamhive.kube.reconciling.catalogue import parse
from slamhive.kube.reconciling.variants import VariantSeen, Wanted
from slamhive.kube.status import iso
from slamhive.model.algorithm import Algorithm
from slamhive.model.dataset import Dataset
from slamhive.model.results import Reason
from slamhive.plan import resolve

KEY = Key(Kind.DATASET, "lab", "hall")
ENTRY: dict[str, Any] = {
    "name": "v",
    "phase": "Ready",
    "folder": "variants/" + "a" * 32,
    "sizeBytes": 700,
    "description": READY | {"groundTruth": "poses"},
    "changedTime": iso(BEGIN - 1e5),
    "lastUsedTime": iso(BEGIN - 1e5),
}
TRAJECTORY = {
    "poses": 2,
    "durationSeconds": 1,
    "sha256": "a" * 64,
    "path": "runs/x/pod/output/trajectory.txt",
}
FINISHED = {"phase": "Succeeded", "trajectory": TRAJECTORY, "variant": "v"}


@pytest.fixture
async def cluster() -> Cluster:
    made = catalogued()
    made.apply(Kind.DATASET, "hall", DATASET, variants=[ENTRY, ENTRY | {"name": "other", "later": 1}])
    return made


def entries(cluster: Cluster) -> dict[str, dict[str, Any]]:
    return {item["name"]: item for item in cluster.objects[KEY]["status"].get("variants") or ()}


def preparing(cluster: Cluster, name: str) -> Key:
    """Have a Job that prepares the variant."""
    labels = {
        str(Label.ROLE): "prepare",
        str(Label.VARIANT): "v",
        str(Label.DATASET): "hall",
        str(Label.MANAGED_BY): "slamhive",
    }
    return cluster.apply(Kind.JOB, name, {}, labels=labels)


async def test_a_lost_variant_is_prepared_anew_and_what_is_known_of_it_stays(cluster: Cluster) -> None:
    job = preparing(cluster, "first")
    await variants.lose(cluster.seen, KEY, "v")
    lost = entries(cluster)["v"]
    assert lost["phase"] == "Pending"
    assert lost.items() >= {name: ENTRY[name] for name in ("folder", "sizeBytes", "description")}.items()
    assert entries(cluster)["other"] == ENTRY | {"name": "other", "later": 1}
    assert job not in cluster.objects
    written = cluster.objects[KEY]
    await variants.lose(cluster.seen, KEY, "v")
    await variants.lose(cluster.seen, KEY, "unknown")
    assert cluster.objects[KEY] is written
    preparing(cluster, "second")
    await cluster.look(KEY)
    again = entries(cluster)["v"]
    assert (again["phase"], again["description"]) == ("Preparing", ENTRY["description"])


async def test_runs_of_a_lost_variant_are_still_measured(cluster: Cluster) -> None:
    key = cluster.apply(Kind.MAPPING_RUN, "a", RUN, **FINISHED)
    await variants.lose(cluster.seen, KEY, "v")
    await cluster.look(cluster.apply(Kind.EVALUATION, "mine", {"runs": {"names": ["a"]}}), 100)
    assert [found.name for found in cluster.objects if found.kind is Kind.JOB]
    assert (
        "annotations" not in cluster.objects[key]["metadata"]
        or not (cluster.objects[key]["metadata"]["annotations"])
    )


@pytest.mark.parametrize("measured", [False, True])
async def test_a_variant_stays_until_its_runs_are_measured(cluster: Cluster, *, measured: bool) -> None:
    cluster.seen.settings = cluster.seen.settings.replace(variants_limit="1")
    results = [{"evaluation": "own", "outcome": "Tracked"}] if measured else []
    cluster.apply(Kind.MAPPING_RUN, "a", RUN | {"evaluate": True}, **FINISHED, results=results)
    await cluster.look(KEY)
    assert ("v" in entries(cluster)) is not measured
    assert "other" not in entries(cluster)


@pytest.mark.parametrize("bound", ["LIST_BYTES", "_ENTRIES"])
async def test_the_least_recently_used_go_where_an_object_has_no_room(
    cluster: Cluster, bound: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also those of this hour; but none that a run needs, or that is new."""
    used = {"a": 3000, "b": 2000, "c": 1000, "new": 10}
    listed = [
        ENTRY | {"name": name, "changedTime": iso(BEGIN - age), "lastUsedTime": iso(BEGIN - age)}
        for name, age in used.items()
    ]
    cluster.apply(Kind.DATASET, "hall", DATASET, variants=[ENTRY, *listed])
    cluster.apply(Kind.MAPPING_RUN, "a", RUN | {"evaluate": True}, **FINISHED)
    await cluster.look(KEY)
    assert [*entries(cluster)] == ["v", *used]
    most = {"LIST_BYTES": 3 * len(encode(listed[0])) + 50, "_ENTRIES": 3}[bound]
    monkeypatch.setattr(variants, bound, most)
    await cluster.look(KEY)
    assert [*entries(cluster)] == ["v", "c", "new"]
    monkeypatch.setattr(variants, bound, 1)
    await cluster.look(KEY)
    assert [*entries(cluster)] == ["v", "new"]


def failed(cluster: Cluster, changed: dict[str, Any]) -> VariantSeen:
    """Return the state of a variant that failed, as a run made long ago sees it."""
    key = cluster.apply(Kind.DATASET, "hall", DATASET, variants=[])
    known = parse(Algorithm, cluster.objects[Key(Kind.ALGORITHM, "lab", "icp")])
    dataset = parse(Dataset, cluster.objects[key])
    wanted = Wanted.by(resolve(RUN, known, dataset), known, dataset)
    entry = {"name": wanted.name, "phase": "Failed", "changedTime": iso(BEGIN)} | changed
    cluster.apply(Kind.DATASET, "hall", DATASET, variants=[entry])
    return variants.look(cluster.seen, "lab", wanted, BEGIN - 1)


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"reason": "SystemFault", "message": "disk: full"}, (Reason.SYSTEM_FAULT, "disk: full")),
        ({"message": "SystemFault: disk: full"}, (Reason.SYSTEM_FAULT, "disk: full")),
        ({"message": "disk: full"}, (Reason.PREPARATION_FAILED, "disk: full")),
        ({"reason": "OfALaterVersion", "message": "x"}, (Reason.PREPARATION_FAILED, "x")),
        ({}, (Reason.PREPARATION_FAILED, "preparation failed")),
    ],
)
async def test_why_a_variant_failed_is_read_of_earlier_versions_too(
    cluster: Cluster, changed: dict[str, Any], problem: tuple[Reason, str]
) -> None:
    assert failed(cluster, changed).problem == problem
