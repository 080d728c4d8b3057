# SPDX-License-Identifier: Apache-2.0
"""The program that plays: `python3 -P -m slamhive.playback.player`, beside the algorithm, never in its tree.

It starts a ROS master, waits until the algorithm's node takes its sensors' topics, plays the bag by the
clock, records poses, and asks the node to end. rospy is imported by `node` alone, when there is a master.
"""
