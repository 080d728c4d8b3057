# SPDX-License-Identifier: Apache-2.0
"""Samples: folders of TUM VI and Monado."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

START = 1_520_530_308_199_447_626
CAMCHAIN = """cam0:
  T_cam_imu:
  - [0.0, 1.0, 0.0, 0.1]
  - [-1.0, 0.0, 0.0, 0.2]
  - [0.0, 0.0, 1.0, 0.3]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.003, 0.0007, -0.002, 0.0002]
  distortion_model: equidistant
  intrinsics: [5.1, 5.2, 3.3, 2.4]
  resolution: [8, 6]
  timeshift_cam_imu: 0.004
cam1:
  T_cam_imu:
  - [0.0, 1.0, 0.0, 0.0]
  - [-1.0, 0.0, 0.0, 0.2]
  - [0.0, 0.0, 1.0, 0.3]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.003, 0.0007, -0.002, 0.0002]
  distortion_model: equidistant
  intrinsics: [5.1, 5.2, 3.3, 2.4]
  resolution: [8, 6]
"""
IMU_CONFIG = """accelerometer_noise_density: 0.0028
accelerometer_random_walk: 0.00086
gyroscope_noise_density: 0.00016
gyroscope_random_walk: 2.2e-05
update_rate: 200.0
"""
MOCAP = (
    "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
)

ASL_CAMERA = """%YAML:1.0
T_BS:
  cols: 4
  rows: 4
  data: [1, 0, 0, {x}, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
rate_hz: 20
resolution: [8, 6]
camera_model: pinhole
intrinsics: [5, 5.5, 3, 2]
distortion_model: radial-tangential
distortion_coefficients: [0.1, 0.2, 0.3, 0.4]
"""
ASL_IMU = """%YAML:1.0
T_BS: {cols: 4, rows: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}
rate_hz: 200
gyroscope_noise_density: 1.7e-04
"""


def write_png(path: Path, value: int, size: tuple[int, int] = (6, 8), dtype: Any = np.uint8) -> None:
    """Write an image whose pixels are all of one value."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full(size, value, dtype=dtype))


def write_asl(
    folder: Path, *, frames: int = 8, dtype: Any = np.uint8, missing: Any = (), base: str = "mav0"
) -> Path:
    """Write mav0 without calibration: cameras whose images carry the number of their frame, 200 Hz of IMU."""
    for n in range(2):
        rows = ["#timestamp [ns],filename"]
        for k in range(frames):
            if (n, k) in missing:
                continue
            stamp = START + 50_000_000 * k + 1000 * n
            value = (k + 1) * 256 + 99 if dtype == np.uint16 else k + 1
            write_png(folder / base / f"cam{n}" / "data" / f"{stamp}.png", value, dtype=dtype)
            rows.append(f"{stamp},{stamp}.png")
        (folder / base / f"cam{n}" / "data.csv").write_text("\n".join(rows) + "\n")
    (folder / base / "imu0").mkdir()
    head = "#timestamp [ns],w_RS_S_x [rad s^-1],w y,w z,a_RS_S_x [m s^-2],a y,a z\n"
    rows = [f"{START + 5_000_000 * k},0.1,0.2,0.3,0.4,0.5,{9 + k}" for k in range(10 * frames)]
    (folder / base / "imu0" / "data.csv").write_text(head + "\n".join(rows) + "\n")
    return folder


def write_euroc(folder: Path, **options: Any) -> Path:
    """Write a folder as EuRoC's are, without ground truth."""
    write_asl(folder, **options)
    for n in range(2):
        (folder / "mav0" / f"cam{n}" / "sensor.yaml").write_text(ASL_CAMERA.replace("{x}", str(0.1 * n)))
    (folder / "mav0" / "imu0" / "sensor.yaml").write_text(ASL_IMU)
    return folder


def lamaria_calibration() -> str:
    """Return the JSON of the pinholes that images are undistorted to."""
    camera = {
        "model": "PINHOLE",
        "params": [5.0, 5.0, 4.0, 3.0],
        "resolution": {"width": 8, "height": 6},
        "T_b_s": {"qvec": [0.0, 0.0, 1.0, 0.0], "tvec": [0.1, 0.0, 0.0]},
    }
    return json.dumps({"cam0": camera, "cam1": camera, "imu0": {}})


def lamaria_truth() -> str:
    """Return four poses of the pseudo-dense ground truth."""
    return "".join(f"{START + 50_000_000 * k} {k} 0 0 0 0 0 1\n" for k in range(4))


def tum_vi(asl: Any, folder: Path) -> Path:
    asl(folder, dtype=np.uint16)
    (folder / "dso").mkdir()
    (folder / "dso" / "camchain.yaml").write_text(CAMCHAIN)
    (folder / "dso" / "imu_config.yaml").write_text(IMU_CONFIG)
    (folder / "mav0" / "mocap0").mkdir()
    # 120 Hz: poses a few ms apart.
    rows = [f"{START + 8_333_333 * k},{0.01 * k},0,0,1,0,0,0" for k in range(48)]
    (folder / "mav0" / "mocap0" / "data.csv").write_text(MOCAP + "\n".join(rows) + "\n")
    return folder


def basalt_camera(kind: str, **values: float) -> dict[str, Any]:
    return {"camera_type": kind, "intrinsics": {"fx": 5.0, "fy": 5.1, "cx": 3.0, "cy": 2.0} | values}


def monado(asl: Any, folder: Path) -> Path:
    asl(folder)
    fisheye = basalt_camera("kb4", k1=0.1, k2=0.2, k3=0.3, k4=0.4)
    pose = {"px": 0.1, "py": 0.2, "pz": 0.3, "qx": 0.0, "qy": 0.0, "qz": 1.0, "qw": 0.0}
    value = {
        "T_imu_cam": [pose, pose | {"px": 0.2}],
        "intrinsics": [fisheye, fisheye],
        "resolution": [[8, 6], [8, 6]],
        "imu_update_rate": 1000.0,
        "accel_noise_std": [0.016, 0.016, 0.016],
        "gyro_noise_std": [0.000282, 0.000282, 0.000282],
        "cam_time_offset_ns": 2_000_000,
    }
    (folder / "calibration.json").write_text(json.dumps({"value0": value}))
    (folder / "mav0" / "gt").mkdir()
    rows = [f"{START + 10_000_000 * k},{k},0,0,0.5,0.5,0.5,0.5" for k in range(4)]
    (folder / "mav0" / "gt" / "data.csv").write_text("#timestamp [ns],p,p,p,q\n" + "\n".join(rows) + "\n")
    return folder
