# SPDX-License-Identifier: Apache-2.0
"""Import of sequences of Boreas: lidar/US.bin and applanix/lidar_poses.csv."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.importers.contents import Contents, ImportedTruth, cloud_stream
from slamhive.data.importers.poses import rigid, trajectory
from slamhive.data.importers.scans import lidar_sensor, make_points, numbered_files, read_records
from slamhive.data.importers.tables import nanoseconds, read_table, rows
from slamhive.model.dataset import GroundTruth
from slamhive.model.errors import DataError
from slamhive.model.sensors import Stamp
from slamhive_eval.rotation import from_roll_pitch_yaw, to_matrix

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers import ImportOptions
    from slamhive.data.importers.contents import SensorStream
    from slamhive.data.importers.tables import Unit

    Array = npt.NDArray[np.float64]

TITLE = "a sequence of Boreas (lidar/, applanix/)"

POINT = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity", "ring", "time")])
_LIDAR_POSES, _APPLANIX_POSES = "lidar_poses.csv", "gps_post_process.csv"
_EXTRINSIC = "T_applanix_lidar.txt"
_FIRST_MICROSECONDS = 1e12
"""Least stamp in µs, in the second week of 1970; in seconds it would be 30,000 years."""


def recognises(source: Path) -> bool:
    """Tell whether something has lidar/ and applanix/."""
    return (source / "lidar").is_dir() and (source / "applanix").is_dir()


def read(source: Path, options: ImportOptions) -> Contents:  # noqa: ARG001
    """Read a sequence; the body is the LiDAR.

    Raises:
        DataError: Something is missing or damaged.
    """
    notes = [
        (
            "imu: left out, as gravity is removed from its acceleration and its axes are permuted: no "
            "lidar-inertial mode, whose algorithms need gravity"
        ),
        "lidar: a stamp is the middle of the scan, points have times before and after it",
    ]
    left_out = [name for name in ("camera", "radar") if (source / name).is_dir()]
    if left_out:
        notes.append(f"{' and '.join(left_out)}: left out, only the LiDAR is imported")
    return Contents(
        description="Imported from a sequence of Boreas.",
        streams=[_scans(source / "lidar")],
        truth=_truth(source, notes),
        body="lidar",
        gravity_aligned=True,
        notes=notes,
    )


def _scans(folder: Path) -> SensorStream:
    found = numbered_files(folder, ".bin")
    if not found:
        raise DataError(f"{folder}: no files *.bin in it, named by their times in µs")
    stamps = np.array([nanoseconds(str(number), "us") for number in found], dtype=np.int64)
    files = [*found.values()]

    def load(k: int) -> npt.NDArray[np.void]:
        records = read_records(files[k], POINT)
        return make_points(records, time=records["time"], ring=records["ring"])

    known = {"rings": 128, "maxRange": 300.0}
    sensor = lidar_sensor("lidar", stamps, stamp=Stamp.SCAN_MID, lidar=known, has_times=True, has_rings=True)
    return cloud_stream("lidar", sensor, stamps, load)


def _truth(source: Path, notes: list[str]) -> ImportedTruth | None:
    lidar, applanix = source / "applanix" / _LIDAR_POSES, source / "applanix" / _APPLANIX_POSES
    path = next((place for place in (lidar, applanix) if place.is_file()), None)
    if path is None:
        notes.append(f"no ground truth: neither {lidar} nor {applanix} exists")
        return None
    unit = _unit(path)
    table = read_table(path, 9, "t, x, y, z, vx, vy, vz, r, p, y", stamp=unit).ascending("poses", notes)
    manifest = GroundTruth(file="groundtruth.txt")
    if path == applanix:
        extrinsic = source / "calib" / _EXTRINSIC
        matrix = read_table(extrinsic, 4, "4 numbers of a 4×4 matrix").values
        if matrix.shape != (4, 4):
            raise DataError(f"{extrinsic}: 4 rows of a 4×4 matrix are needed, found {len(matrix)}")
        pose = np.linalg.inv(rigid(matrix, str(extrinsic)))
        pose[3] = 0, 0, 0, 1
        manifest = GroundTruth(file="groundtruth.txt", T_body_frame=pose.tolist())
        notes.append(f"ground truth from {_APPLANIX_POSES}, poses of the Applanix; times are in {unit}")
    rotations = rotations_of(table.values[:, 6:9])
    return ImportedTruth(manifest, trajectory(path, table.stamps, table.values[:, :3], rotations))


def _unit(path: Path) -> Unit:
    """Return the unit of the stamps: µs, but s in gps_post_process.csv in spite of its documentation."""
    for _, words in rows(path):
        try:
            return "us" if float(words[0]) > _FIRST_MICROSECONDS else "s"
        except ValueError:
            continue
    return "us"


def rotations_of(angles: Array) -> Array:
    """Return rotations from the sensor to east, north, up, of roll, pitch and yaw as Boreas has them.

    It is the transpose of Rz(yaw)·Ry(pitch)·Rx(roll): Rx(−roll)·Ry(−pitch)·Rz(−yaw).

    Args:
        angles: rad, shape (n, 3).

    Returns:
        Shape (n, 3, 3).
    """
    return to_matrix(from_roll_pitch_yaw(angles)).transpose(0, 2, 1)
