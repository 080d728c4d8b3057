# SPDX-License-Identifier: Apache-2.0
"""Sessions of NCLT, in small."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from layouts.nclt import START, write_session

from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def test_scans_are_scaled_and_turned_up(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    found = take_in(write_session(tmp_path), "Nclt")
    stamp, points = found.messages("lidar")[2]
    assert stamp == (START + 400_000) * 1000
    assert points[0].tolist() == pytest.approx((1, -2, -100, 9, 31), abs=1e-5)
    assert points[1].tolist() == pytest.approx((-100, 0.005, 0, 255, 0), abs=1e-5)
    assert "ring" in (points.dtype.names or ())
    assert found.spec.sensors["lidar"].lidar.time_field is None
    assert {*found.spec.sensors} == {"lidar"}


def test_poses_are_turned_with_them(
    tmp_path: Path, take_in: Callable[..., Any], rotation: Callable[..., Any]
) -> None:
    found = take_in(write_session(tmp_path), "Nclt")
    truth = ground_truth(found.entry).poses
    assert found.spec.gravity_aligned
    assert truth.positions.tolist() == [[k, -2, 3] for k in range(3)]
    # A heading to the right about z down is one to the right about z up: negative.
    assert np.abs(truth.matrices[2] - rotation(2, -np.degrees(0.2))).max() < 1e-9


def test_poses_that_are_not_known_are_left_out(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_session(tmp_path)
    path = folder / "groundtruth_2012-01-08.csv"
    path.write_text(f"{START - 5},NaN,NaN,NaN,NaN,NaN,NaN\n" + path.read_text())
    found = take_in(folder, "Nclt")
    assert "1 of 4 rows hold NaN (the first is line 1)" in found.notes
    assert len(ground_truth(found.entry).poses) == 3


def test_ground_truth_beside_the_session(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_session(tmp_path)
    (tmp_path / "ground_truth").mkdir()
    path = folder / "groundtruth_2012-01-08.csv"
    path.rename(tmp_path / "ground_truth" / path.name)
    assert len(ground_truth(take_in(folder, "Nclt").entry).poses) == 3
    (tmp_path / "ground_truth" / path.name).unlink()
    assert "no ground truth: no groundtruth_2012-01-08.csv" in take_in(folder, "Nclt").notes


def test_a_scan_that_is_cut_off(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_session(tmp_path)
    (folder / "velodyne_sync" / f"{START}.bin").write_bytes(b"123")
    with pytest.raises(DataError, match="3 bytes are no whole number of points of 8 bytes"):
        take_in(folder, "Nclt")
