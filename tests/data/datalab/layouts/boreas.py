# SPDX-License-Identifier: Apache-2.0
"""Samples: a sequence of Boreas."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

START = 1_606_417_097_528_152
"""µs"""
HEAD = "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,wz,wy,wx"


def write_sequence(folder: Path) -> Path:
    (folder / "lidar").mkdir(parents=True)
    (folder / "applanix").mkdir()
    for k in range(3):
        points = np.array([[1, 2, 3, 4, 100, -0.05], [1, 2, 4, 4, 3, 0.05]], dtype="<f4")
        points.tofile(folder / "lidar" / f"{START + 100_000 * k}.bin")
    rows = (f"{START + 100_000 * k},{k},2,3,0,0,0,0.1,0.2,0.3,0,0,0" for k in range(3))
    (folder / "applanix" / "lidar_poses.csv").write_text("\n".join([HEAD, *rows]) + "\n")
    (folder / "applanix" / "imu.csv").write_text("GPSTime,wz,wy,wx,az,ay,ax\n")
    return folder
