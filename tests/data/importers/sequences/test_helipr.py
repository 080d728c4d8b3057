# SPDX-License-Identifier: Apache-2.0
"""Sequences of HeLiPR, whose LiDARs have packed points of their own."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from layouts.helipr import PACKED, START, some, write_sequence

from slamhive.data.importers.helipr import LAST_SHORT_AEVA, T_IMU_OUSTER
from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.errors import DataError, InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.mark.parametrize("name", [*PACKED])
def test_points_of_each_lidar(tmp_path: Path, take_in: Callable[..., Any], name: str) -> None:
    found = take_in(write_sequence(tmp_path / "a", name, some(name)), "HeLiPR")
    stamp, points = found.messages("lidar")[0]
    assert stamp == START
    intensity, time, ring = PACKED[name][2]
    assert points[0].tolist() == pytest.approx((1, 2, 3, intensity, time, ring))
    assert len(points) == 4
    assert ground_truth(found.entry).poses.positions[2].tolist() == [2, 0, 0]


def test_the_aeva_has_an_intensity_from_a_stamp_on(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    short = struct.pack("=ffffflB", 1, 2, 3, 0.25, -4, 50_000_000, 9)
    long = struct.pack("=ffffflBf", 1, 2, 3, 0.25, -4, 50_000_000, 9, 77)
    packed = {LAST_SHORT_AEVA: short * 2, LAST_SHORT_AEVA + 1: long * 2}
    found = take_in(write_sequence(tmp_path / "a", "Aeva", packed), "HeLiPR")
    (_, before), (_, after) = found.messages("lidar")
    assert before[0].tolist() == pytest.approx((1, 2, 3, 0.25, 0.05, 9))
    assert after[0].tolist() == pytest.approx((1, 2, 3, 77, 0.05, 9))


def test_the_imu_stands_beside_the_ouster(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    write_sequence(tmp_path / "a", "Velodyne", some("Velodyne"))
    folder = write_sequence(tmp_path / "a", "Ouster", some("Ouster"))
    random = np.random.default_rng(1)
    rows = []
    for k in range(40):
        vectors = (*random.normal(0, 0.1, 3), 0, 0, 9.81, 0.2, 0.3, 0.4)
        rows.append(",".join(map(str, (START + k * 10**7, 0, 0, 0, 1, 0, 0, 0, *vectors))))
    (folder / "Inertial_data").mkdir()
    (folder / "Inertial_data" / "xsens_imu.csv").write_text("\n".join(rows) + "\n")
    found = take_in(folder, "HeLiPR")
    pose = np.array(found.spec.sensors["imu"].T_body_sensor)
    assert np.abs(pose @ np.array(T_IMU_OUSTER) - np.eye(4)).max() < 1e-9
    assert "of the LiDARs Ouster, Velodyne Ouster was imported" in found.notes
    assert found.stamps("imu")[:2] == [START, START + 10**7]
    other = take_in(folder, "HeLiPR", "Velodyne")
    assert {*other.spec.sensors} == {"lidar"}
    assert "its pose is known beside the Ouster only" in other.notes
    with pytest.raises(InputError, match=r"no LiDAR 'Avia' in it; it has: Ouster, Velodyne"):
        take_in(folder, "HeLiPR", "Avia")


def test_a_sequence_without_an_imu(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_sequence(tmp_path / "Town04", "Ouster", some("Ouster"))
    assert r"the sequences *_04 have none" in take_in(folder, "HeLiPR").notes


def test_a_scan_of_another_struct_is_refused(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_sequence(tmp_path / "a", "Ouster", some("Velodyne"))
    with pytest.raises(DataError, match="88 bytes are no whole number of points of 26 bytes"):
        take_in(folder, "HeLiPR")
