# SPDX-License-Identifier: Apache-2.0
"""The words with which an engine makes the containers of a ROS node and of its player. Nothing runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.local.home.catalog import AlgorithmEntry
from slamhive.local.programs.containerwords import ImageProgram, PlayerBeside, create_words, player_words
from slamhive.local.programs.engines import Engine
from slamhive.local.programs.images import Image
from slamhive.local.programs.prepared import AttemptOrder
from slamhive.model.algorithm import Algorithm
from slamhive.model.configuration import RunConfiguration
from slamhive.playback.pod import player_pod
from slamhive.playback.protocol import LEAST_SHARED_MEMORY, PROFILE_FILE

if TYPE_CHECKING:
    from pathlib import Path

EYE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
POSES = {"topic": "/odometry", "type": "Odometry"}
ROS1 = {"recording": ["Rosbag1"], "ros1": {"poses": POSES}}
ROS2 = {
    "recording": ["Mcap"],
    "files": [{"path": "node.yaml", "template": "/**: {ros__parameters: {voxel: 0.5}}"}],
    "ros2": {
        "poses": POSES,
        "topics": {"lidar": "points"},
        "arguments": "Ros",
        "parameters": "node.yaml",
    },
}
ENGINES = [
    Engine("podman", ("podman",)),
    Engine("docker", ("docker",)),
    Engine("podman", ("podman",), rootless=True),
]

both = pytest.mark.parametrize("engine", ENGINES, ids=lambda engine: f"{engine.name}-{engine.rootless}")


class Made:
    """Words of a player's container and of its algorithm's.

    Attributes:
        player: Those of the player's.
        node: Those of the algorithm's.
    """

    def __init__(self, engine: Engine, fields: dict[str, Any], memory: str, folder: Path) -> None:
        image, node = Image("sha256:1", ("entry",)), Image("sha256:2", ("entry",))
        program = ImageProgram(engine, node, "home")
        order = ordered(fields, memory, folder)
        pod = player_pod(order.entry.algorithm.spec, order.configuration, "algorithm")
        assert pod is not None
        self.player = player_words(program, image, order, folder / "player", pod)
        beside = PlayerBeside("idofplayer", pod)
        self.node = create_words(program, order, folder, pod.algorithm_variables, beside)


def ordered(fields: dict[str, Any], memory: str, folder: Path) -> AttemptOrder:
    body = {
        "image": "localhost/odometry:1",
        "command": ["odometry", "$(SLAMHIVE_SEED)"],
        "modes": [{"name": "lidar"}],
        "output": {"frame": "lidar"},
        "paces": ["Realtime"],
        "realtime": {"queue": 1, "drop": "Oldest"},
    }
    algorithm = Algorithm.model_validate({"metadata": {"name": "odometry"}, "spec": body | fields})
    sensor = {"name": "lidar", "type": "Lidar", "topic": "/lidar/cloud", "rate": 10, "T_body_sensor": EYE}
    told: dict[str, Any] = {
        "run": "r",
        "algorithm": "odometry",
        "mode": "lidar",
        "dataset": {
            "name": "d",
            "recording": {"format": algorithm.spec.recording[0], "path": "dataset/recording"},
        },
        "sensors": {"lidar": sensor},
        "input": {"pace": "Realtime"},
        "seed": 7,
        "cores": 1,
    }
    return AttemptOrder(
        uid="u",
        content_hash="c",
        configuration=RunConfiguration.model_validate(told),
        entry=AlgorithmEntry(algorithm, folder),
        program=None,  # type: ignore[arg-type]
        dataset=folder,
        frames=100,
        spec={"resources": {"memory": memory}},
        cpus=(0,),
    )


def after(words: list[str], option: str) -> list[str]:
    return [words[at + 1] for at, word in enumerate(words) if word == option]


@both
def test_a_node_of_ros_2_and_its_player_have_one_memory_network_and_user(
    engine: Engine, tmp_path: Path
) -> None:
    """Otherwise Fast DDS finds the node, and nothing arrives."""
    made = Made(engine, ROS2, "2Gi", tmp_path)
    assert after(made.player, "--ipc") == ["shareable"]
    assert after(made.player, "--shm-size") == [str(2**30)]
    for shared in ("--ipc", "--network", "--pid"):
        assert after(made.node, shared) == ["container:idofplayer"]
    assert after(made.node, "--shm-size") == []
    assert after(made.node, "--user") == after(made.player, "--user")


def test_its_memory_has_room_for_what_meets_there_however_little_the_algorithm_has(tmp_path: Path) -> None:
    made = Made(ENGINES[0], ROS2, "64Mi", tmp_path)
    assert after(made.player, "--shm-size") == [str(LEAST_SHARED_MEMORY)]
    assert after(made.node, "--memory") == [str(64 * 2**20)]


@both
def test_it_is_told_where_to_look_and_can_not_change_it(engine: Engine, tmp_path: Path) -> None:
    made = Made(engine, ROS2, "2Gi", tmp_path)
    own = tmp_path / "player" / "own"
    assert f"type=bind,source={own},target=/player,readonly" in after(made.node, "--mount")
    assert f"type=bind,source={own},target=/player" in after(made.player, "--mount")
    told = dict(word.split("=", 1) for word in after(made.node, "--env"))
    assert told["FASTDDS_DEFAULT_PROFILES_FILE"] == f"/player/{PROFILE_FILE}"
    assert told["ROS_DOMAIN_ID"] == "0"
    words = ["7", "--ros-args", "-p", "use_sim_time:=true", "-r", "points:=/lidar/cloud"]
    assert after(made.node, "--entrypoint") == ["odometry"]
    end = made.node.index("sha256:2")
    assert made.node[end + 1 :] == [*words, "--params-file", "/slamhive/files/node.yaml"]


@both
def test_a_node_of_ros_1_shares_no_memory_with_its_player(engine: Engine, tmp_path: Path) -> None:
    made = Made(engine, ROS1, "2Gi", tmp_path)
    assert after(made.node, "--ipc") == after(made.player, "--ipc") == ["private"]
    assert after(made.node, "--shm-size") == [str(2**30)]
    assert not [word for word in after(made.node, "--mount") if "target=/player" in word]
    assert made.node[made.node.index("sha256:2") + 1 :] == ["7"]
