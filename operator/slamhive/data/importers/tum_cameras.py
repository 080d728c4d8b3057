# SPDX-License-Identifier: Apache-2.0
"""Cameras of the datasets in TUM RGB-D's layout: by the name of the camera, or from files beside images."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from slamhive.data.importers.calibrations import matrix_of, read_yaml
from slamhive.model.base import explain
from slamhive.model.errors import DataError
from slamhive.model.sensors import Sensor

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

_DEPTH_SCALE = 5000.0
_LORIS_DEPTH_SCALE = 1000.0
_COLOR, _DEPTH, _SECOND = "rgb", "depth", "rgb2"
_SIZE = {"width": 640, "height": 480}

_FR2 = r"(?:freiburg|fr)2"
_FR2_DEPTH = (
    "depth: 5000 units a metre, as published; ORB-SLAM's settings for freiburg2 say 5208 (depthScale), by "
    "which everything is 4 % smaller"
)
_KNOWN: dict[str, tuple[str, tuple[float, ...], tuple[float, ...]]] = {
    r"(?:freiburg|fr)1": (
        "TUM RGB-D (freiburg1)",
        (517.306408, 516.469215, 318.643040, 255.313989),
        (0.262383, -0.953104, -0.005358, 0.002628, 1.163314),
    ),
    _FR2: (
        "TUM RGB-D (freiburg2)",
        (520.908620, 521.007327, 325.141443, 249.701764),
        (0.231222, -0.784899, -0.003257, -0.000105, 0.917205),
    ),
    r"(?:freiburg|fr)3": ("TUM RGB-D (freiburg3)", (535.4, 539.2, 320.1, 247.6), ()),
    r"rgbd_bonn": (
        "Bonn RGB-D Dynamic",
        (542.822841, 542.576870, 315.593520, 237.756098),
        (0.039903, -0.099343, -0.000730, -0.000144, 0.0),
    ),
}
"""Published calibrations by what the name of a sequence begins or contains: fx fy cx cy, k1 k2 p1 p2 k3."""


@dataclass(frozen=True, eq=False)
class Device:
    """Calibration of one camera or IMU of a dataset in TUM RGB-D's layout.

    Attributes:
        source: The file that says it, or what else does, for messages.
        pose: In the body, (4, 4).
        camera: Fields of a manifest's `camera`, without the encoding; of the size if it is stated.
        depth_scale: Units per metre, of a depth camera.
        imu: Fields of a manifest's `imu`.
        frame: Name of its frame, if it has one.
    """

    source: Path | str
    pose: Array = field(default_factory=lambda: np.eye(4))
    camera: dict[str, Any] | None = None
    depth_scale: float = _DEPTH_SCALE
    imu: dict[str, Any] = field(default_factory=dict)
    frame: str | None = None


@dataclass(frozen=True, eq=False)
class Rig:
    """The sensors of a dataset.

    Attributes:
        family: Whose it is, for the description.
        devices: By ``rgb``, ``rgb2``, ``depth``, ``imu``.
        body: Name of the body frame.
        imu_prefix: What the names of the IMU's files begin with.
        is_left_handed: Whether poses and camera are, as published.
        notes: Sentences about what was assumed.
    """

    family: str
    devices: dict[str, Device]
    body: str = "camera_color"
    imu_prefix: str = ""
    is_left_handed: bool = False
    notes: tuple[str, ...] = ()


def rig_of(source: Path, listed: Path) -> Rig:
    """Return the sensors of a folder, by the calibration in it, its name, or what its list says it is.

    Args:
        source: The folder.
        listed: The list of colour images, whose comments name the recording.

    Raises:
        DataError: A calibration is damaged, or there is none.
    """
    if (source / "trans_matrix.yaml").is_file():
        return _openloris(source)
    if (source / "sensors.yaml").is_file():
        return _loris_or_exported(source)
    if (source / "calibration.txt").is_file():
        return _eth3d(source)
    with listed.open(encoding="utf-8", errors="replace") as file:
        comments = [line for line, _ in zip(file, range(5), strict=False) if line.startswith("#")]
    for name in (source.resolve().name, *comments):
        for pattern, (family, lens, distortion) in _KNOWN.items():
            if re.search(rf"(?<![a-z]){pattern}(?!\d)", name):
                return _published(family, lens, distortion)
    raise DataError(
        f"{source}: no calibration: neither the folder's name nor {listed.name} names a known camera "
        "(freiburg1, freiburg2, freiburg3, rgbd_bonn), and there is no calibration.txt, which holds "
        "fx fy cx cy in one line, nor sensors.yaml"
    )


def icl_nuim(source: Path) -> Rig:
    """Return ICL-NUIM's camera, right-handed: the published fy of -480 belongs to a y axis that points up."""
    camera = _lens((481.20, 480.00, 319.5, 239.5), ()) | _SIZE
    devices = {key: Device(source, camera=camera) for key in (_COLOR, _DEPTH)}
    return Rig("ICL-NUIM", devices, is_left_handed=True)


