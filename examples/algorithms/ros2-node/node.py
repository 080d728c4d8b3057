#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""ROS 2 node: takes scans from `points`, publishes the LiDAR's pose on `odometry`; knows no SLAM Hive."""

import sys
from contextlib import suppress

import numpy as np
import rclpy
from nav_msgs.msg import Odometry as OdometryMessage
from odometry import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.time import Duration, Time
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2

TYPES = {5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}
"""Datatypes of sensor_msgs/PointField as numpy names them."""


def column(message, name):  # noqa: ANN001, ANN201 - a message of ROS, an array
    """Return a field of all points of a cloud, None where it has none of that name."""
    for field in message.fields:
        if field.name == name:
            kind = np.dtype(TYPES[field.datatype])
            shape, strides = (message.height, message.width), (message.row_step, message.point_step)
            return np.ndarray(shape, kind, message.data, field.offset, strides).reshape(-1).astype(float)
    return None


class LidarOdometry(Node):
    """Registers scans as they come; what comes meanwhile is lost but for the newest."""

    def __init__(self) -> None:
        super().__init__("lidar_odometry")
        self.odometry = Odometry(
            self.declare_parameter("voxel_size", 0.5).value,
            self.declare_parameter("max_range", 60.0).value,
            self.declare_parameter("max_iterations", 30).value,
        )
        self.poses = self.create_publisher(OdometryMessage, "odometry", 100)
        # One scan waits at most; the newest replaces it. Reliable, as the default is.
        self.create_subscription(PointCloud2, "points", self.take, QoSProfile(depth=1))

    def take(self, message: PointCloud2) -> None:
        """Take in a scan and publish where it was taken, at its end."""
        points = np.column_stack([column(message, axis) for axis in "xyz"])
        finite = np.isfinite(points).all(axis=1)
        if not finite.any():
            return
        times = column(message, "time")
        times = None if times is None else times[finite]
        pose = self.odometry.register(points[finite], times)
        end = Time.from_msg(message.header.stamp)
        if times is not None:
            end += Duration(nanoseconds=round(times.max() * 1e9))
        self.publish(end, pose)

    def publish(self, stamp: Time, pose: np.ndarray) -> None:
        """Publish a pose."""
        message = OdometryMessage()
        message.header.stamp, message.header.frame_id = stamp.to_msg(), "map"
        message.child_frame_id = "lidar"
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        place.x, place.y, place.z = pose[:3, 3].tolist()
        turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        self.poses.publish(message)


if __name__ == "__main__":
    rclpy.init(args=sys.argv)
    with suppress(KeyboardInterrupt, ExternalShutdownException):  # the usual end, by SIGINT or SIGTERM
        rclpy.spin(LidarOdometry())
