# SPDX-License-Identifier: Apache-2.0
"""Configuration of KISS-ICP, for the adapter that reads recordings and for those that are ROS nodes."""

from adapter_support import Run
from kiss_icp.config import KISSConfig


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
