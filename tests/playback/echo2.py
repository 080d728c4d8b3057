# SPDX-License-Identifier: Apache-2.0
"""A ROS 2 node that answers each scan by a pose, and writes down what it was started with."""

import os
import sys
from contextlib import suppress
from pathlib import Path

import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import PointCloud2

output = Path(os.environ["SLAMHIVE_RUN"], "output")
(output / "environment.txt").write_text(
    "".join(f"{name}={os.environ[name]}\n" for name in sorted(os.environ))
)
(output / "started.txt").write_text("\n".join([sys.executable, rclpy.__file__, *sys.argv]))


def take(scan: PointCloud2) -> None:
    message = Odometry(header=scan.header)
    stamp = scan.header.stamp
    message.pose.pose.position.x = stamp.sec - 1_600_000_000 + stamp.nanosec / 1e9
    message.pose.pose.orientation.w = 1.0
    publisher.publish(message)


rclpy.init()
node = rclpy.create_node("echo")
node.declare_parameter("voxel", 1.0)
(output / "voxel.txt").write_text(str(node.get_parameter("voxel").value))
publisher = node.create_publisher(Odometry, "/poses", 100)
node.create_subscription(PointCloud2, "cloud", take, 100)
with suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(node)
