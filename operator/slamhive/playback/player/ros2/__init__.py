# SPDX-License-Identifier: Apache-2.0
"""ROS 2 for the player: a domain of its own on the loopback interface, the bag as bytes, poses and a witness.

It takes rclpy, of an installed ROS 2 or of wheels, and rosbags.
"""
