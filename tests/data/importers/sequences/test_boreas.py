# SPDX-License-Identifier: Apache-2.0
"""Sequences of Boreas, in small."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from layouts.boreas import HEAD, START, write_sequence

from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.errors import DataError
from slamhive.model.sensors import Stamp

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def test_a_stamp_is_the_middle_of_the_scan(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    found = take_in(write_sequence(tmp_path / "a"), "Boreas")
    assert found.spec.sensors["lidar"].stamp is Stamp.SCAN_MID
    stamp, points = found.messages("lidar")[1]
    assert stamp == (START + 100_000) * 1000
    assert points["time"].tolist() == pytest.approx([-0.05, 0.05])
    assert points["ring"].tolist() == [100, 3]


def test_no_imu_as_its_gravity_is_removed(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    found = take_in(write_sequence(tmp_path / "a"), "Boreas")
    assert {*found.spec.sensors} == {"lidar"}
    assert "gravity is removed" in found.notes


def test_poses(tmp_path: Path, take_in: Callable[..., Any], rotation: Callable[..., Any]) -> None:
    truth = ground_truth(take_in(write_sequence(tmp_path / "a"), "Boreas").entry).poses
    assert truth.positions.tolist() == [[k, 2, 3] for k in range(3)]
    degrees = np.degrees([0.1, 0.2, 0.3])
    expected = rotation(0, -degrees[0]) @ rotation(1, -degrees[1]) @ rotation(2, -degrees[2])
    assert np.abs(truth.matrices[0] - expected).max() < 1e-9
    assert truth.stamps[0] == START / 1e6


def test_post_processed_poses_are_in_seconds_and_the_applanix(
    tmp_path: Path, take_in: Callable[..., Any]
) -> None:
    folder = write_sequence(tmp_path / "a")
    (folder / "applanix" / "lidar_poses.csv").unlink()
    rows = (f"{(START + 100_000 * k) / 1e6:.15e},{k},2,3,0,0,0,0,0,0,0,0,0" for k in range(3))
    (folder / "applanix" / "gps_post_process.csv").write_text("\n".join([HEAD, *rows]) + "\n")
    with pytest.raises(DataError, match=r"T_applanix_lidar\.txt: No such file"):
        take_in(folder, "Boreas")
    (folder / "calib").mkdir()
    (folder / "calib" / "T_applanix_lidar.txt").write_text("0 -1 0 0\n1 0 0 0\n0 0 1 0.13\n0 0 0 1\n")
    found = take_in(folder, "Boreas")
    truth = ground_truth(found.entry)
    assert truth.T_body_frame[:3, 3].tolist() == [0, 0, -0.13]
    assert truth.poses.stamps[0] == pytest.approx(START / 1e6, abs=1e-3)
    assert "times are in s" in found.notes


def test_what_is_wrong_is_named(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_sequence(tmp_path / "a")
    path = folder / "applanix" / "lidar_poses.csv"
    path.write_text(path.read_text().replace("0.3,0,0,0", "x,0,0,0", 1))
    with pytest.raises(DataError, match=r"lidar_poses\.csv, line 2: could not convert"):
        take_in(folder, "Boreas")
    path.unlink()
    assert "no ground truth" in take_in(folder, "Boreas").notes
    for scan in (folder / "lidar").iterdir():
        scan.unlink()
    with pytest.raises(DataError, match=r"no files \*\.bin in it"):
        take_in(folder, "Boreas")
