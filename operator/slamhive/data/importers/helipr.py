# SPDX-License-Identifier: Apache-2.0
"""Import of sequences of HeLiPR: LiDAR/Ouster, Velodyne, Avia or Aeva, their poses, xsens_imu.csv."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slamhive.data.importers.contents import Contents, ImportedTruth, cloud_stream
from slamhive.data.importers.poses import trajectory
from slamhive.data.importers.scans import lidar_sensor, make_points, read_records, stamped_files
from slamhive.data.importers.tables import read_table
from slamhive.data.importers.xsens import xsens_stream
from slamhive.model.dataset import GroundTruth
from slamhive.model.errors import DataError, InputError
from slamhive.model.sensors import Stamp

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers import ImportOptions
    from slamhive.data.importers.contents import SensorStream

    Array = npt.NDArray[np.float64]
    Records = npt.NDArray[np.void]

TITLE = "a sequence of HeLiPR (LiDAR/, LiDAR_GT/)"

LAST_SHORT_AEVA = 1691936557946849179
"""ns: from the next scan on, the Aeva's points have an intensity behind their other fields."""

T_IMU_OUSTER = (
    (0.999715495593027, 0.0223448061210468, -0.00834490926264448, -0.41696532),
    (-0.0224514077723064, 0.999664614804883, -0.0129070599303583, -0.00301141),
    (0.00805370475188661, 0.0130907427756056, 0.999881878170293, 0.2996),
    (0.0, 0.0, 0.0, 1.0),
)
"""Pose of the Ouster in the IMU, as evalio has it."""

_XYZ = [(axis, "<f4") for axis in "xyz"]


class LidarFormat(NamedTuple):
    """Format of one LiDAR's scans in HeLiPR: fields of a point, unit of time, entry for the manifest.

    Attributes:
        dtype: Of a point in its files, without padding.
        intensity: Name of the field.
        time: Name of the field.
        seconds: Seconds of a unit of the time.
        ring: Name of the field.
        lidar: As in the manifest.
    """

    dtype: np.dtype[Any]
    intensity: str
    time: str
    seconds: float
    ring: str
    lidar: dict[str, Any]


_AEVA_SHORT = [*_XYZ, ("reflectivity", "<f4"), ("velocity", "<f4"), ("t", "<i4"), ("ring", "u1")]
DEVICES = {
    "Ouster": LidarFormat(
        np.dtype(
            [
                *(*_XYZ, ("intensity", "<f4"), ("t", "<u4")),
                *((name, "<u2") for name in ("reflectivity", "ring", "ambient")),
            ]
        ),
        "intensity",
        "t",
        1e-9,
        "ring",
        {"rings": 128, "columns": 1024, "minRange": 1.0, "maxRange": 200.0},
    ),
    "Velodyne": LidarFormat(
        np.dtype([*_XYZ, ("intensity", "<f4"), ("ring", "<u2"), ("t", "<f4")]),
        "intensity",
        "t",
        1.0,
        "ring",
        {"rings": 16, "maxRange": 100.0},
    ),
    "Avia": LidarFormat(
        np.dtype([*_XYZ, ("reflectivity", "u1"), ("tag", "u1"), ("ring", "u1"), ("t", "<u4")]),
        "reflectivity",
        "t",
        1e-9,
        "ring",
        {"rings": 6},
    ),
    "Aeva": LidarFormat(np.dtype([*_AEVA_SHORT, ("intensity", "<f4")]), "intensity", "t", 1e-9, "ring", {}),
}
"""In the order in which one is chosen."""


def recognises(source: Path) -> bool:
    """Tell whether something has scans of one of the LiDARs, in LiDAR/ or beside files of HeLiPR."""
    beside = any((source / name).exists() for name in ("LiDAR_GT", "Inertial_data", "Ouster_gt.txt"))
    return any(
        (source / "LiDAR" / name).is_dir() or (beside and (source / name).is_dir()) for name in DEVICES
    )


def read(source: Path, options: ImportOptions) -> Contents:
    """Read the scans of one LiDAR, the first there is or the one that `sequence` names; it is the body.

    Each LiDAR has ground truth of its own, and the folder doesn't say how they are mounted to each other.

    Raises:
        DataError: Something is missing or damaged.
        InputError: The chosen LiDAR isn't there.
    """
    folders = {name: folder for name in DEVICES if (folder := _scan_folder(source, name)) is not None}
    if not folders:
        raise DataError(f"{source}: no scans in LiDAR/{', LiDAR/'.join(DEVICES)}")
    chosen = options.sequence or next(iter(folders))
    if chosen not in folders:
        raise InputError(f"{source}: no LiDAR {chosen!r} in it; it has: {', '.join(folders)}")
    notes = [f"{chosen}: a stamp is taken for the start of the scan: the files don't say"]
    if len(folders) > 1:
        notes.append(
            f"of the LiDARs {', '.join(folders)} {chosen} was imported; another is chosen as the sequence. "
            "The folder doesn't say how they are mounted to each other"
        )
    streams = [_scans(chosen, folders[chosen])]
    imu = _imu(source, chosen, notes)
    if imu is not None:
        streams.append(imu)
    return Contents(
        description=f"Imported from a sequence of HeLiPR, its {chosen}.",
        streams=streams,
        truth=_truth(source, chosen, notes),
        body=chosen.lower(),
        gravity_aligned=True,
        notes=notes,
    )


def _scan_folder(source: Path, name: str) -> Path | None:
    return next((path for path in (source / "LiDAR" / name, source / name) if path.is_dir()), None)


def _scans(name: str, folder: Path) -> SensorStream:
    files, stamps = stamped_files(folder, "ns")
    device = DEVICES[name]

    def load(k: int) -> Records:
        is_short = name == "Aeva" and stamps[k] <= LAST_SHORT_AEVA
        records = read_records(files[k], np.dtype(_AEVA_SHORT) if is_short else device.dtype)
        times = records[device.time] * device.seconds
        intensity = records["reflectivity" if is_short else device.intensity]
        return make_points(records, intensity=intensity, time=times, ring=records[device.ring])

    sensor = lidar_sensor(
        name.lower(), stamps, stamp=Stamp.SCAN_START, lidar=device.lidar, has_times=True, has_rings=True
    )
    return cloud_stream("lidar", sensor, stamps, load)


def _imu(source: Path, chosen: str, notes: list[str]) -> SensorStream | None:
    places = (source / "Inertial_data" / "xsens_imu.csv", source / "xsens_imu.csv")
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        notes.append("no xsens_imu.csv: no IMU (the sequences *_04 have none)")
        return None
    if chosen != "Ouster":
        notes.append(f"no IMU: its pose is known beside the Ouster only, not beside the {chosen}")
        return None
    pose = np.linalg.inv(np.array(T_IMU_OUSTER))
    pose[3] = 0, 0, 0, 1
    return xsens_stream(path, pose, notes)


def _truth(source: Path, chosen: str, notes: list[str]) -> ImportedTruth | None:
    names = (f"{chosen}_gt.txt", f"global_{chosen}_gt.txt")
    places = [folder / name for folder in (source / "LiDAR_GT", source) for name in names]
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        notes.append(f"no ground truth: neither {names[0]} nor {names[1]} in {source} or its LiDAR_GT")
        return None
    table = read_table(path, 7, "ns x y z qx qy qz qw", stamp="ns").ascending("poses", notes)
    poses = trajectory(path, table.stamps, table.values[:, :3], table.values[:, 3:])
    return ImportedTruth(GroundTruth(file="groundtruth.txt"), poses)
