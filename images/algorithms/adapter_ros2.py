# SPDX-License-Identifier: Apache-2.0
"""Subscriptions, poses and the end by SIGINT of adapters that are ROS 2 nodes.

Imported by ``kiss-icp-ros2`` and ``rko-lio-ros2``. ``adapter_ros`` is its sibling.
"""

from __future__ import annotations

import signal
import sys
import threading
from functools import partial
from typing import TYPE_CHECKING, Any, Self

import rclpy
from adapter_support import NANOSECONDS, quaternions
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from adapter_frames import InertialScans, JoinedFrames
    from rclpy.publisher import Publisher

QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Deep enough for inertial samples that come while Python is busy: a short history loses some unnoticed."""


class RosNode:
    """A node that listens on a thread of its own, from `with` to its end.

    Args:
        name: The node's name. The words behind --ros-args may rename it, and whatever else they say holds.
    """

    def __init__(self, name: str) -> None:
        self._told = threading.Event()
        # ROS's own handlers leave a traceback, and none is there where SIGINT was ignored at the start.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: self._told.set())
        rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node(name)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="listener", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            self._told.set()

    def is_ended(self) -> bool:
        """Tell whether the node was told to end."""
        return self._told.is_set()

    def listen(self, frames: JoinedFrames | InertialScans, kinds: Mapping[str, type]) -> None:
        """Subscribe to the sensors of frames.

        Args:
            frames: Take the messages in.
            kinds: Type of the messages of each role.
        """

        def hear(role: str, message: Any) -> None:
            stamp = message.header.stamp
            frames.take(role, stamp.sec * NANOSECONDS + stamp.nanosec, message)

        for role, sensor in frames.sensors.items():
            self._node.create_subscription(kinds[role], sensor.topic, partial(hear, role), QOS)

    def publisher(self, topic: str) -> Publisher:
        """Return a publisher of nav_msgs/Odometry."""
        return self._node.create_publisher(Odometry, topic, QOS)


class Poses:
    """Publishes poses as nav_msgs/Odometry.

    Args:
        node: The node.
        topic: The topic.
        frame: Name of the frame whose pose it is.
    """

    def __init__(self, node: RosNode, topic: str, frame: str) -> None:
        self._publisher = node.publisher(topic)
        self._frame = frame

    def publish(self, stamp: int, pose: np.ndarray) -> None:
        """Publish a pose `(4, 4)` with its stamp in ns."""
        message = Odometry()
        message.header.frame_id = "map"
        message.child_frame_id = self._frame
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        place.x, place.y, place.z = map(float, pose[:3, 3])
        turn.x, turn.y, turn.z, turn.w = map(float, quaternions(pose[None, :3, :3])[0])
        self._publisher.publish(message)
