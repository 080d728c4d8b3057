# SPDX-License-Identifier: Apache-2.0
"""Adapter of RKO-LIO as a ROS 2 node: scans and inertial samples from topics, poses to /rko_lio/odometry."""

import sys

from adapter_frames import InertialScans, write_numbers
from adapter_recording import decode_cloud, decode_imu, pose_stamp
from adapter_rko_lio import configure, point_stamps
from adapter_ros2 import Poses, RosNode
from adapter_support import Run, Stopwatch, run_adapter
from rko_lio.lio import LIO
from rko_lio.rko_lio_pybind import InputError, RegistrationError
from sensor_msgs.msg import Imu, PointCloud2


def program(run: Run) -> None:
    """Feed inertial samples and scans until the node is told to end."""
    lio, watch, deskew = LIO(configure(run)), Stopwatch(), run.parameter("deskew")
    lidar, imu = run.sensor("lidar"), run.sensor("imu")
    with RosNode("rko_lio") as node:
        poses = Poses(node, "/rko_lio/odometry", "body")
        frames = InertialScans(run, {"lidar": decode_cloud, "imu": decode_imu}, node.is_ended)
        node.listen(frames, {"lidar": PointCloud2, "imu": Imu})
        for item in frames:
            if item.role == "imu":
                sample = item.data
                lio.add_imu_measurement(sample.accelerometer, sample.gyroscope, item.stamp, imu.T_body_sensor)
                continue
            if not len(item.data.points):
                continue
            stamp = pose_stamp(item, lidar, deskew)
            try:
                with watch.frame():
                    lio.register_scan(
                        item.data.points, point_stamps(item, item.data, stamp), lidar.T_body_sensor
                    )
            except (InputError, RegistrationError) as error:
                print(f"scan {item.stamp} left out: {error}", file=sys.stderr)
                continue
            poses.publish(stamp, lio.pose())
    write_numbers(run, frames, watch)


if __name__ == "__main__":
    run_adapter(program)
