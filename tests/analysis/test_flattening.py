# SPDX-License-Identifier: Apache-2.0
"""Records of runs as columns."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest

from slamhive.analysis.flattening import CORE_COLUMNS, LEFT_OUT, Results, columns_of_runs
from slamhive.analysis.frame import Frame
from slamhive.archive.records import run_row
from slamhive.model.results import (
    CpuUsage,
    IntendedEvaluation,
    MemoryUsage,
    Outcome,
    Phase,
    Reason,
    Result,
    RunRecord,
    Usage,
)


def make(**changes: Any) -> RunRecord:
    fields: dict[str, Any] = {
        "uid": "u1",
        "name": "demo-1",
        "sweep": "demo",
        "sweepUid": "s1",
        "spec": {
            "algorithmRef": {"name": "kiss-icp"},
            "datasetRef": {"name": "hall"},
            "sensors": "lidar",
            "parameters": {"voxelSize": None, "deskew": True, "ORB.n": 3},
            "input": {"frameRate": 10, "lidar": {"rings": 16}},
            "repetition": 2,
            "seed": 5,
        },
        "attributes": {"loops": 2, "size": [1, 2]},
        "phase": Phase.SUCCEEDED,
        "finished": datetime(2026, 1, 2, tzinfo=UTC),
        "usage": Usage(
            cpu=CpuUsage(mean_cores=1 / 3, seconds=5), memory=MemoryUsage(peak_bytes=7), wall_seconds=1.5
        ),
    }
    return RunRecord.model_validate(fields | changes)


def result(name: str, rmse: float, **values: Any) -> Result:
    found = {"ate": {"rmse": rmse}, "rpe": [{"rmse": 1.0}, {"rmse": 2.0}], "alignment": name} | values
    return Result(evaluation=name, outcome=Outcome.TRACKED, coverage=0.5, values=found)


def rows_of(record: RunRecord) -> list[dict[str, Any]]:
    found = Results.of((1, one) for one in record.results)
    whole = {name: [value] for name, value in (run_row(record) | {"id": 1}).items()}
    columns, length = columns_of_runs(whole, found, LEFT_OUT)
    frame = Frame(columns, length)
    return frame.records(frame.names)


def test_names_and_values() -> None:
    (row,) = rows_of(make(results=[result("se3", 0.1 + 0.2, message="note")], labels={"team": "a"}))
    expected = {
        "run": "demo-1",
        "sweep": "demo",
        "sweep.uid": "s1",
        "algorithm": "kiss-icp",
        "dataset": "hall",
        "sensors": "lidar",
        "repetition": 2,
        "seed": 5,
        "phase": "Succeeded",
        "outcome": "Tracked",
        "message": "note",
        "evaluation": "se3",
        "coverage": 0.5,
        "alignment": "se3",
        "ate.rmse": 0.1 + 0.2,
        "rpe[0].rmse": 1.0,
        "rpe[1].rmse": 2.0,
        "usage.cpu.meanCores": 1 / 3,
        "usage.cpu.seconds": 5,
        "usage.cpu.maxCores": None,
        "usage.memory.peakBytes": 7,
        "usage.wallSeconds": 1.5,
        "parameters.deskew": True,
        "parameters.ORB.n": 3,
        "input.frameRate": 10,
        "input.lidar.rings": 16,
        "dataset.attributes.loops": 2,
        "dataset.attributes.size": [1, 2],
        "label.team": "a",
        "finished": "2026-01-02T00:00:00+00:00",
    }
    assert {name: row.get(name, "absent") for name in expected} == expected


def test_one_row_a_run_and_evaluation() -> None:
    record = make(results=[result("se3", 1.0), result("sim3", 2.0)])
    assert [(row["evaluation"], row["ate.rmse"]) for row in rows_of(record)] == [("se3", 1.0), ("sim3", 2.0)]


def test_a_failed_run_has_a_row_for_what_it_was_meant_to_be_measured_by() -> None:
    meant = [IntendedEvaluation(evaluation="se3", alignment="se3", settings="abc")]
    failed = make(phase=Phase.FAILED, reason=Reason.OUT_OF_MEMORY, message="m", usage=None, evaluations=meant)
    (row,) = rows_of(failed)
    assert (row["phase"], row["reason"], row["message"], row["outcome"]) == (
        *("Failed", "OutOfMemory", "m", None),
    )
    assert (row["evaluation"], row["alignment"], row["settings"]) == ("se3", "se3", "abc")
    assert set(CORE_COLUMNS) <= set(row)


def test_an_intended_evaluation_that_came_to_pass_is_there_once() -> None:
    meant = [IntendedEvaluation(evaluation=name) for name in ("se3", "yaw")]
    rows = rows_of(make(results=[result("se3", 1.0)], evaluations=meant))
    assert [(row["evaluation"], row["outcome"]) for row in rows] == [("se3", "Tracked"), ("yaw", None)]


def test_a_run_that_nothing_was_to_measure_has_one_row() -> None:
    (row,) = rows_of(make())
    assert (row["evaluation"], row["outcome"]) == (None, None)


@pytest.mark.parametrize(
    ("label", "run"),
    [("126", 126), ("-1", -1), ("1.5", 1.5), ("1e3", 1000.0), ("nan", "nan"), ("0x1", "0x1"), ("a1", "a1")],
)
def test_the_label_run_names_the_run(label: str, run: float | str) -> None:
    (row,) = rows_of(make(labels={"run": label}))
    assert row["run"] == run
    assert row["name"] == "demo-1"


def test_columns_are_the_core_then_the_rest() -> None:
    names = list(rows_of(make())[0])
    assert names[: len(CORE_COLUMNS)] == list(CORE_COLUMNS)
    assert names[len(CORE_COLUMNS) :] == sorted(names[len(CORE_COLUMNS) :])
