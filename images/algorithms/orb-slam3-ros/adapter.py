# SPDX-License-Identifier: Apache-2.0
"""Adapter of ORB-SLAM3 as a ROS 1 node: images from topics, poses of the camera to /orb_slam3/odometry.

Poses are published as they are tracked. When the node is told to end, it writes its final trajectory, after
loop closure, as output/trajectory.txt: the player keeps the published one as trajectory.online.txt.
"""

from __future__ import annotations

import os

import numpy as np
from adapter_recording import decode_image
from adapter_ros import Frames, Poses, begin, write_numbers
from adapter_support import NANOSECONDS, AdapterError, Run, Stopwatch, Trajectory, run_adapter
from cameras import Pinhole
from lockstep import ROLES, Rig, check_image, settings, start, wait_until_quiet
from sensor_msgs.msg import Image


def program(run: Run) -> None:
    """Track frames until the node is told to end."""
    roles = ROLES.get(run.mode)
    if roles is None:
        raise AdapterError(f"the mode {run.mode} isn't known; this adapter has {', '.join(ROLES)}")
    cameras = {role: Pinhole.of(run.sensor(role)) for role in roles}
    rig = Rig.of(run, cameras)
    system = start(run, settings(run, rig))
    process = getattr(system, rig.method)
    T_camera_frame = np.linalg.inv(rig.T_frame_camera)
    begin("orb_slam3")
    poses = Poses("/orb_slam3/odometry", roles[0])
    frames, watch = Frames(run, dict.fromkeys(roles, decode_image)), Stopwatch()
    frames.subscribe(Image)
    stamps: dict[float, int] = {}
    for items in frames:
        for item in items:
            check_image(item, cameras[item.role])
        # ORB-SLAM3 keeps times as float64 seconds, which are exact enough from the beginning on.
        origin = next(iter(stamps.values()), items[0].stamp)
        seconds = (items[0].stamp - origin) / NANOSECONDS
        stamps[seconds] = items[0].stamp
        with watch.frame():
            tracked = process(*rig.prepare(*(item.data for item in items)), seconds)
        T_camera_world = system.get_frame_pose() if tracked else None
        if T_camera_world is not None and np.isfinite(T_camera_world).all():
            poses.publish(items[0].stamp, np.linalg.inv(T_camera_world) @ T_camera_frame)
    wait_until_quiet(limit_seconds=10.0)
    trajectory = Trajectory()
    offset = run.sensor(roles[0]).offset
    for seconds, T_camera_world in system.get_trajectory_points():
        trajectory.add(stamps[seconds] + offset, np.linalg.inv(T_camera_world) @ T_camera_frame)
    lost = len(stamps) - len(trajectory.stamps)
    write_numbers(run, frames, watch, framesLost=lost, keyframes=len(system.get_keyframe_points()))
    trajectory.write(run.output / "trajectory.txt")
    system.shutdown()


if __name__ == "__main__":
    run_adapter(program)
    # The libraries it links to may fall over each other in their destructors.
    os._exit(0)
