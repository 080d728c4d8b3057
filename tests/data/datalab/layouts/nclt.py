# SPDX-License-Identifier: Apache-2.0
"""Samples: a session of NCLT."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.importers.nclt import RECORD

if TYPE_CHECKING:
    from pathlib import Path

START = 1_326_030_975_726_043
"""µs"""


def write_session(root: Path) -> Path:
    folder = root / "2012-01-08"
    (folder / "velodyne_sync").mkdir(parents=True)
    for k in range(3):
        points = np.array([(20200, 20400, 40000, 9, 31), (0, 19999, 20000, 255, 0)], dtype=RECORD)
        points.tofile(folder / "velodyne_sync" / f"{START + 200_000 * k}.bin")
    rows = (f"{START + 200_000 * k}, {k}, 2, -3, 0, 0, {0.1 * k:e}" for k in range(3))
    (folder / "groundtruth_2012-01-08.csv").write_text("\n".join(rows) + "\n")
    return folder
