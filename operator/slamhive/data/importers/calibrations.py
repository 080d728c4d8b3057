# SPDX-License-Identifier: Apache-2.0
"""Calibration files in the layouts of foreign recordings, read into one form.

ASL's sensor.yaml (EuRoC), Kalibr's camchain and imu.yaml (TUM VI), Basalt's calibration.json (Monado) and
LaMAria's pinhole JSON.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from slamhive.model.errors import DataError
from slamhive_eval.rotation import to_matrix

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

_ASL = {"radial-tangential": "RadialTangential", "equidistant": "Equidistant", "none": "None"}
_KALIBR = {"radtan": "RadialTangential", "equidistant": "Equidistant", "none": "None"}
_BASALT = {
    "kb4": ("Equidistant", ("k1", "k2", "k3", "k4")),
    "pinhole-radtan8": ("RadialTangential", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "pinhole": ("None", ()),
}
_NOISE = {
    "accelerometerNoise": "accelerometer_noise_density",
    "gyroscopeNoise": "gyroscope_noise_density",
    "accelerometerRandomWalk": "accelerometer_random_walk",
    "gyroscopeRandomWalk": "gyroscope_random_walk",
}
"""Names in sensor.yaml and in Kalibr's imu.yaml."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibration of one camera or IMU, read from a calibration file of a foreign recording.

    Attributes:
        source: The file.
        pose: Of the sensor in the body, (4, 4).
        camera: Fields of a manifest's `camera`, without the encoding; empty for an IMU.
        imu: Fields of a manifest's `imu`; empty for a camera.
        rate: Hz.
        time_offset: Seconds to add to stamps.
    """

    source: Path
    pose: Array
    camera: dict[str, Any] = field(default_factory=dict)
    imu: dict[str, float] = field(default_factory=dict)
    rate: float | None = None
    time_offset: float = 0.0


def read_asl_camera(path: Path) -> Calibration:
    """Read the sensor.yaml of a camera.

    Raises:
        DataError: It is missing or damaged, or its model isn't known.
    """
    known = read_yaml(path)
    model, distortion = known.get("camera_model"), str(known.get("distortion_model", "none"))
    if model not in {"pinhole", "omni"} or distortion not in _ASL:
        raise DataError(
            f"{path}: camera_model {model!r} with distortion_model {distortion!r} is not known; "
            f"allowed: pinhole and omni with {', '.join(_ASL)}"
        )
    width, height = _numbers(known, "resolution", 2, path)
    lens = _lens(known, path, omni=model == "omni")
    values = known.get("distortion_coefficients")
    count = max(4, len(values)) if isinstance(values, list) else 4
    found = _numbers(known, "distortion_coefficients", count, path) if distortion != "none" else []
    camera = {"width": int(width), "height": int(height)} | lens | _distortion(_ASL[distortion], found)
    return Calibration(path, _asl_pose(known, path), camera, rate=_rate(known, "rate_hz", path))


def read_asl_imu(path: Path) -> Calibration:
    """Read the sensor.yaml of an IMU.

    Raises:
        DataError: It is missing or damaged.
    """
    known = read_yaml(path)
    rate = _rate(known, "rate_hz", path)
    return Calibration(path, _asl_pose(known, path), imu=_noise(known, path), rate=rate)


def read_kalibr(path: Path, names: Sequence[str]) -> dict[str, Calibration]:
    """Read the cameras of a Kalibr camchain, whose T_cam_imu takes points of the IMU to a camera.

    Args:
        path: The file.
        names: Cameras that are needed, such as cam0.

    Raises:
        DataError: It is missing or damaged, lacks a camera, or its model isn't known.
    """
    chain = read_yaml(path)
    return {name: _kalibr_camera(_block(chain, name, path), path, name) for name in names}


def read_kalibr_imu(path: Path) -> Calibration:
    """Read Kalibr's imu.yaml; the IMU is the body.

    Raises:
        DataError: It is missing or damaged.
    """
    known = read_yaml(path)
    return Calibration(path, np.eye(4), imu=_noise(known, path), rate=_rate(known, "update_rate", path))


def read_basalt(path: Path, names: Sequence[str]) -> dict[str, Calibration]:
    """Read Basalt's calibration.json: cameras by their place in it, and ``imu0``, the body.

    Noise is of continuous time in it (basalt-headers, calibration.hpp).

    Raises:
        DataError: It is damaged, lacks a camera, or its model isn't known.
    """
    known = _block(_json(path), "value0", path)
    cameras, poses = known.get("intrinsics"), known.get("T_imu_cam")
    sizes = known.get("resolution")
    if not (isinstance(cameras, list) and isinstance(poses, list) and isinstance(sizes, list)):
        raise DataError(f"{path}: value0 needs intrinsics, T_imu_cam and resolution")
    if min(len(cameras), len(poses), len(sizes)) < len(names):
        raise DataError(f"{path}: {len(names)} cameras are needed, found {len(cameras)}")
    found = {}
    key = "cam_time_offset_ns"
    offset = _number(known, key, path) / 1e9 if key in known else 0.0
    for k, name in enumerate(names):
        if not (isinstance(cameras[k], dict) and isinstance(poses[k], dict)):
            raise DataError(f"{path}: value0: intrinsics and T_imu_cam of {name} must be mappings")
        kind, values = cameras[k].get("camera_type"), _block(cameras[k], "intrinsics", path)
        if kind not in _BASALT:
            raise DataError(f"{path}: camera_type {kind!r} is not known; allowed: {', '.join(_BASALT)}")
        distortion, keys = _BASALT[kind]
        numbers = [_number(values, key, path) for key in ("fx", "fy", "cx", "cy", *keys)]
        width, height = _numbers({"resolution": sizes[k]}, "resolution", 2, path)
        camera: dict[str, Any] = {"width": int(width), "height": int(height)}
        camera |= dict(zip(("fx", "fy", "cx", "cy"), numbers[:4], strict=True))
        quaternion = [_number(poses[k], key, path) for key in ("qx", "qy", "qz", "qw")]
        position = [_number(poses[k], key, path) for key in ("px", "py", "pz")]
        camera |= _distortion(distortion, numbers[4:])
        found[name] = Calibration(path, _pose(quaternion, position), camera, time_offset=offset)
    noise = {}
    for key, name in (
        ("accelerometerNoise", "accel_noise_std"),
        ("gyroscopeNoise", "gyro_noise_std"),
        ("accelerometerRandomWalk", "accel_bias_std"),
        ("gyroscopeRandomWalk", "gyro_bias_std"),
    ):
        if name in known:
            noise[key] = max(_numbers(known, name, 3, path))
    rate = _rate(known, "imu_update_rate", path)
    return found | {"imu0": Calibration(path, np.eye(4), imu=noise, rate=rate)}


def read_lamaria(path: Path, names: Sequence[str]) -> dict[str, Calibration]:
    """Read LaMAria's JSON of the cameras of its ASL folders: pinholes, T_b_s with qvec x y z w and tvec.

    Raises:
        DataError: It is damaged, lacks a camera, or its model isn't known.
    """
    known = _json(path)
    found = {}
    for name in names:
        one = _block(known, name, path)
        if one.get("model") != "PINHOLE":
            raise DataError(f"{path}: {name}: model {one.get('model')!r} is not known; allowed: PINHOLE")
        size = one.get("resolution") if isinstance(one.get("resolution"), dict) else one
        pose = _block(one, "T_b_s", path)
        camera: dict[str, Any] = {key: int(_number(size or {}, key, path)) for key in ("width", "height")}
        camera |= dict(zip(("fx", "fy", "cx", "cy"), _numbers(one, "params", 4, path), strict=True))
        placed = _pose(_numbers(pose, "qvec", 4, path), _numbers(pose, "tvec", 3, path))
        found[name] = Calibration(path, placed, camera)
    return found


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file, also one that OpenCV's FileStorage wrote.

    Raises:
        DataError: It is missing, or no YAML mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from None
    # OpenCV's header is not YAML's, nor are its tags.
    lines = [line for line in text.splitlines() if not line.startswith("%YAML")]
    try:
        known = yaml.safe_load("\n".join(lines).replace("!!opencv-matrix", ""))
    except yaml.YAMLError as error:
        raise DataError(f"{path}: not YAML: {getattr(error, 'problem', error)}") from None
    if not isinstance(known, dict):
        raise DataError(f"{path}: no calibration in it")
    return known


def matrix_of(block: object, key: str, path: Path) -> Array:
    """Return a pose that stands in a mapping as rows, or as OpenCV's matrix, (4, 4).

    Raises:
        DataError: It isn't 16 numbers.
    """
    data = block.get("data") if isinstance(block, dict) else block
    try:
        values = np.array(data if data is not None else [], dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.size != 16 or not np.isfinite(values).all():
        raise DataError(f"{path}: {key}: 16 numbers are needed, found {values.size}")
    pose = values.reshape(4, 4).copy()
    pose[3] = 0.0, 0.0, 0.0, 1.0
    return pose


def _kalibr_camera(known: dict[str, Any], path: Path, name: str) -> Calibration:
    model, distortion = known.get("camera_model"), known.get("distortion_model")
    if model not in {"pinhole", "omni"} or distortion not in _KALIBR:
        raise DataError(
            f"{path}: {name}: camera_model {model!r} with distortion_model {distortion!r} is not known; "
            f"allowed: pinhole and omni with {', '.join(_KALIBR)}"
        )
    if "T_cam_imu" not in known:
        raise DataError(
            f"{path}: {name}: T_cam_imu is missing: a camchain of cameras alone doesn't say where the IMU is"
        )
    width, height = _numbers(known, "resolution", 2, path)
    camera = {"width": int(width), "height": int(height)} | _lens(known, path, omni=model == "omni")
    found = _numbers(known, "distortion_coeffs", 4, path) if distortion != "none" else []
    camera |= _distortion(_KALIBR[str(distortion)], found)
    pose = np.linalg.inv(matrix_of(known["T_cam_imu"], f"{name}.T_cam_imu", path)).astype(np.float64)
    pose[3] = 0.0, 0.0, 0.0, 1.0
    # Kalibr: the time of the IMU is that of the camera and the shift.
    shift = _number(known, "timeshift_cam_imu", path) if "timeshift_cam_imu" in known else 0.0
    return Calibration(path, pose, camera, time_offset=shift)


def _lens(known: Mapping[str, Any], path: Path, *, omni: bool) -> dict[str, Any]:
    keys = ("xi", "fx", "fy", "cx", "cy") if omni else ("fx", "fy", "cx", "cy")
    lens: dict[str, Any] = dict(zip(keys, _numbers(known, "intrinsics", len(keys), path), strict=True))
    return lens | ({"model": "Mei"} if omni else {})


def _distortion(name: str, coefficients: list[float]) -> dict[str, Any]:
    if name == "RadialTangential" and len(coefficients) == 4:
        coefficients = [*coefficients, 0.0]
    kept = {"None": 0, "Equidistant": 4}.get(name, len(coefficients))
    return {"distortion": name, "coefficients": coefficients[:kept]}


def _noise(known: Mapping[str, Any], path: Path) -> dict[str, float]:
    return {key: _number(known, name, path) for key, name in _NOISE.items() if name in known}


def _asl_pose(known: Mapping[str, Any], path: Path) -> Array:
    return matrix_of(known.get("T_BS"), "T_BS", path)


def _pose(quaternion: list[float], position: list[float]) -> Array:
    pose = np.eye(4)
    norm = float(np.linalg.norm(quaternion)) or 1.0
    pose[:3, :3] = to_matrix(np.array([quaternion]) / norm)[0]
    pose[:3, 3] = position
    return pose


def _rate(known: Mapping[str, Any], key: str, path: Path) -> float | None:
    return _number(known, key, path) if key in known else None


def _number(known: Mapping[str, Any], key: str, path: Path) -> float:
    try:
        value = float(known[key])
    except (KeyError, TypeError, ValueError):
        value = float("nan")
    if not np.isfinite(value):
        raise DataError(f"{path}: {key}: a number is needed, found {known.get(key)!r}")
    return value


def _numbers(known: Mapping[str, Any], key: str, count: int, path: Path) -> list[float]:
    values = known.get(key)
    if not isinstance(values, list) or len(values) < count:
        raise DataError(f"{path}: {key}: {count} numbers are needed, found {values!r}")
    named = {f"{key}[{k}]": value for k, value in enumerate(values[:count])}
    return [_number(named, name, path) for name in named]


def _block(known: Mapping[str, Any], key: str, path: Path) -> dict[str, Any]:
    block = known.get(key) if isinstance(known, dict) else None
    if not isinstance(block, dict):
        raise DataError(f"{path}: {key} is missing")
    return block


def _json(path: Path) -> dict[str, Any]:
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: can't be read as JSON: {error}") from None
    if not isinstance(known, dict):
        raise DataError(f"{path}: no calibration in it")
    return known
