# SPDX-License-Identifier: Apache-2.0
"""Samples: a drive of KITTI's raw data."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

DRIVE = "2011_09_30_drive_0028_sync"
NOON = 1_317_384_000 * 10**9
"""2011-09-30 12:00:00 as if in UTC, ns."""


def dates(count: int, offset: float, step: float = 0.1) -> str:
    """Return times of a day's 12th hour, one a line."""
    found = (f"2011-09-30 12:00:{offset + step * k:012.9f}" for k in range(count))
    return "".join(f"{line}\n" for line in found)


def write_oxts(folder: Path, count: int, step: float) -> None:
    (folder / "data").mkdir(parents=True)
    for k in range(count):
        values = [49.0 + 1e-6 * k, 8.0, 110.0, 0.0, 0.0, 0.5] + [0.0] * 24
        values[11:14], values[17:20] = [0.1, 0.2, 9.8], [0.01, 0.02, 0.03]
        (folder / "data" / f"{k:010}.txt").write_text(" ".join(map(str, values)) + "\n")
    (folder / "timestamps.txt").write_text(dates(count, 1.0, step))


def write_drive(root: Path, name: str = DRIVE, first: int = 0, frames: int = 4) -> Path:
    date = root / "2011_09_30"
    folder = date / name
    lines = first + frames
    for number in (0, 1):
        (folder / f"image_0{number}" / "data").mkdir(parents=True)
        for k in range(first, lines):
            path = folder / f"image_0{number}" / "data" / f"{k:010}.png"
            cv2.imwrite(str(path), np.full((24, 80), 10 * (k - first) + number, dtype=np.uint8))
        (folder / f"image_0{number}" / "timestamps.txt").write_text(dates(lines, 1.0, 0.01))
    scans = folder / "velodyne_points"
    (scans / "data").mkdir(parents=True)
    for k in range(first, lines):
        points = np.array([[-5, 1e-6, 0, 0.5], [0, 5, 0, 0.5], [5, 0, 0, 0.5], [0, -5, 0, 0.5]], dtype="<f4")
        points.tofile(scans / "data" / f"{k:010}.bin")
    for part, offset in (("_start", 0.996), ("", 1.0), ("_end", 1.004)):
        (scans / f"timestamps{part}.txt").write_text(dates(lines, offset, 0.01))
    write_oxts(folder / "oxts", lines, 0.01 if first else 0.1)
    (date / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.3 -0.8\n")
    (date / "calib_velo_to_cam.txt").write_text(
        "calib_time: 15-Mar-2012 11:37:16\nR: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.1 -0.3\n"
    )
    rows = ["R_rect_00: 1 0 0 0 1 0 0 0 1"]
    for number, offset in ((0, 0.0), (1, -400.0)):
        rows += [f"S_rect_0{number}: 80 24", f"P_rect_0{number}: 800 0 30 {offset} 0 800 11 0 0 0 1 0"]
    (date / "calib_cam_to_cam.txt").write_text("\n".join(rows) + "\n")
    return folder
