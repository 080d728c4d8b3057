# SPDX-License-Identifier: Apache-2.0
"""Runs that quotas and nodes allow, and how many pods wait where the cluster is full."""

from __future__ import annotations

from typing import Any

import pytest

from slamhive.kube.capacity import Bound, FeltRoom, bound_by_nodes, bound_by_quotas

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
    assert room.slots(waits=0, undecided=8) == 8  # nobody knows yet that it is full
    room.note(placed=8, refused=0, used=8, held=8)
    assert room.slots(waits=0, undecided=0) == 16
    room.note(placed=2, refused=6, used=16, held=10)
    assert room.is_full
    assert room.slots(waits=6, undecided=0) == 10 + max(6, waiting)
    assert room.slots(waits=waiting, undecided=0) == 10 + waiting
    # Of those that were just made some may wait too; one is tried in any case.
    assert room.slots(waits=1, undecided=9) == room.slots(waits=0, undecided=9) == 11
    room.note(placed=0, refused=0, used=10, held=12)  # an autoscaler brought room for two of them
    assert room.slots(waits=0, undecided=0) == 12 + waiting
