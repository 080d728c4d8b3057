# SPDX-License-Identifier: Apache-2.0
"""Findings of a recording as `dataset check` hands them on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from spoiling import found_in, spoil

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.data.inspecting.inspection import inspect
from slamhive.model.dataset import DatasetSpec

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.recordings.entries import DatasetEntry


def test_a_clean_recording_has_none(lidar_entry: DatasetEntry, tmp_path: Path) -> None:
    assert found_in(lidar_entry) == {}
    again = spoil(lidar_entry, tmp_path / "same", lambda _, message: message)
    assert found_in(again) == {}
    assert inspect(again).as_json()["findings"] == []


def test_a_repair_line_is_taken_as_it_stands(lidar_entry: DatasetEntry) -> None:
    import yaml

    line = Finding(
        "points.times.unit", Severity.ERROR, "", "lidar", repair=sensor_repair("lidar", pointTimes="us")
    ).repair_line
    spec = lidar_entry.dataset.spec.as_json() | yaml.safe_load(str(line))
    repair = DatasetSpec.model_validate(spec).repair
    assert repair is not None
    assert str(repair.sensors["lidar"].point_times) == "us"
