# SPDX-License-Identifier: Apache-2.0
"""Stand-in of VINS-Mono's feature_tracker: it publishes the stamps of the images that are used."""

import rospy
from sensor_msgs.msg import Image, PointCloud
from vins_mono_support import settings

file = settings("feature_tracker", "vins_folder")
frequency = file.integer("freq")
last = 0.0


def take(image: Image) -> None:
    global last  # noqa: PLW0603
    stamp = image.header.stamp.to_sec()
    if frequency and stamp - last < 1 / frequency - 1e-3:
        return
    last = stamp
    publisher.publish(PointCloud(header=image.header))


publisher = rospy.Publisher("~feature", PointCloud, queue_size=1000)
rospy.Subscriber(file.text("image_topic"), Image, take, queue_size=100, buff_size=1 << 24)
rospy.spin()
