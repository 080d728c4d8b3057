# SPDX-License-Identifier: Apache-2.0
"""Import of folders in the ASL layout of the EuRoC MAV dataset: mav0/cam*, imu*, ground truth."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from slamhive.data.importers.contents import (
    Contents,
    Stream,
    Truth,
    camera_stream,
    encoding_of,
    imu_stream,
    read_pixels,
)
from slamhive.model.dataset import GroundTruth
from slamhive.model.errors import DataError
from slamhive.model.sensors import Camera, Sensor
from slamhive_eval import EvaluationError, read_trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers import ImportOptions

    Array = npt.NDArray[np.float64]

TITLE = "a folder in EuRoC's layout (mav0/)"

_DISTORTIONS = {"radial-tangential": "RadialTangential", "equidistant": "Equidistant", "none": "None"}
_TRUTHS = (
    "state_groundtruth_estimate0/data.csv",
    "../groundtruth.txt",
    "groundtruth.txt",
)


def recognises(source: Path) -> bool:
    """Tell whether something is a folder with mav0, or mav0 itself."""
    return (source / "mav0").is_dir() or (source / "cam0").is_dir()


def read(source: Path, options: ImportOptions) -> Contents:  # noqa: ARG001
    """Read a folder in EuRoC's layout: the folder with mav0, or mav0 itself.

    The body frame is the one of its calibration, the IMU's.

    Raises:
        DataError: Something in the folder is missing or damaged.
    """
    base = source / "mav0" if (source / "mav0").is_dir() else source
    cameras = _cameras(base)
    imus = [_imu(path) for path in sorted(base.glob("imu[0-9]")) if (path / "data.csv").is_file()][:1]
    if not cameras and not imus:
        raise DataError(
            f"{base}: no cam0/data.csv and no imu0/data.csv in it: not a folder in EuRoC's layout"
        )
    return Contents(
        description="Imported from a folder in EuRoC's layout.",
        streams=cameras + imus,
        truth=_truth(base),
        gravity_aligned=True,
    )


def _cameras(base: Path) -> list[Stream]:
    folders = [path for path in sorted(base.glob("cam[0-9]")) if (path / "data.csv").is_file()]
    roles = ["camera"] if len(folders) == 1 else ["left", "right", *(path.name for path in folders[2:])]
    return [_camera(path, role) for path, role in zip(folders, roles, strict=False)]


def _camera(folder: Path, role: str) -> Stream:
    path = folder / "sensor.yaml"
    known = _calibration(path)
    frames = []
    for line, (stamp, file) in _rows(folder / "data.csv", 2):
        image = folder / "data" / file.strip()
        if not image.is_file():
            raise DataError(f"{folder / 'data.csv'}, line {line}: {image} does not exist")
        frames.append((_stamp(stamp, folder / "data.csv", line), image))
    distortion = str(known.get("distortion_model", "none"))
    if known.get("camera_model") != "pinhole" or distortion not in _DISTORTIONS:
        raise DataError(
            f"{path}: camera_model {known.get('camera_model')!r} with distortion_model {distortion!r} is "
            f"not known; "
            f"allowed: pinhole with {', '.join(_DISTORTIONS)}"
        )
    fx, fy, cx, cy = _numbers(known, "intrinsics", 4, path)
    width, height = (int(number) for number in _numbers(known, "resolution", 2, path))
    coefficients = _coefficients(known, path) if distortion != "none" else []
    camera = Camera.model_validate(
        {
            "width": width,
            "height": height,
            "encoding": encoding_of(read_pixels(frames[0][1])),
            "fx": fx,
            "fy": fy,
            "cx": cx,
            "cy": cy,
            "distortion": _DISTORTIONS[distortion],
            "coefficients": _with_k3(coefficients) if distortion == "radial-tangential" else coefficients[:4],
        }
    )
    sensor = Sensor.model_validate(
        {
            "type": "Camera",
            "topic": f"/{folder.name}/image_raw",
            "frameId": folder.name,
            "rate": float(known.get("rate_hz", 20)),
            "T_body_sensor": _pose(known, path).tolist(),
            "camera": camera,
        }
    )
    stamps = np.array([stamp for stamp, _ in frames], dtype=np.int64)
    return camera_stream(role, sensor, stamps, [image for _, image in frames], path)


def _imu(folder: Path) -> Stream:
    path = folder / "sensor.yaml"
    known = _calibration(path)
    rows = [(line, row) for line, row in _rows(folder / "data.csv", 7)]
    stamps = np.array([_stamp(row[0], folder / "data.csv", line) for line, row in rows], dtype=np.int64)
    try:
        samples = np.array([row[1:7] for _, row in rows], dtype=np.float64)
    except ValueError as error:
        raise DataError(f"{folder / 'data.csv'}: {error}") from None
    wrong = np.flatnonzero(~np.isfinite(samples).all(axis=1))
    if wrong.size:
        raise DataError(f"{folder / 'data.csv'}, line {rows[wrong[0]][0]}: a value is not a finite number")
    names = {
        "accelerometerNoise": "accelerometer_noise_density",
        "gyroscopeNoise": "gyroscope_noise_density",
        "accelerometerRandomWalk": "accelerometer_random_walk",
        "gyroscopeRandomWalk": "gyroscope_random_walk",
    }
    noise = {key: float(known[name]) for key, name in names.items() if name in known}
    sensor = Sensor.model_validate(
        {
            "type": "Imu",
            "topic": f"/{folder.name}",
            "frameId": folder.name,
            "rate": float(known.get("rate_hz", 200)),
            "T_body_sensor": _pose(known, path).tolist(),
            "imu": noise,
        }
    )
    return imu_stream("imu", sensor, stamps, samples[:, :3], samples[:, 3:])


def _calibration(path: Path) -> dict[str, Any]:
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


def _pose(known: dict[str, Any], path: Path) -> Array:
    block = known.get("T_BS")
    values = np.array(block.get("data", []) if isinstance(block, dict) else [], dtype=np.float64)
    if values.size != 16:
        raise DataError(f"{path}: T_BS: 16 numbers are needed, found {values.size}")
    pose = values.reshape(4, 4)
    pose[3] = 0.0, 0.0, 0.0, 1.0
    return pose


def _coefficients(known: dict[str, Any], path: Path) -> list[float]:
    """Return all coefficients: EuRoC's own files have four, others may have those of more terms."""
    values = known.get("distortion_coefficients")
    return _numbers(
        known, "distortion_coefficients", max(4, len(values) if isinstance(values, list) else 0), path
    )


