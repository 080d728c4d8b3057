# SPDX-License-Identifier: Apache-2.0
"""Stand-in of VINS-Mono's vins_estimator: it takes features and IMU, and begins after its first window."""

from pathlib import Path

import numpy as np
import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import PointCloud
from standin import SENSORS, Truth, upright
from vins_mono_support import settings
from vins_support import Frames, append_row, odometry

WINDOW = 10

file = settings("vins_estimator", "vins_folder")
truth = Truth("imu")
output = Path(file.text("output_path"))
count = 0
start = None


def take(stamp: rospy.Time) -> None:
    global count, start  # noqa: PLW0603
    count += 1
    pose = truth.at(stamp.to_sec() + SENSORS["camera"].get("timeOffset", 0.0))
    if start is None:
        start = upright(pose)
    if count <= WINDOW:
        return
    message = odometry(stamp, np.linalg.inv(start) @ pose)
    publisher.publish(message)
    append_row(output / "vins_result_no_loop.csv", message)
    if count % 3 == 0:
        keyframes.publish(message)


publisher = rospy.Publisher("~odometry", Odometry, queue_size=1000)
keyframes = rospy.Publisher("~keyframe_pose", Odometry, queue_size=1000)
frames = Frames(["/feature_tracker/feature"], file.text("imu_topic"), take, PointCloud)
rospy.spin()
