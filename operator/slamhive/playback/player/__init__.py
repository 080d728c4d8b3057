# SPDX-License-Identifier: Apache-2.0
"""The program that plays: `python3 -P -m slamhive.playback.player`, beside the algorithm, never in its tree.

It waits until the algorithm's node takes its sensors' topics, plays the recording by the clock or frame by
frame, records poses, and asks the node to end. `ros1` and `ros2` are what differs between the two; one alone
is imported, as a machine may have one alone.
"""
