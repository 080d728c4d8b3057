# SPDX-License-Identifier: Apache-2.0
"""Import of CARMEN logs (.log, .clf): planar laser scans and odometry of classic 2-D data sets.

Messages and their order of values: CARMEN's logger. Stamps are the field ``ipc_timestamp``, which
relations files refer to; lines are not in its order, so messages are sorted by it.
"""

from __future__ import annotations

import bz2
import gzip
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.importers.contents import Contents, ImportedTruth, SensorStream, cloud_stream
from slamhive.model.dataset import GroundTruth, TruthFormat
from slamhive.model.errors import DataError
from slamhive.model.sensors import Sensor, SensorType

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers import ImportOptions
    from slamhive.data.recordings.rosmessages import BagWriter

    Array = npt.NDArray[np.float64]

TITLE = "a CARMEN log (.log, .clf, also .gz and .bz2)"

SCANS, ODOMETRY = "/points", "/odom"
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
_SUFFIXES = {".clf", ".log", ".bz2", ".gz"}
_BODY, _LASER = "base_link", "lidar"
_NO_RETURN_METRES = 80.0
"""FLASER lines don't state the scanner's range; a SICK LMS writes 81.83 or more where nothing came back."""


@dataclass
class CarmenScan:
    """A laser scan.

    Attributes:
        stamp: ns.
        ranges: m, from right to left, shape (n,).
        start: Angle of the first one, rad.
        step: Angle between two, rad.
        limit: Ranges from here on are no returns, m.
    """

    stamp: int
    ranges: Array
    start: float
    step: float
    limit: float


@dataclass
class CarmenLog:
    """Part of a CARMEN log that is imported: laser scans, odometry and the laser's offset.

    Attributes:
        scans: Laser scans of the front scanner, by time.
        odometry: Stamp in ns, pose (x, y, heading), velocity (forward, turning), by time.
        laser_offset: Distance of the laser before the robot's centre, m.
        inversions: Lines stamped before the one above them.
    """

    scans: list[CarmenScan] = field(default_factory=list)
    odometry: list[tuple[int, Array, Array]] = field(default_factory=list)
    laser_offset: float = 0.0
    inversions: int = 0


def recognises(source: Path) -> bool:
    """Tell whether something is a log, by its name."""
    return source.is_file() and source.suffix in _SUFFIXES


def read(source: Path, options: ImportOptions) -> Contents:
    """Read a CARMEN log, plain or compressed by gzip or bzip2.

    Its relations, manually verified relative poses, are the ground truth.

    Raises:
        DataError: The log is damaged or has no scans.
    """
    log = read_log(source)
    if not log.scans:
        raise DataError(f"{source}: no laser scans in it (lines FLASER or ROBOTLASER1): not a CARMEN log?")
    if options.relations is not None and not options.relations.is_file():
        raise DataError(f"{options.relations}: no such file")
    truth = None
    if options.relations is not None:
        kept_as = GroundTruth(file="groundtruth.relations", format=TruthFormat.RELATIONS, frame="lidar")
        truth = ImportedTruth(kept_as, options.relations)
    return Contents(
        description=f"{len(log.scans)} planar laser scans and odometry from a CARMEN log.",
        streams=[_laser(log), *([_wheels(log)] if log.odometry else [])],
        truth=truth,
        body=_BODY,
        gravity_aligned=True,
        attributes={"planar": True},
    )


def read_log(path: Path) -> CarmenLog:
    """Read a CARMEN log.

    Raises:
        DataError: It can't be read; names the line.
    """
    log = CarmenLog()
    last = 0
    for number, line in _lines(path):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            stamp = _take(words, log)
        except (ValueError, IndexError, OverflowError):
            shown = line if len(line) <= 40 else line[:40] + "…"
            raise DataError(f"{path}, line {number}: not a complete {words[0]} message: {shown!r}") from None
        if stamp is not None:
            log.inversions += stamp < last
            last = stamp
    log.scans.sort(key=lambda scan: scan.stamp)
    log.odometry.sort(key=lambda item: item[0])
    return log


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    openers = {b"BZh": bz2.open, b"\x1f\x8b\x08": gzip.open}
    try:
        with path.open("rb") as file:
            magic = file.read(3)
        with openers.get(magic, open)(path, "rt", encoding="ascii", errors="replace") as text:
            yield from enumerate((line.rstrip("\n") for line in text), start=1)
    except EOFError:
        raise DataError(f"{path}: the compressed data is cut off") from None
    except OSError as error:
        raise DataError(f"{path}: can't be read: {error.strerror or error}") from None


