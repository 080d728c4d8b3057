# SPDX-License-Identifier: Apache-2.0
"""Poses out of ROS messages, which are taken as they are: any object with their fields will do."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from slamhive.playback.protocol import PoseSource

NANOSECONDS = 1_000_000_000
POSE_TYPES = ("PoseStamped", "PoseWithCovarianceStamped", "Odometry", "Path", "TFMessage")
"""Names of the types of messages that poses can be taken from."""

_AXES = ("x", "y", "z", "rx", "ry", "rz")
_UPPER = [(row, column) for row in range(6) for column in range(row, 6)]
COVARIANCE_NAMES = (
    ",".join(("stamp", *(f"cov_{_AXES[row]}_{_AXES[column]}" for row, column in _UPPER))) + "\n"
)
"""First line of covariances.csv."""


class Pose(NamedTuple):
    """A pose.

    Attributes:
        stamp: Of its header, ns.
        position: x, y, z in m.
        rotation: Unit quaternion x, y, z, w.
        covariance: Of x, y, z and the rotation about the world's x, y, z, row by row, 36 numbers; none where
            its message has none, or zeros alone.
    """

    stamp: int
    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    covariance: tuple[float, ...] = ()

    @property
    def is_sound(self) -> bool:
        """Tell whether it is a pose at all: finite, with a rotation that can be normalised."""
        norm = math.hypot(*self.rotation)
        return all(map(math.isfinite, self.position)) and math.isfinite(norm) and norm > 1e-6

    def line(self, offset: int = 0) -> str:
        """Return it as a line in the TUM format, its stamp moved by an offset in ns."""
        norm = math.hypot(*self.rotation)
        numbers = (*self.position, *(value / norm for value in self.rotation))
        return f"{seconds_text(self.stamp + offset)} " + " ".join(f"{value:.9f}" for value in numbers) + "\n"

    def row(self, offset: int = 0) -> str:
        """Return its covariance as a line below COVARIANCE_NAMES, its stamp moved by an offset in ns."""
        upper = (self.covariance[6 * row + column] for row, column in _UPPER)
        return f"{seconds_text(self.stamp + offset)}," + ",".join(f"{value:.9g}" for value in upper) + "\n"


def reader(source: PoseSource) -> Callable[[Any], Iterator[Pose]]:
    """Return a function that takes the poses out of a source's messages; of a Path all, the newest last."""
    if source.type == "TF":
        return Chain(source.parent or "", source.frame or "").take
    return {
        "PoseStamped": lambda message: iter([_pose(message.header, message.pose)]),
        "PoseWithCovarianceStamped": lambda message: iter([_uncertain(message)]),
        "Odometry": lambda message: iter([_uncertain(message)]),
        "Path": lambda message: (_pose(item.header, item.pose) for item in message.poses),
    }[source.type]


def _pose(header: Any, pose: Any) -> Pose:
    return _of(header, pose.position, pose.orientation)


def _uncertain(message: Any) -> Pose:
    covariance = tuple(map(float, message.pose.covariance))
    return _pose(message.header, message.pose.pose)._replace(covariance=covariance if any(covariance) else ())


def _of(header: Any, position: Any, rotation: Any) -> Pose:
    return Pose(
        _nanoseconds(header.stamp),
        (position.x, position.y, position.z),
        (rotation.x, rotation.y, rotation.z, rotation.w),
    )


def seconds_text(nanoseconds: int) -> str:
    """Return a time in ns as seconds with all digits."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return f"{seconds}.{rest:09d}"


def _nanoseconds(stamp: Any) -> int:
    """Return a stamp in ns: ROS 1 and ROS 2 name its fields differently."""
    if hasattr(stamp, "secs"):
        return int(stamp.secs) * NANOSECONDS + int(stamp.nsecs)
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


class Chain:
    """The pose of one frame in another by the transforms of /tf and /tf_static, as they stand at the moment.

    A pose comes with each message that moves the chain. Transforms that weren't in the message are taken as
    they were last heard, and the stamp is that of the newest.

    Args:
        parent: The frame of the world.
        frame: The frame whose pose is taken.
    """

    def __init__(self, parent: str, frame: str) -> None:
        self._parent, self._frame = parent.strip("/"), frame.strip("/")
        self._edges: dict[str, tuple[str, Pose]] = {}

    def take(self, message: Any) -> Iterator[Pose]:
        """Take a TFMessage and yield the pose that it gives, if it gives one."""
        moved = set()
        for item in message.transforms:
            child = item.child_frame_id.strip("/")
            transform = item.transform
            edge = _of(item.header, transform.translation, transform.rotation)
            self._edges[child] = (item.header.frame_id.strip("/"), edge)
            moved.add(child)
        steps = self._steps()
        if not steps or moved.isdisjoint(child for child, _ in steps):
            return
        result = steps[0][1]
        for _, edge in list(steps)[1:]:
            result = compose(result, edge)
        yield result

    def _steps(self) -> deque[tuple[str, Pose]]:
        steps: deque[tuple[str, Pose]] = deque()
        at = self._frame
        while at != self._parent:
            if at not in self._edges or len(steps) > len(self._edges):
                return deque()
            above, edge = self._edges[at]
            steps.appendleft((at, edge))
            at = above
        return steps


def compose(first: Pose, second: Pose) -> Pose:
    """Return one pose in the frame of another: the product of both transforms, the newer stamp."""
    x, y, z, w = first.rotation
    a, b, c, d = second.rotation
    rotation = (
        w * a + x * d + y * c - z * b,
        w * b - x * c + y * d + z * a,
        w * c + x * b - y * a + z * d,
        w * d - x * a - y * b - z * c,
    )
    px, py, pz = second.position
    # v + 2 w (q × v) + 2 q × (q × v)
    tx, ty, tz = 2 * (y * pz - z * py), 2 * (z * px - x * pz), 2 * (x * py - y * px)
    moved = (
        px + w * tx + y * tz - z * ty,
        py + w * ty + z * tx - x * tz,
        pz + w * tz + x * ty - y * tx,
    )
    u, v, s = first.position
    position = (u + moved[0], v + moved[1], s + moved[2])
    return Pose(max(first.stamp, second.stamp), position, rotation)
