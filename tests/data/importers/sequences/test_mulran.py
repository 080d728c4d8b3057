# SPDX-License-Identifier: Apache-2.0
"""Sequences of MulRan, in small but for the scans, which are whole."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from layouts.mulran import START, imu_rows, write_sequence

from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def test_a_sequence(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    found = take_in(write_sequence(tmp_path / "KAIST01"), "MulRan")
    lidar = found.spec.sensors["lidar"]
    pose = np.array(lidar.T_body_sensor)
    assert pose[:3, 3].tolist() == [1.7042, -0.021, 1.8047]
    assert np.degrees(np.arctan2(pose[1, 0], pose[0, 0])) == pytest.approx(179.6654)
    assert (lidar.lidar.rings, lidar.lidar.columns) == (64, 1024)
    stamp, points = found.messages("lidar")[1]
    assert stamp == START + 10**8
    assert len(points) == 1024 * 64 - 1
    assert np.array_equal(points["ring"], points["y"])
    assert np.abs(points["time"] - (points["x"] - 1) * 0.1 / 1024).max() < 1e-7
    truth = ground_truth(found.entry).poses
    assert truth.positions.tolist() == [[353000.5, 4026000, 20], [353000.5, 4026001, 20]]


@pytest.mark.parametrize(
    ("order", "words"),
    [
        (("gyro", "force", "field"), "acceleration from the columns 11 to 13 (9.78 m/s² typically), angular"),
        (("field", "force", "gyro"), "angular velocity from 14 to 16"),
        (("force", "gyro", "field"), "acceleration from the columns 8 to 10"),
    ],
)
def test_columns_of_the_imu_are_told_by_what_is_in_them(
    tmp_path: Path, take_in: Callable[..., Any], order: Any, words: str
) -> None:
    folder = write_sequence(tmp_path / "a")
    (folder / "xsens_imu.csv").write_text(imu_rows(order))
    found = take_in(folder, "MulRan")
    assert words in found.notes
    rates, forces = zip(*(content for _, content in found.messages("imu")), strict=True)
    assert np.linalg.norm(forces, axis=1).mean() == pytest.approx(9.8, abs=0.1)
    assert np.abs(np.mean(rates, axis=0)).max() < 0.05


def test_an_imu_without_an_acceleration_is_refused(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_sequence(tmp_path / "a")
    (folder / "xsens_imu.csv").write_text(imu_rows(("gyro", "field", "field")))
    with pytest.raises(DataError, match="none of the columns 8 to 16 are an acceleration"):
        take_in(folder, "MulRan")


def test_scans_with_fewer_points_are_left_out(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_sequence(tmp_path / "a")
    broken = folder / "Ouster" / f"{START}.bin"
    broken.write_bytes(broken.read_bytes()[:-16])
    (folder / "xsens_imu.csv").write_text("\n".join(f"{START},0,0,0,1,0,0,0" for _ in range(2)) + "\n")
    found = take_in(folder, "MulRan")
    assert found.stamps("lidar") == [START + 10**8]
    assert f"1 of 2 scans haven't 1024×64 points (the first is {START}.bin)" in found.notes
    assert "8 columns, no angular velocity and acceleration: no IMU" in found.notes
    broken.with_name(f"{START + 10**8}.bin").unlink()
    with pytest.raises(DataError, match="no scan of 1024×64 points of 16 bytes"):
        take_in(folder, "MulRan")


def test_poses_that_step_back_are_left_out(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_sequence(tmp_path / "a", scans=20)
    lines = (folder / "global_pose.csv").read_text().splitlines()
    lines[7] = lines[6]
    (folder / "global_pose.csv").write_text("\n".join(lines) + "\n")
    found = take_in(folder, "MulRan")
    assert "1 of 20 stamps of poses aren't later than those before (the first is line 8)" in found.notes
    assert len(ground_truth(found.entry).poses) == 19
