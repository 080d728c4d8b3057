# SPDX-License-Identifier: Apache-2.0
"""Import of sequences of KITTI odometry: image_0 to image_3, velodyne, calib.txt, times.txt and poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import yaml

from slamhive.data.importers.contents import Contents, ImportedTruth, cloud_stream
from slamhive.data.importers.kitti_cameras import camera_names, kitti_camera, read_calibration
from slamhive.data.importers.poses import from_rows, rigid
from slamhive.data.importers.scans import XYZI, lidar_sensor, make_points, numbered_files, read_records
from slamhive.data.importers.tables import ascending, read_table, rows
from slamhive.model.configuration import SensorView
from slamhive.model.dataset import GroundTruth
from slamhive.model.errors import DataError, InputError
from slamhive.model.sensors import Stamp

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers import ImportOptions
    from slamhive.data.importers.contents import SensorStream

    Array = npt.NDArray[np.float64]
    Stamps = npt.NDArray[np.int64]

TITLE = "a sequence of KITTI odometry (image_0, velodyne, calib.txt, times.txt)"
CLOCK_START = 10**9
"""ns that are added where a clock begins with 0: a header stamp of 0 means that there is none."""
HDL_64 = {"rings": 64, "maxRange": 120.0}

_BODY = "cam0"
_IMAGES = {number: f"image_{number}" for number in range(4)}
_SCANS = "velodyne"
_TIMES, _CALIBRATION = "times.txt", "calib.txt"
_STAMPS, _SENSORS, _POSES = "frames.txt", "sensors.yaml", "groundtruth.txt"
"""Files that `slamhive dataset export` writes beside: stamps in ns, calibration, poses of the body."""


def recognises(source: Path) -> bool:
    """Tell whether something is a sequence, or a folder with sequences/."""
    if (source / "sequences").is_dir() or (source / "dataset" / "sequences").is_dir():
        return True
    has_data = any((source / name).is_dir() for name in (*_IMAGES.values(), _SCANS))
    return has_data and any((source / name).is_file() for name in (_TIMES, _CALIBRATION))


def read(source: Path, options: ImportOptions) -> Contents:
    """Read a sequence: its own folder, or one that holds sequences/ and poses/.

    The body is the rectified left grey camera (camera 0), whose poses KITTI gives. A frame belongs to
    the line of times.txt by the number in its name, so a missing image moves no other.

    Raises:
        DataError: Something is missing or damaged.
        InputError: There are several sequences and none, or one that isn't there, is chosen.
    """
    folder = sequence_folder(source, options.sequence)
    exported = _exported(folder)
    notes: list[str] = []
    stamps, kept = _stamps(folder, notes)
    frames = {name: _frames(folder / name, stamps, kept, notes) for name in (*_IMAGES.values(), _SCANS)}
    if not any(frames.values()):
        raise DataError(f"{folder}: no images in image_0 to image_3 and no scans in velodyne")
    numbers = [number for number, name in _IMAGES.items() if frames[name]]
    keys = {f"P{number}": 12 for number in numbers} | ({"Tr": 12} if frames[_SCANS] else {})
    path = folder / _CALIBRATION
    known = {key: values.reshape(3, 4) for key, values in read_calibration(path, keys).items()}
    streams = [
        kitti_camera(
            number,
            name,
            known[f"P{number}"],
            stamps[[*frames[_IMAGES[number]]]],
            [*frames[_IMAGES[number]].values()],
            first=np.eye(4),
            source=path,
            notes=notes,
        )
        for number, name in camera_names(numbers).items()
    ]
    if frames[_SCANS]:
        pose = rigid(known["Tr"], f"{path}: Tr")
        streams.append(_scans(frames[_SCANS], stamps, pose, exported, notes))
    return Contents(
        description="Imported from a sequence of KITTI odometry.",
        streams=streams,
        truth=_truth(folder, stamps, kept, exported, notes),
        body=_BODY,
        notes=notes,
    )


def sequence_folder(source: Path, sequence: str | None) -> Path:
    """Return the folder of the sequence that is chosen, or of the only one.

    Raises:
        DataError: There is none.
        InputError: The one that is chosen isn't there, or there are several and none is chosen.
    """
    root = next(
        (path for path in (source / "sequences", source / "dataset" / "sequences") if path.is_dir()), None
    )
    if root is None:
        if sequence is not None and source.resolve().name != sequence:
            raise InputError(f"{source}: one sequence, {source.resolve().name}; {sequence!r} isn't in it")
        return source
    known = sorted(path.name for path in root.iterdir() if path.is_dir())
    if not known:
        raise DataError(f"{root}: no sequences in it")
    if sequence is None and len(known) > 1:
        raise InputError(f"{source}: several sequences; choose one of: {', '.join(known)}")
    if sequence is not None and sequence not in known:
        raise InputError(f"{source}: no sequence {sequence!r} in it; it has: {', '.join(known)}")
    return root / (sequence or known[0])


def _stamps(folder: Path, notes: list[str]) -> tuple[Stamps, npt.NDArray[np.bool_]]:
    """Return the stamps of the lines of times.txt, ns, and which of them ascend, shapes (n,)."""
    table = read_table(folder / _TIMES, 0, "a time in s", stamp="s")
    stamps = table.stamps
    kept = np.zeros(len(stamps), dtype=np.bool_)
    kept[ascending(stamps, table.path, "frames", notes, table.lines)] = True
    if (folder / _STAMPS).is_file():
        exact = read_table(folder / _STAMPS, 0, "a stamp in ns", stamp="ns").stamps
        if len(exact) != len(stamps):
            raise DataError(f"{folder / _STAMPS}: {len(exact)} stamps, but {len(stamps)} times in {_TIMES}")
        return exact, kept
    if stamps[0] < CLOCK_START:
        stamps = stamps + CLOCK_START
        notes.append(
            f"{_TIMES} begins with 0, and a stamp of 0 means none: 1 s was added to all times, those of the "
            "ground truth too"
        )
    return stamps, kept


def _frames(folder: Path, stamps: Stamps, kept: npt.NDArray[np.bool_], notes: list[str]) -> dict[int, Path]:
    """Return the files of a sensor by the number of their frame, without those whose stamp doesn't ascend."""
    suffix = ".bin" if folder.name == _SCANS else ".png"
    found = numbered_files(folder, suffix)
    if not found:
        return {}
    last = max(found)
    if last >= len(stamps):
        raise DataError(f"{found[last]}: frame {last} has no line in {_TIMES}, which has {len(stamps)}")
    missing = [number for number in range(len(stamps)) if number not in found]
    if missing:
        notes.append(
            f"{folder.name}: {len(missing)} of {len(stamps)} frames have no file (the first is "
            f"{missing[0]:06}{suffix}); the others keep their own times"
        )
    return {number: path for number, path in found.items() if kept[number]}


