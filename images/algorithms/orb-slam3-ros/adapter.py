# SPDX-License-Identifier: Apache-2.0
"""Adapter of ORB-SLAM3 as a ROS 1 node: images from topics, poses of the camera to /orb_slam3/odometry.

Poses are published as they are tracked. When the node is told to end, it writes its final trajectory, after
loop closure, as output/trajectory.txt: the player keeps the published one as trajectory.online.txt.
"""

from __future__ import annotations

import os

from adapter_frames import write_numbers
from adapter_recording import decode_image
from adapter_ros import Frames, Poses, begin
from adapter_support import AdapterError, Run, run_adapter
from cameras import Pinhole
from lockstep import Rig, Tracker, cameras_of, check_image, is_inertial
from sensor_msgs.msg import Image


def program(run: Run) -> None:
    """Track frames until the node is told to end."""
    if is_inertial(run):
        raise AdapterError(f"the mode {run.mode} isn't known; this node takes images alone")
    roles = cameras_of(run)
    cameras = {role: Pinhole.of(run.sensor(role)) for role in roles}
    tracker = Tracker(run, Rig.of(run, cameras))
    begin("orb_slam3")
    poses = Poses("/orb_slam3/odometry", roles[0])
    frames = Frames(run, dict.fromkeys(roles, decode_image))
    frames.subscribe(Image)
    for images in frames:
        for image in images:
            check_image(image, cameras[image.role])
        pose = tracker.track(images, ())
        if pose is not None:
            poses.publish(images[0].stamp, pose)
    trajectory, keyframes = tracker.finish(limit_seconds=10.0)
    offset = run.sensor(roles[0]).offset
    for estimate in (trajectory, keyframes):
        estimate.stamps = [stamp + offset for stamp in estimate.stamps]
    lost = len(tracker.stamps) - len(trajectory.stamps)
    write_numbers(run, frames, tracker.watch, framesLost=lost, keyframes=len(keyframes.stamps))
    tracker.health.write(run.output / "health.csv")
    keyframes.write(run.output / "trajectory.keyframes.txt")
    trajectory.write(run.output / "trajectory.txt")


if __name__ == "__main__":
    run_adapter(program)
    # The libraries it links to may fall over each other in their destructors.
    os._exit(0)
