# SPDX-License-Identifier: Apache-2.0
"""Import of folders in the layout of the TUM RGB-D benchmark, and of those that others publish in it.

``rgb.txt``, ``depth.txt`` and ``groundtruth.txt``: TUM, Bonn, ETH3D SLAM, ICL-NUIM and OpenLORIS, and what
`exporting` writes. `tum_cameras` knows their cameras. Colour and depth keep stamps of their own: they are
paired where a recording is prepared.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slamhive.data.importers import tum_cameras
from slamhive.data.importers.contents import (
    Contents,
    ImportedTruth,
    SensorStream,
    camera_encoding,
    camera_stream,
    imu_stream,
    measured_rate,
    read_pixels,
)
from slamhive.data.importers.lists import Images, read_images
from slamhive.data.importers.sequences import sequence_folder
from slamhive.data.importers.tables import read_table
from slamhive.model.dataset import GroundTruth
from slamhive.model.errors import DataError
from slamhive.model.sensors import Sensor, SensorType
from slamhive_eval import EvaluationError, Trajectory, read_trajectory

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.importers import ImportOptions
    from slamhive.data.importers.tables import NumberTable
    from slamhive.data.importers.tum_cameras import Device, Rig

TITLE = (
    "a folder in the layout of TUM RGB-D (rgb.txt, depth.txt), also Bonn's, ETH3D's, ICL-NUIM's, OpenLORIS'"
)

_LISTS = ("rgb.txt", "color.txt", "depth.txt", "aligned_depth.txt")
_FRAME_RATE = 30
"""Of ICL-NUIM, which has numbers of frames instead of stamps."""
_FIRST_STAMP = 10**9
"""ns of ICL-NUIM's frame 0: a stamp of 0 would mean none."""
_MIRROR = np.diag([1.0, -1.0, 1.0])


class _Lists(NamedTuple):
    """Paths of a folder's lists of images; None where there is no such camera."""

    color: Path
    depth: Path | None


def recognises(source: Path) -> bool:
    """Tell whether something is a folder with a list of images, or ICL-NUIM's folders, or has such in it."""
    return _is_sequence(source) or any(next(source.glob(f"*/{name}"), None) for name in _LISTS)


def _is_sequence(source: Path) -> bool:
    return any((source / name).is_file() for name in _LISTS) or _is_numbered(source)


def read(source: Path, options: ImportOptions) -> Contents:
    """Read a folder in the layout of TUM RGB-D, or one of several.

    The body is the colour camera, for OpenLORIS the robot's base, whose ground truth they have.

    Raises:
        DataError: Something in the folder is missing or damaged.
        InputError: There are several sequences in it, and none is chosen.
    """
    source = sequence_folder(source, options.sequence, _is_sequence)
    notes: list[str] = []
    if _is_numbered(source):
        images = {"rgb": _numbered(source / "rgb")}
        images["depth"] = _numbered(source / "depth")
        rig = tum_cameras.icl_nuim(source)
        notes.append(
            f"frame n is stamped 1 s + n / {_FRAME_RATE} Hz; y of the poses is turned round and fy made "
            "positive: the published camera is left-handed"
        )
    else:
        lists = _lists(source, notes)
        images = {"rgb": read_images(lists.color, source, "s")}
        if lists.depth is not None:
            images["depth"] = read_images(lists.depth, source, "s")
        rig = tum_cameras.rig_of(source, lists.color)
        second = source / "rgb2.txt"
        if "rgb2" in rig.devices:
            paths = [source / "rgb2" / path.name for path in images["rgb"].files]
            images["rgb2"] = (
                read_images(second, source, "s")
                if second.is_file()
                else _same_names(images["rgb"], paths, notes)
            )
    notes += [note for found in images.values() for note in found.notes]
    roles = _roles(images)
    streams = [_camera(roles[key], key, images[key], rig.devices[key], notes) for key in roles]
    streams += _imu(source, rig, notes)
    return Contents(
        description=f"Imported from {rig.family}.",
        streams=streams,
        truth=_truth(source, rig, notes),
        body=rig.body,
        notes=notes + list(rig.notes),
    )


