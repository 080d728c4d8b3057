# SPDX-License-Identifier: Apache-2.0
"""The operator understands the settings that the chart writes, and both have the same defaults."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from slamhive.kube.settings import Settings, load

VALUES = Path(__file__).parent / "values"


def settings(objects: list[dict[str, Any]], folder: Path) -> Settings:
    (found,) = (
        o for o in objects if o["kind"] == "ConfigMap" and o["metadata"]["name"].endswith("-settings")
    )
    (folder / "operator.yaml").write_text(found["data"]["operator.yaml"])
    return load(folder / "operator.yaml")


def test_the_operator_reads_them(rendered: list[dict[str, Any]], tmp_path: Path) -> None:
    assert settings(rendered, tmp_path).namespaces[0] == "lab"


def test_defaults_are_those_of_the_operator(helm: Any, tmp_path: Path) -> None:
    found = settings(helm.objects(), tmp_path)
    given = {"namespaces", "image", "evaluator_image", "player_image", "ros2_player_image", "volumes", "pods"}
    default = Settings.model_validate(
        {"namespaces": ["lab"], "image": "x", "volumes": {"results": {"claim": "r"}, "data": {"claim": "d"}}}
    )
    assert found.model_dump(exclude=given) == default.model_dump(exclude=given)
    assert found.model_fields_set == {*Settings.model_fields} - {"archive_url_file", "cluster_name", "store"}
    assert found.pods.model_dump(exclude={"service_account_name"}) == default.pods.model_dump(
        exclude={"service_account_name"}
    )
    assert found.volumes.results.claim == "slamhive-results"


def test_everything_set_arrives(helm: Any, tmp_path: Path) -> None:
    found = settings(helm.objects("-f", str(VALUES / "team.yaml")), tmp_path)
    assert found.namespaces == ["lab", "students", "guests"]
    assert found.image == "registry.example.org/slamhive@sha256:" + 4 * "0123456789abcdef"
    assert found.evaluator_image == "registry.example.org/evaluator:1.0"
    assert found.image_pull_policy == "Always"
    assert found.volumes.results.claim == "hive-results"
    assert found.volumes.data.claim == "recordings"
    assert found.archive_url_file == Path("/etc/slamhive-archive/url")
    assert found.cluster_name == "lab-1"
    assert found.uid == 1000
    assert found.default_parallelism == 32
    assert found.metrics.run_name_label
    assert found.passed_labels == ["kueue.x-k8s.io/", "example.org/team"]
    assert not found.custom_evaluators
    assert (found.output_limit, found.output_files) == ("2Gi", 5000)
    sharing = found.sharing
    assert (sharing.slots, sharing.waiting_pods, sharing.read_nodes) == (64, 4, False)
    students = sharing.namespaces["students"]
    assert (students.weight, students.slots, students.cpu_hours) == (1, 16, 500)
    pods = found.pods
    assert pods.service_account_name == "hive-runs"
    assert pods.node_selector == {"pool": "runs"}
    assert pods.tolerations[0]["value"] == "slam"
    assert pods.affinity
    assert pods.runtime_class_name == "nvidia"
    assert pods.priority_class_name == "batch"
    assert pods.gpu_resource == "amd.com/gpu"
    assert pods.image_pull_secrets == ["registry"]


@pytest.mark.parametrize(
    ("values", "path"), [("default", None), ("single-node", "/etc/slamhive/archive-url"), ("bare", None)]
)
def test_the_archive_s_file(helm: Any, tmp_path: Path, values: str, path: str | None) -> None:
    objects = helm.objects("-f", str(VALUES / f"{values}.yaml"))
    assert settings(objects, tmp_path).archive_url_file == (Path(path) if path else None)
    urls = [o["data"]["archive-url"] for o in objects if "archive-url" in o.get("data", {})]
    assert {*urls} == ({"sqlite:////slamhive/archive/archive.sqlite"} if path else set())
