# SPDX-License-Identifier: Apache-2.0
"""The player in a run's pod: a sidecar between the monitor and the algorithm.

It is an init container that stays (restartPolicy Always): the kubelet starts the algorithm when the player's
startup probe says that a ROS master answers, and the pod ends with the algorithm. It shares the pod's
processes, network and the run's output folder with it, so that it ends the algorithm as Ctrl-C would.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.playback.building import play_request
from slamhive.playback.protocol import LOOPBACK, READY_FILE, VARIABLE, ros_variables

if TYPE_CHECKING:
    from slamhive.model.algorithm import AlgorithmSpec
    from slamhive.model.configuration import RunConfiguration

NAME = "player"
COMMAND = ("python3", "-P", "-m", "slamhive.playback.player")
FOLDER = "/player"
_PORT = 11311


@dataclass(frozen=True)
class PlayerPod:
    """Environment variables and startup probe that a run's pod needs for its player.

    Attributes:
        variables: Environment of the player.
        startup: Its startup probe.
        algorithm_variables: What the algorithm gets to find it.
    """

    variables: dict[str, str]
    startup: dict[str, object]
    algorithm_variables: dict[str, str]


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
        run="/slamhive",
        folder=FOLDER,
        mark=f"SLAMHIVE_CONTAINER={container}",
        port=_PORT,
        stay=True,
    )
    if request is None:
        return None
    return PlayerPod(
        variables={
            VARIABLE: request.to_json(),
            "SLAMHIVE_CONTAINER": NAME,
            "HOME": "/tmp",  # noqa: S108 - a volume of the pod's own
            "TMPDIR": "/tmp",  # noqa: S108
            "LANG": "C.UTF-8",
        },
        startup={
            "exec": {"command": ["test", "-e", f"{FOLDER}/{READY_FILE}"]},
            "periodSeconds": 1,
            "timeoutSeconds": 5,
            "failureThreshold": 120,
        },
        algorithm_variables=ros_variables(f"http://{LOOPBACK}:{_PORT}", "/tmp"),  # noqa: S108
    )
