# SPDX-License-Identifier: Apache-2.0
"""Stand-in of VINS-Mono's pose_graph: it publishes the path of all keyframes with each new one."""

import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import Image
from vins_mono_support import settings

file = settings("pose_graph", "visualization_shift_x", "visualization_shift_y", "skip_cnt", "skip_dis")
path = Path()


def take(message: Odometry) -> None:
    path.poses.append(PoseStamped(header=message.header, pose=message.pose.pose))
    publisher.publish(path)


publisher = rospy.Publisher("~pose_graph_path", Path, queue_size=1000)
rospy.Subscriber(file.text("image_topic"), Image, lambda _: None, queue_size=2000)
rospy.Subscriber("/vins_estimator/keyframe_pose", Odometry, take, queue_size=2000)
rospy.spin()
