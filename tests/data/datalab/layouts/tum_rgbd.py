# SPDX-License-Identifier: Apache-2.0
"""Samples: folders of TUM RGB-D, ETH3D, ICL-NUIM and OpenLORIS."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

VGA = (480, 640)
DELAYS = (0.005, 0.012, 0.03, 0.008, 0.017, 0.02, 0.006)


def rgbd(
    png: Any, folder: Path, *, size: Any = VGA, names: Any = ("rgb", "depth"), comment: str = ""
) -> Path:
    """Write 8 colour and 7 depth images, the latter somewhat later; pixels carry the number of the frame."""
    for name, count, kind in zip(names, (8, 7), (np.uint8, np.uint16), strict=True):
        rows = [f"# {name}", f"# file: '{comment}'", "# timestamp filename"]
        for k in range(count):
            stamp = f"{1305031102 + k / 30 + (DELAYS[k] if kind is np.uint16 else 0):.6f}"
            png(folder / name / f"{stamp}.png", k + 1, size, kind)
            rows.append(f"{stamp} {name}/{stamp}.png")
        (folder / f"{name}.txt").write_text("\n".join(rows) + "\n")
    poses = [f"{1305031102 + k / 100:.4f} {k} 0 0 0 0 0 1" for k in range(20)]
    (folder / "groundtruth.txt").write_text("# a\n# b\n# c\n" + "\n".join(poses) + "\n")
    return folder


def eth3d(png: Any, folder: Path) -> Path:
    rgbd(png, folder, size=(6, 8))
    (folder / "calibration.txt").write_text("7.5 7.6 3.5 2.5\n")
    return folder


def icl(png: Any, folder: Path) -> Path:
    for n in range(1, 5):
        png(folder / "rgb" / f"{n}.png", n, VGA)
        png(folder / "depth" / f"{n}.png", n, VGA, np.uint16)
    png(folder / "rgb" / "10.png", 10, VGA)
    png(folder / "depth" / "10.png", 10, VGA, np.uint16)
    rows = [f"{n} {0.1 * n} 0.2 -2.25 0.1 0.2 0.3 0.9273618495495703" for n in (1, 2, 3, 4, 10)]
    (folder / "livingRoom0.gt.freiburg").write_text("\n".join(rows) + "\n")
    return folder


SENSORS = """%YAML:1.0
d400_color_optical_frame:
   sensor_type: camera
   fps: 30
   width: 8
   height: 6
   intrinsics: !!opencv-matrix
      rows: 1
      cols: 4
      dt: d
      data: [ 6.11, 4.33, 6.12, 2.49 ]
"""
TREE = """%YAML:1.0
trans_matrix:
   - parent_frame: base_link
     child_frame: d400_color_optical_frame
     matrix: !!opencv-matrix
        rows: 4
        cols: 4
        dt: d
        data: [ 0., 0., 1., 0.4, -1., 0., 0., 0., 0., -1., 0., 1.2, 0., 0., 0., 1. ]
   - parent_frame: d400_color_optical_frame
     child_frame: d400_accelerometer
     matrix: !!opencv-matrix
        rows: 4
        cols: 4
        dt: d
        data: [ 1., 0., 0., 0.02, 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1. ]
"""


def loris(png: Any, folder: Path) -> Path:
    rgbd(png, folder, size=(6, 8), names=("color", "aligned_depth"))
    (folder / "sensors.yaml").write_text(SENSORS)
    (folder / "trans_matrix.yaml").write_text(TREE)
    forces = [f"{1305031102 + k / 250:.6f} {k} 0 9.8" for k in range(60)]
    rates = [f"{1305031102 + k / 400 - 0.002:.6f} 0 0 {k}" for k in range(100)]
    (folder / "d400_accelerometer.txt").write_text("#Time Ax Ay Az\n" + "\n".join(forces) + "\n")
    (folder / "d400_gyroscope.txt").write_text("#Time Gx Gy Gz\n" + "\n".join(rates) + "\n")
    return folder
