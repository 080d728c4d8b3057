# SPDX-License-Identifier: Apache-2.0
"""Playing a recording to an algorithm that is a ROS node, and recording the poses that it publishes.

`building` says what is to be played from a run's configuration and its Algorithm, `pod` how the player stands
in a pod beside the algorithm, `ros` and `ros2` whether this machine has ROS. The program `player` does it: it
runs with the Python that ROS is installed for, and needs nothing but the standard library, `protocol`, and
rospy or else rclpy and rosbags.
"""
