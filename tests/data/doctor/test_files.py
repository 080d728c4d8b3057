# SPDX-License-Identifier: Apache-2.0
"""Findings of a recording's files and of its static transforms."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from spoiling import found_in

from slamhive.data.doctor.findings import Severity
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.model.dataset import Dataset

if TYPE_CHECKING:
    from pathlib import Path

START = 1_600_000_000 * 10**9
POINT = np.ones(5, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])


def bag(path: Path, bag_writer: Any, bag_entry: Any, moved: tuple[float, ...]) -> Any:
    with bag_writer(path) as writer:
        for later, metres in enumerate(moved):
            pose = np.eye(4)
            pose[0, 3] = metres
            writer.static_transforms(START + later, "base_link", {"lidar": pose})
        for k in range(20):
            writer.points("/points", START + k * 10**8, "lidar", POINT)
    return bag_entry(path, {"lidar": ("Lidar", "/points")})


def test_two_static_poses_of_a_frame(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> None:
    finding = found_in(bag(tmp_path / "a.bag", bag_writer, bag_entry, (0.09, 0.59)))["frames.contradiction"]
    assert finding.severity is Severity.WARNING
    assert finding.value == pytest.approx(0.5)
    assert "(0.09, 0, 0," in finding.message
    assert "(0.59, 0, 0," in finding.message


def test_the_same_static_pose_again_is_none(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> None:
    entry = bag(tmp_path / "a.bag", bag_writer, bag_entry, (0.09, 0.09, 0.09 + 1e-9))
    assert not {code for code in found_in(entry) if code.startswith(("frames.", "files."))}


def test_pieces_that_lie_beside_are_noted(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> None:
    entry = bag(tmp_path / "run.bag", bag_writer, bag_entry, (0.0,))
    for name in ("run_0.bag", "run_1.bag", "walk_1.bag"):
        shutil.copy(tmp_path / "run.bag", tmp_path / name)
    assert "files.missing" not in found_in(entry)
    values = entry.dataset.as_json()
    values["spec"]["recording"]["files"] = [{"path": "run_0.bag"}]
    finding = found_in(DatasetEntry(Dataset.model_validate(values), tmp_path))["files.missing"]
    assert finding.severity is Severity.NOTE
    assert "run_1.bag beside it may be" in finding.message
    assert "walk" not in finding.message
