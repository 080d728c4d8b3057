# SPDX-License-Identifier: Apache-2.0
"""The dashboard as the chart renders it: its settings, what it may touch, how it is reached."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from slamhive.dashboard.server.settings import DashboardSettings, load_settings

VALUES = Path(__file__).parent / "values"
WITH_DASHBOARD = ["default", "single-node", "team"]


def of(objects: list[dict[str, Any]], kind: str) -> Any:
    """Return the dashboard's object of a kind; None where there is none."""
    found = [
        one
        for one in objects
        if one["kind"] == kind and one["metadata"]["labels"]["app.kubernetes.io/component"] == "dashboard"
    ]
    assert len(found) <= 1
    return found[0] if found else None


def objects_of(helm: Any, name: str) -> list[dict[str, Any]]:
    return list(helm.objects("-f", str(VALUES / f"{name}.yaml")))


def settings(objects: list[dict[str, Any]], folder: Path) -> DashboardSettings:
    (folder / "dashboard.yaml").write_text(of(objects, "ConfigMap")["data"]["dashboard.yaml"])
    return load_settings(folder / "dashboard.yaml")


def pod(objects: list[dict[str, Any]]) -> dict[str, Any]:
    return dict(of(objects, "Deployment")["spec"]["template"]["spec"])


@pytest.mark.parametrize("name", WITH_DASHBOARD)
def test_it_reads_its_settings_and_finds_what_they_name(helm: Any, tmp_path: Path, name: str) -> None:
    objects = objects_of(helm, name)
    found, spec = settings(objects, tmp_path), pod(objects)
    assert found.namespaces == (["lab", "students", "guests"] if name == "team" else ["lab"])
    assert found.cluster_name == ("lab-1" if name == "team" else "")
    assert (found.archive_url_file is None) == (name == "default")
    (container,) = spec["containers"]
    assert [*container["command"][-2:]] == ["--settings", "/etc/slamhive/dashboard.yaml"]
    mounts = {mount["mountPath"]: mount for mount in container["volumeMounts"]}
    for place in (found.results, found.ground_truth):
        assert mounts[str(place)]["readOnly"] is True
    assert mounts[str(found.ground_truth)]["subPath"] == "groundtruth"
    assert str(found.cache).startswith("/tmp/")
    assert container["ports"] == [
        {"name": "http", "containerPort": found.port},
        {"name": "health", "containerPort": found.health_port},
    ]
    assert found.connections_per_address == (512 if name == "team" else 128)


@pytest.mark.parametrize("name", WITH_DASHBOARD)
def test_it_writes_to_no_recording_and_no_result(helm: Any, name: str) -> None:
    spec = pod(objects_of(helm, name))
    written = {mount["name"] for mount in spec["containers"][0]["volumeMounts"] if not mount.get("readOnly")}
    for volume in spec["volumes"]:
        # Else the first pod on a node would leave a local volume to root, and no run could write its results.
        assert "readOnly" not in volume.get("persistentVolumeClaim", {})
    # SQLite keeps its lock and index beside the file; the connection itself refuses to write.
    more = {"single-node": {"archive"}, "team": {"store-cache"}}
    assert written == {"tmp", *more.get(name, set())}
    (folder,) = spec["initContainers"]
    assert [mount["name"] for mount in folder["volumeMounts"]] == ["data"]


def test_probes_and_resources(helm: Any) -> None:
    (container,) = pod(helm.objects())["containers"]
    for probe, path in (
        ("startupProbe", "/healthz"),
        ("livenessProbe", "/healthz"),
        ("readinessProbe", "/readyz"),
    ):
        assert container[probe]["httpGet"] == {"path": path, "port": "health"}
    assert {*container["resources"]["limits"]} == {*container["resources"]["requests"]} == {"cpu", "memory"}


def test_changed_settings_start_it_again(helm: Any) -> None:
    """A file in a ConfigMap changes under a process that has read it."""

    def mark(*words: str) -> str:
        template = of(helm.objects(*words), "Deployment")["spec"]["template"]
        return str(template["metadata"]["annotations"]["checksum/settings"])

    marks = [mark(), mark("--set", "clusterName=other"), mark("--set", "workspaces={more}")]
    assert len({*marks, mark("--set", "archive.existingSecret=database")}) == 4
    assert mark("--set", "settings.workers=3") == marks[0]


def test_an_ingress_leads_to_its_service(helm: Any) -> None:
    objects = objects_of(helm, "team")
    spec, service = of(objects, "Ingress")["spec"], of(objects, "Service")
    (rule,) = spec["rules"]
    (path,) = rule["http"]["paths"]
    assert (rule["host"], path["path"], spec["ingressClassName"]) == ("slam.example.org", "/", "nginx")
    assert path["backend"]["service"]["name"] == service["metadata"]["name"] == "hive-dashboard"
    assert path["backend"]["service"]["port"]["name"] == service["spec"]["ports"][0]["name"]
    assert spec["tls"] == [{"hosts": ["slam.example.org"], "secretName": "slam-tls"}]
    assert of(objects, "PodDisruptionBudget")["spec"]["minAvailable"] == 1
    assert of(helm.objects(), "Ingress") is None


def test_visitors_behind_an_ingress_share_its_connections_unless_told_otherwise(
    helm: Any, tmp_path: Path
) -> None:
    with_ingress = "dashboard.ingress.enabled=true,dashboard.ingress.host=slam.example.org"
    told = ("--set", f"{with_ingress},dashboard.connectionsPerAddress=40")
    assert settings(helm.objects(*told), tmp_path).connections_per_address == 40


def test_it_can_be_left_out(helm: Any) -> None:
    for one in objects_of(helm, "bare"):
        assert "dashboard" not in one["metadata"]["name"]
        assert one["metadata"]["labels"]["app.kubernetes.io/component"] != "dashboard"