def _published(family: str, lens: tuple[float, ...], distortion: tuple[float, ...]) -> Rig:
    camera = _lens(lens, distortion) | _SIZE
    source = f"the published calibration of {family}"
    notes = [_FR2_DEPTH] if family == _KNOWN[_FR2][0] else []
    devices = {key: Device(source, camera=camera) for key in (_COLOR, _DEPTH)}
    return Rig(family, devices, notes=tuple(notes))


def _lens(numbers: tuple[float, ...], distortion: tuple[float, ...]) -> dict[str, Any]:
    lens: dict[str, Any] = dict(zip(("fx", "fy", "cx", "cy"), numbers, strict=True))
    return lens | {
        "distortion": "RadialTangential" if distortion else "None",
        "coefficients": list(distortion),
    }


def _eth3d(source: Path) -> Rig:
    """Return ETH3D's cameras: fx fy cx cy in a file each, and the pose of the second one in the first."""
    path = source / "calibration.txt"
    camera = _lens(tuple(_numbers(path, 4)), ())
    devices = {key: Device(path, camera=camera) for key in (_COLOR, _DEPTH)}
    second, between = source / "calibration2.txt", source / "extrinsics_1_2.txt"
    if (source / "rgb2").is_dir():
        pose = np.eye(4)
        pose[:3] = np.array(_numbers(between, 12)).reshape(3, 4)
        devices[_SECOND] = Device(second, pose, _lens(tuple(_numbers(second, 4)), ()))
    notes = []
    if (source / "imu.txt").is_file():
        notes.append("imu.txt is left out: its calibration stands in another file for each camera")
    return Rig("ETH3D SLAM", devices, notes=tuple(notes))


def _numbers(path: Path, count: int) -> list[float]:
    try:
        words = path.read_text(encoding="utf-8-sig").split()
    except FileNotFoundError:
        raise DataError(f"{path} does not exist: it holds {count} numbers of the calibration") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: {getattr(error, 'strerror', None) or 'not a text file'}") from None
    values: list[float] = []
    for word in words:
        try:
            values.append(float(word))
        except ValueError:
            raise DataError(f"{path}: {count} numbers are needed and nothing else, found {word!r}") from None
    if len(values) != count or not np.isfinite(values).all():
        raise DataError(f"{path}: {count} numbers are needed, found {len(values)}")
    return values


def _loris_or_exported(source: Path) -> Rig:
    path = source / "sensors.yaml"
    known = read_yaml(path)
    if "sensors" not in known:
        raise DataError(f"{source / 'trans_matrix.yaml'} does not exist: it holds the poses of {path.name}")
    return _exported(known, path)


