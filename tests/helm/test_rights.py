# SPDX-License-Identifier: Apache-2.0
"""Tests of the rendered roles: rights in namespaces alone, no secrets, no wildcards, no needless tokens."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from slamhive.kube.api.kinds import OUR_KINDS

VALUES = Path(__file__).parent / "values"
READ = {"get", "list", "watch"}
KINDS = {kind.plural for kind in OUR_KINDS}
WORKLOADS = {"Deployment", "Pod", "CronJob"}


def rules(objects: list[dict[str, Any]], account: str) -> dict[str, set[str]]:
    """Verbs by resource (with its group) that a component's account has in the release's namespace."""
    found: dict[str, set[str]] = {}
    for one in objects:
        labels = one["metadata"]["labels"]
        if one["kind"] == "Role" and labels["app.kubernetes.io/component"] == account:
            for rule in one["rules"]:
                for resource in rule["resources"]:
                    for group in rule["apiGroups"]:
                        found.setdefault(f"{resource}.{group}".rstrip("."), set()).update(rule["verbs"])
    return found


def test_no_rule_is_wide(rendered: list[dict[str, Any]]) -> None:
    roles = [one for one in rendered if one["kind"] == "Role"]
    assert roles
    assert [one for one in rendered if one["kind"].startswith("Cluster")] == []
    for role in roles:
        for rule in role["rules"]:
            words = [*rule["apiGroups"], *rule["resources"], *rule["verbs"]]
            assert "*" not in "".join(words)
            assert not {"secrets", "pods/exec", "pods/attach", "serviceaccounts/token"} & {*rule["resources"]}
            assert not {"escalate", "bind", "impersonate", "deletecollection"} & {*rule["verbs"]}


def test_the_operator_has_what_it_needs(helm: Any) -> None:
    found = rules(helm.objects(), "operator")
    for kind in KINDS:
        assert found[f"{kind}.slamhive.io"] >= READ
        assert found[f"{kind}/status.slamhive.io"] == {"patch"}
    assert found["mappingruns.slamhive.io"] == READ | {"create", "patch", "delete"}
    assert found["jobs.batch"] == READ | {"create", "patch", "delete"}
    assert found["pods"] == READ
    assert found["pods/log"] == {"get"}
    assert found["pods.metrics.k8s.io"] == {"get", "list"}
    assert found["resourcequotas"] == {"list"}
    assert found["events"] == {"get", "list", "create", "patch"}
    # What people describe is theirs: the operator changes only its state.
    for kind in KINDS - {"mappingruns"}:
        assert found[f"{kind}.slamhive.io"] == READ


def test_the_operator_lists_workloads_of_kueue_where_that_is_asked_for_alone(helm: Any) -> None:
    name = "workloads.kueue.x-k8s.io"
    assert name not in rules(helm.objects(), "operator")
    assert rules(helm.objects("--set", "kueue.enabled=true"), "operator")[name] == {"list"}


def test_the_others_only_read(helm: Any) -> None:
    objects = helm.objects("-f", str(VALUES / "team.yaml"))
    assert rules(objects, "dashboard") == {f"{kind}.slamhive.io": READ for kind in KINDS}
    lists = {f"{kind}.slamhive.io": {"get", "list"} for kind in ("algorithms", "datasets", "mappingruns")}
    tells = {"namespaces": {"get"}, "cronjobs.batch": {"get"}, "events": {"create"}}
    assert rules(objects, "collector") == rules(objects, "offloader") == lists | tells
    assert rules(objects, "runs") == {}
    assert {verb for verbs in rules(objects, "test").values() for verb in verbs} <= {"get", "list"}


def test_beyond_the_namespaces_one_right_is_given_to_who_asks_for_it(helm: Any) -> None:
    def elsewhere(*words: str) -> list[dict[str, Any]]:
        objects = helm.objects(*words)
        return [one for one in objects if one["metadata"].get("namespace", "lab") != "lab"]

    assert elsewhere() == []
    role, binding = elsewhere("--set", "clusterIdentity=true")
    assert {role["metadata"]["namespace"], binding["metadata"]["namespace"]} == {"kube-system"}
    # Two releases of one name, in two namespaces, don't meet there.
    assert role["metadata"]["name"] == binding["roleRef"]["name"] == "slamhive-identity-lab"
    [rule] = role["rules"]
    assert rule == {
        "apiGroups": [""],
        "resources": ["namespaces"],
        "resourceNames": ["kube-system"],
        "verbs": ["get"],
    }
    accounts = [subject["name"] for subject in binding["subjects"]]
    assert accounts == ["slamhive-operator", "slamhive-dashboard"]


@pytest.mark.parametrize(
    ("value", "name", "group", "resource"),
    [
        ("readNodes", "nodes", "", "nodes"),
        ("readPriorityClasses", "priorities", "scheduling.k8s.io", "priorityclasses"),
    ],
)
def test_what_sharing_goes_by_is_listed_by_the_operator_alone_where_that_is_asked_for(
    value: str, name: str, group: str, resource: str, helm: Any
) -> None:
    objects = helm.objects("--set", f"sharing.{value}=true")
    role, binding = (one for one in objects if one["kind"].startswith("Cluster"))
    # Two releases of one name, in two namespaces, don't meet there.
    assert role["metadata"]["name"] == binding["roleRef"]["name"] == f"slamhive-{name}-lab"
    assert role["rules"] == [{"apiGroups": [group], "resources": [resource], "verbs": ["list"]}]
    accounts = [(one["name"], one["namespace"]) for one in binding["subjects"]]
    assert accounts == [("slamhive-operator", "lab")]


def test_a_policy_holds_the_operator_to_its_own_jobs_where_that_is_asked_for(helm: Any) -> None:
    def made(*words: str) -> list[dict[str, Any]]:
        team = helm.objects("-f", str(VALUES / "team.yaml"), *words)
        return [one for one in team if one["apiVersion"].startswith("admissionregistration")]

    assert made() == []
    policy, binding = made("--set", "jobPolicy=true")
    assert binding["spec"]["policyName"] == policy["metadata"]["name"] == "hive-jobs-lab"
    assert binding["spec"]["validationActions"] == ["Deny"]
    [condition] = policy["spec"]["matchConditions"]
    assert condition["expression"] == "request.userInfo.username == 'system:serviceaccount:lab:hive-operator'"
    settings = yaml.safe_load(_named(helm, "ConfigMap", "hive-settings")["data"]["operator.yaml"])
    rules = "".join(rule["expression"] for rule in policy["spec"]["validations"])
    names = [settings["pods"]["serviceAccountName"], *settings["pods"]["imagePullSecrets"]]
    names += [volume["claim"] for volume in settings["volumes"].values()]
    names += [*settings["store"].values()]
    assert [name for name in names if name not in rules] == []
    old = ("--set", "jobPolicy=true", "--kube-version", "1.29.0")
    assert "Kubernetes v1.29.0 has no ValidatingAdmissionPolicy" in helm.text(*old, code=1)


def _named(helm: Any, kind: str, name: str) -> dict[str, Any]:
    objects = helm.objects("-f", str(VALUES / "team.yaml"))
    [found] = [one for one in objects if (one["kind"], one["metadata"]["name"]) == (kind, name)]
    return dict(found)


@pytest.mark.parametrize("name", ["hive-collector", "hive-offloader"])
def test_who_walks_over_volumes_sees_its_own_namespace_and_cronjob_alone(helm: Any, name: str) -> None:
    objects = helm.objects("-f", str(VALUES / "team.yaml"))
    roles = [one for one in objects if one["kind"] == "Role" and one["metadata"]["name"] == name]
    named = {
        (one["metadata"]["namespace"], *rule["resources"], *rule["resourceNames"])
        for one in roles
        for rule in one["rules"]
        if "resourceNames" in rule
    }
    places = ("lab", "students", "guests")
    expected = {(place, "namespaces", place) for place in places}
    assert named == expected | {(place, "cronjobs", name) for place in places}


def test_roles_are_bound_to_their_own_account(rendered: list[dict[str, Any]]) -> None:
    roles = {(o["metadata"]["namespace"], o["metadata"]["name"]) for o in rendered if o["kind"] == "Role"}
    accounts = {
        (o["metadata"]["namespace"], o["metadata"]["name"]) for o in rendered if o["kind"] == "ServiceAccount"
    }
    bindings = [one for one in rendered if one["kind"] == "RoleBinding"]
    assert {(o["metadata"]["namespace"], o["roleRef"]["name"]) for o in bindings} == roles
    for one in bindings:
        (subject,) = one["subjects"]
        assert (subject["namespace"], subject["name"]) in accounts
        assert subject["name"] == one["roleRef"]["name"]


def test_no_account_has_a_token_of_itself(rendered: list[dict[str, Any]]) -> None:
    accounts = {o["metadata"]["name"]: o for o in rendered if o["kind"] == "ServiceAccount"}
    for account in accounts.values():
        assert account["automountServiceAccountToken"] is False
    bound = {one["roleRef"]["name"] for one in rendered if one["kind"] == "RoleBinding"}
    assert {name for name in accounts if name not in bound} == {n for n in accounts if n.endswith("-runs")}


@pytest.mark.parametrize(
    ("role", "verbs"), [("edit", READ | {"create", "patch", "update", "delete"}), ("view", READ)]
)
def test_people_get_the_kinds_with_the_clusters_roles(helm: Any, role: str, verbs: set[str]) -> None:
    chart = Path(__file__).parents[2] / "helm" / "slamhive-crds"
    (found,) = (
        one
        for one in helm.objects(chart=chart)
        if one["kind"] == "ClusterRole" and role in one["metadata"]["name"]
    )
    assert found["metadata"]["labels"][f"rbac.authorization.k8s.io/aggregate-to-{role}"] == "true"
    (rule,) = found["rules"]
    assert rule["apiGroups"] == ["slamhive.io"]
    assert {*rule["resources"]} == KINDS
    assert {*rule["verbs"]} == verbs
    none = helm.objects("--set", "aggregateRoles=false", chart=chart)
    assert {one["kind"] for one in none} == {"CustomResourceDefinition"}
