# SPDX-License-Identifier: Apache-2.0
"""Subscriptions, poses and the end by SIGINT of adapters that are ROS 1 nodes.

Imported by ``kiss-icp-ros`` and ``orb-slam3-ros``. ``adapter_ros2`` is its sibling.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import rospy
from adapter_frames import JoinedFrames
from adapter_support import NANOSECONDS, AdapterError, Run, quaternions
from nav_msgs.msg import Odometry

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy as np
    from adapter_recording import Item
    from adapter_support import Sensor

BUFFER_BYTES = 1 << 24
"""Bytes read of a connection at a time; less than a message would make rospy copy it again and again."""


class Frames(JoinedFrames):
    """The messages of one time, from all roles, as they come.

    Args:
        run: The run.
        decoders: Role to a function of a message and its sensor, as `adapter_recording.Recording` takes them.
        queue: Frames that wait at most.
    """

    def __init__(
        self, run: Run, decoders: Mapping[str, Callable[[Any, Sensor], Any]], queue: int = 1
    ) -> None:
        super().__init__(run, decoders, rospy.is_shutdown, queue)

    def subscribe(self, kind: Any) -> None:
        """Begin to listen, to messages of one type; the player takes it as: ready."""
        for role, sensor in self.sensors.items():
            rospy.Subscriber(sensor.topic, kind, self._hear, role, buff_size=BUFFER_BYTES, tcp_nodelay=True)

    def _hear(self, message: Any, role: str) -> None:
        stamp = message.header.stamp
        self.take(role, stamp.secs * NANOSECONDS + stamp.nsecs, message)

    def _decoded(self, role: str, stamp: int, message: Any) -> Item:
        return super()._decoded(role, stamp, _like_rosbags(message))


def _like_rosbags(message: Any) -> Any:
    """Return a message with its stamp named as in ROS 2, which is what the decoders read."""
    fields = {name: getattr(message, name) for name in message.__slots__}
    stamp = SimpleNamespace(sec=message.header.stamp.secs, nanosec=message.header.stamp.nsecs)
    return SimpleNamespace(**fields | {"header": SimpleNamespace(stamp=stamp)})


class Poses:
    """Publishes poses as nav_msgs/Odometry.

    Args:
        topic: The topic.
        frame: Name of the frame whose pose it is.
    """

    def __init__(self, topic: str, frame: str) -> None:
        self._publisher = rospy.Publisher(topic, Odometry, queue_size=100)
        self._frame = frame

    def publish(self, stamp: int, pose: np.ndarray) -> None:
        """Publish a pose `(4, 4)` with its stamp in ns."""
        message = Odometry()
        message.header.frame_id = "map"
        message.child_frame_id = self._frame
        message.header.stamp = rospy.Time(*divmod(stamp, NANOSECONDS))
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        place.x, place.y, place.z = map(float, pose[:3, 3])
        turn.x, turn.y, turn.z, turn.w = map(float, quaternions(pose[None, :3, :3])[0])
        self._publisher.publish(message)


def begin(name: str) -> None:
    """Become a node.

    Raises:
        AdapterError: There is no master.
    """
    if not rospy.core.rosgraph.is_master_online():
        raise AdapterError("no ROS master answers at ROS_MASTER_URI; slamhive starts one with its player")
    rospy.init_node(name)
