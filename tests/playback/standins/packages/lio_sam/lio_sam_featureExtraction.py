# SPDX-License-Identifier: Apache-2.0
"""Stand-in of lio_sam_featureExtraction."""

import rospy
from lio_sam_support import parameters
from std_msgs.msg import Header

parameters("lio_sam_featureExtraction")
publisher = rospy.Publisher("lio_sam/feature/cloud_info", Header, queue_size=100)
rospy.Subscriber("lio_sam/deskew/cloud_info", Header, publisher.publish, queue_size=100)
rospy.spin()
