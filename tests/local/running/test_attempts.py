# SPDX-License-Identifier: Apache-2.0
"""Tests of attempts with algorithms that behave and with ones that don't."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.dashboard.answers.timeline import timeline
from slamhive.dashboard.sources.archived import Snapshot
from slamhive.engine import PointState
from slamhive.model.results import Outcome, Phase, Reason
from slamhive.tables.reading import read_archive

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.home.folder import Home
    from slamhive.local.running.workbench import Workbench

DEADLINE_SECONDS = 50


def alive_with(text: str) -> list[int]:
    """Return the processes whose environment holds a text."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                if text.encode() in (entry / "environ").read_bytes():
                    found.append(int(entry.name))
            except OSError:
                continue
    return found


def test_a_good_run_is_measured_and_kept_with_all_that_made_it(run_acts: Callable, bench) -> None:  # noqa: ANN001
    job, notes = run_acts(["good"])
    record = bench.archive.get(job.run_uid(0))
    assert record.phase is Phase.SUCCEEDED
    assert [phase for _, phase in notes.phases] == [Phase.PREPARING, Phase.RUNNING, Phase.SUCCEEDED]
    result = record.results[0]
    assert (result.evaluation, result.outcome) == ("se3", Outcome.TRACKED)
    assert result.values["ate"]["rmse"] < 1e-6
    assert result.coverage == pytest.approx(1.0)
    assert record.usage.cpu.seconds > 0
    assert record.usage.memory.peak_bytes > 1_000_000
    assert record.trajectory.poses > 100
    assert record.frames.offered == 100
    assert len(record.provenance.content_hash) == 64
    folder = Path(record.folder)
    assert (folder / "run/output/usage.csv").read_text().startswith("time")
    configuration = yaml.safe_load((folder / "run/config.yaml").read_text())
    assert configuration["parameters"] == {"act": "good", "number": 0}
    assert configuration["sensors"]["lidar"]["topic"] == "/points"
    assert configuration["input"]["pace"] == "Lockstep"


def test_the_run_folder_is_as_the_contract_says(run_acts: Callable) -> None:
    _, notes = run_acts(["configuration"])
    assert notes.records[0].phase is Phase.SUCCEEDED, notes.records[0].log_tail


def test_a_hanging_run_ends_at_its_timeout_and_nothing_of_it_is_left(run_acts: Callable, home) -> None:  # noqa: ANN001
    _, notes = run_acts(["hang"], template={"timeout": "1s"})
    assert notes.records[0].reason is Reason.DEADLINE_EXCEEDED
    assert not alive_with(str(home.path))


def test_children_that_outlive_the_program_are_ended(run_acts: Callable, home) -> None:  # noqa: ANN001
    _, notes = run_acts(["forks"])
    assert notes.records[0].phase is Phase.SUCCEEDED
    until = time.monotonic() + DEADLINE_SECONDS
    while alive_with(str(home.path)) and time.monotonic() < until:
        pass
    assert not alive_with(str(home.path))


def test_a_flood_of_output_is_kept_within_bounds(run_acts: Callable) -> None:
    _, notes = run_acts(["log"])
    record = notes.records[0]
    assert record.phase is Phase.SUCCEEDED
    assert (Path(record.folder) / "log.txt").stat().st_size < 12_000_000
    assert len(record.log_tail) < 10_000


@pytest.mark.parametrize(
    ("act", "outcome", "coverage"),
    [
        ("half", Outcome.PARTIAL, (0.5, 0.9)),
        ("elsewhere", Outcome.LOST, (0.0, 0.0)),
        ("empty", Outcome.LOST, (0.0, 0.0)),
    ],
)
def test_a_lost_run_is_a_result_not_a_failure(
    act: str, outcome: Outcome, coverage: tuple[float, float], run_acts: Callable
) -> None:
    job, notes = run_acts([act])
    record = notes.records[0]
    assert record.phase is Phase.SUCCEEDED
    assert record.results[0].outcome is outcome
    assert coverage[0] <= record.results[0].coverage <= coverage[1]
    assert job.count(PointState.SUCCEEDED) == 1


def test_a_run_without_a_pose_is_kept_and_reused_as_what_it_is(run_acts: Callable) -> None:
    _, first = run_acts(["empty"])
    _, second = run_acts(["empty"], name="others")
    for record in (first.records[0], second.records[0]):
        assert (record.trajectory.poses, record.trajectory.duration_seconds) == (0, 0.0)
        assert record.results[0].values["message"] == "the algorithm wrote no pose"
        assert record.results[0].values["ate"] is None
    assert second.records[0].provenance.reused_from


def test_rows_of_nan_are_counted_beside_the_coverage(run_acts: Callable) -> None:
    _, notes = run_acts(["nan"])
    (record,) = notes.records
    (result,) = record.results
    left_out, poses = result.values["nanRows"], result.values["estimatePoses"]
    assert record.trajectory.poses == poses == 150
    assert left_out == 51
    assert f"{left_out} of {left_out + poses} rows hold NaN and were left out" in result.values["notes"]
    assert result.values["ate"]["rmse"] < 1e-5


def test_the_other_runs_go_on_beside_bad_ones(run_acts: Callable) -> None:
    job, _ = run_acts(["crash", "good", "infinite", "segfault"], repetitions=2)
    assert (job.count(PointState.SUCCEEDED), job.count(PointState.FAILED)) == (2, 6)


def test_a_sweep_stops_at_its_limit_of_failures(run_acts: Callable) -> None:
    job, _ = run_acts(["crash"], repetitions=20, maxFailures=2, parallelism=1)
    assert job.verdict == "TooManyFailures"
    assert job.count(PointState.FAILED) == 3
    assert job.count(PointState.PENDING) == 17


def test_a_record_says_on_which_cores_it_ran_and_the_timeline_has_them_as_lanes(
    run_acts: Callable[..., Any], bench: Workbench, home: Home
) -> None:
    run_acts(["good", "noted"])
    used = set()
    for record in bench.archive.runs():
        told = json.loads(
            (home.path / "runs" / str(record.sweep) / record.name / "supervisor.json").read_text()
        )
        assert record.usage is not None
        assert record.usage.processors == ",".join(map(str, told["cpus"]))
        used.add(f"{record.provenance.node}, cores {record.usage.processors}")
    answer = timeline(Snapshot(read_archive(home.archive_url)), [], (None, None)).content
    assert set(answer["lanes"]) == used