def _exported(known: dict[str, Any], path: Path) -> Rig:
    """Return the sensors of a folder that `exporting` wrote, by the roles in its sensors.yaml."""
    roles = {"color": _COLOR, "camera": _COLOR, "left": _COLOR, "depth": _DEPTH, "imu": "imu"}
    devices = {}
    sensors = known["sensors"] if isinstance(known["sensors"], dict) else {}
    for role, stated in sensors.items():
        if role not in roles or not isinstance(stated, dict):
            continue
        try:
            sensor = Sensor.model_validate({key: value for key, value in stated.items() if key != "name"})
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(map(str, (role, *first["loc"])))
            raise DataError(f"{path}: sensors.{place}: {explain(first)}") from None
        pose = np.array(sensor.T_body_sensor, dtype=np.float64)
        camera = sensor.camera.as_json() if sensor.camera else None
        scale = sensor.camera.depth_scale if sensor.camera and sensor.camera.depth_scale else _DEPTH_SCALE
        imu = sensor.imu.as_json() if sensor.imu else {}
        devices[roles[role]] = Device(path, pose, camera, scale, imu, sensor.frame_id)
    if _COLOR not in devices:
        raise DataError(f"{path}: sensors: color or camera is missing")
    return Rig(f"an export of {known.get('dataset')}", devices, body="body")


def _openloris(source: Path) -> Rig:
    """Return OpenLORIS' D435i: sensors.yaml has fx cx fy cy, trans_matrix.yaml poses in parent frames."""
    path, tree = source / "sensors.yaml", source / "trans_matrix.yaml"
    known, poses = read_yaml(path), _frames(read_yaml(tree), tree)
    stated = known.get("d400_color_optical_frame")
    block = stated.get("intrinsics") if isinstance(stated, dict) else None
    values = block.get("data") if isinstance(block, dict) else None
    if not isinstance(stated, dict) or not isinstance(values, list) or len(values) != 4:
        raise DataError(
            f"{path}: d400_color_optical_frame.intrinsics: 4 numbers are needed, found {values!r}"
        )
    fx, cx, fy, cy = map(float, values)
    camera = _lens((fx, fy, cx, cy), ())
    camera |= {key: int(stated[key]) for key in ("width", "height") if key in stated}
    color = _in_base("d400_color_optical_frame", poses, tree)
    devices = {
        _COLOR: Device(path, color, camera, frame="d400_color"),
        # Depth is aligned to the colour camera.
        _DEPTH: Device(path, color, camera, _LORIS_DEPTH_SCALE, frame="d400_aligned_depth"),
    }
    imu = next((name for name in ("d400_gyroscope", "d400_accelerometer", "d400_imu") if name in poses), None)
    if imu is not None:
        devices["imu"] = Device(path, _in_base(imu, poses, tree), frame="d400_imu")
    notes = ["the fisheye cameras, the T265's IMU and the odometry are left out; the D435i is imported"]
    if (source / "d400_gyroscope.txt").is_file():
        notes.append("imu: noise is not stated; typical noise is assumed. Forces are interpolated")
    return Rig("OpenLORIS-Scene", devices, "base_link", "d400_", notes=tuple(notes))


def _frames(known: dict[str, Any], path: Path) -> dict[str, tuple[str, Array]]:
    """Return frames by name: the parent, and the pose in it."""
    entries = known.get("trans_matrix")
    if not isinstance(entries, list):
        raise DataError(f"{path}: trans_matrix: a list of parent_frame, child_frame and matrix is needed")
    found = {}
    for entry in entries:
        child, parent = str(entry.get("child_frame")), str(entry.get("parent_frame"))
        found[child] = parent, matrix_of(entry.get("matrix"), f"trans_matrix of {child}", path)
    return found


def _in_base(name: str, frames: dict[str, tuple[str, Array]], path: Path) -> Array:
    """Return the pose of a frame in base_link, over any number of parents."""
    pose, at = np.eye(4), name
    for _ in range(len(frames) + 1):
        if at == "base_link":
            return pose
        if at not in frames:
            break
        parent, step = frames[at]
        pose, at = step @ pose, parent
    raise DataError(f"{path}: no way from {name} to base_link: {at} has no parent")
