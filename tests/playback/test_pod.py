# SPDX-License-Identifier: Apache-2.0
"""The player in a run's pod."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from slamhive.kube.builders.player import player
from slamhive.kube.builders.run import NO_COMPANION, Companion
from slamhive.kube.settings import Settings
from slamhive.model.algorithm import Algorithm
from slamhive.model.configuration import RunConfiguration
from slamhive.model.errors import InputError
from slamhive.model.loading import load_file
from slamhive.playback.protocol import READY_FILE, VARIABLE, PlayRequest

CATALOG = Path(__file__).parents[2] / "images" / "algorithms"
EYE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
SETTINGS = {
    "namespaces": ["lab"],
    "image": "slamhive:1",
    "volumes": {"results": {"claim": "r"}, "data": {"claim": "d"}},
}


def companion(name: str, pace: str = "Realtime", image: str | None = "player:1") -> Companion:
    (algorithm,) = load_file(CATALOG / name / "algorithm.yaml")
    assert isinstance(algorithm, Algorithm)
    told: dict[str, Any] = {
        "run": "r",
        "algorithm": name,
        "mode": "lidar",
        "dataset": {"name": "d", "recording": {"format": "Rosbag1", "path": "dataset/recording.bag"}},
        "sensors": {
            "lidar": {"name": "lidar", "type": "Lidar", "topic": "/points", "rate": 10, "T_body_sensor": EYE}
        },
        "input": {"pace": pace},
        "seed": 1,
        "cores": 1,
    }
    return player(
        run={"metadata": {"name": "r", "uid": "u1"}},
        algorithm=algorithm,
        configuration=RunConfiguration.model_validate(told),
        description={"folder": "abc"},
        settings=Settings.model_validate(SETTINGS),
        image=image,
    )


def test_a_sidecar_that_is_ready_before_the_algorithm_starts() -> None:
    made = companion("kiss-icp-ros")
    (body,) = made.init_containers
    assert made.containers == ()
    assert (body["name"], body["image"], body["restartPolicy"]) == ("player", "player:1", "Always")
    assert body["securityContext"]["readOnlyRootFilesystem"] is True
    env = {item["name"]: item.get("value") for item in body["env"]}
    assert env["SLAMHIVE_CONTAINER"] == "player"
    asked = PlayRequest.from_json(str(env[VARIABLE]))
    assert (asked.algorithm, asked.stay) == ("SLAMHIVE_CONTAINER=algorithm", True)
    assert body["startupProbe"]["exec"]["command"] == ["test", "-e", f"{asked.folder}/{READY_FILE}"]
    assert made.variables["ROS_MASTER_URI"] == f"http://127.0.0.1:{asked.port}"


def test_it_sees_what_the_algorithm_sees_and_no_more() -> None:
    made = companion("kiss-icp-ros")
    seen = {item["mountPath"]: item for item in made.init_containers[0]["volumeMounts"]}
    assert seen["/slamhive/dataset"] == {
        "name": "data",
        "mountPath": "/slamhive/dataset",
        "subPath": "variants/abc",
        "readOnly": True,
    }
    assert seen["/slamhive/output"]["subPathExpr"] == "runs/u1/$(POD_UID)/output"
    own = {volume["name"] for volume in made.volumes}
    assert {item["name"] for item in seen.values()} - {"data", "results"} == own


def test_others_need_none() -> None:
    assert companion("kiss-icp", "Lockstep", image=None) is NO_COMPANION


def test_without_an_image_of_the_player() -> None:
    with pytest.raises(InputError, match="playerImage"):
        companion("kiss-icp-ros", image=None)


def test_a_request_passes_through_kubernetes_as_it_is() -> None:
    env = {item["name"]: item.get("value") for item in companion("kiss-icp-ros").init_containers[0]["env"]}
    assert "$(" not in str(env[VARIABLE])
    assert json.loads(str(env[VARIABLE]))["topics"] == {"/points": "/points"}