def _lists(source: Path, notes: list[str]) -> _Lists:
    """Return the lists of colour and depth; one that is missing though its images are there is named."""
    is_loris = (source / "color.txt").is_file() or (source / "aligned_depth.txt").is_file()
    names = ("color", "aligned_depth") if is_loris else ("rgb", "depth")
    color, depth = (source / f"{name}.txt" for name in names)
    if not color.is_file():
        raise DataError(f"{color} does not exist: it lists the colour images and their stamps")
    if depth.is_file():
        return _Lists(color, depth)
    if (source / names[1]).is_dir() or is_loris:
        raise DataError(f"{depth} does not exist: it lists the depth images and their stamps")
    notes.append(f"no {depth.name} and no folder {names[1]}: imported without depth")
    return _Lists(color, None)


def _is_numbered(source: Path) -> bool:
    """Tell whether images are numbered instead of listed, as ICL-NUIM's are."""
    if not (source / "rgb").is_dir() or (source / "rgb.txt").is_file() or (source / "depth.txt").is_file():
        return False
    return (source / "rgb" / "0.png").is_file() or (source / "rgb" / "1.png").is_file()


def _numbered(folder: Path) -> Images:
    numbers = sorted(int(path.stem) for path in folder.glob("*.png") if path.stem.isdigit())
    if not numbers:
        raise DataError(f"{folder}: no images 0.png, 1.png and so on in it")
    stamps = np.array([_frame_stamp(number) for number in numbers], dtype=np.int64)
    return Images(stamps, [folder / f"{number}.png" for number in numbers], [])


def _frame_stamp(number: int) -> int:
    return _FIRST_STAMP + round(number * 10**9 / _FRAME_RATE)


def _same_names(first: Images, paths: list[Path], notes: list[str]) -> Images:
    """Return the images of a second camera that has no list but the names and stamps of the first."""
    there = np.array([path.is_file() for path in paths], dtype=np.bool_)
    if 2 * int(there.sum()) < len(paths):
        missing = paths[int(np.argmin(there))]
        raise DataError(f"{missing} does not exist: rgb2 needs the images of rgb.txt")
    if not there.all():
        notes.append(f"{paths[0].parent}: {int((~there).sum())} of {len(paths)} images do not exist")
    return Images(first.stamps[there], [path for path, kept in zip(paths, there, strict=True) if kept], [])


def _roles(images: dict[str, Images]) -> dict[str, str]:
    """Return the roles of the cameras; of ETH3D's two the second one is on the left."""
    if "depth" in images:
        return {"rgb": "color", "depth": "depth"} | ({"rgb2": "color2"} if "rgb2" in images else {})
    return {"rgb2": "left", "rgb": "right"} if "rgb2" in images else {"rgb": "camera"}


def _camera(role: str, key: str, images: Images, device: Device, notes: list[str]) -> SensorStream:
    pixels = read_pixels(images.files[0])
    kind = SensorType.DEPTH_CAMERA if key == "depth" else SensorType.CAMERA
    camera = dict(device.camera or {})
    # Without a size in the calibration, images of another size can't be told from wrong ones.
    camera = {"width": pixels.shape[1], "height": pixels.shape[0]} | camera
    if kind is SensorType.DEPTH_CAMERA:
        camera |= {"encoding": "16UC1", "depthScale": device.depth_scale}
    else:
        camera |= {"encoding": camera_encoding(images.files[0], role, notes)}
    sensor = Sensor.model_validate(
        {
            "type": kind,
            "topic": f"/{role}/image_raw",
            "frameId": role if device.frame is None else device.frame,
            "rate": measured_rate(images.stamps),
            "T_body_sensor": device.pose.tolist(),
            "camera": camera,
        }
    )
    return camera_stream(role, sensor, images.stamps, images.files, device.source)


