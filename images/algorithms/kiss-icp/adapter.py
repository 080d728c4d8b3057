# SPDX-License-Identifier: Apache-2.0
"""Adapter of KISS-ICP for the lidar of a recording.

It moves the points of a scan to its end, and there its pose belongs, which is that of the lidar.
"""

import numpy as np
from adapter_recording import Cloud, register_scans
from adapter_support import Run, run_adapter
from kiss_icp.config import KISSConfig
from kiss_icp.kiss_icp import KissICP


def configure(run: Run) -> KISSConfig:
    """Translate the parameters to KISS-ICP's own configuration."""
    voxel_size = run.parameter("voxelSize")
    return KISSConfig(
        data={
            "max_range": run.parameter("maxRange"),
            "min_range": run.parameter("minRange"),
            "deskew": run.parameter("deskew"),
        },
        mapping={
            # KISS-ICP's own rule, which lives in the loader of its configuration files.
            "voxel_size": run.parameter("maxRange") / 100 if voxel_size is None else voxel_size,
            "max_points_per_voxel": run.parameter("maxPointsPerVoxel"),
        },
        registration={
            "max_num_iterations": run.parameter("maxIterations"),
            "convergence_criterion": run.parameter("convergenceCriterion"),
            "max_num_threads": run.cores,
        },
        adaptive_threshold={
            "fixed_threshold": run.parameter("fixedThreshold"),
            "initial_threshold": run.parameter("initialThreshold"),
            "min_motion_th": run.parameter("minMotionThreshold"),
        },
    )


def program(run: Run) -> None:
    """Register every scan."""
    odometry = KissICP(configure(run))

    def register(cloud: Cloud) -> np.ndarray:
        odometry.register_frame(cloud.points, np.array([]) if cloud.times is None else cloud.times)
        return odometry.last_pose

    # By how much its poses have differed from what it expected: the less, the surer it is.
    register_scans(
        run, register, run.parameter("deskew"), lambda: -odometry.adaptive_threshold.get_threshold()
    )


if __name__ == "__main__":
    run_adapter(program)
