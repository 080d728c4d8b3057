# SPDX-License-Identifier: Apache-2.0
"""LiDAR scans with fewer points: by range and by ring."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.model.errors import DataError, InputError

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive.model.run import LidarInput
    from slamhive.model.sensors import Lidar

    Array = npt.NDArray[np.float64]

_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""sensor_msgs/PointField datatype → numpy."""

_ABSOLUTE_SECONDS, _ABSOLUTE_NANOSECONDS = 1e6, 1e15
"""Times of points beyond which they can't be those within a scan."""

PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
"""Units of the times of points."""
TIME_FIELDS = ("time", "t", "timestamp", "timestamps", "time_offset", "offset_time", "time_stamp")
"""Usual names of the field with the times of points."""


@dataclass(frozen=True)
class CloudFilter:
    """Filter for the points of LiDAR scans: the ranges and rings that are kept.

    Attributes:
        min_range: Points nearer go, m; None: none.
        max_range: Points farther go, m; None: none.
        ring_field: Point field with the ring's number, when rings are chosen.
        ring_map: New number of each ring, -1 for one that goes, shape (rings,); None: all stay.
    """

    min_range: float | None
    max_range: float | None
    ring_field: str | None
    ring_map: npt.NDArray[np.int64] | None

    @property
    def is_idle(self) -> bool:
        """Tell whether everything is kept."""
        return self.min_range is None and self.max_range is None and self.ring_map is None


def even_rings(rings: int, kept: int) -> npt.NDArray[np.int64]:
    """Number evenly spaced rings anew.

    Args:
        rings: Rings of the sensor.
        kept: How many stay.

    Returns:
        New number of each ring, 0 to kept - 1, or -1, shape (rings,).
    """
    result = np.full(rings, -1, dtype=np.int64)
    result[((np.arange(kept) + 0.5) * rings / kept).astype(np.int64)] = np.arange(kept)
    return result


def cloud_filter(
    options: LidarInput | None, lidar: Lidar | None, name: str
) -> tuple[CloudFilter, Lidar | None]:
    """Say what is kept of a sensor's scans, and what the sensor is like afterwards.

    Raises:
        InputError: The options can't be met with this sensor.
    """
    if options is None:
        return CloudFilter(None, None, None, None), lidar
    low, high = options.min_range, options.max_range
    if low is not None and high is not None and low >= high:
        raise InputError(f"input.lidar: minRange {low:g} must be less than maxRange {high:g}")
    ring_map = None
    if options.rings is not None:
        ring_map = _chosen_rings(options.rings, lidar, name)
    if lidar is not None:
        lidar = lidar.replace(
            min_range=lidar.min_range if low is None else max(lidar.min_range, low),
            max_range=lidar.max_range if high is None else min(lidar.max_range, high),
            rings=lidar.rings if options.rings is None else options.rings,
        )
    return CloudFilter(low, high, lidar.ring_field if lidar else None, ring_map), lidar


def _chosen_rings(wanted: int, lidar: Lidar | None, name: str) -> npt.NDArray[np.int64] | None:
    if lidar is None or lidar.ring_field is None:
        raise InputError(
            f"input.lidar.rings: sensor {name!r} has no ring numbers "
            f"(sensors.{name}.lidar.ringField); leave rings out"
        )
    if lidar.rings is None:
        raise InputError(
            f"input.lidar.rings: the dataset doesn't say how many rings sensor {name!r} has; state "
            f"sensors.{name}.lidar.rings"
        )
    if wanted > lidar.rings:
        raise InputError(f"input.lidar.rings: {wanted} asked for, sensor {name!r} has {lidar.rings}")
    return None if wanted == lidar.rings else even_rings(lidar.rings, wanted)


def cloud_dtype(message: Any, where: str) -> np.dtype[np.void]:
    """Return the numpy type of a PointCloud2's points.

    Raises:
        DataError: A field has an unknown type.
    """
    order = ">" if message.is_bigendian else "<"
    names, formats, offsets = [], [], []
    for field in message.fields:
        if field.datatype not in _NUMBERS:
            raise DataError(f"{where}: point field {field.name!r} has the unknown datatype {field.datatype}")
        number = order + _NUMBERS[field.datatype]
        names.append(field.name)
        formats.append((number, (field.count,)) if field.count > 1 else number)
        offsets.append(field.offset)
    layout = {"names": names, "formats": formats, "offsets": offsets, "itemsize": message.point_step}
    try:
        return np.dtype(layout)  # type: ignore[call-overload,no-any-return]
    except ValueError as error:
        raise DataError(
            f"{where}: the point fields don't fit a point of {message.point_step} bytes ({error})"
        ) from None


