# SPDX-License-Identifier: Apache-2.0
"""Scans in binary files, one file a scan: their files, their records, and the points made of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.importers.tables import nanoseconds
from slamhive.data.recordings.thinning import rate_of
from slamhive.model.errors import DataError
from slamhive.model.sensors import Sensor, Stamp

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers.tables import Unit

    Records = npt.NDArray[np.void]
    Stamps = npt.NDArray[np.int64]

TIME, RING = "time", "ring"
XYZI = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity")])


def read_records(path: Path, dtype: np.dtype[Any]) -> Records:
    """Return the records of a binary file, shape (n,).

    Raises:
        DataError: It is missing, or its size is not that of whole records.
    """
    try:
        size = path.stat().st_size
        if size % dtype.itemsize:
            raise DataError(
                f"{path}: {size} bytes are no whole number of points of {dtype.itemsize} bytes; the file is "
                "cut off or in another form"
            )
        return np.fromfile(path, dtype=dtype)
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from None


def make_points(
    records: Records,
    *,
    intensity: npt.NDArray[Any] | None = None,
    time: npt.NDArray[Any] | None = None,
    ring: npt.NDArray[Any] | None = None,
) -> Records:
    """Return points with x, y, z, intensity and, where there are such, time and ring.

    Points without a position and those at the origin of the sensor, which are directions without a return,
    are left out.

    Args:
        records: With x, y, z in m, and intensity unless it is given, shape (n,).
        intensity: Of each point, shape (n,).
        time: Seconds after the header stamp, shape (n,).
        ring: Number of the ring, shape (n,).

    Returns:
        Shape (m,), m ≤ n.
    """
    fields = [*XYZI.descr]
    columns = {axis: records[axis] for axis in "xyz"}
    columns["intensity"] = records["intensity"] if intensity is None else intensity
    for name, column, kind in ((TIME, time, "<f4"), (RING, ring, "<u2")):
        if column is not None:
            fields.append((name, kind))
            columns[name] = column
    x, y, z = (columns[axis] for axis in "xyz")
    with np.errstate(all="ignore"):
        # A sum is finite only of finite numbers: one look at each point instead of three.
        kept = np.isfinite(x + y + z) & ((x != 0) | (y != 0) | (z != 0))
    points = np.empty(int(np.count_nonzero(kept)), dtype=fields)
    for name, column in columns.items():
        points[name] = column[kept]
    return points


def numbered_files(folder: Path, suffix: str) -> dict[int, Path]:
    """Return the files of a folder whose names are numbers, by these, in their order.

    Raises:
        DataError: A file with the suffix has another name, or two have one number.
    """
    found: dict[int, Path] = {}
    for path in folder.glob(f"*{suffix}"):
        if path.name.startswith("."):
            continue
        if not (path.stem.isascii() and path.stem.isdecimal()):
            raise DataError(f"{path}: its name is no number")
        if int(path.stem) in found:
            raise DataError(f"{path}: another file has the same number, {found[int(path.stem)].name}")
        found[int(path.stem)] = path
    return dict(sorted(found.items()))


def stamped_files(folder: Path, unit: Unit) -> tuple[list[Path], Stamps]:
    """Return the files of a folder whose names are times, ascending, and these in ns, shape (n,).

    Raises:
        DataError: There are none, or a name is no time.
    """
    found = numbered_files(folder, ".bin")
    if not found:
        raise DataError(f"{folder}: no files *.bin in it, named by their times in {unit}")
    stamps = np.array([nanoseconds(str(number), unit) for number in found], dtype=np.int64)
    return [*found.values()], stamps


def lidar_sensor(
    frame: str,
    stamps: Stamps,
    *,
    stamp: Stamp,
    pose: npt.NDArray[np.float64] | None = None,
    lidar: dict[str, Any] | None = None,
    has_times: bool = False,
    has_rings: bool = False,
) -> Sensor:
    """Return a LiDAR as the manifest has it; its topic is named after its frame.

    Args:
        frame: Name of its frame.
        stamps: ns, ascending, for its rate, shape (n,).
        stamp: What a header stamp means.
        pose: T_body_sensor, (4, 4); None: the body is the sensor.
        lidar: What is known of the device, as in the manifest.
        has_times: Whether points have times.
        has_rings: Whether points have rings.
    """
    fields = {"timeField": TIME if has_times else None, "ringField": RING if has_rings else None}
    block = (lidar or {}) | {key: value for key, value in fields.items() if value}
    return Sensor.model_validate(
        {
            "type": "Lidar",
            "topic": f"/{frame}",
            "frameId": frame,
            "rate": mean_rate(stamps),
            "stamp": stamp,
            "T_body_sensor": (np.eye(4) if pose is None else pose).tolist(),
            "lidar": block,
        }
    )


def mean_rate(stamps: Stamps) -> float | None:
    """Return the mean rate of a stream in Hz to 6 digits, gaps left out; None for fewer than two stamps."""
    rate = rate_of(stamps)
    return None if rate is None else float(f"{rate:.6g}")
