# SPDX-License-Identifier: Apache-2.0
"""Poses that a recording carries: pose, odometry and transform topics, and frames of /tf."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.recordings import TF_TYPES
from slamhive.data.streams import STATIC_TRANSFORMS
from slamhive.model.errors import DataError, suggestion
from slamhive_eval import EvaluationError, Trajectory
from slamhive_eval.rotation import from_matrix, to_matrix

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive.data.recordings import Recording

    Poses = npt.NDArray[np.float64]

Edges = dict[tuple[str, str], list[tuple[float, tuple[float, ...]]]]
"""Transforms by parent and child: stamp in s and x, y, z, qx, qy, qz, qw of each message."""

POSE_TYPES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
)
"""Messages that carry one stamped pose."""


def truth_topic(topic: str | None) -> str | None:
    """Return the topic's name without the frames of a transform: ``/tf:map.base`` is on ``/tf``."""
    return None if topic is None else topic.split(":", 1)[0]


def poses_of_topic(recording: Recording, topic: str) -> Trajectory:
    """Read the poses of a topic.

    Args:
        recording: The recording.
        topic: A topic with stamped poses, or ``TOPIC:PARENT.CHILD`` for the pose of the frame CHILD in the
            frame PARENT by the transforms of a topic; one transform between them may move.

    Returns:
        Poses by their header stamps, s.

    Raises:
        DataError: There is no such topic or frame, it carries no poses, or they are no trajectory.
    """
    name = truth_topic(topic) or topic
    found = recording.topics.get(name)
    where = f"groundTruth.topic: {name} in {recording.label}"
    if found is None:
        known = [item.name for item in recording.topics.values() if item.message_type in POSE_TYPES]
        raise DataError(
            f"groundTruth.topic: no topic {name!r} in "
            f"{recording.label}{suggestion(name, known or recording.topics)}"
        )
    if found.message_type in TF_TYPES:
        stamps, poses = _transforms(recording, topic, where)
    elif found.message_type in POSE_TYPES:
        stamps, poses = _stamped(recording, name, found.message_type)
    else:
        raise DataError(f"{where}: messages of type {found.message_type} carry no pose; {_allowed()}")
    try:
        return Trajectory(stamps, poses[:, :3], poses[:, 3:])
    except EvaluationError as error:
        raise DataError(f"{where}: {error}") from None


def _allowed() -> str:
    return f"allowed: {', '.join(POSE_TYPES)}, {TF_TYPES[0]}"


def _stamped(recording: Recording, topic: str, kind: str) -> tuple[Poses, Poses]:
    stamps, poses = [], []
    for _, _, raw in recording.messages({topic}):
        message = recording.decode(raw, kind)
        stamps.append(_seconds(message.header.stamp))
        if kind.endswith("TransformStamped"):
            poses.append(_row(message.transform.translation, message.transform.rotation))
        else:
            inner = message.pose if kind.endswith("PoseStamped") else message.pose.pose
            poses.append(_row(inner.position, inner.orientation))
    return np.array(stamps, dtype=np.float64), np.array(poses, dtype=np.float64).reshape(-1, 7)


def _seconds(stamp: Any) -> float:
    # Integer by integer: the float64 nearest to the stamp, as reading its decimal digits gives it.
    return (int(stamp.sec) * 10**9 + int(stamp.nanosec)) / 10**9


def _row(p: Any, q: Any) -> tuple[float, ...]:
    return p.x, p.y, p.z, q.x, q.y, q.z, q.w


def static_tree(recording: Recording) -> Edges:
    """Return the transforms that /tf_static states, by parent and child; empty when there are none."""
    found = recording.topics.get(STATIC_TRANSFORMS)
    if found is None or found.message_type not in TF_TYPES:
        return {}
    return _edges(recording, STATIC_TRANSFORMS)


