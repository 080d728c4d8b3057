# SPDX-License-Identifier: Apache-2.0
"""Tests of the rendered charts for several values files: golden files, and rules for all of them."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from release import repack
from release_checks import CHARTS as CHARTS_RELEASED

if TYPE_CHECKING:
    from collections.abc import Callable

HERE = Path(__file__).parent
CHARTS = HERE.parents[1] / "helm"
LICENCE = "# SPDX-License-Identifier: Apache-2.0\n"
CLUSTER_SCOPED = {"PersistentVolume"}
OF_WORKSPACES = {
    "ServiceAccount",
    "Role",
    "RoleBinding",
    "PersistentVolumeClaim",
    "NetworkPolicy",
    "CronJob",
    "ConfigMap",
    "PodDisruptionBudget",
}


def test_renders_are_what_they_were(
    variety: str, rendered: list[dict[str, Any]], kept: Callable[[Path, str], None]
) -> None:
    shown = [_without_files(one) for one in rendered]
    kept(HERE / "golden" / f"{variety}.yaml", LICENCE + yaml.safe_dump_all(shown, sort_keys=True, width=110))


def _without_files(one: dict[str, Any]) -> dict[str, Any]:
    """Leave out what is a file of its own, tested elsewhere."""
    if one["metadata"]["name"].endswith("-grafana"):
        one = one | {"data": dict.fromkeys(one["data"], "…")}
    if one["kind"] == "Pod":
        container = one["spec"]["containers"][0] | {"args": ["…"]}
        one = one | {"spec": one["spec"] | {"containers": [container]}}
    return one


def test_every_object_is_told_apart(rendered: list[dict[str, Any]]) -> None:
    names = Counter((o["kind"], o["metadata"].get("namespace"), o["metadata"]["name"]) for o in rendered)
    assert [name for name, times in names.items() if times > 1] == []


def test_objects_are_in_their_namespaces_and_labelled(variety: str, rendered: list[dict[str, Any]]) -> None:
    workspaces = {"students", "guests"} if variety == "team" else set()
    for one in rendered:
        namespace = one["metadata"].get("namespace")
        if one["kind"] in CLUSTER_SCOPED:
            assert namespace is None
        else:
            assert namespace in {"lab", *workspaces}
        if namespace in workspaces:
            assert one["kind"] in OF_WORKSPACES
        labels = one["metadata"]["labels"]
        assert labels["app.kubernetes.io/instance"] == "slamhive"
        assert labels["app.kubernetes.io/component"]
        assert labels.get("team") == ("robotics" if variety == "team" else None)
    assert {one["metadata"]["namespace"] for one in rendered if "namespace" in one["metadata"]} == {
        "lab",
        *workspaces,
    }


@pytest.mark.parametrize("name", ["team"])
def test_each_workspace_has_what_the_release_has(helm: Any, name: str) -> None:
    objects = helm.objects("-f", str(HERE / "values" / f"{name}.yaml"))
    found = {
        workspace: {
            (one["kind"], one["metadata"]["name"])
            for one in objects
            if one["metadata"].get("namespace") == workspace
        }
        for workspace in ("lab", "students", "guests")
    }
    assert found["students"] == found["guests"]
    assert found["students"] < found["lab"]
    assert {kind for kind, _ in found["students"]} == OF_WORKSPACES
    subjects = {
        one["metadata"]["name"]: one["subjects"][0]["namespace"]
        for one in objects
        if one["kind"] == "RoleBinding" and one["metadata"]["namespace"] == "students"
    }
    assert subjects == {
        "hive-operator": "lab",
        "hive-dashboard": "lab",
        "hive-collector": "students",
        "hive-offloader": "students",
    }


@pytest.mark.parametrize("chart", ["slamhive", "slamhive-crds"])
def test_lint_finds_nothing(helm: Any, chart: str) -> None:
    told = helm.run("lint", "--strict", str(CHARTS / chart), "--kube-version", "1.34.0")
    assert "[WARNING]" not in told
    assert "[ERROR]" not in told


@pytest.mark.parametrize("chart", ["slamhive", "slamhive-crds"])
def test_old_kubernetes_is_refused(helm: Any, chart: str) -> None:
    told = helm.text("--kube-version", "1.28.3", chart=CHARTS / chart, code=1)
    assert "requires kubeVersion: >=1.29.0-0" in told


@pytest.mark.parametrize(
    ("release", "values", "name"),
    [
        ("slamhive", [], "slamhive"),
        ("lab", [], "lab-slamhive"),
        ("my-slamhive-2", [], "my-slamhive-2"),
        ("lab", ["--set", "fullnameOverride=hive"], "hive"),
        ("l" * 53, [], "l" * 40),
    ],
)
def test_names_come_from_the_release_and_fit(helm: Any, release: str, values: list[str], name: str) -> None:
    text = helm.run("template", release, str(CHARTS / "slamhive"), "--kube-version", "1.34.0", *values)
    objects = [one for one in yaml.safe_load_all(text) if one]
    assert {o["metadata"]["name"] for o in objects if o["kind"] == "Deployment"} == {
        f"{name}-operator",
        f"{name}-dashboard",
    }
    assert all(len(o["metadata"]["name"]) <= 52 for o in objects if o["kind"] == "CronJob")


def test_changed_settings_restart_the_operator(helm: Any) -> None:
    def checksum(*words: str) -> str:
        (operator,) = (
            one
            for one in helm.objects(*words)
            if one["kind"] == "Deployment" and one["metadata"]["name"].endswith("-operator")
        )
        return str(operator["spec"]["template"]["metadata"]["annotations"]["checksum/settings"])

    assert checksum() == checksum("--set", "operator.resources.limits.cpu=1")
    assert checksum() != checksum("--set", "settings.workers=9")


@pytest.mark.parametrize("chart", CHARTS_RELEASED)
def test_a_released_archive_is_equal_each_time_and_renders_as_its_folder(
    helm: Any, chart: str, tmp_path: Path
) -> None:
    made = []
    for name in ("first", "second"):
        helm.run("package", str(CHARTS / chart), "--destination", str(tmp_path / name))
        (packed,) = (tmp_path / name).iterdir()
        repack(packed, tmp_path / f"{name}.tgz", 1_700_000_000)
        made.append(tmp_path / f"{name}.tgz")
    assert made[0].read_bytes() == made[1].read_bytes()
    assert helm.text(chart=made[0]) == helm.text(chart=CHARTS / chart)
