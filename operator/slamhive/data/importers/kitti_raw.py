# SPDX-License-Identifier: Apache-2.0
"""Import of drives of KITTI's raw data (_sync): images, velodyne_points, oxts, calibration of the date."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slamhive.data.importers.contents import Contents, ImportedTruth, cloud_stream, imu_stream
from slamhive.data.importers.kitti import HDL_64
from slamhive.data.importers.kitti_cameras import camera_names, kitti_camera, read_calibration
from slamhive.data.importers.poses import rigid, trajectory
from slamhive.data.importers.scans import (
    XYZI,
    lidar_sensor,
    make_points,
    mean_rate,
    numbered_files,
    read_records,
)
from slamhive.data.importers.tables import ascending, nanoseconds, read_table
from slamhive.model.dataset import GroundTruth
from slamhive.model.errors import DataError, InputError
from slamhive.model.sensors import Sensor, Stamp
from slamhive_eval.rotation import from_roll_pitch_yaw

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers import ImportOptions
    from slamhive.data.importers.contents import SensorStream

    Array = npt.NDArray[np.float64]
    Stamps = npt.NDArray[np.int64]

TITLE = "a drive of KITTI's raw data (DATE_drive_NNNN_sync/)"

_BODY = "imu"
_FAST = 50.0
"""Hz; IMU samples that come more rarely are too slow to be integrated between frames."""
_EARTH = 6_378_137.0
"""m, radius of KITTI's Mercator projection."""
_LONGEST = 10**9
"""ns that a turn may last at most."""


class DriveWindow(NamedTuple):
    """Frames of a drive that make up a sequence of the odometry benchmark, first to last inclusive."""

    drive: str
    first: int
    last: int


SEQUENCES = {
    "00": DriveWindow("2011_10_03_drive_0027", 0, 4540),
    "01": DriveWindow("2011_10_03_drive_0042", 0, 1100),
    "02": DriveWindow("2011_10_03_drive_0034", 0, 4660),
    "04": DriveWindow("2011_09_30_drive_0016", 0, 270),
    "05": DriveWindow("2011_09_30_drive_0018", 0, 2760),
    "06": DriveWindow("2011_09_30_drive_0020", 0, 1100),
    "07": DriveWindow("2011_09_30_drive_0027", 0, 1100),
    "08": DriveWindow("2011_09_30_drive_0028", 1100, 5170),
    "09": DriveWindow("2011_09_30_drive_0033", 0, 1590),
    "10": DriveWindow("2011_09_30_drive_0034", 0, 1200),
}
"""The odometry benchmark in the raw data, which lack the drive of 03."""


def recognises(source: Path) -> bool:
    """Tell whether something is a drive, or a folder with drives."""
    is_drive = any((source / name).is_dir() for name in ("velodyne_points", "image_00", "image_02", "oxts"))
    return is_drive or bool(_drives(source))


def read(source: Path, options: ImportOptions) -> Contents:
    """Read a drive; `sequence` names a drive, or a sequence of the odometry benchmark by two digits.

    The body is the IMU (the OXTS: x forward, y left, z up), whose poses are the ground truth.

    Raises:
        DataError: Something is missing or damaged.
        InputError: There are several drives and none, or one that isn't there, is chosen.
    """
    folder, window = _choose(source, options.sequence)
    notes: list[str] = []
    _note_sequences(folder, window, notes)
    calibration = folder.resolve().parent
    T_velo_imu = _motion(calibration / "calib_imu_to_velo.txt")
    T_cam_velo = _motion(calibration / "calib_velo_to_cam.txt")
    T_imu_velo = _inverse(T_velo_imu)
    T_imu_cam = T_imu_velo @ _inverse(T_cam_velo)
    streams = _cameras(folder, calibration / "calib_cam_to_cam.txt", window, T_imu_cam, notes)
    if (folder / "velodyne_points").is_dir():
        streams.append(_scans(folder / "velodyne_points", T_imu_velo, window, notes))
    if not streams:
        raise DataError(f"{folder}: no images in image_00 to image_03 and no velodyne_points")
    ends = [stream.stamps[end] for stream in streams for end in (0, -1)]
    truth = None
    if (folder / "oxts").is_dir():
        imu, truth = _oxts(folder, int(min(ends)), int(max(ends)), notes)
        streams.append(imu)
    else:
        notes.append("no oxts: no IMU and no ground truth")
    notes.append("times are local ones without a zone, and were taken for UTC")
    return Contents(
        description="Imported from a drive of KITTI's raw data.",
        streams=streams,
        truth=truth,
        body=_BODY,
        gravity_aligned=True,
        notes=notes,
    )


