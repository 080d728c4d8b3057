# SPDX-License-Identifier: Apache-2.0
"""Poses that a recording carries: topics of poses, points, paths and fixes, and frames of /tf."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from slamhive.data.recordings.reading import TF_TYPES
from slamhive.data.recordings.streams import STATIC_TRANSFORMS
from slamhive.model.errors import DataError, suggestion
from slamhive_eval import EvaluationError, Trajectory
from slamhive_eval.formats.posemessages import (
    PATH,
    READERS,
    Row,
    add_transforms,
    pose_row,
    read_poses,
    seconds,
)
from slamhive_eval.formats.transforms import Frames

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    import numpy.typing as npt

    from slamhive.data.recordings.reading import Recording

POSE_TYPES = tuple(READERS)
"""Messages that carry stamped poses, or positions alone."""
TRUTH_NAME = re.compile(r"ground_?truth|(^|/)gt(/|_|$)|vicon|mocap|optitrack|vrpn", re.IGNORECASE)
"""Names by which topics and files are known for ground truth."""


def truth_topic(topic: str | None) -> str | None:
    """Return the topic's name without the frames of a transform: ``/tf:map.base`` is on ``/tf``."""
    return None if topic is None else topic.split(":", 1)[0]


def poses_of_topic(recording: Recording, topic: str) -> Trajectory:
    """Read the poses of a topic.

    Args:
        recording: The recording.
        topic: A topic with messages of POSE_TYPES, or ``TOPIC:PARENT.CHILD`` for the pose of the frame CHILD
            in the frame PARENT by the transforms of a topic; one transform between them may move.

    Returns:
        Poses by their header stamps, s; positions alone of points and fixes.

    Raises:
        DataError: There is no such topic or frame, it carries no poses, or they are no trajectory.
    """
    kind = check_pose_topic(recording, topic)
    name = truth_topic(topic) or topic
    try:
        if kind in TF_TYPES:
            return _transforms(recording, topic)
        if kind == PATH:
            return read_poses(_paths(recording, name), kind)
        return read_poses((recording.decode(raw, kind) for _, _, raw in recording.messages({name})), kind)
    except EvaluationError as error:
        raise DataError(f"{_where(recording, topic)}: {error}") from None


def _paths(recording: Recording, name: str) -> Iterator[Any]:
    """Yield the paths of a topic that count: of one that grows the last, as all are its square in poses."""
    first, last = None, b""
    for _, _, raw in recording.messages({name}):
        first = first if first is not None and first.poses else recording.decode(raw, PATH)
        last = raw
    if first is None:
        return
    whole = recording.decode(last, PATH)
    if whole.poses and seconds(whole.poses[0].header.stamp) <= seconds(first.poses[0].header.stamp):
        yield whole
    else:
        yield from (recording.decode(raw, PATH) for _, _, raw in recording.messages({name}))


def _where(recording: Recording, topic: str) -> str:
    return f"groundTruth.topic: {truth_topic(topic)} in {recording.label}"


def check_pose_topic(recording: Recording, topic: str) -> str:
    """Check that a topic is there and carries poses; return the type of its messages.

    Raises:
        DataError: It isn't, or doesn't.
    """
    name = truth_topic(topic) or topic
    found = recording.topics.get(name)
    if found is None:
        known = [item.name for item in recording.topics.values() if item.message_type in POSE_TYPES]
        raise DataError(
            f"groundTruth.topic: no topic {name!r} in "
            f"{recording.label}{suggestion(name, known or recording.topics)}"
        )
    kind = found.message_type
    if kind not in (*TF_TYPES, *POSE_TYPES):
        allowed = f"allowed: {', '.join(POSE_TYPES)}, {TF_TYPES[0]}"
        raise DataError(f"{_where(recording, topic)}: messages of type {kind} carry no pose; {allowed}")
    return kind


def static_tree(recording: Recording) -> Frames:
    """Return the transforms that /tf_static states; none where the recording has no such topic."""
    found = recording.topics.get(STATIC_TRANSFORMS)
    if found is None or found.message_type not in TF_TYPES:
        return Frames()
    return _frames(recording, STATIC_TRANSFORMS)


def static_poses(recording: Recording) -> dict[tuple[str, str], list[Row]]:
    """Return all poses that /tf_static states, by parent and child: x, y, z in m, quaternion x to w."""
    found = recording.topics.get(STATIC_TRANSFORMS)
    poses: dict[tuple[str, str], dict[Row, None]] = {}
    if found is not None and found.message_type in TF_TYPES:
        for connection, _, raw in recording.messages({STATIC_TRANSFORMS}):
            for item in recording.decode(raw, connection.msgtype).transforms:
                edge = (item.header.frame_id.lstrip("/"), item.child_frame_id.lstrip("/"))
                row = pose_row(item.transform.translation, item.transform.rotation)
                poses.setdefault(edge, {})[row] = None
    return {edge: list(rows) for edge, rows in poses.items()}


def relative_pose(frames: Frames, parent: str, child: str) -> npt.NDArray[np.float64] | None:
    """Return the pose (4, 4) of one frame in another by static transforms, None when none lead there."""
    return frames.fixed_pose(parent, child)


def _transforms(recording: Recording, topic: str) -> Trajectory:
    name, _, pair = topic.partition(":")
    frames = _frames(recording, name)
    parent, child = frames.split(pair)
    moving = frames.moving(frames.steps(parent, child))
    if len(moving) > 1:
        listed = ", ".join(f"{a} to {b}" for a, b in moving)
        raise EvaluationError(
            f"{len(moving)} of the transforms from {parent!r} to {child!r} move ({listed}); only one may, as "
            "ground truth isn't interpolated"
        )
    return frames.trajectory(parent, child)


def _frames(recording: Recording, topic: str) -> Frames:
    frames = Frames()
    topics = {name for name in (topic, STATIC_TRANSFORMS) if name in recording.topics}
    for connection, _, raw in recording.messages(topics):
        add_transforms(frames, recording.decode(raw, connection.msgtype), connection.topic)
    return frames
