# SPDX-License-Identifier: Apache-2.0
"""Adapter of GenZ-ICP for the lidar of a recording.

Where it undoes the motion within a scan, it moves the points to the end, and there its pose belongs, which
is that of the lidar.
"""

import numpy as np
from adapter_recording import Cloud, register_scans
from adapter_support import Run, run_adapter
from genz_icp.config import GenZConfig
from genz_icp.genz_icp import GenZICP


def configure(run: Run) -> GenZConfig:
    """Translate the parameters to GenZ-ICP's own configuration."""
    return GenZConfig(
        data={
            "max_range": run.parameter("maxRange"),
            "min_range": run.parameter("minRange"),
            "deskew": run.parameter("deskew"),
        },
        mapping={
            "voxel_size": run.parameter("voxelSize"),
            "map_cleanup_radius": run.parameter("mapCleanupRadius"),
            "desired_num_voxelized_points": run.parameter("desiredVoxelizedPoints"),
            "planarity_threshold": run.parameter("planarityThreshold"),
            "max_points_per_voxel": run.parameter("maxPointsPerVoxel"),
        },
        registration={
            "max_num_iterations": run.parameter("maxIterations"),
            "convergence_criterion": run.parameter("convergenceCriterion"),
        },
        adaptive_threshold={
            "initial_threshold": run.parameter("initialThreshold"),
            "min_motion_th": run.parameter("minMotionThreshold"),
        },
    )


def program(run: Run) -> None:
    """Register every scan."""
    odometry = GenZICP(configure(run))

    def register(cloud: Cloud) -> np.ndarray:
        odometry.register_frame(cloud.points, cloud.times)
        return odometry.last_pose

    register_scans(run, register, run.parameter("deskew"))


if __name__ == "__main__":
    run_adapter(program)
