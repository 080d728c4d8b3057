# SPDX-License-Identifier: Apache-2.0
"""The player in a run's pod: a sidecar between the monitor and the algorithm.

It is an init container that stays (restartPolicy Always): the kubelet starts the algorithm when the player's
startup probe says that nodes may come, and the pod ends with the algorithm. It shares the pod's processes,
network and the run's output folder with it, so that it ends the algorithm as Ctrl-C would. With a node of
ROS 2 it shares /dev/shm too, through which messages pass, and the user: with two of either, Fast DDS
finds the node and nothing arrives. On a workstation two containers are the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.contract.environment import SETTINGS_FOLDER
from slamhive.playback.building import node_arguments, play_request
from slamhive.playback.protocol import (
    LOOPBACK,
    PROFILE_FILE,
    READY_FILE,
    VARIABLE,
    ros1_variables,
    ros2_variables,
)

if TYPE_CHECKING:
    from slamhive.model.algorithm import AlgorithmSpec
    from slamhive.model.configuration import RunConfiguration
    from slamhive.playback.protocol import PlayRequest

NAME = "player"
COMMAND = ("python3", "-P", "-m", "slamhive.playback.player")
FOLDER = "/player"

_RUN = "/slamhive"
_SCRATCH = "/tmp"  # noqa: S108 - a volume of the pod's own
_PORT = 11311
_DOMAIN = 0
"""Of ROS 2. The network is the pod's own, so no other run is in it."""


@dataclass(frozen=True)
class PlayerImage:
    """Names of the image that plays to nodes of a ROS.

    Attributes:
        name: What images/build calls it.
        variable: Variable that names another on a workstation.
        setting: Setting that names it on a cluster.
    """

    name: str
    variable: str
    setting: str


PLAYER_IMAGES = {
    1: PlayerImage("ros1-player", "SLAMHIVE_PLAYER_IMAGE", "playerImage"),
    2: PlayerImage("ros2-player", "SLAMHIVE_ROS2_PLAYER_IMAGE", "ros2PlayerImage"),
}


@dataclass(frozen=True)
class PlayerPod:
    """Needs of a run's pod for its player: environment, startup probe, and additions to the algorithm.

    Attributes:
        ros: 1 or 2: the ROS that the node is of.
        variables: Environment of the player.
        startup: Its startup probe.
        algorithm_variables: What the algorithm gets to find it.
        arguments: What is added to the algorithm's command.
    """

    ros: int
    variables: dict[str, str]
    startup: dict[str, object]
    algorithm_variables: dict[str, str]
    arguments: tuple[str, ...] = ()

    @property
    def meets_in_memory(self) -> bool:
        """Tell whether both need one /dev/shm, and the algorithm the player's folder at `FOLDER`."""
        return self.ros == 2


def player_pod(algorithm: AlgorithmSpec, configuration: RunConfiguration, container: str) -> PlayerPod | None:
    """Return the needs of a run's pod for its player, None where the algorithm needs none.

    The player needs /slamhive/dataset and /slamhive/output as the algorithm has them, a folder of its own at
    `FOLDER` and one at /tmp.

    Args:
        algorithm: The run's Algorithm.
        configuration: The run's configuration.
        container: What the algorithm's processes have as SLAMHIVE_CONTAINER.
    """
    request = play_request(
        algorithm,
        configuration,
        run=_RUN,
        folder=FOLDER,
        mark=f"SLAMHIVE_CONTAINER={container}",
        port=_PORT,
        domain=_DOMAIN,
        stay=True,
    )
    if request is None:
        return None
    return PlayerPod(
        ros=request.ros,
        variables={
            VARIABLE: request.to_json(),
            "SLAMHIVE_CONTAINER": NAME,
            "HOME": _SCRATCH,
            "TMPDIR": _SCRATCH,
            "LANG": "C.UTF-8",
        },
        startup={
            "exec": {"command": ["test", "-e", f"{FOLDER}/{READY_FILE}"]},
            "periodSeconds": 1,
            "timeoutSeconds": 5,
            "failureThreshold": 120,
        },
        algorithm_variables=_variables_of_node(request),
        arguments=tuple(node_arguments(algorithm, configuration, f"{_RUN}/{SETTINGS_FOLDER}")),
    )


def _variables_of_node(request: PlayRequest) -> dict[str, str]:
    if request.ros == 1:
        return ros1_variables(f"http://{LOOPBACK}:{_PORT}", _SCRATCH)
    return ros2_variables(_DOMAIN, f"{FOLDER}/{PROFILE_FILE}", request.rmw, _SCRATCH)
