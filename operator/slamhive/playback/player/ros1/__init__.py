# SPDX-License-Identifier: Apache-2.0
"""ROS 1 for the player: a master of its own, rosbag, and a node that hears poses."""
