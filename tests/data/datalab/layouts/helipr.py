# SPDX-License-Identifier: Apache-2.0
"""Samples: a sequence of HeLiPR."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

START = 1_689_519_045_000_000_123
PACKED = {
    "Ouster": ("=ffffIHHH", (1, 2, 3, 40, 50_000_000, 6, 7, 8), (40, 0.05, 7)),
    "Velodyne": ("=ffffHf", (1, 2, 3, 40, 7, 0.05), (40, 0.05, 7)),
    "Avia": ("=fffBBBL", (1, 2, 3, 40, 16, 5, 50_000_000), (40, 0.05, 5)),
}
"""Struct of a point, the values of one, and its intensity, time and ring."""


def write_sequence(root: Path, name: str, packed: dict[int, bytes]) -> Path:
    folder = root / "LiDAR" / name
    folder.mkdir(parents=True)
    for stamp, data in packed.items():
        (folder / f"{stamp}.bin").write_bytes(data)
    (root / "LiDAR_GT").mkdir(exist_ok=True)
    rows = (f"{stamp} {k} 0 0 0 0 0 1\n" for k, stamp in enumerate(packed))
    (root / "LiDAR_GT" / f"{name}_gt.txt").write_text("".join(rows))
    return root


def some(name: str, scans: int = 3) -> dict[int, bytes]:
    kind, values, _ = PACKED[name]
    return {START + k * 10**8: struct.pack(kind, *values) * 4 for k in range(scans)}
