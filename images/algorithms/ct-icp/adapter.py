# SPDX-License-Identifier: Apache-2.0
"""Adapter of CT-ICP, as evalio has it, for the lidar of a recording.

CT-ICP estimates a pose for the start and one for the end of each scan; evalio answers the one of the start.
"""

from adapter_support import Run, run_adapter
from evalio.pipelines import CTICP
from evalio_support import Layout, configure, run_pipeline

PARAMETERS = {
    "initVoxelSize": "init_voxel_size",
    "initSampleVoxelSize": "init_sample_voxel_size",
    "initFrames": "init_num_frames",
    "voxelSize": "voxel_size",
    "sampleVoxelSize": "sample_voxel_size",
    "mapVoxelSize": "size_voxel_map",
    "maxPointsPerVoxel": "max_num_points_in_voxel",
    "minPointDistance": "min_distance_points",
    "maxIterations": "num_iters_icp",
    "minNeighbors": "min_number_neighbors",
    "maxNeighbors": "max_number_neighbors",
    "maxPlaneDistance": "max_dist_to_plane_ct_icp",
    "locationConsistency": "beta_location_consistency",
    "constantVelocity": "beta_constant_velocity",
    "lossFunction": "loss_function",
    "solver": "solver",
}


def program(run: Run) -> None:
    """Register every scan."""
    pipeline = CTICP()
    layout = Layout.of(run.sensor("lidar"), grid=False)
    parameters = {theirs: run.parameter(ours) for ours, theirs in PARAMETERS.items()}
    parameters |= {"ls_num_threads": run.cores, "ct_init_num_frames": run.parameter("initFrames")}
    configure(run, pipeline, parameters, layout, (0.0, run.parameter("maxRange")))
    run_pipeline(run, pipeline, layout, "start")


if __name__ == "__main__":
    run_adapter(program)
