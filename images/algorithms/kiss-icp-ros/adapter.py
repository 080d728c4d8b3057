# SPDX-License-Identifier: Apache-2.0
"""Adapter of KISS-ICP as a ROS 1 node: scans from the lidar's topic, poses to /kiss_icp/odometry."""

import numpy as np
from adapter_frames import write_numbers
from adapter_kiss_icp import configure
from adapter_recording import decode_cloud, pose_stamp
from adapter_ros import Frames, Poses, begin
from adapter_support import Run, Stopwatch, run_adapter
from kiss_icp.kiss_icp import KissICP
from sensor_msgs.msg import PointCloud2


def program(run: Run) -> None:
    """Register scans until the node is told to end."""
    lidar, deskew = run.sensor("lidar"), run.parameter("deskew")
    odometry = KissICP(configure(run))
    begin("kiss_icp")
    poses = Poses("/kiss_icp/odometry", "lidar")
    frames, watch = Frames(run, {"lidar": decode_cloud}), Stopwatch()
    frames.subscribe(PointCloud2)
    for (scan,) in frames:
        if not len(scan.data.points):
            continue
        with watch.frame():
            times = np.array([]) if scan.data.times is None else scan.data.times
            odometry.register_frame(scan.data.points, times)
        poses.publish(pose_stamp(scan, lidar, deskew), odometry.last_pose)
    write_numbers(run, frames, watch)


if __name__ == "__main__":
    run_adapter(program)
