# SPDX-License-Identifier: Apache-2.0
"""Samples: a sequence of KITTI odometry."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

FRAMES, SECOND = 6, 10**9
P0 = "7.188560000000e+02 0.0 3.2e+01 {} 0.0 7.188560000000e+02 1.1e+01 {} 0.0 0.0 1.0 {}"
TR = (
    "4.2e-04 -9.999672e-01 -8.08e-03 -1.198e-02 -7.21e-03 8.08e-03 -9.99941e-01 -5.4e-02 "
    "9.999738e-01 4.85e-04 -7.2e-03 -2.92e-01"
)


def write_sequence(root: Path, name: str = "08", cameras: tuple[int, ...] = (0, 1)) -> Path:
    """Write a sequence of 80×24 pixels and 200 points; pixels carry frame and camera."""
    folder = root / "sequences" / name
    random = np.random.default_rng(1)
    for number in cameras:
        (folder / f"image_{number}").mkdir(parents=True)
        for k in range(FRAMES):
            pixels = np.full((24, 80) if number < 2 else (24, 80, 3), 10 * k + number, dtype=np.uint8)
            cv2.imwrite(str(folder / f"image_{number}" / f"{k:06}.png"), pixels)
    (folder / "velodyne").mkdir(parents=True)
    for k in range(FRAMES):
        random.normal(k, 1, (200, 4)).astype("<f4").tofile(folder / "velodyne" / f"{k:06}.bin")
    rows = {f"P{n}": P0.format(offset, 0.2, 0.003) for n, offset in enumerate((0.0, -386.1448, 45.0, -337.0))}
    rows["P0"] = P0.format(0.0, 0.0, 0.0)
    (folder / "calib.txt").write_text("".join(f"{key}: {row}\n" for key, row in (rows | {"Tr": TR}).items()))
    (folder / "times.txt").write_text("".join(f"{0.1 * k:.6e}\n" for k in range(FRAMES)))
    (root / "poses").mkdir(exist_ok=True)
    (root / "poses" / f"{name}.txt").write_text(
        "".join(f"1 0 0 0.5 0 1 0 0 0 0 1 {k:.6e}\n" for k in range(FRAMES))
    )
    return folder