def _drives(source: Path) -> list[Path]:
    """Return the drives in a folder, or in those of the dates in it."""
    return sorted([*source.glob("*_drive_*_sync"), *source.glob("*/*_drive_*_sync")])


def _choose(source: Path, sequence: str | None) -> tuple[Path, DriveWindow | None]:
    window = SEQUENCES.get(sequence) if sequence else None
    drives = _drives(source) or [source.resolve()]
    if sequence == "03":
        raise InputError("sequence 03 of the odometry benchmark isn't among the raw data")
    wanted = window.drive if window else sequence
    if wanted is None:
        if len(drives) > 1:
            raise InputError(
                f"{source}: several drives; choose one of: {', '.join(path.name for path in drives)}"
            )
        return drives[0], None
    chosen = [path for path in drives if wanted in path.name]
    if len(chosen) != 1:
        raise InputError(
            f"{source}: {'no' if not chosen else 'more than one'} drive {wanted!r} in it; it has: "
            f"{', '.join(path.name for path in drives)}"
        )
    return chosen[0], window


def _note_sequences(folder: Path, window: DriveWindow | None, notes: list[str]) -> None:
    known = next((key for key, item in SEQUENCES.items() if item.drive in folder.name), None)
    if known is None:
        return
    item = SEQUENCES[known]
    frames = (
        f"frames {item.first} to {item.last} of this drive are sequence {known} of the odometry benchmark"
    )
    notes.append(frames if window else f"{frames}: choose the sequence {known} for these alone")


def _motion(path: Path) -> Array:
    known = read_calibration(path, {"R": 9, "T": 3})
    return rigid(np.column_stack((known["R"].reshape(3, 3), known["T"])), f"{path}: R")


def _inverse(pose: Array) -> Array:
    found = np.linalg.inv(pose)
    found[3] = 0, 0, 0, 1
    return found.astype(np.float64)


def _cameras(
    folder: Path, path: Path, window: DriveWindow | None, T_imu_cam: Array, notes: list[str]
) -> list[SensorStream]:
    """Return the streams of the rectified cameras; T_imu_cam is the pose of the unrectified camera 0."""
    numbers = [number for number in range(4) if (folder / f"image_0{number}").is_dir()]
    if not numbers:
        return []
    keys = {"R_rect_00": 9}
    for number in numbers:
        keys |= {f"P_rect_0{number}": 12, f"S_rect_0{number}": 2}
    known = read_calibration(path, keys)
    turned = np.eye(4)
    turned[:3, :3] = known["R_rect_00"].reshape(3, 3)
    first = T_imu_cam @ _inverse(rigid(turned, f"{path}: R_rect_00"))
    streams = []
    for number, name in camera_names(numbers).items():
        place = folder / f"image_0{number}"
        times = read_times(place / "timestamps.txt")
        files, stamps = _frames(place, ".png", times, window, notes)
        width, height = known[f"S_rect_0{number}"]
        streams.append(
            kitti_camera(
                number,
                name,
                known[f"P_rect_0{number}"].reshape(3, 4),
                stamps,
                files,
                first=first,
                source=path,
                notes=notes,
                size=(int(width), int(height)),
            )
        )
    return streams


def _frames(
    folder: Path, suffix: str, times: dict[int, int], window: DriveWindow | None, notes: list[str]
) -> tuple[list[Path], Stamps]:
    """Return the files of a sensor and their stamps; a file belongs to the line of its number."""
    if not (folder / "data").is_dir():
        raise DataError(f"{folder / 'data'}: does not exist")
    found = numbered_files(folder / "data", suffix)
    if window:
        found = {number: path for number, path in found.items() if window.first <= number <= window.last}
    if not found:
        raise DataError(f"{folder / 'data'}: no files *{suffix} of these frames in it")
    timed = {number: path for number, path in found.items() if number in times}
    if not timed:
        raise DataError(f"{folder / 'data'}: no frame has a time in the files of times beside it")
    if len(timed) < len(found):
        notes.append(f"{folder.name}: {len(found) - len(timed)} frames have no time: left out")
    missing = [number for number in range(min(found), max(found)) if number not in found]
    if missing:
        notes.append(
            f"{folder.name}: {len(missing)} frames have no file (the first is {missing[0]:010}{suffix}); the "
            "others keep their own times"
        )
    stamps = np.array([times[number] for number in timed], dtype=np.int64)
    kept = ascending(stamps, folder, "frames", notes)
    files = [*timed.values()]
    return [files[k] for k in kept], stamps[kept]


