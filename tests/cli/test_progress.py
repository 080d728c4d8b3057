# SPDX-License-Identifier: Apache-2.0
"""Progress of `slamhive run` off a terminal: what is said of the time left, and of what runs wait for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from slamhive.cli.parts.progress import Display, run_line, run_values
from slamhive.engine import PointState
from slamhive.local.running.execution import RunStep
from slamhive.local.running.outlook import Outlook, RunStanding
from slamhive.local.running.runner import Job
from slamhive.model.results import CpuUsage, Outcome, Phase, Provenance, Result, RunRecord, Usage
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, Plan, local_uid

SPEC = {"algorithmRef": {"name": "kiss-icp"}, "datasetRef": {"name": "d"}}
SWEEP = {
    "apiVersion": "slamhive.io/v1alpha1",
    "kind": "Sweep",
    "metadata": {"name": "short"},
    "spec": {
        "template": {"spec": SPEC},
        "matrix": [{"path": "parameters.maxRange", "values": [30, 60, 100]}],
    },
}


class Clock:
    """A clock that stands still unless it is moved."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def bench() -> Any:
    return SimpleNamespace(making={}, archive=SimpleNamespace(costs=lambda *_: []))


@pytest.fixture
def job() -> Job:
    sweep = Sweep.model_validate(SWEEP)
    points = Plan(sweep, FixedCatalog(), strict=False)
    job = Job(sweep, local_uid(sweep), points)
    job.outlook = Outlook(bytearray([RunStanding.NEW] * 3))
    return job


def test_a_lost_run_says_why() -> None:
    why = "no pose of the estimate, 0 s to 15 s, lies within 0.01 s of a ground-truth pose"
    lost = Result(evaluation="se3", outcome=Outcome.LOST, coverage=0.0, values={"message": why})
    record = RunRecord(uid="u", name="n", spec=SPEC, phase=Phase.SUCCEEDED, results=[lost])
    assert why in run_line(record, "voxelSize 1")
    assert run_values(record)["message"] == why


def test_a_tracked_run_with_an_error_out_of_proportion_says_so() -> None:
    values = {"ate": {"rmse": 0.5}, "rpe": [{"rmse": 0.68, "delta": 1.0, "unit": "m"}]}
    tracked = Result(evaluation="se3", outcome=Outcome.TRACKED, coverage=1.0, values=values)
    record = RunRecord(uid="u", name="n", spec=SPEC, phase=Phase.SUCCEEDED, results=[tracked])
    assert "RPE 0.68 m a metre" in run_line(record, "rings 8")


def test_what_is_made_once_is_not_expected_of_each_run(
    job: Job, bench: Any, clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    display = Display(bench, clock=clock)
    display.begun(job)
    for moment, step in (
        (0, RunStep.DATASET),
        (100, RunStep.PROGRAM),
        (300, RunStep.RECORDING),
        (301, RunStep.RUNNING),
    ):
        clock.now = moment
        display.step(job, 0, step)
    clock.now = 305
    job.states[0] = PointState.SUCCEEDED
    point = job.points.point(0)
    record = RunRecord(
        uid="a",
        name=point.name,
        index=0,
        spec=point.spec,
        phase=Phase.SUCCEEDED,
        provenance=Provenance(),
        usage=Usage(wall_seconds=4.0, cpu=CpuUsage(seconds=3.0)),
        results=[],
    )
    display.finished(job, record)
    assert "1/3 maxRange 30: 3.0 CPU s, – · 0:10 left" in capsys.readouterr().err


def test_off_a_terminal_it_is_said_now_and_then_what_runs_wait_for(
    bench: Any, clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    display = Display(bench, clock=clock)
    for second in range(101):
        clock.now = second
        bench.making = {"generating the dataset hall (once)": second / 200} if second < 90 else {}
        display.tick([])
    assert capsys.readouterr().err.splitlines() == [
        f"generating the dataset hall (once): {share}%, {time} so far"
        for share, time in ((8, "0:15"), (15, "0:30"), (22, "0:45"), (30, "1:00"), (40, "1:20"))
    ]
