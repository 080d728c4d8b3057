# SPDX-License-Identifier: Apache-2.0
"""Stand-in of VINS-Fusion's loop_fusion_node: its only argument is the settings file."""

import sys

import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import Image
from standin import CAMERAS, SENSORS, Storage, agree
from vins_support import check_camera

file = Storage(sys.argv[1])
check_camera(file.beside("cam0_calib"), CAMERAS[0])
agree("image0_topic", file.text("image0_topic"), SENSORS[CAMERAS[0]]["topic"])
for key in ("load_previous_pose_graph", "save_image", "image_width", "image_height"):
    file.integer(key)
for key in ("pose_graph_save_path", "output_path"):
    file.text(key)


def take(message: Odometry) -> None:
    path.poses.append(PoseStamped(header=message.header, pose=message.pose.pose))
    publisher.publish(path)


rospy.init_node("loop_fusion")
path = Path()
publisher = rospy.Publisher("~pose_graph_path", Path, queue_size=1000)
rospy.Subscriber(file.text("image0_topic"), Image, lambda _: None, queue_size=2000)
rospy.Subscriber("/vins_estimator/keyframe_pose", Odometry, take, queue_size=2000)
rospy.spin()
