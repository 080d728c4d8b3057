# SPDX-License-Identifier: Apache-2.0
"""Runs MAD-ICP, as evalio has it, on the lidar of a recording.

evalio hands it points without their times, so that the motion within a scan stays as it is: its pose belongs
best to the middle of the scan.
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
    run_pipeline(run, pipeline, layout, "middle")


if __name__ == "__main__":
    run_adapter(program)