def read_times(path: Path) -> dict[int, int]:
    """Return the times of a file of dates ("2011-09-30 12:40:25.123456789") in ns, by line from 0.

    Raises:
        DataError: The file is missing, or a line is no date.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: {getattr(error, 'strerror', None) or 'not a text file'}") from None
    found: dict[int, int] = {}
    for number, line in enumerate(lines):
        if not line.strip():
            continue
        date, _, fraction = line.strip().partition(".")
        try:
            second = datetime.strptime(date, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
            found[number] = int(second.timestamp()) * 10**9 + nanoseconds(f"0.{fraction or 0}", "s")
        except ValueError:
            raise DataError(f"{path}, line {number + 1}: {line.strip()!r} is not a date and time") from None
    if not found:
        raise DataError(f"{path}: no times in it")
    return found


def _scans(folder: Path, pose: Array, window: DriveWindow | None, notes: list[str]) -> SensorStream:
    """Return the LiDAR's stream: a scan's stamp is its start, points have times by their azimuth.

    The scanner turns clockwise, seen from above, and starts backwards: it looks forward, where the cameras
    are triggered, in the middle of the turn.
    """
    start = read_times(folder / "timestamps_start.txt")
    end = read_times(folder / "timestamps_end.txt")
    whole = {k: start[k] for k in start if k in end and 0 < end[k] - start[k] < _LONGEST}
    files, stamps = _frames(folder, ".bin", whole, window, notes)
    ends = {at: end[k] for k, at in whole.items()}
    lengths = np.array([ends[at] - at for at in stamps.tolist()]) / 1e9

    def load(k: int) -> npt.NDArray[np.void]:
        records = read_records(files[k], XYZI)
        share = (np.pi - np.arctan2(records["y"], records["x"])) / (2 * np.pi)
        return make_points(records, time=share * lengths[k])

    notes.append(
        "velodyne_points: not deskewed. A stamp is the start of the turn (timestamps_start.txt; the cameras "
        "are triggered in its middle, timestamps.txt), points' times are by their azimuth from start to "
        "end, as the files have none"
    )
    notes.append(
        "velodyne_points: the HDL-64E's vertical angles are known to be 0.205° off, which KISS-ICP corrects "
        "in its own reader; the points here are as published"
    )
    sensor = lidar_sensor("velodyne", stamps, stamp=Stamp.SCAN_START, pose=pose, lidar=HDL_64, has_times=True)
    return cloud_stream("lidar", sensor, stamps, load)


def _oxts(folder: Path, first: int, last: int, notes: list[str]) -> tuple[SensorStream, ImportedTruth]:
    """Return the IMU's stream and the poses from the first to the last frame.

    The samples of the drive's _extract folder, if it is there, are 100 Hz.
    """
    extract = folder.resolve().parent / folder.resolve().name.replace("_sync", "_extract") / "oxts"
    fast = extract if extract != folder.resolve() / "oxts" and extract.is_dir() else folder / "oxts"
    stamps, values = _packets(fast, first, last, notes)
    rate = mean_rate(stamps)
    if rate is None or rate < _FAST:
        notes.append(
            f"imu: {rate or 0:.0f} Hz in _sync, too slow to be integrated between frames: lidar-inertial and "
            "visual-inertial algorithms need the 100 Hz of the drive's _extract folder beside it"
        )
    declared: dict[str, Any] = {"type": "Imu", "topic": "/imu", "frameId": _BODY, "rate": rate, "imu": {}}
    imu = imu_stream("imu", Sensor.model_validate(declared), stamps, values[:, 17:20], values[:, 11:14])
    latitude, longitude, altitude = values[:, 0], values[:, 1], values[:, 2]
    scale = np.cos(np.radians(latitude[0]))
    positions = np.column_stack(
        (
            scale * _EARTH * np.radians(longitude),
            scale * _EARTH * np.log(np.tan(np.pi / 4 + np.radians(latitude) / 2)),
            altitude,
        )
    )
    rotations = from_roll_pitch_yaw(values[:, 3:6])
    poses = trajectory(fast / "data", stamps, positions - positions[0], rotations)
    notes.append("ground truth: poses of the OXTS by KITTI's Mercator projection, from the first one on")
    return imu, ImportedTruth(GroundTruth(file="groundtruth.txt"), poses)


def _packets(folder: Path, first: int, last: int, notes: list[str]) -> tuple[Stamps, Array]:
    times = read_times(folder / "timestamps.txt")
    files, stamps = _frames(folder, ".txt", times, None, notes)
    # A sample more at either end, so that the frames at the ends lie between two.
    begin = max(int(np.searchsorted(stamps, first, side="right")) - 1, 0)
    stop = min(int(np.searchsorted(stamps, last)) + 1, len(stamps))
    if stop - begin < 1:
        raise DataError(f"{folder}: no samples at the times of the frames")
    meaning = "30 numbers of the OXTS (dataformat.txt)"
    values = [read_table(path, 30, meaning).values[0] for path in files[begin:stop]]
    return stamps[begin:stop], np.array(values)
