# SPDX-License-Identifier: Apache-2.0
"""Tests of the program that renders settings files in a run's pod, asked as the run's Job asks it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.contract.environment import SETTINGS_FOLDER
from slamhive.kube.builders import configuration, run_job
from slamhive.kube.settings import Settings
from slamhive.model.algorithm import Algorithm
from slamhive.model.dataset import Dataset
from slamhive.plan import resolve
from slamhive.templating import render

if TYPE_CHECKING:
    from conftest import Pod

UID = "1a041cf6-9b92-477e-a9c3-86376ca82111"
SHA = "b" * 64
LIDAR = {"type": "Lidar", "topic": "/points", "rate": 10.0}
DESCRIPTION = {
    "folder": "0123abcd",
    "format": "Rosbag1",
    "recording": "recording.bag",
    "sensors": {
        "lidar": LIDAR
        | {"name": "lidar", "T_body_sensor": [[1, 0, 0, 1e-7], [0, 1, 0, 0], [0, 0, 1, 0.3], [0, 0, 0, 1]]}
    },
    "startTime": 1600000000.123456789,
    "durationSeconds": 26.0,
    "frames": 131,
    "key": "k",
    "sourceSha256": SHA,
    "datasetSha256": SHA,
    "sizeBytes": 1024,
}
TEMPLATE = """# {{ dataset.name }} from {{ dataset.startTime }} s: é
{% for name in parameters %}
{{ name }}: {{ parameters[name] }}
{% endfor %}
T: {{ opencv_matrix(transform('body', 'lidar')) }}
bag: {{ paths.recording|quoted }}
"""


def algorithm(*templates: str, **parameters: Any) -> Algorithm:
    declared = {
        name: {"type": "String" if isinstance(value, str) else "Number", "default": value}
        for name, value in parameters.items()
    }
    spec = {
        "image": "example.org/lio:1.0",
        "modes": [{"name": "lidar"}],
        "output": {"frame": "lidar"},
        "parameters": declared,
        "files": [{"path": f"config/{n}.yaml", "template": text} for n, text in enumerate(templates)],
    }
    return Algorithm.model_validate({"metadata": {"name": "lio"}, "spec": spec})


def asked(pod: Pod, declared: Algorithm) -> Any:
    """Lay what a run's Job says into a pod's folders, and return its configuration."""
    data = Dataset.model_validate(
        {
            "metadata": {"name": "hall"},
            "spec": {"recording": {"files": [{"path": "a.bag"}]}, "sensors": {"lidar": LIDAR}},
        }
    )
    spec = resolve({"algorithmRef": {"name": "lio"}, "datasetRef": {"name": "hall"}}, declared, data)
    told = configuration("one", spec, data, DESCRIPTION)
    volumes = {"results": {"claim": "results"}, "data": {"claim": "data"}}
    job = run_job(
        run={
            "apiVersion": "slamhive.io/v1alpha1",
            "kind": "MappingRun",
            "metadata": {"name": "one", "namespace": "lab", "uid": UID},
        },
        spec=spec,
        algorithm=declared,
        configuration=told,
        description=DESCRIPTION,
        attempt=1,
        settings=Settings.model_validate(
            {"namespaces": ["lab"], "image": "example.org/slamhive:1", "volumes": volumes}
        ),
    )
    template = job["spec"]["template"]
    (container, *_) = template["spec"]["initContainers"]
    volume = {item["name"]: item for item in template["spec"]["volumes"]}
    for mount in container["volumeMounts"]:
        folder = pod.root / Path(mount["mountPath"]).relative_to("/slamhive")
        folder.mkdir(exist_ok=True)
        for item in volume[mount["name"]].get("downwardAPI", {}).get("items", ()):
            name = item["fieldRef"]["fieldPath"].split("'")[1]
            (folder / item["path"]).write_text(template["metadata"]["annotations"][name])
    return told.as_json()


def test_a_pod_renders_what_a_workstation_renders(pod: Pod) -> None:
    declared = algorithm(
        TEMPLATE, "{{ seed }}", size=1e-7, text="12:30 'x' \"y\"\nno", date="2026-11-23", z="\x7f"
    )
    told = asked(pod, declared)
    assert pod.run("render").code == 0
    expected = render(declared.spec.templates, told, "/slamhive", "/slamhive/files")
    folder = pod.root / "run" / SETTINGS_FOLDER
    found = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    assert {name: path.read_text() for name, path in found.items()} == {
        file.path: file.text for file in expected
    }
    assert [path.stat().st_mode & 0o777 for path in found.values()] == [0o440, 0o440]
    assert "size: 1.0e-07" in found["config/0.yaml"].read_text()
    assert yaml.safe_load(found["config/1.yaml"].read_text()) == 1


def test_a_container_that_is_started_again_renders_again(pod: Pod) -> None:
    asked(pod, algorithm("{{ seed }}\n"))
    assert [pod.run("render").code for _ in range(2)] == [0, 0]
    assert (pod.root / "run" / SETTINGS_FOLDER / "config" / "0.yaml").read_text() == "1\n"


@pytest.mark.parametrize(
    ("template", "words"),
    [
        ("\n{{ 1 / parameters.size }}", "line 2: division by zero"),
        ("\n{{ sensors.lidar.camera.fx }}", "line 2: unknown name 'camera'"),
        ("\n{{ 'a' * 10**10 }}", "line 2: it takes more than 64 MiB of memory"),
    ],
)
def test_what_can_not_be_rendered_is_told_with_field_and_line(template: str, words: str, pod: Pod) -> None:
    asked(pod, algorithm("", template, size=0))
    reason, message = pod.run("render").error
    assert reason == "InvalidParameters"
    assert message.startswith(f"algorithm 'lio': files.1.template (config/1.yaml): {words}")
    assert not (pod.root / "run" / SETTINGS_FOLDER).exists()


def test_a_disk_that_refuses_is_a_fault_and_no_mistake(pod: Pod) -> None:
    asked(pod, algorithm("{{ seed }}"))
    (pod.root / "run" / SETTINGS_FOLDER).write_text("in the way")
    reason, message = pod.run("render").error
    assert reason == "SystemFault"
    assert SETTINGS_FOLDER in message


def test_a_request_that_is_none_is_told(pod: Pod) -> None:
    asked(pod, algorithm("{{ seed }}"))
    pod.ask({"files": [{"path": "../x", "template": ""}], "run": "/slamhive"})
    reason, message = pod.run("render").error
    assert (reason, "request.files.0.path" in message) == ("InvalidParameters", True)
    assert json.loads((pod.root / "request" / "request.json").read_text())