def relative_pose(edges: Edges, parent: str, child: str) -> Poses | None:
    """Return the pose (4, 4) of one frame in another by static transforms, None when none lead there."""
    if parent == child:
        return np.eye(4)
    steps = _steps(edges, parent, child)
    if not steps:
        return None
    result: Poses = _compose(edges, steps)[0]
    return result


def _transforms(recording: Recording, topic: str, where: str) -> tuple[Poses, Poses]:
    name, _, frames = topic.partition(":")
    edges = _edges(recording, name)
    parent, _, child = frames.partition(".")
    names = {frame for edge in edges for frame in edge}
    for frame in (parent, child):
        if frame not in names:
            raise DataError(
                f"{where}: name two frames as in {name}:map.base_link; {frame!r} is "
                f"none{suggestion(frame, names)}"
            )
    steps = _steps(edges, parent, child)
    if not steps:
        raise DataError(f"{where}: no transforms lead from {parent!r} to {child!r}")
    moving = [key for key, _ in steps if len(edges[key]) > 1]
    if len(moving) > 1:
        listed = ", ".join(f"{a} to {b}" for a, b in moving)
        raise DataError(
            f"{where}: {len(moving)} of the transforms from {parent!r} to {child!r} move ({listed}); only "
            f"one may, as "
            "their stamps differ"
        )
    stamps = np.array([at for at, _ in edges[(moving or [steps[0][0]])[0]]])
    result = _compose(edges, steps)
    return stamps, np.hstack([result[:, :3, 3], from_matrix(result[:, :3, :3])])


def _steps(edges: Edges, parent: str, child: str) -> list[tuple[tuple[str, str], bool]]:
    """Return the transforms from a frame to another, each with whether it is gone through backwards."""
    chain = [(key, False) for key in _up(edges, child)]
    # Up from the child to the root and down again to the parent; what both share cancels.
    back = [(key, True) for key in _up(edges, parent)]
    while chain and back and chain[-1][0] == back[-1][0]:
        chain.pop()
        back.pop()
    return [*back, *reversed(chain)] if _root(edges, parent) == _root(edges, child) else []


def _compose(edges: Edges, steps: list[tuple[tuple[str, str], bool]]) -> Poses:
    """Multiply transforms out, (n, 4, 4) where one of them moves, (1, 4, 4) otherwise."""
    result: Poses = np.eye(4)[None]
    for key, inverse in steps:
        matrices = _matrices(np.array([pose for _, pose in edges[key]]))
        result = result @ (np.linalg.inv(matrices) if inverse else matrices)
    return result


def _edges(recording: Recording, topic: str) -> Edges:
    edges: Edges = {}
    topics = {name for name in (topic, STATIC_TRANSFORMS) if name in recording.topics}
    for connection, _, raw in recording.messages(topics):
        for item in recording.decode(raw, connection.msgtype).transforms:
            key = (item.header.frame_id.lstrip("/"), item.child_frame_id.lstrip("/"))
            pose = _row(item.transform.translation, item.transform.rotation)
            if connection.topic == STATIC_TRANSFORMS:
                edges[key] = [(_seconds(item.header.stamp), pose)]
            else:
                edges.setdefault(key, []).append((_seconds(item.header.stamp), pose))
    return edges


def _up(edges: Edges, frame: str) -> list[tuple[str, str]]:
    """Return the transforms from a frame up to its root."""
    parents = {child: parent for parent, child in edges}
    chain: list[tuple[str, str]] = []
    while frame in parents and len(chain) <= len(parents):
        chain.append((parents[frame], frame))
        frame = parents[frame]
    return chain


def _root(edges: Edges, frame: str) -> str:
    chain = _up(edges, frame)
    return chain[-1][0] if chain else frame


def _matrices(poses: Poses) -> Poses:
    result = np.tile(np.eye(4), (len(poses), 1, 1))
    result[:, :3, :3] = to_matrix(poses[:, 3:])
    result[:, :3, 3] = poses[:, :3]
    return result