def cloud_points(message: Any, where: str, *, copy: bool = True) -> npt.NDArray[np.void]:
    """Return the points of a PointCloud2, shape (height·width,), without padding at the rows' ends.

    Rows of 0 bytes, as some drivers state them, are rows without padding.

    Args:
        message: The scan.
        where: What it is, for messages.
        copy: Whether they must be a copy; else they may lie in the message.

    Raises:
        DataError: It is damaged.
    """
    dtype = cloud_dtype(message, where)
    used = message.width * message.point_step
    step = message.row_step or used
    if step < used or message.data.size < step * message.height:
        raise DataError(
            f"{where}: a scan of {message.width}×{message.height} points of {message.point_step} bytes "
            f"has only {message.data.size} bytes in rows of {step}"
        )
    data = message.data[: step * message.height]
    if step == used and not copy:
        whole: npt.NDArray[np.void] = data.view(dtype)
        return whole
    rows = data.reshape(message.height, step)[:, :used]
    # A copy, as readers hand out views of what they read, and one of bytes, as numpy doesn't copy the
    # padding inside of structured types.
    return np.array(rows).reshape(-1, message.point_step).view(dtype)[:, 0]


def time_reading(kind: np.dtype[Any], largest: float) -> tuple[str, bool]:
    """Return the unit in which times of points are taken where no repair states it.

    Whole numbers are ns; others are s, or ns where they are too large for that.

    Args:
        kind: Type of the numbers.
        largest: The largest of them, without its sign.

    Returns:
        The unit, and whether they are absolute times.
    """
    if largest > _ABSOLUTE_NANOSECONDS:
        return "ns", True
    return ("ns", False) if kind.kind in "iu" else ("s", largest > _ABSOLUTE_SECONDS)


