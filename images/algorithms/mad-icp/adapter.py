# SPDX-License-Identifier: Apache-2.0
"""Adapter of MAD-ICP, as evalio has it, for the lidar of a recording.

Where it undoes the motion within a scan, it tells the time of a point by its azimuth and moves the points to
the end, and there its pose belongs; or else best to the middle.
"""

from adapter_support import Run, run_adapter
from evalio.pipelines import MadICP
from evalio_support import Layout, configure, run_pipeline

PARAMETERS = {
    "deskew": "deskew",
    "maxLeafSize": "b_max",
    "minLeafSize": "b_min",
    "leafRatio": "b_ratio",
    "kernel": "rho_ker",
    "overlapThreshold": "p_th",
    "keyframes": "num_keyframes",
}


def program(run: Run) -> None:
    """Register every scan."""
    pipeline = MadICP()
    layout = Layout.of(run.sensor("lidar"), grid=False)
    parameters = {theirs: run.parameter(ours) for ours, theirs in PARAMETERS.items()}
    # In real time it stops matching when a scan's time is up, which depends on the machine.
    parameters |= {"num_threads": run.cores, "realtime": False}
    limits = run.parameter("minRange"), run.parameter("maxRange")
    configure(run, pipeline, parameters, layout, limits)
    run_pipeline(run, pipeline, layout, "end" if run.parameter("deskew") else "middle")


if __name__ == "__main__":
    run_adapter(program)
