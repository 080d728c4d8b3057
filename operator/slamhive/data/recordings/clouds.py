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


def cloud_points(message: Any, where: str) -> npt.NDArray[np.void]:
    """Return the points of a PointCloud2, shape (height·width,), without padding at the rows' ends.

    Raises:
        DataError: It is damaged.
    """
    dtype = cloud_dtype(message, where)
    used = message.width * message.point_step
    if message.row_step < used or message.data.size < message.row_step * message.height:
        raise DataError(
            f"{where}: a scan of {message.width}×{message.height} points of {message.point_step} bytes "
            f"has only {message.data.size} bytes in rows of {message.row_step}"
        )
    data = message.data[: message.row_step * message.height]
    rows = data.reshape(message.height, message.row_step)[:, :used]
    # A copy, as readers hand out views of what they read, and one of bytes, as numpy doesn't copy the
    # padding inside of structured types.
    return np.array(rows).reshape(-1, message.point_step).view(dtype)[:, 0]


def point_times(points: npt.NDArray[np.void], field: str, header: int) -> tuple[Array, bool] | None:
    """Return the times of a scan's points, s, and whether they are absolute ones, told after the header.

    Whole numbers are ns; others are s, or ns where they are too large for that.

    Args:
        points: With the field.
        field: Of the times.
        header: The header stamp, ns.

    Returns:
        Times, shape (n,); None where there are none, or not finite ones.
    """
    times = points[field]
    values = times.astype(np.float64)
    if not values.size or not np.isfinite(values).all():
        return None
    largest = float(np.abs(values).max())
    if times.dtype.kind in "iu" and largest > _ABSOLUTE_NANOSECONDS:
        return (times.astype(np.int64) - header) / 1e9, True
    if times.dtype.kind in "iu":
        return values / 1e9, False
    if largest > _ABSOLUTE_NANOSECONDS:
        return (values - header) / 1e9, True
    if largest > _ABSOLUTE_SECONDS:
        return values - header / 1e9, True
    return values, False


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
    chosen = points.view(np.uint8).reshape(len(points), -1)[mask]
    return replace(
        message,
        height=1,
        width=len(chosen),
        row_step=len(chosen) * message.point_step,
        data=chosen.reshape(-1),
    )


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
