# SPDX-License-Identifier: Apache-2.0
"""Stand-in of lio_sam_mapOptmization: positions of mid-scan, rotations and stamps of the scan's start."""

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from lio_sam_support import parameters
from nav_msgs.msg import Odometry, Path
from standin import SENSORS, Truth, quaternion_of
from std_msgs.msg import Header

told = parameters("lio_sam_mapOptmization")
truth = Truth("lidar")
half = 0.5 / SENSORS["lidar"]["rate"]
path = Path()
start = None
last = 0.0


def take(header: Header) -> None:
    global start, last  # noqa: PLW0603
    stamp = header.stamp.to_sec()
    if stamp - last < told["mappingProcessInterval"]:
        return
    last = stamp
    begin = stamp + SENSORS["lidar"].get("timeOffset", 0.0)
    pose = truth.at(begin)
    pose[:3, 3] = truth.at(begin + half)[:3, 3]
    if start is None:
        start = pose
    pose = np.linalg.inv(start) @ pose
    message = Odometry()
    message.header.stamp, message.header.frame_id = header.stamp, told["odometryFrame"]
    message.child_frame_id = "odom_mapping"
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    place.x, place.y, place.z = pose[:3, 3]
    turn.x, turn.y, turn.z, turn.w = quaternion_of(pose[:3, :3])
    odometry.publish(message)
    incremental.publish(message)
    ends = path.poses[-1].pose.position if path.poses else None
    moved = np.inf if ends is None else np.linalg.norm([place.x - ends.x, place.y - ends.y, place.z - ends.z])
    if moved > told["surroundingkeyframeAddingDistThreshold"]:
        path.header = message.header
        path.poses.append(PoseStamped(header=message.header, pose=message.pose.pose))
    if keyframes.get_num_connections():
        keyframes.publish(path)


odometry = rospy.Publisher("lio_sam/mapping/odometry", Odometry, queue_size=100)
incremental = rospy.Publisher("lio_sam/mapping/odometry_incremental", Odometry, queue_size=100)
keyframes = rospy.Publisher("lio_sam/mapping/path", Path, queue_size=100)
rospy.Subscriber("lio_sam/feature/cloud_info", Header, take, queue_size=100)
rospy.spin()
