# SPDX-License-Identifier: Apache-2.0
"""Import of folders in the ASL layout of the EuRoC MAV dataset: mav0/cam*, imu*, ground truth."""

from __future__ import annotations

import csv
import heapq
import shutil
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import yaml

from slamhive.data.importing import publish
from slamhive.data.rosmessages import BagWriter
from slamhive.model.errors import DataError
from slamhive.model.sensors import Camera
from slamhive_eval import EvaluationError, read_trajectory, write_tum

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.model.dataset import Dataset

    Array = npt.NDArray[np.float64]

_ENCODINGS = {("uint8", 2): "mono8", ("uint16", 2): "mono16", ("uint8", 3): "bgr8", ("uint16", 3): "bgr16"}
_DISTORTIONS = {"radial-tangential": "RadialTangential", "equidistant": "Equidistant", "none": "None"}
_TRUTHS = (
    "state_groundtruth_estimate0/data.csv",
    "../groundtruth.txt",
    "groundtruth.txt",
)
_BODY = "body"


@dataclass(frozen=True)
class _Camera:
    role: str
    folder: Path
    pose: Array
    rate: float
    intrinsics: Camera
    frames: list[tuple[int, Path]]

    @property
    def topic(self) -> str:
        return f"/{self.folder.name}/image_raw"


@dataclass(frozen=True)
class _Imu:
    folder: Path
    pose: Array
    rate: float
    noise: dict[str, float]
    stamps: npt.NDArray[np.int64]
    samples: Array

    @property
    def topic(self) -> str:
        return f"/{self.folder.name}"


def import_euroc(folder: Path, out: Path, name: str) -> Dataset:
    """Turn a folder in EuRoC's layout into a dataset.

    Args:
        folder: The folder with mav0, or mav0 itself.
        out: Folder to make: dataset.yaml, recording.bag, groundtruth.txt.
        name: Name of the dataset.

    Returns:
        The dataset that is in the folder now. The body frame is the one of its calibration, the IMU's.

    Raises:
        DataError: Something in the folder is missing or damaged.
        InputError: The folder to make exists.
    """
    base = folder / "mav0" if (folder / "mav0").is_dir() else folder
    cameras = _cameras(base)
    imus = [_imu(path) for path in sorted(base.glob("imu[0-9]")) if (path / "data.csv").is_file()][:1]
    if not cameras and not imus:
        raise DataError(
            f"{base}: no cam0/data.csv and no imu0/data.csv in it: not a folder in EuRoC's layout"
        )
    truth = next((base / path for path in _TRUTHS if (base / path).is_file()), None)

    def make(aside: Path) -> None:
        _write_bag(aside / "recording.bag", cameras, imus)
        if truth is not None:
            _write_truth(truth, aside / "groundtruth.txt")

    return publish(out, _manifest(name, cameras, imus, has_truth=truth is not None), make)


def _cameras(base: Path) -> list[_Camera]:
    folders = [path for path in sorted(base.glob("cam[0-9]")) if (path / "data.csv").is_file()]
    roles = ["camera"] if len(folders) == 1 else ["left", "right", *(path.name for path in folders[2:])]
    return [_camera(path, role) for path, role in zip(folders, roles, strict=False)]


def _camera(folder: Path, role: str) -> _Camera:
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
            "encoding": _encoding(_pixels(frames[0][1])),
            "fx": fx,
            "fy": fy,
            "cx": cx,
            "cy": cy,
            "distortion": _DISTORTIONS[distortion],
            "coefficients": _with_k3(coefficients) if distortion == "radial-tangential" else coefficients[:4],
        }
    )
    return _Camera(role, folder, _pose(known, path), float(known.get("rate_hz", 20)), camera, frames)


def _imu(folder: Path) -> _Imu:
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
    return _Imu(folder, _pose(known, path), float(known.get("rate_hz", 200)), noise, stamps, samples)


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


def _pixels(path: Path) -> npt.NDArray[Any]:
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise DataError(f"{path}: can't be decoded as an image")
    return pixels


def _encoding(pixels: npt.NDArray[Any]) -> str:
    return _ENCODINGS.get((pixels.dtype.name, pixels.ndim), "mono8")


def _write_bag(path: Path, cameras: list[_Camera], imus: list[_Imu]) -> None:
    streams: list[list[tuple[int, int, int]]] = []
    streams += [
        [(stamp, -1 - n, k) for k, stamp in enumerate(imu.stamps.tolist())] for n, imu in enumerate(imus)
    ]
    streams += [
        [(stamp, n, k) for k, (stamp, _) in enumerate(camera.frames)] for n, camera in enumerate(cameras)
    ]
    poses = {camera.folder.name: camera.pose for camera in cameras}
    poses |= {imu.folder.name: imu.pose for imu in imus}
    with BagWriter(path) as bag:
        bag.static_transforms(min(stream[0][0] for stream in streams), _BODY, poses)
        for stamp, n, k in heapq.merge(*streams):
            if n < 0:
                imu = imus[-1 - n]
                bag.imu(imu.topic, stamp, imu.folder.name, imu.samples[k, :3], imu.samples[k, 3:])
            else:
                _write_frame(bag, cameras[n], stamp, cameras[n].frames[k][1])


def _write_frame(bag: BagWriter, camera: _Camera, stamp: int, path: Path) -> None:
    pixels, known = _pixels(path), camera.intrinsics
    if pixels.shape[:2] != (known.height, known.width) or _encoding(pixels) != known.encoding:
        raise DataError(
            f"{path}: {pixels.shape[1]}×{pixels.shape[0]} {_encoding(pixels)}, but "
            f"{camera.folder / 'sensor.yaml'} "
            f"and the first image say {known.width}×{known.height} {known.encoding}"
        )
    frame = camera.folder.name
    bag.camera_info(f"/{frame}/camera_info", stamp, frame, known)
    bag.image(camera.topic, stamp, frame, known.encoding, pixels)


def _write_truth(source: Path, target: Path) -> None:
    if source.suffix == ".txt":
        shutil.copyfile(source, target)
        return
    try:
        write_tum(target, read_trajectory(source, "euroc"))
    except EvaluationError as error:
        raise DataError(f"ground truth: {error}") from None


def _manifest(name: str, cameras: list[_Camera], imus: list[_Imu], *, has_truth: bool) -> dict[str, Any]:
    sensors: dict[str, Any] = {
        camera.role: {
            "type": "Camera",
            "topic": camera.topic,
            "frameId": camera.folder.name,
            "rate": camera.rate,
            "T_body_sensor": camera.pose.tolist(),
            "camera": camera.intrinsics.as_json(),
        }
        for camera in cameras
    }
    for imu in imus:
        sensors["imu"] = {
            "type": "Imu",
            "topic": imu.topic,
            "frameId": imu.folder.name,
            "rate": imu.rate,
            "T_body_sensor": imu.pose.tolist(),
            "imu": imu.noise,
        }
    spec = {
        "description": "Imported from a folder in EuRoC's layout.",
        "recording": {"format": "Rosbag1", "files": [{"path": "recording.bag"}]},
        "sensors": sensors,
        "groundTruth": {"file": "groundtruth.txt"} if has_truth else None,
        "gravityAligned": True,
    }
    return {"apiVersion": "slamhive.io/v1alpha1", "kind": "Dataset", "metadata": {"name": name}, "spec": spec}
