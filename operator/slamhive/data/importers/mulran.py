# SPDX-License-Identifier: Apache-2.0
"""Import of sequences of MulRan: Ouster/NS.bin, global_pose.csv, xsens_imu.csv."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.importers.contents import Contents, ImportedTruth, cloud_stream
from slamhive.data.importers.poses import from_rows, translation
from slamhive.data.importers.scans import XYZI, lidar_sensor, make_points, read_records, stamped_files
from slamhive.data.importers.tables import read_table
from slamhive.data.importers.xsens import xsens_stream
from slamhive.model.dataset import GroundTruth
from slamhive.model.errors import DataError
from slamhive.model.sensors import Stamp

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers import ImportOptions
    from slamhive.data.importers.contents import SensorStream

TITLE = "a sequence of MulRan (Ouster/, global_pose.csv)"

RINGS, COLUMNS, SCAN_SECONDS = 64, 1024, 0.1
_LIDAR_YAW = np.radians(179.6654)
_POSES, _IMU = "global_pose.csv", "xsens_imu.csv"


def recognises(source: Path) -> bool:
    """Tell whether something has scans in Ouster/, itself or in sensor_data/, and files of MulRan."""
    known = (_POSES, _IMU, "data_stamp.csv", "ouster_front_stamp.csv")
    is_helipr = any((source / name).exists() for name in ("LiDAR_GT", "Ouster_gt.txt", "Inertial_data"))
    scans = _found(source, "Ouster")
    return scans is not None and not is_helipr and any(_found(source, name) for name in known)


def read(source: Path, options: ImportOptions) -> Contents:  # noqa: ARG001
    """Read a sequence. The body is the base of the vehicle, whose poses global_pose.csv has in UTM.

    Scans are organised, 1,024 columns of 64 points, from which come the points' rings and times; one with
    fewer points is left out, as nothing says which are missing.

    Raises:
        DataError: Something is missing or damaged.
    """
    folder = _found(source, "Ouster")
    if folder is None:
        raise DataError(f"{source}: no folder Ouster in it or in its sensor_data")
    notes = [
        (
            "Ouster: a stamp is taken for the start of the scan, point i for one of column i/64 of 1024 in "
            "0.1 s, as KISS-ICP does: the files don't say"
        )
    ]
    streams = [_scans(folder, notes)]
    path = _found(source, _IMU)
    imu = xsens_stream(path, translation(-0.07, 0.0, 1.7), notes) if path else None
    if path is None:
        notes.append(f"no {_IMU} in {source} or its sensor_data: no IMU")
    if imu is not None:
        streams.append(imu)
    return Contents(
        description="Imported from a sequence of MulRan.",
        streams=streams,
        truth=_truth(source, notes),
        body="base_link",
        gravity_aligned=True,
        notes=notes,
    )


def _found(source: Path, name: str) -> Path | None:
    return next((path for path in (source / name, source / "sensor_data" / name) if path.exists()), None)


def _scans(folder: Path, notes: list[str]) -> SensorStream:
    files, stamps = stamped_files(folder, "ns")
    whole = [path.stat().st_size == RINGS * COLUMNS * XYZI.itemsize for path in files]
    if not any(whole):
        raise DataError(f"{folder}: no scan of {COLUMNS}×{RINGS} points of {XYZI.itemsize} bytes in it")
    if not all(whole):
        first = files[whole.index(False)].name
        notes.append(
            f"Ouster: {whole.count(False)} of {len(files)} scans haven't {COLUMNS}×{RINGS} points (the first "
            f"is {first}), and nothing says which are missing: left out"
        )
    files = [path for path, is_whole in zip(files, whole, strict=True) if is_whole]
    stamps = stamps[np.array(whole)]
    pose = translation(1.7042, -0.021, 1.8047)
    cosine, sine = np.cos(_LIDAR_YAW), np.sin(_LIDAR_YAW)
    pose[:2, :2] = [[cosine, -sine], [sine, cosine]]
    index = np.arange(RINGS * COLUMNS)
    times = (index // RINGS * (SCAN_SECONDS / COLUMNS)).astype(np.float32)
    rings = (index % RINGS).astype(np.uint16)

    def load(k: int) -> npt.NDArray[np.void]:
        return make_points(read_records(files[k], XYZI), time=times, ring=rings)

    known = {"rings": RINGS, "columns": COLUMNS, "maxRange": 120.0}
    sensor = lidar_sensor(
        "ouster", stamps, stamp=Stamp.SCAN_START, pose=pose, lidar=known, has_times=True, has_rings=True
    )
    return cloud_stream("lidar", sensor, stamps, load)


def _truth(source: Path, notes: list[str]) -> ImportedTruth | None:
    path = _found(source, _POSES)
    if path is None:
        notes.append(f"no {_POSES} in {source} or its sensor_data: no ground truth")
        return None
    table = read_table(path, 12, "a stamp in ns and 12 numbers, a 3×4 matrix row by row", stamp="ns")
    table = table.ascending("poses", notes)
    return ImportedTruth(GroundTruth(file="groundtruth.txt"), from_rows(path, table.stamps, table.values))
