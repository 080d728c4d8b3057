# SPDX-License-Identifier: Apache-2.0
"""Samples: a trajectory of TartanAir, a scene of Replica."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

FRAMES, SECOND = 3, 10**9
QUARTER = (0.0, 0.0, 0.5**0.5, 0.5**0.5)
"""Quaternion of a quarter turn to the right, about z down."""


def write_images(folder: Path, names: str, size: tuple[int, int] = (12, 16)) -> None:
    folder.mkdir(parents=True)
    for k in range(FRAMES):
        cv2.imwrite(str(folder / names.format(k)), np.full((*size, 3), 50 * k + 3, dtype=np.uint8))


def write_trajectory(folder: Path, size: tuple[int, int] = (12, 16)) -> Path:
    """Write one of version 1: it goes forward, then looks to the right."""
    for side in ("left", "right"):
        write_images(folder / f"image_{side}", f"{{:06}}_{side}.png", size)
    (folder / "depth_left").mkdir()
    for k in range(FRAMES):
        depth = np.full(size, 1.25 + k, dtype=np.float32)
        np.save(folder / "depth_left" / f"{k:06}_left_depth.npy", depth)
    turned = ((0, 0, 0, 1), (0, 0, 0, 1), QUARTER)
    poses = [(10 + k, 20, -5, *q) for k, q in enumerate(turned)]
    (folder / "pose_left.txt").write_text("".join(" ".join(f"{v:e}" for v in row) + "\n" for row in poses))
    # 0.3 m to the right: along y, and after the turn to the right along -x.
    rights = [(10, 20.3, -5, *turned[0]), (11, 20.3, -5, *turned[1]), (11.7, 20, -5, *turned[2])]
    (folder / "pose_right.txt").write_text("".join(" ".join(f"{v:e}" for v in row) + "\n" for row in rights))
    return folder


def write_scene(root: Path) -> Path:
    folder = root / "office0"
    write_images(folder / "results", "frame{:06}.jpg")
    for k in range(FRAMES):
        depth = np.full((12, 16), 6553 + 300 * k, dtype=np.uint16)
        cv2.imwrite(str(folder / "results" / f"depth{k:06}.png"), depth)
    rows = (f"1 0 0 {k} 0 1 0 0 0 0 1 0 0 0 0 1\n" for k in range(FRAMES))
    (folder / "traj.txt").write_text("".join(rows))
    camera = {"w": 16, "h": 12, "fx": 8.0, "fy": 8.0, "cx": 7.5, "cy": 5.5, "scale": 6553.5}
    (root / "cam_params.json").write_text(json.dumps({"camera": camera}))
    return folder
