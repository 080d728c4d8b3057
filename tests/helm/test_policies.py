# SPDX-License-Identifier: Apache-2.0
"""Tests of the NetworkPolicies: which pods they select, and what these may reach."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from slamhive.kube.api.kinds import Label, Role

VALUES = Path(__file__).parent / "values"
ROLES = [str(role) for role in Role]
NOTHING: tuple[set[int], bool] = (set(), False)


def selects(policy: dict[str, Any], labels: dict[str, str]) -> bool:
    selector = policy["spec"]["podSelector"]
    equal = selector.get("matchLabels", {}).items() <= labels.items()
    for expression in selector.get("matchExpressions", []):
        assert expression["operator"] == "In"
        equal &= labels.get(expression["key"]) in expression["values"]
    return equal


def allowed(objects: list[dict[str, Any]], labels: dict[str, str], namespace: str) -> tuple[set[int], bool]:
    """Ports that a pod may reach, and whether it may be reached; every pod has one policy for both."""
    (policy,) = (
        one
        for one in objects
        if one["kind"] == "NetworkPolicy"
        and one["metadata"]["namespace"] == namespace
        and selects(one, labels)
    )
    spec = policy["spec"]
    assert spec["policyTypes"] == ["Ingress", "Egress"]
    ports = {port["port"] for rule in spec.get("egress", []) for port in rule["ports"]}
    return ports, bool(spec.get("ingress"))


@pytest.mark.parametrize("namespace", ["lab", "students"])
@pytest.mark.parametrize(
    ("role", "expected"),
    [
        ("run", NOTHING),
        ("evaluate", NOTHING),
        ("read", NOTHING),
        ("prepare", ({53, 443}, False)),
        ("collect", ({6443, 53, 6432}, False)),
        ("offload", ({6443, 53, 6432, 9000}, False)),
        ("restore", ({53, 9000}, False)),
        ("send", ({53, 9000}, False)),
    ],
)
def test_jobs_reach_what_they_need(
    helm: Any, namespace: str, role: str, expected: tuple[set[int], bool]
) -> None:
    objects = helm.objects("-f", str(VALUES / "team.yaml"))
    assert role in ROLES
    assert allowed(objects, {str(Label.ROLE): role}, namespace) == expected


def test_no_role_is_forgotten(helm: Any) -> None:
    for role in ROLES:
        allowed(helm.objects(), {str(Label.ROLE): role}, "lab")


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (
            "default",
            {
                "operator": ({443, 6443}, True),
                "dashboard": ({443, 6443}, True),
                "test": ({443, 6443}, False),
                "egress": NOTHING,
            },
        ),
        (
            "team",
            {
                "operator": ({6443, 53, 6432}, True),
                "dashboard": ({6443, 53, 6432, 9000}, True),
                "test": ({6443}, False),
                "egress": NOTHING,
            },
        ),
        (
            "single-node",
            {
                "operator": ({443, 6443}, True),
                "dashboard": ({443, 6443}, True),
                "test": ({443, 6443}, False),
                "egress": NOTHING,
            },
        ),
    ],
)
def test_servers_reach_what_they_need(
    helm: Any, values: str, expected: dict[str, tuple[set[int], bool]]
) -> None:
    objects = helm.objects("-f", str(VALUES / f"{values}.yaml"))
    found = {}
    for one in objects:
        if one["kind"] in {"Deployment", "Pod"}:
            pod = one["spec"]["template"] if one["kind"] == "Deployment" else one
            labels = pod["metadata"]["labels"]
            found[labels["app.kubernetes.io/component"]] = allowed(objects, labels, "lab")
    assert found == expected


def test_peers_are_passed_on(helm: Any) -> None:
    objects = helm.objects("-f", str(VALUES / "team.yaml"))
    specs = {o["metadata"]["name"]: o["spec"] for o in objects if o["kind"] == "NetworkPolicy"}
    metrics = [
        {
            "ports": [{"port": 9090, "protocol": "TCP"}],
            "from": [{"namespaceSelector": {"matchLabels": {"name": "monitoring"}}}],
        }
    ]
    assert specs["hive-operator"]["ingress"] == metrics
    assert specs["hive-operator"]["egress"][0]["to"] == [{"ipBlock": {"cidr": "10.0.0.1/32"}}]
    assert specs["hive-dashboard"]["ingress"][0]["from"] == [{"ipBlock": {"cidr": "10.0.0.0/8"}}]


def test_they_can_be_left_out(helm: Any) -> None:
    objects = helm.objects("--set", "networkPolicies.enabled=false")
    assert [one for one in objects if one["kind"] == "NetworkPolicy"] == []


def test_draining_can_wait_for_runs(helm: Any) -> None:
    (budget,) = (
        one
        for one in helm.objects("--set", "runs.disruptionBudget=true")
        if one["kind"] == "PodDisruptionBudget"
    )
    assert budget["spec"]["selector"] == {"matchLabels": {str(Label.ROLE): "run"}}
    assert budget["spec"]["minAvailable"] > 100_000
    assert [one for one in helm.objects() if one["kind"] == "PodDisruptionBudget"] == []
