# SPDX-License-Identifier: Apache-2.0
"""Adapter of RKO-LIO for the lidar and the IMU of a recording.

It estimates the pose of a base frame that its caller chooses by the extrinsics: here the body. The pose
belongs to the end of the scan.
"""

import sys

from adapter_recording import Recording, decode_cloud, decode_imu, inertial_order, pose_stamp
from adapter_rko_lio import configure, point_stamps
from adapter_support import Run, Stopwatch, Trajectory, run_adapter, write_results
from rko_lio.lio import LIO
from rko_lio.rko_lio_pybind import InputError, RegistrationError


def program(run: Run) -> None:
    """Feed inertial samples and scans in the order of their times."""
    lio = LIO(configure(run))
    lidar, imu = run.sensor("lidar"), run.sensor("imu")
    recording = Recording(run, {"lidar": decode_cloud, "imu": decode_imu})
    trajectory, watch, dropped = Trajectory(), Stopwatch(), 0
    for item in inertial_order(recording.items(), lidar):
        if item.role == "imu":
            sample = item.data
            lio.add_imu_measurement(sample.accelerometer, sample.gyroscope, item.stamp, imu.T_body_sensor)
            continue
        if not len(item.data.points):
            dropped += 1
            continue
        stamp = pose_stamp(item, lidar, run.parameter("deskew"))
        points, stamps = item.data.points, point_stamps(item, item.data, stamp)
        try:
            with watch.frame():
                lio.register_scan(points, stamps, lidar.T_body_sensor)
        except (InputError, RegistrationError) as error:
            dropped += 1
            print(f"scan {item.stamp} left out: {error}", file=sys.stderr)
            continue
        trajectory.add(stamp, lio.pose())
    write_results(run, trajectory, watch, recording.cpu_seconds, recording.dropped["lidar"] + dropped)


if __name__ == "__main__":
    run_adapter(program)
