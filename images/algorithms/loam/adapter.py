# SPDX-License-Identifier: Apache-2.0
"""Adapter of LOAM, as evalio has it, for the lidar of a recording.

This port has the odometry of LOAM without its mapping, and leaves the motion within a scan as it is: its pose
belongs best to the middle of the scan.
"""

from adapter_support import Run, run_adapter
from evalio.pipelines import LOAM
from evalio_support import Layout, configure, run_pipeline

PARAMETERS = {
    "localMapScans": "num_local_map_scans",
    "neighborPoints": "neighbor_points",
    "sectors": "number_sectors",
    "maxEdgesPerSector": "max_edge_feats_per_sector",
    "maxPlanesPerSector": "max_planar_feats_per_sector",
    "planeThreshold": "planar_feat_threshold",
    "edgeThreshold": "edge_feat_threshold",
    "occlusionThreshold": "occlusion_thresh",
    "parallelThreshold": "parallel_thresh",
    "maxIterations": "max_icf_iterations",
    "maxEdgeNeighborDistance": "max_edge_neighbor_dist",
    "maxPlaneNeighborDistance": "max_plane_neighbor_dist",
}


def program(run: Run) -> None:
    """Register every scan."""
    pipeline = LOAM()
    layout = Layout.of(run.sensor("lidar"), grid=True)
    parameters = {theirs: run.parameter(ours) for ours, theirs in PARAMETERS.items()}
    limits = run.parameter("minRange"), run.parameter("maxRange")
    configure(run, pipeline, parameters, layout, limits)
    run_pipeline(run, pipeline, layout, "middle")


if __name__ == "__main__":
    run_adapter(program)
