# SPDX-License-Identifier: Apache-2.0
"""Drives of KITTI's raw data, in small."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from layouts.kitti_raw import DRIVE, NOON, write_drive, write_oxts

from slamhive.data.importers.kitti_raw import read_times
from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.errors import DataError, InputError
from slamhive.model.sensors import Stamp

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def test_a_drive(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    write_drive(tmp_path)
    found = take_in(tmp_path / "2011_09_30", "KittiRaw")
    assert {*found.spec.sensors} == {"left", "right", "lidar", "imu"}
    sensors = found.spec.sensors
    assert [row[3] for row in sensors["lidar"].T_body_sensor] == pytest.approx([0.8, -0.3, 0.8, 1])
    # The camera looks along the IMU's x, 0.3 m before the LiDAR and 0.1 m below; the right one beside it.
    left, right = (np.array(sensors[name].T_body_sensor) for name in ("left", "right"))
    assert left[:3, 3] == pytest.approx([1.1, -0.3, 0.7])
    assert left[:3, 2] == pytest.approx([1, 0, 0])
    assert right[:3, 3] - left[:3, 3] == pytest.approx([0, -0.5, 0])
    assert [pixels.flat[0] for _, pixels in found.messages("right")] == [1, 11, 21, 31]
    rates, forces = found.messages("imu")[0][1]
    assert (rates, forces) == ([0.01, 0.02, 0.03], [0.1, 0.2, 9.8])
    truth = ground_truth(found.entry).poses
    assert truth.positions[0].tolist() == [0, 0, 0]
    assert "frames 1100 to 5170 of this drive are sequence 08" in found.notes


def test_a_scan_is_stamped_by_its_start(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    found = take_in(write_drive(tmp_path), "KittiRaw")
    assert found.spec.sensors["lidar"].stamp is Stamp.SCAN_START
    stamp, points = found.messages("lidar")[0]
    assert stamp == NOON + 996_000_000
    # Behind, left, ahead (as the cameras are triggered), right, over the 8 ms from start to end.
    assert points["time"].tolist() == pytest.approx([0, 0.002, 0.004, 0.006], abs=1e-6)
    assert found.stamps("left")[0] == NOON + 10**9


def test_imu_of_sync_is_too_slow_and_that_of_extract_is_taken(
    tmp_path: Path, take_in: Callable[..., Any]
) -> None:
    folder = write_drive(tmp_path)
    assert "10 Hz in _sync, too slow to be integrated" in take_in(folder, "KittiRaw").notes
    write_oxts(folder.parent / DRIVE.replace("_sync", "_extract") / "oxts", 8, 0.01)
    found = take_in(folder, "KittiRaw")
    assert found.spec.sensors["imu"].rate == pytest.approx(100)
    assert "too slow" not in found.notes


def test_sequence_08_begins_with_frame_1100(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    write_drive(tmp_path, first=1098)
    found = take_in(tmp_path, "KittiRaw", "08")
    assert [pixels.flat[0] for _, pixels in found.messages("left")] == [20, 30]
    assert found.stamps("left")[0] == NOON + 12 * 10**9
    assert len(found.stamps("lidar")) == 2
    with pytest.raises(InputError, match="no drive '2011_10_03_drive_0027' in it"):
        take_in(tmp_path, "KittiRaw", "00")
    with pytest.raises(InputError, match="03 of the odometry benchmark isn't among"):
        take_in(tmp_path, "KittiRaw", "03")


def test_missing_scans_move_no_other(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_drive(tmp_path)
    (folder / "velodyne_points" / "data" / f"{1:010}.bin").unlink()
    found = take_in(folder, "KittiRaw")
    assert found.stamps("lidar") == [NOON + at * 10**6 for at in (996, 1016, 1026)]
    assert "velodyne_points: 1 frames have no file (the first is 0000000001.bin)" in found.notes


def test_dates_are_exact_to_the_ns(tmp_path: Path) -> None:
    path = tmp_path / "timestamps.txt"
    path.write_text("2011-09-30 12:00:00.123456789\n\n2011-09-30 12:00:01\n")
    assert read_times(path) == {0: NOON + 123_456_789, 2: NOON + 10**9}


@pytest.mark.parametrize(
    ("path", "text", "words"),
    [
        ("calib_imu_to_velo.txt", None, r"calib_imu_to_velo\.txt: No such file"),
        ("calib_velo_to_cam.txt", "R: 1 0 0 0 1 0 0 0 1\n", "no line 'T'"),
        ("calib_cam_to_cam.txt", None, r"calib_cam_to_cam\.txt: No such file"),
        (f"{DRIVE}/velodyne_points/timestamps_end.txt", None, r"timestamps_end\.txt: No such file"),
        (f"{DRIVE}/image_00/timestamps.txt", "2011-09-30\n", "line 1: '2011-09-30' is not a date and time"),
        (f"{DRIVE}/oxts/data/0000000001.txt", "1 2 3\n", "0000000001.txt, line 1: 3 of 30 values"),
    ],
)
def test_what_is_wrong_is_named(
    tmp_path: Path, take_in: Callable[..., Any], path: str, text: str | None, words: str
) -> None:
    place = write_drive(tmp_path).parent / path
    place.unlink() if text is None else place.write_text(text)
    with pytest.raises(DataError, match=words):
        take_in(tmp_path, "KittiRaw")


def test_calibration_of_another_size(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    path = write_drive(tmp_path).parent / "calib_cam_to_cam.txt"
    path.write_text(path.read_text().replace("S_rect_01: 80 24", "S_rect_01: 1226 370"))
    with pytest.raises(DataError, match=r"says 1226×370 pixels of camera 1, but .* has 80×24"):
        take_in(tmp_path, "KittiRaw")
