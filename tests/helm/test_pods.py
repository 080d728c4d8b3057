# SPDX-License-Identifier: Apache-2.0
"""Every pod of the chart keeps the restricted Pod Security standard, and has only what it needs."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

Spec = dict[str, Any]
VALUES = Path(__file__).parent / "values"

VOLUMES = {
    "configMap",
    "csi",
    "downwardAPI",
    "emptyDir",
    "ephemeral",
    "persistentVolumeClaim",
    "projected",
    "secret",
}
HARMLESS_SYSCTLS = {"net.ipv4.ip_unprivileged_port_start"}


def pods(objects: list[dict[str, Any]]) -> Iterator[tuple[str, dict[str, str], Spec]]:
    """Name, labels and spec of every pod that objects make."""
    for one in objects:
        template: Any = {
            "Pod": lambda o: o,
            "Deployment": lambda o: o["spec"]["template"],
            "CronJob": lambda o: o["spec"]["jobTemplate"]["spec"]["template"],
        }.get(one["kind"], lambda _: None)(one)
        if template:
            yield one["metadata"]["name"], template["metadata"]["labels"], template["spec"]


def violations(spec: Spec) -> list[str]:
    """Return a pod's breaches of the standard kubernetes.io/docs/concepts/security/pod-security-standards."""
    found = [key for key in ("hostNetwork", "hostPID", "hostIPC") if spec.get(key)]
    for volume in spec.get("volumes", []):
        found += [f"volume {kind}" for kind in volume.keys() - {"name"} if kind not in VOLUMES]
    outer = spec.get("securityContext", {})
    found += [
        f"sysctl {one['name']}" for one in outer.get("sysctls", []) if one["name"] not in HARMLESS_SYSCTLS
    ]
    for container in [*spec.get("initContainers", []), *spec["containers"]]:
        inner = container.get("securityContext", {})
        both = outer | inner
        capabilities = inner.get("capabilities", {})
        found += [
            f"{container['name']}: {rule}"
            for rule, broken in {
                "privileged": inner.get("privileged", False),
                "allowPrivilegeEscalation": inner.get("allowPrivilegeEscalation") is not False,
                "runAsNonRoot": both.get("runAsNonRoot") is not True,
                "runAsUser": both.get("runAsUser") == 0,
                "seccompProfile": both.get("seccompProfile", {}).get("type")
                not in {"RuntimeDefault", "Localhost"},
                "capabilities.drop": "ALL" not in capabilities.get("drop", []),
                "capabilities.add": not set(capabilities.get("add", [])) <= {"NET_BIND_SERVICE"},
                "procMount": inner.get("procMount", "Default") != "Default",
                "hostPort": any(port.get("hostPort") for port in container.get("ports", [])),
            }.items()
            if broken
        ]
    return found


def test_all_pods_are_restricted(rendered: list[dict[str, Any]]) -> None:
    found = list(pods(rendered))
    assert len(found) >= 2
    for name, _, spec in found:
        assert violations(spec) == [], name


def _container(**fields: Any) -> Callable[[Spec], None]:
    return lambda spec: spec["containers"][0]["securityContext"].update(fields)


def _pod(**fields: Any) -> Callable[[Spec], None]:
    return lambda spec: spec["securityContext"].update(fields)


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (lambda spec: spec.update(hostPID=True), "hostPID"),
        (lambda spec: spec["volumes"].append({"name": "x", "hostPath": {"path": "/"}}), "volume hostPath"),
        (_container(privileged=True), "operator: privileged"),
        (_container(allowPrivilegeEscalation=None), "operator: allowPrivilegeEscalation"),
        (_container(capabilities={}), "operator: capabilities.drop"),
        (_container(capabilities={"drop": ["ALL"], "add": ["SYS_PTRACE"]}), "operator: capabilities.add"),
        (_pod(runAsNonRoot=False), "operator: runAsNonRoot"),
        (_container(runAsUser=0), "operator: runAsUser"),
        (_pod(seccompProfile={}), "operator: seccompProfile"),
        (_container(seccompProfile={"type": "Unconfined"}), "operator: seccompProfile"),
    ],
)
def test_the_check_notices(helm: Any, change: Callable[[Spec], None], rule: str) -> None:
    spec = copy.deepcopy(next(spec for name, _, spec in pods(helm.objects()) if name == "slamhive-operator"))
    change(spec)
    assert violations(spec) == [rule]


def test_all_pods_are_careful(rendered: list[dict[str, Any]]) -> None:
    for name, _, spec in pods(rendered):
        assert spec["enableServiceLinks"] is False, name
        assert spec["securityContext"]["fsGroupChangePolicy"] == "OnRootMismatch", name
        assert spec["serviceAccountName"], name
        mounts = [mount for c in spec["containers"] for mount in c.get("volumeMounts", ())]
        # What only opens connections needs no place for files.
        assert name.endswith("-egress") or "/tmp" in {mount["mountPath"] for mount in mounts}, name
        for container in spec["containers"]:
            assert container["securityContext"]["readOnlyRootFilesystem"] is True, name
            assert {*container["resources"]} == {"requests", "limits"}, name
        for volume in spec.get("volumes", ()):
            assert "emptyDir" not in volume or volume["emptyDir"]["sizeLimit"], name
        volumes = {volume["name"] for volume in spec.get("volumes", ())}
        assert {mount["name"] for mount in mounts} == volumes, name