def point_times(points: npt.NDArray[np.void], field: str, header: int) -> tuple[Array, bool] | None:
    """Return the times of a scan's points, s, and whether they are absolute ones, told after the header.

    Args:
        points: With the field.
        field: Of the times.
        header: The header stamp, ns.

    Returns:
        Times of the points that have one, shape (n,); None where none has.
    """
    times = points[field]
    times = times[np.isfinite(times)]
    if not times.size:
        return None
    unit, is_absolute = time_reading(times.dtype, float(np.abs(times.astype(np.float64)).max()))
    if is_absolute and times.dtype.kind in "iu":
        return (times.astype(np.int64) - header) / 1e9, True
    values = times.astype(np.float64) - (header / (10**9 // PER_SECOND[unit]) if is_absolute else 0.0)
    return values / PER_SECOND[unit], is_absolute


def filter_cloud(message: Any, kept: CloudFilter, where: str) -> Any:
    """Return a PointCloud2 with fewer points; an organised cloud becomes a list of points.

    Points without a position (NaN) go with those out of range.

    Raises:
        DataError: A field that is needed is missing, or the message is damaged.
    """
    points = cloud_points(message, where)
    names = points.dtype.names or ()
    mask = np.ones(len(points), dtype=np.bool_)
    if kept.min_range is not None or kept.max_range is not None:
        missing = [axis for axis in "xyz" if axis not in names]
        if missing:
            raise DataError(f"{where}: points have no field {missing[0]!r}; they have: {', '.join(names)}")
        squares = sum(points[axis].astype(np.float64) ** 2 for axis in "xyz")
        mask &= squares >= (kept.min_range or 0.0) ** 2
        if kept.max_range is not None:
            mask &= squares <= kept.max_range**2
    if kept.ring_map is not None:
        mask &= _renumber(points, kept, where)
    return chosen_points(message, points, mask)


def chosen_points(message: Any, points: npt.NDArray[np.void], mask: npt.NDArray[np.bool_] | None) -> Any:
    """Return a scan as the list of those of its points that a mask keeps; None: of all."""
    # Bytes of whole points: numpy doesn't copy the padding inside of structured types.
    whole = points.view(f"V{message.point_step}")
    chosen = whole if mask is None else whole[mask]
    return replace(
        message,
        height=1,
        width=len(chosen),
        row_step=len(chosen) * message.point_step,
        data=chosen.view(np.uint8),
    )


def returned_points(message: Any, where: str, time_field: str | None = None) -> Any:
    """Return a PointCloud2 without points at the origin or of NaN, which are no returns.

    Args:
        message: The scan.
        where: What it is, for messages.
        time_field: Field of times that are NaN for some points, which go then; a scan without any keeps them.

    Raises:
        DataError: It has no positions, or is damaged.
    """
    points = cloud_points(message, where)
    if missing := [axis for axis in "xyz" if axis not in (points.dtype.names or ())]:
        raise DataError(
            f"{where}: points have no field {missing[0]!r}; they have: {', '.join(points.dtype.names or ())}"
        )
    positions = np.column_stack([points[axis] for axis in "xyz"])
    stay = np.isfinite(positions).all(axis=1) & positions.any(axis=1)
    if time_field in (points.dtype.names or ()):
        timed = np.isfinite(points[time_field])
        stay &= timed | ~timed.any()
    return replace(chosen_points(message, points, stay), is_dense=True)


def retime_points(message: Any, time_field: str, unit: str, where: str) -> Any:
    """Return a PointCloud2 whose points' times are seconds after the header stamp, in floating point.

    Args:
        message: The scan.
        time_field: Field of the times; they may be absolute.
        unit: Their unit: s, ms, us or ns; None: they say nothing, and the field goes.
        where: What it is, for messages.

    Raises:
        DataError: There is no such field, or the scan is damaged.
    """
    points = cloud_points(message, where)
    index = next((k for k, one in enumerate(message.fields) if one.name == time_field), None)
    if index is None:
        raise DataError(
            f"{where}: points have no field {time_field!r}; they have: {', '.join(points.dtype.names or ())}"
        )
    fields, field = list(message.fields), message.fields[index]
    if unit == "None":
        del fields[index]
        return replace(message, fields=fields)
    times, per_second = points[time_field], PER_SECOND[unit]
    header = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    seconds = times / per_second
    # Clocks that count from a sensor's start, or of a simulation, are near 0, too.
    middle = float(np.median(known)) if (known := seconds[np.isfinite(seconds)]).size else 0.0
    if abs(middle) > _ABSOLUTE_SECONDS or (abs(middle) > 1.0 and abs(middle - header / 1e9) < abs(middle)):
        whole = times.dtype.kind in "iu"
        seconds = (
            (times.astype(np.int64) * (10**9 // per_second) - header) / 1e9
            if whole
            else seconds - header / 1e9
        )
    rows = points.view(np.uint8).reshape(len(points), -1)
    code, size = (8, 8) if times.dtype.itemsize == 8 else (7, 4)
    offset = field.offset
    if times.dtype.itemsize < size:  # No room for it: the new one is put behind the others.
        offset = message.point_step
        rows = np.hstack([rows, np.zeros((len(rows), size), dtype=np.uint8)])
    order = ">" if message.is_bigendian else "<"
    rows[:, offset : offset + size] = (
        seconds.astype(f"{order}{_NUMBERS[code]}").view(np.uint8).reshape(len(rows), size)
    )
    fields[index] = replace(field, offset=offset, datatype=code)
    step = rows.shape[1]
    return replace(
        message, fields=fields, point_step=step, row_step=message.width * step, data=rows.reshape(-1)
    )


def move_point_times(message: Any, time_field: str, nanoseconds: int, where: str) -> Any:
    """Return a PointCloud2 with its points' absolute times so much later; times within the scan stay."""
    points = cloud_points(message, where)
    found = point_times(points, time_field, 0) if time_field in (points.dtype.names or ()) else None
    if found is None or not found[1]:
        return message
    times = points[time_field]
    is_seconds = times.dtype.kind == "f" and abs(float(np.nanmax(times))) < _ABSOLUTE_NANOSECONDS
    points[time_field] = times + (nanoseconds / 1e9 if is_seconds else times.dtype.type(nanoseconds))
    step = message.point_step
    return replace(message, row_step=message.width * step, data=points.view(np.uint8).reshape(-1))


def _renumber(points: npt.NDArray[np.void], kept: CloudFilter, where: str) -> npt.NDArray[np.bool_]:
    """Write the new ring numbers into points; return which of them stay."""
    field, ring_map = kept.ring_field, kept.ring_map
    if field not in (points.dtype.names or ()) or ring_map is None:
        raise DataError(
            f"{where}: points have no field {field!r} for rings; they have: "
            f"{', '.join(points.dtype.names or ())}"
        )
    rings = points[field].astype(np.int64)
    if len(rings) and not 0 <= int(rings.min()) <= int(rings.max()) < len(ring_map):
        raise DataError(
            f"{where}: ring numbers go from {rings.min()} to {rings.max()}, the dataset "
            f"states {len(ring_map)} rings"
        )
    numbers = ring_map[rings]
    points[field] = np.maximum(numbers, 0)
    kept_rings: npt.NDArray[np.bool_] = numbers >= 0
    return kept_rings
