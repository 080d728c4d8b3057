# SPDX-License-Identifier: Apache-2.0
"""Adapter of RKO-LIO for the lidar and the IMU of a recording.

It estimates the pose of a base frame that its caller chooses by the extrinsics: here the body. The pose
belongs to the end of the scan.
"""

import sys

import numpy as np
from adapter_recording import Cloud, Item, Recording, decode_cloud, decode_imu, inertial_order, pose_stamp
from adapter_support import NANOSECONDS, Run, Stopwatch, Trajectory, run_adapter, write_results
from rko_lio.config import LIOConfig
from rko_lio.lio import LIO
from rko_lio.rko_lio_pybind import InputError, RegistrationError


def configure(run: Run) -> LIOConfig:
    """Translate the parameters to RKO-LIO's own configuration."""
    return LIOConfig(
        deskew=run.parameter("deskew"),
        max_iterations=run.parameter("maxIterations"),
        voxel_size=run.parameter("voxelSize"),
        max_range=run.parameter("maxRange"),
        min_range=run.parameter("minRange"),
        convergence_criterion=run.parameter("convergenceCriterion"),
        max_correspondence_distance=run.parameter("maxCorrespondenceDistance"),
        max_num_threads=run.cores,
        initialization_phase=run.parameter("initializationPhase"),
        max_expected_jerk=run.parameter("maxExpectedJerk"),
        double_downsample=run.parameter("doubleDownsample"),
        min_beta=run.parameter("minBeta"),
    )


def point_stamps(item: Item, cloud: Cloud, otherwise: int) -> np.ndarray:
    """Sensor time of each point in ns, the same for all if the recording doesn't say."""
    if cloud.times is None:
        return np.full(len(cloud.points), otherwise, np.int64)
    return np.asarray(item.stamp + np.rint(cloud.times * NANOSECONDS).astype(np.int64))


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
