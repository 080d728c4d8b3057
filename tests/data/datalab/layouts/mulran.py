# SPDX-License-Identifier: Apache-2.0
"""Samples: a sequence of MulRan, whose scans are whole."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

START = 1_561_000_444_390_857_630


def imu_rows(order: tuple[str, str, str] = ("gyro", "force", "field"), count: int = 50) -> str:
    """Return rows of xsens_imu.csv with the three vectors in an order."""
    random = np.random.default_rng(1)
    rows = []
    for k in range(count):
        vectors = {
            "gyro": random.normal(0, 0.05, 3),
            "force": [0.1, -0.2, 9.79 + random.normal(0, 0.05)],
            "field": [0.3 + random.normal(0, 0.001), -0.1, 0.4],
        }
        numbers = [0, 0, 0, 1, 0, 0, 0, *(value for name in order for value in vectors[name])]
        rows.append(",".join(map(str, (START + k * 10**7, *numbers))))
    return "\n".join(rows) + "\n"


def write_sequence(folder: Path, scans: int = 2) -> Path:
    (folder / "Ouster").mkdir(parents=True)
    points = np.zeros((1024, 64, 4), dtype="<f4")
    points[:, :, 0] = np.arange(1, 1025)[:, None]
    points[:, :, 1] = np.arange(64)
    points[5, 7] = 0  # a direction without a return
    for k in range(scans):
        points.tofile(folder / "Ouster" / f"{START + k * 10**8}.bin")
    rows = (f"{START + k * 10**8},1,0,0,353000.5,0,1,0,{4026000 + k},0,0,1,20\n" for k in range(scans))
    (folder / "global_pose.csv").write_text("".join(rows))
    (folder / "xsens_imu.csv").write_text(imu_rows())
    return folder
