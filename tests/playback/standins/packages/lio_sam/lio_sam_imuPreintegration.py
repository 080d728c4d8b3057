# SPDX-License-Identifier: Apache-2.0
"""Stand-in of lio_sam_imuPreintegration: the last odometry, at the IMU's rate."""

import rospy
from lio_sam_support import parameters
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu

told = parameters("lio_sam_imuPreintegration")
latest = Odometry()


def take(message: Odometry) -> None:
    global latest  # noqa: PLW0603
    latest = message


def hear(sample: Imu) -> None:
    publisher.publish(Odometry(header=sample.header, pose=latest.pose))


publisher = rospy.Publisher(told["odomTopic"], Odometry, queue_size=2000)
rospy.Subscriber("lio_sam/mapping/odometry_incremental", Odometry, take, queue_size=5)
rospy.Subscriber(told["imuTopic"], Imu, hear, queue_size=2000)
rospy.spin()