def _imu(source: Path, rig: Rig, notes: list[str]) -> list[SensorStream]:
    """Read an IMU of two files, its forces interpolated at the stamps of its rates."""
    force_path, rate_path = (
        source / f"{rig.imu_prefix}{name}.txt" for name in ("accelerometer", "gyroscope")
    )
    if not force_path.is_file() and not rate_path.is_file():
        return []
    if not rate_path.is_file():
        notes.append(f"{force_path.name} is left out: without a gyroscope it is no IMU that programs take")
        return []
    rates, forces = (
        read_table(path, 3, "a stamp in s and three numbers", stamp="s").ascending("samples", notes)
        for path in (rate_path, force_path)
    )
    rates, values = interpolated(rates, forces)
    if not rates.stamps.size:
        raise DataError(f"{force_path} and {rate_path}: no time in common")
    device = rig.devices.get("imu")
    pose = np.eye(4) if device is None else device.pose
    if device is None:
        notes.append("imu: its pose and noise are not stated; it is taken to be in the colour camera")
    sensor = Sensor.model_validate(
        {
            "type": "Imu",
            "topic": "/imu",
            "frameId": "imu" if device is None or device.frame is None else device.frame,
            "rate": measured_rate(rates.stamps),
            "T_body_sensor": pose.tolist(),
            "imu": {} if device is None else device.imu,
        }
    )
    return [imu_stream("imu", sensor, rates.stamps, rates.values, values)]


def interpolated(
    rates: NumberTable, forces: NumberTable
) -> tuple[NumberTable, np.ndarray[tuple[int, int], np.dtype[np.float64]]]:
    """Return the rates within the time of the forces, and the forces at their stamps, shape (n, 3)."""
    first, last = forces.stamps[0], forces.stamps[-1]
    inside = (rates.stamps >= first) & (rates.stamps <= last)
    kept = rates.rows(np.flatnonzero(inside))
    # Stamps in ns need more digits than float64 has: times are taken from the first one.
    at, known = (kept.stamps - first).astype(np.float64), (forces.stamps - first).astype(np.float64)
    return kept, np.column_stack([np.interp(at, known, forces.values[:, k]) for k in range(3)])


def _truth(source: Path, rig: Rig, notes: list[str]) -> ImportedTruth | None:
    manifest = GroundTruth(file="groundtruth.txt")
    numbered = sorted(source.glob("*.gt.freiburg"))
    try:
        if numbered:
            return ImportedTruth(manifest, right_handed(numbered[0]))
        path = source / "groundtruth.txt"
        if not path.is_file():
            if not rig.is_left_handed:
                notes.append("no groundtruth.txt: runs can't be measured")
            else:
                notes.append(f"no *.gt.freiburg in {source}: runs can't be measured")
            return None
        read_trajectory(path, "tum")
    except EvaluationError as error:
        raise DataError(f"ground truth: {error}") from None
    return ImportedTruth(manifest, path)


def right_handed(path: Path) -> Trajectory:
    """Read ICL-NUIM's poses, of numbered frames and a left-handed camera, as stamped right-handed ones.

    With M = diag(1, -1, 1), a pose (R, t) becomes (M R M, M t): y turns round in camera and world. Pixels
    are the same, as fy = -480 with y up is fy = 480 with y down.

    Raises:
        EvaluationError: It is damaged.
    """
    poses = read_trajectory(path, "tum")
    numbers = np.rint(poses.stamps).astype(np.int64)
    if re.search(r"[1-9]", f"{np.abs(poses.stamps - numbers).max():.6f}"):
        raise DataError(f"{path}: the first column must be the number of a frame")
    stamps = np.array([_frame_stamp(number) for number in numbers.tolist()]) / 1e9
    turned = poses.quaternions * np.array([-1.0, 1.0, -1.0, 1.0])
    return Trajectory(stamps, poses.positions @ _MIRROR, turned)