def _scans(
    frames: dict[int, Path], stamps: Stamps, pose: Array, exported: dict[str, SensorView], notes: list[str]
) -> SensorStream:
    files, times = [*frames.values()], stamps[[*frames]]
    declared = exported.get("lidar")
    if declared is None:
        notes.append(
            "velodyne: KITTI's clouds are deskewed already, and points have no times: algorithms must not "
            "deskew them again"
        )
        notes.append(
            "velodyne: taken for KITTI's HDL-64E (64 rings, up to 120 m). Its vertical angles are known to "
            "be 0.205° off, which KISS-ICP corrects in its own reader; the points here are as published"
        )
    sensor = lidar_sensor(
        _SCANS,
        times,
        stamp=declared.stamp if declared else Stamp.SAMPLE,
        pose=pose,
        lidar=HDL_64 if declared is None else declared.lidar.as_json() if declared.lidar else {},
    )
    return cloud_stream("lidar", sensor, times, lambda k: make_points(read_records(files[k], XYZI)))


def _truth(
    folder: Path,
    stamps: Stamps,
    kept: npt.NDArray[np.bool_],
    exported: dict[str, SensorView],
    notes: list[str],
) -> ImportedTruth | None:
    if exported and (folder / _POSES).is_file():
        return ImportedTruth(GroundTruth(file=_POSES, T_body_frame=_first_frame(exported)), folder / _POSES)
    name = folder.resolve().name
    places = (folder.resolve().parents[1] / "poses" / f"{name}.txt", folder / "poses.txt")
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        notes.append(
            f"no ground truth: neither {places[0]} nor {places[1]} exists (KITTI has it of 00 to 10)"
        )
        return None
    frames, matrices = _poses(path, len(stamps), folder / _TIMES)
    chosen = kept[frames]
    return ImportedTruth(
        GroundTruth(file=_POSES), from_rows(path, stamps[frames[chosen]], matrices[chosen].reshape(-1, 12))
    )


def _poses(path: Path, count: int, times: Path) -> tuple[npt.NDArray[np.intp], Array]:
    """Return numbers of frames and their matrices, shapes (n,) and (n, 12): of 13 columns the first numbers.

    Raises:
        DataError: A frame has no time, or without numbers there are fewer or more poses than times.
    """
    numbered = len(next((words for _, words in rows(path)), [])) > 12
    meaning = "12 numbers, a 3×4 matrix row by row"
    if not numbered:
        table = read_table(path, 12, meaning)
        if len(table.values) != count:
            raise DataError(f"{path}: {len(table.values)} poses, but {count} times in {times}")
        return np.arange(count), table.values
    table = read_table(path, 13, f"the number of a frame and {meaning}")
    frames = table.values[:, 0]
    wrong = np.flatnonzero((frames != np.rint(frames)) | (frames < 0) | (frames >= count))
    wrong = np.union1d(wrong, np.flatnonzero(np.diff(frames) <= 0) + 1)
    if wrong.size:
        first = int(wrong[0])
        raise DataError(
            f"{path}, line {table.lines[first]}: frame {frames[first]:g}: expected ascending numbers of "
            f"frames from 0 to {count - 1}, as {times} has {count} times"
        )
    return frames.astype(np.intp), table.values[:, 1:]


def _exported(folder: Path) -> dict[str, SensorView]:
    """Return the sensors by role of a folder that `slamhive dataset export` wrote; of others, none."""
    path = folder / _SENSORS
    if not path.is_file():
        return {}
    try:
        sensors = yaml.safe_load(path.read_text(encoding="utf-8"))["sensors"]
        return {str(role): SensorView.model_validate(view) for role, view in sensors.items()}
    except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError, ValueError):
        raise DataError(f"{path}: not the sensors.yaml that `slamhive dataset export` writes") from None


def _first_frame(exported: dict[str, SensorView]) -> list[list[float]]:
    """Return the pose of an exported dataset's body in its first camera, or else its LiDAR: (4, 4)."""
    first = next(role for role in ("left", "camera", "lidar") if role in exported)
    pose = np.linalg.inv(np.array(exported[first].T_body_sensor))
    pose[3] = 0, 0, 0, 1
    found: list[list[float]] = (pose + 0.0).tolist()
    return found