def test_deployments_select_their_pods(rendered: list[dict[str, Any]]) -> None:
    selectors = {}
    for one in rendered:
        if one["kind"] in {"Deployment", "Service"}:
            selector = one["spec"]["selector"]
            selectors[one["kind"], one["metadata"]["name"]] = selector.get("matchLabels", selector)
    for (_, owner), selector in selectors.items():
        found = [name for name, labels, _ in pods(rendered) if selector.items() <= labels.items()]
        assert len(found) == 1, owner


def test_one_operator_at_a_time(rendered: list[dict[str, Any]]) -> None:
    (operator,) = (
        one
        for one in rendered
        if one["metadata"]["labels"]["app.kubernetes.io/component"] == "operator"
        and one["kind"] == "Deployment"
    )
    assert operator["spec"]["replicas"] == 1
    assert operator["spec"]["strategy"] == {"type": "Recreate"}
    container = operator["spec"]["template"]["spec"]["containers"][0]
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    assert ports == {"metrics": 9090, "health": 8080}
    for probe, path in (
        ("livenessProbe", "/healthz"),
        ("startupProbe", "/healthz"),
        ("readinessProbe", "/readyz"),
    ):
        assert container[probe]["httpGet"] == {"path": path, "port": "health"}


@pytest.mark.parametrize(("name", "secret"), [("default", None), ("single-node", None), ("team", "database")])
def test_the_archive_is_where_its_url_says(helm: Any, name: str, secret: str | None) -> None:
    objects = helm.objects("-f", str(Path(__file__).parent / "values" / f"{name}.yaml"))
    for pod, _, spec in pods(objects):
        if pod.endswith(("-test", "-egress")):
            continue
        volumes = {volume["name"]: volume for volume in spec["volumes"]}
        mounts = {m["name"]: m["mountPath"] for m in spec["containers"][0]["volumeMounts"]}
        assert ("archive-url" in volumes) == (name == "team"), pod
        assert ("archive" in volumes) == (name == "single-node"), pod
        if secret:
            assert volumes["archive-url"]["secret"]["secretName"] == secret
            assert volumes["archive-url"]["secret"]["items"] == [{"key": "slamhive-url", "path": "url"}]
            assert mounts["archive-url"] == "/etc/slamhive-archive"
        elif name == "single-node":
            assert mounts["archive"] == "/slamhive/archive"
            assert mounts["settings"] == "/etc/slamhive"


def test_who_only_reads_the_archive_has_an_account_of_its_own(helm: Any) -> None:
    words = ("--set", "archive.existingSecret=writer,archive.readSecret=reader,workspaces={more}")
    found = {
        pod: {volume["secret"]["secretName"] for volume in spec["volumes"] if "secret" in volume}
        for pod, _, spec in pods(helm.objects(*words))
        if not pod.endswith(("-test", "-egress"))
    }
    assert {pod: secrets for pod, secrets in found.items() if "operator" in pod} == {
        "slamhive-operator": {"writer"}
    }
    assert {*map(frozenset, (found[pod] for pod in found if "operator" not in pod))} == {
        frozenset({"reader"})
    }


def test_the_collector_s_limits_are_passed_on(helm: Any) -> None:
    words = ("--set", "collector.brake.count=5,collector.brake.percent=50,collector.trash=24h")
    (command,) = (
        spec["containers"][0]["command"] for pod, _, spec in pods(helm.objects(*words)) if "collector" in pod
    )
    text = " ".join(command)
    assert "--trash 24h --most 5 50 --cronjob slamhive-collector" in text


def test_the_bucket_s_keys_are_given_to_those_alone_who_need_them(helm: Any) -> None:
    """The offloader's may write; the dashboard has the ones that only read, the operator none."""
    objects = helm.objects("-f", str(VALUES / "team.yaml"))
    found = {
        pod: {volume["secret"]["secretName"] for volume in spec["volumes"] if "secret" in volume}
        for pod, _, spec in pods(objects)
        if "volumes" in spec
    }
    holders = {pod: secrets & {"bucket", "bucket-reader"} for pod, secrets in found.items()}
    assert {pod: secrets for pod, secrets in holders.items() if secrets} == {
        "hive-offloader": {"bucket"},
        "hive-dashboard": {"bucket-reader"},
    }
    [settings] = {
        one["data"]["operator.yaml"] for one in objects if one["metadata"]["name"] == "hive-settings"
    }
    assert yaml.safe_load(settings)["store"] == {"configMap": "hive-store", "secret": "bucket-reader"}


def test_the_offloader_s_settings_are_passed_on(helm: Any) -> None:
    objects = helm.objects("-f", str(VALUES / "team.yaml"))
    command = next(spec["containers"][0]["command"] for pod, _, spec in pods(objects) if "offloader" in pod)
    text = " ".join(command)
    assert "--store /etc/slamhive-store/store.yaml --secret /etc/slamhive-store-secret" in text
    assert "--after 72h --trash 24h --full 70 --cronjob hive-offloader" in text
    stores = [
        one for one in objects if one["metadata"]["name"] == "hive-store" and one["kind"] == "ConfigMap"
    ]
    assert {one["metadata"]["namespace"] for one in stores} == {"lab", "students", "guests"}
    assert yaml.safe_load(stores[0]["data"]["store.yaml"]) == {
        "url": "s3://results/lab",
        "options": {"endpoint_url": "https://minio.example.org:9000"},
    }
    crons = [
        one for one in objects if one["metadata"]["name"] == "hive-offloader" and one["kind"] == "CronJob"
    ]
    annotations = crons[0]["metadata"]["annotations"]
    assert annotations == {"slamhive.io/store": "hive-store", "slamhive.io/store-secret": "bucket-reader"}
