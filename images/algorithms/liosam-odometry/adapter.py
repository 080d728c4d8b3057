# SPDX-License-Identifier: Apache-2.0
"""Adapter of LIO-SAM's odometry, as evalio has it, for the lidar and the IMU of a recording.

This port closes no loops and takes neither GPS nor the orientation of a nine-axis IMU.
It works on the scan two before the one that it is given, and undoes the rotation within a scan alone. By a
known truth, its positions belong to the middle of that scan.
"""

from adapter_support import Run, run_adapter
from evalio.pipelines import LioSAM
from evalio_support import Layout, configure, run_pipeline

PARAMETERS = (
    "downsampleRate",
    "edgeThreshold",
    "surfThreshold",
    "edgeFeatureMinValidNum",
    "surfFeatureMinValidNum",
    "odometrySurfLeafSize",
    "mappingCornerLeafSize",
    "mappingSurfLeafSize",
    "mappingProcessInterval",
    "surroundingKeyframeDensity",
    "surroundingKeyframeSearchRadius",
)


def program(run: Run) -> None:
    """Feed inertial samples and scans in the order of their times."""
    pipeline = LioSAM()
    layout = Layout.of(run.sensor("lidar"), grid=True)
    parameters = {name: run.parameter(name) for name in PARAMETERS} | {"numberOfCores": run.cores}
    limits = run.parameter("minRange"), run.parameter("maxRange")
    configure(run, pipeline, parameters, layout, limits)
    run_pipeline(run, pipeline, layout, "middle", delay=2)


if __name__ == "__main__":
    run_adapter(program)
