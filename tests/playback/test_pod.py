# SPDX-License-Identifier: Apache-2.0
"""The player in a run's pod."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from slamhive.kube.builders.player import player
from slamhive.kube.builders.run import NO_COMPANION, Companion, run_job
from slamhive.kube.settings import Settings
from slamhive.model.algorithm import Algorithm
from slamhive.model.configuration import RunConfiguration
from slamhive.model.errors import InputError
from slamhive.model.loading import load_file
from slamhive.playback.protocol import PROFILE_FILE, READY_FILE, VARIABLE, PlayRequest

CATALOG = Path(__file__).parents[2] / "images" / "algorithms"
EYE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
SETTINGS = {
    "namespaces": ["lab"],
    "image": "slamhive:1",
    "volumes": {"results": {"claim": "r"}, "data": {"claim": "d"}},
}


DESCRIPTION = {
    "folder": "abc",
    "format": "Mcap",
    "recording": "recording.mcap",
    "sensors": {},
    "startTime": 1600000000.0,
    "durationSeconds": 10.0,
    "frames": 100,
    "key": "0" * 64,
    "sourceSha256": "0" * 64,
    "datasetSha256": "0" * 64,
}
IMAGES = {"playerImage": "player:1", "ros2PlayerImage": "player:2"}
ROS2 = {
    "image": "localhost/odometry:1",
    "command": ["odometry"],
    "modes": [{"name": "lidar", "roles": ["lidar"]}],
    "output": {"frame": "lidar"},
    "paces": ["Realtime", "Stepped"],
    "realtime": {"queue": 1, "drop": "Oldest"},
    "recording": ["Mcap"],
    "files": [{"path": "node.yaml", "template": "/**: {ros__parameters: {voxel: 0.5}}"}],
    "ros2": {
        "poses": {"topic": "/odometry", "type": "Odometry"},
        "topics": {"lidar": "points_raw"},
        "arguments": "Ros",
        "parameters": "node.yaml",
    },
}


def configured(algorithm: Algorithm, pace: str) -> RunConfiguration:
    told: dict[str, Any] = {
        "run": "r",
        "algorithm": algorithm.name,
        "mode": "lidar",
        "dataset": {
            "name": "d",
            "recording": {"format": algorithm.spec.recording[0], "path": "dataset/recording.bag"},
        },
        "sensors": {
            "lidar": {"name": "lidar", "type": "Lidar", "topic": "/points", "rate": 10, "T_body_sensor": EYE}
        },
        "input": {"pace": pace},
        "seed": 1,
        "cores": 1,
    }
    return RunConfiguration.model_validate(told)


def companion(given: str | dict[str, Any], pace: str = "Realtime", **settings: Any) -> Companion:
    """Additions of a player to the pod of an algorithm: one of the catalog, or one with this spec."""
    if isinstance(given, str):
        (algorithm,) = load_file(CATALOG / given / "algorithm.yaml")
    else:
        algorithm = Algorithm.model_validate({"metadata": {"name": "given"}, "spec": given})
    assert isinstance(algorithm, Algorithm)
    return player(
        run={"metadata": {"name": "r", "uid": "u1"}},
        algorithm=algorithm,
        configuration=configured(algorithm, pace),
        description=DESCRIPTION,
        settings=Settings.model_validate(SETTINGS | IMAGES | settings),
    )


def pod(made: Companion, memory: str = "1Gi") -> dict[str, Any]:
    """The pod of a run of ROS2 beside a player."""
    algorithm = Algorithm.model_validate({"metadata": {"name": "given"}, "spec": ROS2})
    spec: dict[str, Any] = {
        "algorithmRef": {"name": "given"},
        "datasetRef": {"name": "d"},
        "mode": "lidar",
        "seed": 1,
        "timeout": "1h",
        "resources": {"cpu": "1", "memory": memory},
    }
    job = run_job(
        run={"metadata": {"name": "r", "uid": "u1", "namespace": "lab"}},
        spec=spec,
        algorithm=algorithm,
        configuration=configured(algorithm, "Realtime"),
        description=DESCRIPTION,
        attempt=1,
        settings=Settings.model_validate(SETTINGS | IMAGES),
        companion=made,
    )
    body: dict[str, Any] = job["spec"]["template"]["spec"]
    return body


def containers(body: dict[str, Any]) -> list[dict[str, Any]]:
    return [*body["initContainers"], *body["containers"]]


def places(container: dict[str, Any], volume: str) -> list[str]:
    return [item["mountPath"] for item in container["volumeMounts"] if item["name"] == volume]


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
    assert companion("kiss-icp", "Lockstep", playerImage=None) is NO_COMPANION


@pytest.mark.parametrize(
    ("given", "setting", "ros"), [("kiss-icp-ros", "playerImage", 1), (ROS2, "ros2PlayerImage", 2)]
)
def test_without_an_image_of_the_player(given: str | dict[str, Any], setting: str, ros: int) -> None:
    with pytest.raises(InputError, match=rf"is a ROS {ros} node, .* setting {setting} names no image"):
        companion(given, **{setting: None})


@pytest.mark.parametrize("pace", ["Realtime", "Stepped"])
def test_a_node_of_ros_2_meets_its_player_in_memory(pace: str) -> None:
    """In one /dev/shm, by the same profile of the transport, which it can read and not change."""
    made = companion(ROS2, pace)
    (body,) = made.init_containers
    assert body["image"] == "player:2"
    env = {item["name"]: item.get("value") for item in body["env"]}
    asked = PlayRequest.from_json(str(env[VARIABLE]))
    assert (asked.ros, asked.domain, asked.stepped) == (2, 0, pace == "Stepped")
    assert made.mounts == ({"name": "player", "mountPath": "/player", "readOnly": True},)
    assert made.variables["FASTDDS_DEFAULT_PROFILES_FILE"] == f"/player/{PROFILE_FILE}"
    assert made.variables["ROS_DOMAIN_ID"] == "0"
    assert "ROS_MASTER_URI" not in made.variables
    assert {"name": "memory", "mountPath": "/dev/shm"} in body["volumeMounts"]


@pytest.mark.parametrize(("memory", "room"), [("1Gi", 2**29), ("64Mi", 96 * 2**20)])
def test_the_pod_of_a_node_of_ros_2_has_room_for_two_segments(memory: str, room: int) -> None:
    body = pod(companion(ROS2), memory)
    (shared,) = [volume for volume in body["volumes"] if volume["name"] == "memory"]
    assert shared["emptyDir"] == {"medium": "Memory", "sizeLimit": str(room)}
    users = {named["name"]: places(named, "memory") for named in containers(body)}
    assert users == {"render": [], "monitor": [], "player": ["/dev/shm"], "algorithm": ["/dev/shm"]}
    assert "runAsUser" not in json.dumps(list(containers(body))), "one user, the pod's, for both"


def test_its_command_is_told_of_topics_and_parameters() -> None:
    (main,) = pod(companion(ROS2))["containers"]
    words = ["odometry", "--ros-args", "-p", "use_sim_time:=true", "-r", "points_raw:=/points"]
    assert main["command"] == [*words, "--params-file", "/slamhive/files/node.yaml"]
    seen = {item["mountPath"] for item in main["volumeMounts"]}
    assert {"/slamhive/files", "/player", "/dev/shm"} <= seen


def test_the_memory_of_a_node_of_ros_1_is_its_own() -> None:
    users = {named["name"]: places(named, "memory") for named in containers(pod(companion("kiss-icp-ros")))}
    assert users["player"] == []
    assert users["algorithm"] == ["/dev/shm"]


def test_a_request_passes_through_kubernetes_as_it_is() -> None:
    env = {item["name"]: item.get("value") for item in companion("kiss-icp-ros").init_containers[0]["env"]}
    assert "$(" not in str(env[VARIABLE])
    assert json.loads(str(env[VARIABLE]))["topics"] == {"/points": "/points"}
