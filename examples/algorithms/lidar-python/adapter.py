# SPDX-License-Identifier: Apache-2.0
"""Adapter: gives the scans of a prepared recording to the odometry and writes its poses."""

from adapter_recording import Cloud, register_scans
from adapter_support import Run, run_adapter
from odometry import Odometry


def program(run: Run) -> None:
    """Register every scan."""
    odometry = Odometry(run.parameter("voxelSize"), run.parameter("maxRange"), run.parameter("maxIterations"))

    def register(cloud: Cloud):  # noqa: ANN202 - a matrix
        return odometry.register(cloud.points, cloud.times)

    register_scans(run, register, deskew=True)


if __name__ == "__main__":
    run_adapter(program)
