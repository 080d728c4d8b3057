# SPDX-License-Identifier: Apache-2.0
"""``slamhive dataset export``, as the command itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

if TYPE_CHECKING:
    from pathlib import Path


def test_a_folder_for_programs_of_kitti(system: Any, tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    arguments = ("dataset", "export", "tiny", "--format", "Kitti", "-o", str(folder), "--duration", "2s")
    code, out, err = system(*arguments, "--max-range", "8", "--ground-truth")
    assert (code, out.strip()) == (0, str(folder)), err
    assert "Kitti with lidar" in err
    assert "20 frames, 10 Hz, 1.9 s" in err
    names = {path.name for path in folder.iterdir()}
    assert names == {"velodyne", "times.txt", "calib.txt", "frames.txt", "sensors.yaml", "groundtruth.txt"}
    points = np.fromfile(folder / "velodyne/000000.bin", "<f4").reshape(-1, 4)
    assert 0 < np.linalg.norm(points[:, :3], axis=1).max() <= 8.001
    code, out, err = system(*arguments)
    assert (code, out) == (2, "")
    assert f"{folder}: exists already" in err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--format", "Euroc"), "dataset 'tiny' has no sensors for Euroc; it has: lidar"),
        (
            ("--format", "Kitti", "--sensors", "lidar-inertial"),
            "--sensors: Kitti can't hold the mode lidar-inertial (sensors lidar, imu); Kitti holds mono,",
        ),
        (("--format", "Kitti", "--sensors", "stereo"), "no sensor for the role 'left'"),
        (("--format", "Kitti", "--duration", "soon"), "--duration: expected a duration such as 90s"),
        (("--format", "Kitti", "--start", "1h"), "nothing is left of /points after 3600 s"),
        (("--format", "Folder"), "is not one of 'Rosbag1', 'Rosbag2', 'Mcap', 'Euroc', 'Tum', 'Kitti'"),
    ],
)
def test_what_can_not_be_exported(system: Any, tmp_path: Path, arguments: Any, sentence: str) -> None:
    code, out, err = system("dataset", "export", "tiny", "-o", str(tmp_path / "drive"), *arguments)
    assert (code, out) == (2, "")
    assert sentence in " ".join(err.split())
    assert "Traceback" not in err
    assert list(tmp_path.glob("*drive*")) == []
