# SPDX-License-Identifier: Apache-2.0
"""Request to the player, built from a run's configuration and its Algorithm."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.model.algorithm import Poses, PoseStamp
from slamhive.model.base import seconds
from slamhive.model.sensors import ROLE_TYPES, SensorType
from slamhive.playback.protocol import FrameSource, PlayRequest, PoseSource

if TYPE_CHECKING:
    from slamhive.model.algorithm import AlgorithmSpec, Output
    from slamhive.model.configuration import RunConfiguration, SensorView
    from slamhive.model.ros1 import Ros1, Ros1Poses

_POSE_WHEN = {
    PoseStamp.SCAN_START: 0.0,
    PoseStamp.SCAN_MID: 0.5,
    PoseStamp.SCAN_END: 1.0,
}
_USUAL_RATE = 10.0


def play_request(
    algorithm: AlgorithmSpec,
    configuration: RunConfiguration,
    *,
    run: str,
    folder: str,
    mark: str,
    port: int = 0,
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
        stay: Whether the player stays, when all is done, until asked to go.
    """
    ros = algorithm.plays(configuration.input.pace)
    if ros is None:
        return None
    mode = algorithm.mode(configuration.mode)
    leading = next((role for role in mode.needs if ROLE_TYPES[role].has_frames), mode.needs[0])
    first = configuration.sensors[leading]
    topics = {view.topic: ros.topics.get(role, view.topic) for role, view in configuration.sensors.items()}
    output = algorithm.output_of(mode)
    return PlayRequest(
        recording=f"{run}/{configuration.dataset.recording.path}",
        output=f"{run}/output",
        folder=folder,
        algorithm=mark,
        topics=topics,
        remap=_calibrations(configuration, ros),
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
        data_seconds=configuration.dataset.duration_seconds,
        port=port,
        ready_seconds=seconds(ros.ready),
        settle_seconds=seconds(ros.settle),
        end_seconds=seconds(ros.end),
        stay=stay,
    )


def _calibrations(configuration: RunConfiguration, ros: Ros1) -> dict[str, str]:
    """Return the new names of the camera_info beside each camera's topic, by the old ones."""
    renamed = {}
    for role, view in configuration.sensors.items():
        new = ros.topics.get(role, view.topic)
        if view.type in {SensorType.CAMERA, SensorType.DEPTH_CAMERA} and new != view.topic:
            renamed[_sibling(view.topic)] = _sibling(new)
    return renamed


def _sibling(topic: str) -> str:
    return f"{topic.rpartition('/')[0]}/camera_info"


def _source(
    poses: Ros1Poses, configuration: RunConfiguration, first: SensorView, output: Output
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
