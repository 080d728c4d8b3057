# SPDX-License-Identifier: Apache-2.0
"""Request to the player, built from a run's configuration and its Algorithm."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from slamhive.model.algorithm import Pace, Poses, PoseStamp
from slamhive.model.base import seconds
from slamhive.model.errors import InputError
from slamhive.model.rosnodes import Ros1, Ros2
from slamhive.model.sensors import ROLE_TYPES, SensorType
from slamhive.playback.protocol import FrameSource, PlayRequest, PoseSource

if TYPE_CHECKING:
    from collections.abc import Iterable

    from slamhive.model.algorithm import AlgorithmSpec, Output
    from slamhive.model.configuration import RunConfiguration, SensorView
    from slamhive.model.rosnodes import RosNode, RosPoses

_POSE_WHEN = {
    PoseStamp.SCAN_START: 0.0,
    PoseStamp.SCAN_MID: 0.5,
    PoseStamp.SCAN_END: 1.0,
}
_USUAL_RATE = 10.0
_ROS2_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
"""Names of topics that `rmw_validate_full_topic_name` takes. Recordings of ROS 1 have others, too."""


def play_request(
    algorithm: AlgorithmSpec,
    configuration: RunConfiguration,
    *,
    run: str,
    folder: str,
    mark: str,
    port: int = 0,
    domain: int | None = None,
    stay: bool = False,
) -> PlayRequest | None:
    """Return the order to the player for a run, None where the algorithm needs none.

    Args:
        algorithm: The run's Algorithm.
        configuration: The run's configuration.
        run: The run folder as the player sees it.
        folder: A folder of the player's own.
        mark: NAME=VALUE that the algorithm's processes, and no others, have in their environment.
        port: Of the ROS master; 0 for any that is free.
        domain: Of ROS 2; None for one that is free.
        stay: Whether the player stays, when all is done, until asked to go.

    Raises:
        InputError: ROS 2 has no topic of a name that the recording has.
    """
    ros = algorithm.plays(configuration.input.pace)
    if ros is None:
        return None
    mode = algorithm.mode(configuration.mode)
    leading = next((role for role in mode.needs if ROLE_TYPES[role].has_frames), mode.needs[0])
    first = configuration.sensors[leading]
    names = _played_names(ros, configuration)
    topics = {view.topic: names[role] for role, view in configuration.sensors.items()}
    if isinstance(ros, Ros2):
        _check_names([*topics.values(), *(mode.topics or ())])
    output = algorithm.output_of(mode)
    return PlayRequest(
        recording=f"{run}/{configuration.dataset.recording.path}",
        ros=2 if isinstance(ros, Ros2) else 1,
        output=f"{run}/output",
        folder=folder,
        algorithm=mark,
        topics=topics,
        remap=_calibrations(configuration, names),
        poses=_source(ros.poses, configuration, first, output),
        frames=FrameSource(
            topic=topics[first.topic],
            period=1.0 / (first.rate or _USUAL_RATE),
            match=_match(first, ros.poses.stamp or output.stamp),
            time_offset=first.time_offset,
            every=output.poses is Poses.FRAMES,
        ),
        keyframes=_source(ros.keyframes, configuration, first, output) if ros.keyframes is not None else None,
        rate=configuration.input.rate,
        stepped=configuration.input.pace == Pace.STEPPED,
        step_seconds=seconds(ros.step),
        **(_of_ros2(ros, names, domain) if isinstance(ros, Ros2) else {}),
        data_seconds=configuration.dataset.duration_seconds,
        port=port,
        ready_seconds=seconds(ros.ready),
        settle_seconds=seconds(ros.settle),
        end_seconds=seconds(ros.end),
        stay=stay,
    )


def node_arguments(algorithm: AlgorithmSpec, configuration: RunConfiguration, files: str) -> list[str]:
    """Return the arguments with which a ROS 2 node is started beside its command's own; none for others.

    Args:
        algorithm: The run's Algorithm.
        configuration: The run's configuration.
        files: Folder of the rendered settings files, as the node sees it.
    """
    ros = algorithm.plays(configuration.input.pace)
    if not isinstance(ros, Ros2) or not ros.renames:
        return []
    words = ["--ros-args", "-p", "use_sim_time:=true"]
    told = {role: ros.topics.get(role, view.topic) for role, view in configuration.sensors.items()}
    renamed = {told[role]: view.topic for role, view in configuration.sensors.items()}
    renamed |= {new: old for old, new in _calibrations(configuration, told).items()}
    for own, played in renamed.items():
        if own != played:
            words += ["-r", f"{own}:={played}"]
    if ros.parameters is not None:
        words += ["--params-file", f"{files}/{ros.parameters}"]
    return words


def _played_names(ros: RosNode, configuration: RunConfiguration) -> dict[str, str]:
    """Return the names under which sensors' topics are played, by role."""
    views = configuration.sensors.items()
    if isinstance(ros, Ros1) or (isinstance(ros, Ros2) and not ros.renames):
        return {role: ros.topics.get(role, view.topic) for role, view in views}
    return {role: view.topic for role, view in views}


def _check_names(names: Iterable[str]) -> None:
    for name in names:
        if not _ROS2_NAME.fullmatch(name):
            raise InputError(
                f"the recording's topic {name!r} can't be played to a ROS 2 node: expected letters, "
                "digits and _ after each /, no digit first; ros2.topics with arguments: None names another"
            )


def _of_ros2(ros: Ros2, names: dict[str, str], domain: int | None) -> dict[str, Any]:
    """Return the fields of a request that ROS 2 alone has."""
    qos = {
        names[role]: {name: str(value) for name, value in offered if value is not None}
        for role, offered in ros.qos.items()
        if role in names
    }
    told = {"qos": qos, "domain": domain, "parameters": ros.parameters}
    return told | ({"rmw": ros.rmw} if ros.rmw else {})


def _calibrations(configuration: RunConfiguration, names: dict[str, str]) -> dict[str, str]:
    """Return the new names of the camera_info beside each camera's topic, by the old ones."""
    renamed = {}
    for role, view in configuration.sensors.items():
        if view.type in {SensorType.CAMERA, SensorType.DEPTH_CAMERA} and names[role] != view.topic:
            renamed[_sibling(view.topic)] = _sibling(names[role])
    return renamed


def _sibling(topic: str) -> str:
    folder, slash, _ = topic.rpartition("/")
    return f"{folder}{slash}camera_info"


def _source(
    poses: RosPoses, configuration: RunConfiguration, first: SensorView, output: Output
) -> PoseSource:
    """Return the source of poses, with the seconds that their messages' stamps are to be moved."""
    moved = 0.0
    if poses.stamp is not None:
        # A scan lasts as long as it did when it was recorded, however many are left out.
        rate = configuration.input.recorded_frame_rate or first.rate or _USUAL_RATE
        moved = (_POSE_WHEN[output.stamp] - _POSE_WHEN[PoseStamp(poses.stamp)]) / rate
    return PoseSource(
        topic=poses.topic,
        type=poses.type,
        parent=poses.parent,
        frame=poses.frame,
        moved=moved,
    )


def _match(sensor: SensorView, stamp: str) -> str:
    """Return the frame that a pose belongs to: poses may be stamped with another instant of a scan."""
    frame = sensor.stamp.share if sensor.type in {SensorType.LIDAR, SensorType.LASER_SCAN} else None
    pose = _POSE_WHEN.get(PoseStamp(stamp))
    if frame is None or pose is None or frame == pose:
        return "At"
    return "After" if pose > frame else "Before"
