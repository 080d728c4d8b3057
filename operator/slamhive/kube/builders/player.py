# SPDX-License-Identifier: Apache-2.0
"""The player in a run's pod, for algorithms that are ROS nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.kube.builders.common import (
    container,
    equal_resources,
    from_field,
    mount,
    scratch,
    segment,
    variables,
)
from slamhive.kube.builders.run import ALGORITHM, MEMORY, NO_COMPANION, SHARED_MEMORY, Companion
from slamhive.model.errors import InputError
from slamhive.playback.pod import COMMAND, FOLDER, NAME, PLAYER_IMAGES, player_pod
from slamhive.playback.protocol import LEAST_SHARED_MEMORY

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.kube.settings import Settings
    from slamhive.model.algorithm import Algorithm
    from slamhive.model.configuration import RunConfiguration

_RESOURCES = equal_resources("500m", "1Gi", logs="1Gi")
_SCRATCH = "256Mi"


def player(
    *,
    run: Mapping[str, Any],
    algorithm: Algorithm,
    configuration: RunConfiguration,
    description: Mapping[str, Any],
    settings: Settings,
) -> Companion:
    """Return the additions of a player to a run's pod: none where the algorithm needs none.

    Args:
        run: the MappingRun as the API server returned it.
        algorithm: its Algorithm.
        configuration: what the algorithm is told.
        description: what the preparation said of its variant.
        settings: the operator's.

    Raises:
        InputError: the algorithm needs a player and the operator has no image of it.
    """
    pod = player_pod(algorithm.spec, configuration, ALGORITHM)
    if pod is None:
        return NO_COMPANION
    image = settings.player_images[pod.ros]
    if image is None:
        raise InputError(
            f"algorithm {algorithm.name!r} is a ROS {pod.ros} node, and the operator's setting "
            f"{PLAYER_IMAGES[pod.ros].setting} names no image that plays to it"
        )
    folder = f"runs/{segment(run['metadata']['uid'], 'the uid')}/$(POD_UID)"
    variant = segment(description["folder"], "the variant's folder")
    body = container(
        NAME,
        image,
        settings.image_pull_policy,
        command=COMMAND,
        env=[from_field("POD_UID", "metadata.uid"), *variables(pod.variables)],
        mounts=[
            mount("data", "/slamhive/dataset", read_only=True, subPath=f"variants/{variant}"),
            mount("results", "/slamhive/output", subPathExpr=f"{folder}/output"),
            mount("player", FOLDER),
            mount("player-tmp", "/tmp"),  # noqa: S108
            *([mount(MEMORY, SHARED_MEMORY)] if pod.meets_in_memory else ()),
        ],
        resources=_RESOURCES,
    )
    return Companion(
        init_containers=(body | {"restartPolicy": "Always", "startupProbe": pod.startup},),
        volumes=(scratch("player", _SCRATCH), scratch("player-tmp", _SCRATCH)),
        mounts=(mount("player", FOLDER, read_only=True),) if pod.meets_in_memory else (),
        variables=pod.algorithm_variables,
        arguments=pod.arguments,
        least_memory=LEAST_SHARED_MEMORY if pod.meets_in_memory else 0,
    )
