# SPDX-License-Identifier: Apache-2.0
"""Configuration and times of points of RKO-LIO, for the adapter that reads recordings and the ROS node."""

import numpy as np
from adapter_recording import Cloud, Item
from adapter_support import NANOSECONDS, Run
from rko_lio.config import LIOConfig


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