def _with_k3(coefficients: list[float]) -> list[float]:
    return [*coefficients, 0.0] if len(coefficients) == 4 else coefficients


def _numbers(known: dict[str, Any], key: str, count: int, path: Path) -> list[float]:
    values = known.get(key)
    if not isinstance(values, list) or len(values) < count:
        raise DataError(f"{path}: {key}: {count} numbers are needed, found {values!r}")
    return [float(value) for value in values[:count]]


def _rows(path: Path, columns: int) -> Iterator[tuple[int, list[str]]]:
    found = False
    with path.open(encoding="utf-8", newline="") as file:
        for line, row in enumerate(csv.reader(file), start=1):
            if not row or row[0].lstrip().startswith("#"):
                continue
            if len(row) < columns:
                raise DataError(f"{path}, line {line}: {columns} values are needed, found {len(row)}")
            found = True
            yield line, row
    if not found:
        raise DataError(f"{path}: no rows in it")


def _stamp(text: str, path: Path, line: int) -> int:
    try:
        return int(text)
    except ValueError:
        raise DataError(f"{path}, line {line}: {text!r} is not a time stamp in ns") from None


def _truth(base: Path) -> Truth | None:
    source = next((base / path for path in _TRUTHS if (base / path).is_file()), None)
    if source is None:
        return None
    manifest = GroundTruth(file="groundtruth.txt")
    if source.suffix == ".txt":
        return Truth(manifest, source)
    try:
        return Truth(manifest, read_trajectory(source, "euroc"))
    except EvaluationError as error:
        raise DataError(f"ground truth: {error}") from None
