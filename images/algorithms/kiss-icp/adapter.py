# SPDX-License-Identifier: Apache-2.0
"""Adapter of KISS-ICP for the lidar of a recording.

It moves the points of a scan to its end, and there its pose belongs, which is that of the lidar.
"""

import numpy as np
from adapter_kiss_icp import configure
from adapter_recording import Cloud, register_scans
from adapter_support import Run, run_adapter
from kiss_icp.kiss_icp import KissICP


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