def _take(words: list[str], log: CarmenLog) -> int | None:
    """Take in one message; return its stamp, or None when it isn't imported."""
    match words[0]:
        case "PARAM" if words[1] in ("robot_frontlaser_offset", "robot_front_laser_offset"):
            log.laser_offset = float(words[2])
        case "ODOM":
            values = _numbers(words[1:6])
            stamp = _stamp(words[7])
            log.odometry.append((stamp, values[:3], values[3:5]))
            return stamp
        case "FLASER":
            count = int(words[1])
            ranges = _numbers(words[2 : 2 + count], count)
            # n readings over 180°: an even n leaves out the last one, as 180 readings 1° apart.
            step = np.pi / (count if count % 2 == 0 else count - 1)
            stamp = _stamp(words[2 + count + 6])
            log.scans.append(CarmenScan(stamp, ranges, -np.pi / 2, step, _NO_RETURN_METRES))
            return stamp
        case "ROBOTLASER1":
            return _robot_laser(words, log)
    return None


def _robot_laser(words: list[str], log: CarmenLog) -> int:
    start, _, step, limit = _numbers(words[2:6], 4).tolist()
    count = int(words[8])
    ranges = _numbers(words[9 : 9 + count], count)
    remissions = int(words[9 + count])
    rest = words[10 + count + remissions :]
    laser, robot = _numbers(rest[0:3], 3), _numbers(rest[3:6], 3)
    log.laser_offset = round(float(np.hypot(*(laser - robot)[:2])), 6)
    stamp = _stamp(rest[11])
    log.scans.append(CarmenScan(stamp, ranges, start, step, limit))
    return stamp


def _numbers(words: list[str], count: int = 5) -> Array:
    values = np.array(words, dtype=np.float64)
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError
    return values


def _stamp(word: str) -> int:
    """Return a decimal number of seconds as ns, exactly."""
    whole, _, fraction = word.partition(".")
    if not whole.isdigit() or not (fraction + "0").isdigit():
        raise ValueError(word)
    return int(whole) * 10**9 + int(fraction[:9].ljust(9, "0"))


def scan_points(scan: CarmenScan) -> npt.NDArray[np.void]:
    """Return the returns of a scan as points in the laser's plane, z = 0, shape (m,)."""
    angles = scan.start + scan.step * np.arange(len(scan.ranges))
    valid = (scan.ranges > 0.0) & (scan.ranges < scan.limit)
    points = np.zeros(int(valid.sum()), dtype=POINT)
    points["x"] = scan.ranges[valid] * np.cos(angles[valid])
    points["y"] = scan.ranges[valid] * np.sin(angles[valid])
    return points


def _laser(log: CarmenLog) -> SensorStream:
    stamps = np.array([scan.stamp for scan in log.scans], dtype=np.int64)
    duration = (stamps[-1] - stamps[0]) / 1e9
    pose = np.eye(4)
    pose[0, 3] = log.laser_offset
    sensor = Sensor.model_validate(
        {
            "type": "Lidar",
            "topic": SCANS,
            "frameId": _LASER,
            "rate": round(float((len(stamps) - 1) / duration), 3) if duration else None,
            "stamp": "Sample",
            "T_body_sensor": pose.tolist(),
            "lidar": {
                "rings": 1,
                "columns": max(len(scan.ranges) for scan in log.scans),
                "maxRange": min(scan.limit for scan in log.scans),
            },
        }
    )
    return cloud_stream("lidar", sensor, stamps, lambda k: scan_points(log.scans[k]))


def _wheels(log: CarmenLog) -> SensorStream:
    sensor = Sensor(type=SensorType.ODOMETRY, topic=ODOMETRY, frame_id=_BODY)
    stamps = np.array([stamp for stamp, _, _ in log.odometry], dtype=np.int64)

    def write(bag: BagWriter, k: int) -> None:
        stamp, pose, velocity = log.odometry[k]
        bag.planar_odometry(ODOMETRY, stamp, pose, velocity)

    return SensorStream("odometry", sensor, stamps, write)
