# SPDX-License-Identifier: Apache-2.0
"""Import of sessions of NCLT: velodyne_sync/US.bin and groundtruth_DATE.csv."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.importers.contents import Contents, ImportedTruth, cloud_stream
from slamhive.data.importers.poses import trajectory
from slamhive.data.importers.scans import lidar_sensor, make_points, read_records, stamped_files
from slamhive.data.importers.tables import read_table
from slamhive.model.dataset import GroundTruth
from slamhive.model.errors import DataError
from slamhive.model.sensors import Stamp
from slamhive_eval.rotation import from_roll_pitch_yaw, to_matrix

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers import ImportOptions
    from slamhive.data.importers.contents import SensorStream

TITLE = "a session of NCLT (velodyne_sync/)"

RECORD = np.dtype([("x", "<u2"), ("y", "<u2"), ("z", "<u2"), ("intensity", "u1"), ("ring", "u1")])
_UNIT, _ORIGIN = 0.005, -100.0
"""m of a unit of a coordinate, and the coordinate of 0."""
_FLIP = np.diag([1.0, -1.0, -1.0])
"""From x forward, y right, z down to x forward, y left, z up."""
_WRITTEN = np.dtype([(axis, "<f4") for axis in "xyz"])


def recognises(source: Path) -> bool:
    """Tell whether something has scans in velodyne_sync/."""
    return (source / "velodyne_sync").is_dir()


def read(source: Path, options: ImportOptions) -> Contents:  # noqa: ARG001
    """Read a session.

    The body is NCLT's, turned so that z points up: x forward, y left. The scans of velodyne_sync are in it.

    Raises:
        DataError: Something is missing or damaged.
    """
    notes = [
        (
            "velodyne_sync: the points have no times, so algorithms can't deskew them; a stamp is taken for "
            "the whole scan. Rings are the Velodyne's laser numbers as published"
        ),
        "imu (ms25.csv), wheels, GPS and the Ladybug's images are not imported",
    ]
    return Contents(
        description="Imported from a session of NCLT.",
        streams=[_scans(source / "velodyne_sync")],
        truth=_truth(source, notes),
        body="body",
        gravity_aligned=True,
        notes=notes,
    )


def _scans(folder: Path) -> SensorStream:
    files, stamps = stamped_files(folder, "us")

    def load(k: int) -> npt.NDArray[np.void]:
        records = read_records(files[k], RECORD)
        points = np.empty(len(records), dtype=_WRITTEN)
        for axis, sign in zip("xyz", np.diag(_FLIP), strict=True):
            points[axis] = sign * (records[axis] * _UNIT + _ORIGIN)
        return make_points(points, intensity=records["intensity"], ring=records["ring"])

    known = {"rings": 32, "maxRange": 100.0}
    sensor = lidar_sensor("velodyne", stamps, stamp=Stamp.SAMPLE, lidar=known, has_rings=True)
    return cloud_stream("lidar", sensor, stamps, load)


def _truth(source: Path, notes: list[str]) -> ImportedTruth | None:
    folders = (source, source.resolve().parent / "ground_truth")
    name = f"groundtruth_{source.resolve().name}.csv"
    found = [folder / name for folder in folders if (folder / name).is_file()]
    found = found or sorted(source.glob("groundtruth_*.csv"))
    if not found:
        notes.append(f"no ground truth: no {name} in {folders[0]} or {folders[1]}")
        return None
    if len(found) > 1 and found[0].name != name:
        raise DataError(f"{source}: several files of ground truth: {', '.join(path.name for path in found)}")
    path = found[0]
    table = read_table(path, 6, "t (µs), x, y, z, roll, pitch, heading", stamp="us", unknown=notes)
    table = table.ascending("poses", notes)
    rotations = to_matrix(from_roll_pitch_yaw(table.values[:, 3:]))
    poses = trajectory(path, table.stamps, table.values[:, :3] @ _FLIP, _FLIP @ rotations @ _FLIP)
    return ImportedTruth(GroundTruth(file="groundtruth.txt"), poses)
