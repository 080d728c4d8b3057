# SPDX-License-Identifier: Apache-2.0
"""Runs that quotas and nodes allow, and how many pods wait where the cluster is full."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from slamhive.kube.api.kinds import Kind, Label, Role
from slamhive.kube.capacity import Bound, FeltRoom, bound_by_nodes, bound_by_quotas
from slamhive.kube.reconciling.sweep_accounts import ShareAccounts
from slamhive.kube.settings import Settings
from slamhive.kube.store import Store

ASKED = {"cpu": 1.2, "memory": 2.0 * 2**30}


def quota(name: str, hard: dict[str, str], used: dict[str, str] | None = None, **spec: Any) -> dict[str, Any]:
    status = {"hard": hard, "used": used or {}}
    return {"metadata": {"name": name}, "spec": {"hard": hard} | spec, "status": status}


@pytest.mark.parametrize(
    ("hard", "used", "runs"),
    [
        ({"requests.cpu": "12"}, {}, 10),
        ({"cpu": "6"}, {"cpu": "2400m"}, 3),
        ({"limits.cpu": "1"}, {}, 0),
        ({"memory": "9Gi"}, {"memory": "1Gi"}, 4),
        ({"requests.memory": "3Gi"}, {"requests.memory": "4Gi"}, 0),
        ({"pods": "7"}, {"pods": "5"}, 2),
        ({"requests.cpu": "120", "requests.memory": "8Gi", "pods": "50"}, {}, 4),
    ],
)
def test_the_tightest_item_of_a_quota_bounds_runs(
    hard: dict[str, str], used: dict[str, str], runs: int
) -> None:
    bound = bound_by_quotas([quota("lab", hard, used)], ASKED, there=0)
    assert bound is not None
    assert bound.runs == runs


def test_the_quota_that_bounds_is_named_with_what_is_used() -> None:
    quotas = [
        quota("wide", {"requests.cpu": "100"}),
        quota("tight", {"requests.memory": "10Gi"}, {"requests.memory": "6Gi"}),
    ]
    told = "quota tight (requests.memory: 6Gi of 10Gi used)"
    assert bound_by_quotas(quotas, ASKED, there=3) == Bound(5, told)  # two more than are there


@pytest.mark.parametrize(
    "given",
    [
        quota("gpus", {"requests.nvidia.com/gpu": "0"}),
        quota("volumes", {"persistentvolumeclaims": "0"}),
        quota("high", {"pods": "0"}, scopeSelector={"matchExpressions": []}),
        quota("besteffort", {"pods": "0"}, scopes=["BestEffort"]),
    ],
)
def test_quotas_of_what_runs_do_not_use_bound_nothing(given: dict[str, Any]) -> None:
    assert bound_by_quotas([given], ASKED, there=0) is None


def node(name: str, cpu: str = "8", **spec: Any) -> dict[str, Any]:
    allocatable = {"cpu": cpu, "memory": "10Gi", "pods": "110"}
    ready = {"type": "Ready", "status": spec.pop("ready", "True")}
    return {
        "metadata": {"name": name, "labels": spec.pop("labels", {})},
        "spec": spec,
        "status": {"allocatable": allocatable, "conditions": [ready]},
    }


def test_nodes_hold_what_the_scarcest_resource_allows_where_pods_may_go() -> None:
    taint = {"key": "gpu", "value": "yes", "effect": "NoSchedule"}
    soft = {"key": "old", "effect": "PreferNoSchedule"}
    pool = {"labels": {"pool": "runs"}}
    nodes = [
        node("memory", "64", **pool),
        node("processors", "4", **pool, taints=[soft]),
        node("tainted", **pool, taints=[taint]),
        node("cordoned", **pool, unschedulable=True),
        node("lost", **pool, ready="Unknown"),
        node("elsewhere"),
    ]
    chosen = {"nodeSelector": {"pool": "runs"}}
    told = "the cluster (2 nodes that take runs, which could hold 8 of these)"
    assert bound_by_nodes(nodes, ASKED, chosen) == Bound(8, told)
    tolerated = chosen | {"tolerations": [{"key": "gpu", "operator": "Exists"}]}
    assert bound_by_nodes(nodes, ASKED, tolerated).runs == 13


@pytest.mark.parametrize("waiting", [1, 5])
def test_so_many_pods_wait_where_the_cluster_is_full(waiting: int) -> None:
    room = FeltRoom(8, waiting)
    assert room.slots == 8  # nobody knows yet that it is full
    room.note(placed=8, at_once=8, refused=0, used=8, held=8)
    assert room.slots == 16
    room.note(placed=2, at_once=2, refused=6, used=16, held=10)
    assert room.is_full
    assert room.slots == 10 + waiting
    room.note(placed=0, at_once=0, refused=0, used=10, held=12)  # their pods are late, which proves nothing
    assert room.slots == 10 + waiting
    room.note(placed=2, at_once=0, refused=0, used=10, held=12)  # an autoscaler brought room for two of them
    assert room.slots == 12 + waiting


def test_a_new_operator_knows_from_pods_whether_the_cluster_is_full() -> None:
    room = FeltRoom(8)
    room.recall(placed=12, refused=0)
    assert (room.slots, room.is_full) == (20, False)
    room.recall(placed=12, refused=1)
    assert (room.slots, room.is_full) == (13, True)


def a_pod(name: str, node: str | None, **labels: str) -> dict[str, Any]:
    told = {"type": "PodScheduled", "status": "False", "reason": "Unschedulable"}
    return {
        "metadata": {
            "name": name,
            "namespace": "lab",
            "uid": name,
            "resourceVersion": "1",
            "labels": {Label.ROLE: Role.RUN, Label.RUN: name} | labels,
        },
        "spec": {"nodeName": node} if node else {},
        "status": {"phase": "Pending", "conditions": [] if node else [told]},
    }


def test_a_new_operator_counts_no_pods_of_runs_without_a_sweep() -> None:
    settings = Settings.model_validate(
        {
            "namespaces": ["lab"],
            "image": "example.test/slamhive:1",
            "volumes": {"results": {"claim": "results"}, "data": {"claim": "data"}},
        }
    )
    cluster: Any = SimpleNamespace(settings=settings, store=Store())
    sweep = {Label.SWEEP: "study"}
    for pod in (
        a_pod("one", "node", **sweep),
        a_pod("other", "node", **sweep),
        a_pod("mine", "node"),
        a_pod("stuck", None),
    ):
        cluster.store.put(Kind.POD, pod)
    accounts = ShareAccounts()
    accounts.begin(cluster, 1.8e9)
    assert (accounts.felt.slots, accounts.felt.is_full) == (settings.default_parallelism + 2, False)
