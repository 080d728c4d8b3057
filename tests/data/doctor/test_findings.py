# SPDX-License-Identifier: Apache-2.0
"""Findings of a recording as `dataset check` hands them on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from spoiling import found_in, spoil

from slamhive.data.inspecting.inspection import inspect

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.recordings.entries import DatasetEntry


def test_a_clean_recording_has_none(lidar_entry: DatasetEntry, tmp_path: Path) -> None:
    assert found_in(lidar_entry) == {}
    again = spoil(lidar_entry, tmp_path / "same", lambda _, message: message)
    assert found_in(again) == {}
    assert inspect(again).as_json()["findings"] == []
