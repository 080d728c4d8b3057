# SPDX-License-Identifier: Apache-2.0
"""The same output through a workstation's supervisor, and through a pod's sidecar and the operator."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import chdir
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from thinning import thinned

sys.path.insert(0, str(Path(__file__).parents[1] / "contract"))

from executors import algorithm, table

from slamhive.kube.reports import read_report
from slamhive.local.running.attempt import Attempt
from slamhive.model.algorithm import OutputChange
from slamhive.model.posefiles import told_files
from slamhive.model.results import Frames
from slamhive.monitor import SupervisorSpec

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import Pod
    from slamhive.kube.reports import Report


@pytest.mark.parametrize("name", thinned(table.LEAVING | table.WRITING))
@pytest.mark.parametrize("pod", ["proc"], indirect=True)
def test_what_an_algorithm_left_is_judged_the_same_here_and_there(
    name: str, pod: Pod, tmp_path: Path
) -> None:
    wanted = table.BEHAVIOURS[name]
    attempt = Attempt(tmp_path / "attempt")
    here, there = _judged(attempt, pod, algorithm.ACTS[name], _told(name, tmp_path / "frames.txt"))
    end, found = attempt.end(), attempt.trajectory()
    assert (attempt.metrics(), there.metrics) == (wanted.metrics, wanted.metrics)
    assert attempt.frames() == there.frames == Frames.model_validate(wanted.frames)
    problem = wanted.message if wanted.outcome == "Tracked" else None
    assert here["metricsProblem"] == there.metrics_problem == problem
    problem = wanted.message if wanted.reason else None
    assert end.trajectory_problem == there.trajectory_problem == problem
    assert end.trajectory_missing == there.trajectory_missing == (wanted.reason == "NoTrajectory")
    assert (found and found.replace(path="")) == (there.trajectory and there.trajectory.replace(path=""))
    assert (found is not None) == (problem is None)


def _told(name: str, frames: Path) -> dict[str, Any] | None:
    """Return the description of a behaviour's files for a monitor; write the frames' stamps."""
    output = table.OWN_FILES.get(table.BEHAVIOURS[name].asked.get("sensors", ""))
    if output is None:
        return None
    frames.write_text("".join(f"{(algorithm.START_SECONDS * 10 + k) * 10**8}\n" for k in range(table.FRAMES)))
    change = OutputChange.model_validate(output)
    return told_files(change.trajectory, change.keyframes, str(frames))


SEEN = "until [ -e ../usage.csv ]; do sleep .01; done"
"""A program that goes on until it is watched, however busy the machine is."""


def _judged(
    attempt: Attempt, pod: Pod, leave: Callable[[], object], poses: dict[str, Any] | None
) -> tuple[dict[str, object], Report]:
    """Have the same output judged here and there; return a supervisor's summary and an operator's report."""
    attempt.output.mkdir(parents=True)
    with chdir(attempt.run):
        leave()
    here = _supervised(attempt, poses)
    with chdir(pod.folder):
        leave()
    sidecar = pod.sidecar(poses=poses)
    pod.algorithm("sh", "-c", SEEN)
    pod.finished()
    there = read_report(pod.folder.joinpath("message").read_text())
    pod.end(sidecar)
    assert there is not None
    return here, there


def _supervised(attempt: Attempt, poses: dict[str, Any] | None) -> dict[str, object]:
    """Have an output folder judged by the supervisor of a workstation, and return its summary."""
    folder = str(attempt.folder)
    spec = SupervisorSpec(
        argv=("true",),
        cwd=folder,
        env={"PATH": os.environ["PATH"]},
        log_path=f"{folder}/log.txt",
        usage_path=f"{folder}/usage.csv",
        summary_path=f"{folder}/summary.json",
        process_path=f"{folder}/process.json",
        output_directory=str(attempt.output),
        poses=poses,
        cgroup="none",
    )
    path = attempt.folder / "spec.json"
    path.write_text(spec.to_json())
    subprocess.run([sys.executable, "-m", "slamhive.monitor", "--spec", str(path)], check=True, timeout=120)
    return json.loads(attempt.folder.joinpath("summary.json").read_text())
