#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""ROS 1 node: takes scans from `points`, publishes the LiDAR's pose on `odometry`; knows no SLAM Hive."""

import numpy as np
import rospy
from nav_msgs.msg import Odometry as OdometryMessage
from odometry import Odometry
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


class Node:
    """Registers scans as they come; what comes meanwhile is lost but for the newest."""

    def __init__(self) -> None:
        self.odometry = Odometry(
            rospy.get_param("~voxel_size"), rospy.get_param("~max_range"), rospy.get_param("~max_iterations")
        )
        self.poses = rospy.Publisher("odometry", OdometryMessage, queue_size=100)
        rospy.Subscriber("points", PointCloud2, self.take, queue_size=1, buff_size=1 << 24, tcp_nodelay=True)

    def take(self, message: PointCloud2) -> None:
        """Take in a scan and publish where it was taken, at its end."""
        points = np.column_stack([column(message, axis) for axis in "xyz"])
        finite = np.isfinite(points).all(axis=1)
        if not finite.any():
            return
        times = column(message, "time")
        times = None if times is None else times[finite]
        pose = self.odometry.register(points[finite], times)
        end = message.header.stamp
        if times is not None:
            end += rospy.Duration.from_sec(times.max())
        self.publish(end, pose)

    def publish(self, stamp: rospy.Time, pose: np.ndarray) -> None:
        """Publish a pose."""
        message = OdometryMessage()
        message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, "map", "lidar"
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        place.x, place.y, place.z = pose[:3, 3]
        turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        self.poses.publish(message)


if __name__ == "__main__":
    rospy.init_node("lidar_odometry")
    Node()
    rospy.spin()
