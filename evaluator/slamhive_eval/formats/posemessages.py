# SPDX-License-Identifier: Apache-2.0
"""Poses in ROS messages, ROS 1 and ROS 2 alike, as rosbags decodes them."""

from __future__ import annotations

from bisect import bisect_left
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.errors import TrajectoryError
from slamhive_eval.formats.textfiles import known_rows
from slamhive_eval.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from slamhive_eval.formats.transforms import Frames
    from slamhive_eval.rotation import FloatArray

Row = tuple[float, ...]
"""Stamp in s, x, y, z in m and the quaternion's x, y, z, w."""

PATH = "nav_msgs/msg/Path"
FIX = "sensor_msgs/msg/NavSatFix"
POINT = "geometry_msgs/msg/PointStamped"
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
STATIC_TRANSFORMS = "/tf_static"

_SEMI_MAJOR_METRES = 6378137.0
_ECCENTRICITY_SQUARED = 6.69437999014e-3


def seconds(stamp: Any) -> float:
    """A ROS time in s: the float64 nearest to it, as reading its decimal digits gives."""
    return (int(stamp.sec) * 10**9 + int(stamp.nanosec)) / 10**9


def pose_row(position: Any, orientation: Any) -> tuple[float, ...]:
    """x, y, z and the quaternion's x, y, z, w of a pose or transform."""
    p, q = position, orientation
    return p.x, p.y, p.z, q.x, q.y, q.z, q.w


def _row(header: Any, position: Any, orientation: Any) -> list[Row]:
    return [(seconds(header.stamp), *pose_row(position, orientation))]


def _of_point(message: Any) -> list[Row]:
    p = message.point
    return [(seconds(message.header.stamp), p.x, p.y, p.z, 0.0, 0.0, 0.0, 1.0)]


def _of_path(message: Any) -> list[Row]:
    return [_row(one.header, one.pose.position, one.pose.orientation)[0] for one in message.poses]


def _of_fix(message: Any) -> list[Row]:
    if message.status.status < 0:
        return []
    degrees = (message.latitude, message.longitude, message.altitude)
    return [(seconds(message.header.stamp), *degrees, 0.0, 0.0, 0.0, 1.0)]


READERS: dict[str, Callable[[Any], list[Row]]] = {
    "geometry_msgs/msg/PoseStamped": lambda m: _row(m.header, m.pose.position, m.pose.orientation),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: _row(
        m.header, m.pose.pose.position, m.pose.pose.orientation
    ),
    "geometry_msgs/msg/TransformStamped": lambda m: _row(
        m.header, m.transform.translation, m.transform.rotation
    ),
    "nav_msgs/msg/Odometry": lambda m: _row(m.header, m.pose.pose.position, m.pose.pose.orientation),
    POINT: _of_point,
    PATH: _of_path,
    FIX: _of_fix,
}
"""Readers that make rows of a message, by its type; of a NavSatFix degrees and metres above the ellipsoid."""

WITH_COVARIANCE = ("geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry")


def read_poses(messages: Iterable[Any], kind: str, *, sort: bool = False) -> Trajectory:
    """The trajectory in the messages of a topic, by their header stamps.

    Of paths the last one with poses counts, and of those before it the poses that are earlier than all of
    its own, as where each message is a window or a single pose. Fixes become east, north, up in m from the
    first one (WGS 84); messages without a fix are left out. Points and fixes have no orientation.
    Covariances that are all zero say nothing and are left out too.

    Args:
        messages: Decoded messages.
        kind: Their type, a key of READERS.
        sort: Whether to sort decreasing stamps instead of refusing them.

    Returns:
        The trajectory.

    Raises:
        TrajectoryError: There are no poses, they carry no stamps, or they are no trajectory.
    """
    reader = READERS[kind]
    rows: list[Row] = []
    covariances: list[FloatArray] = []
    for message in messages:
        if kind == PATH:
            path = reader(message)
            if path:
                rows[bisect_left(rows, path[0][:1]) :] = path
            continue
        rows += reader(message)
        if kind in WITH_COVARIANCE:
            covariances.append(message.pose.covariance)
    table = np.array(rows, dtype=np.float64).reshape(-1, 8)
    if kind == FIX:
        table = table[np.isfinite(table).all(axis=1)]
    if not len(table):
        raise TrajectoryError(f"no message of type {kind} holds a {'fix' if kind == FIX else 'pose'}")
    if len(table) > 1 and not np.ptp(table[:, 0]):
        raise TrajectoryError(f"the {len(table)} poses carry no stamps: all are {table[0, 0]:g} s")
    known = np.array(covariances, dtype=np.float64).reshape(-1, 6, 6)
    rows_of = known_rows(kind, table)
    if rows_of.left_out:
        table, known = table[rows_of.rows], known[rows_of.rows if len(known) else slice(0)]
    if sort:
        order = np.argsort(table[:, 0], kind="stable")
        table, known = table[order], known[order if len(known) else slice(0)]
    positions = east_north_up(table[:, 1:4]) if kind == FIX else table[:, 1:4]
    return Trajectory(
        table[:, 0],
        positions,
        table[:, 4:],
        oriented=kind not in (FIX, POINT),
        covariances=known if known.any() else None,
        notes=rows_of.notes,
        nan_rows=rows_of.left_out,
    )


def add_transforms(frames: Frames, message: Any, topic: str) -> None:
    """Add the transforms of a TF message; those of /tf_static hold at all times."""
    for item in message.transforms:
        frames.add(
            item.header.frame_id,
            item.child_frame_id,
            seconds(item.header.stamp),
            pose_row(item.transform.translation, item.transform.rotation),
            static=topic == STATIC_TRANSFORMS,
        )


def east_north_up(fixes: FloatArray) -> FloatArray:
    """Positions in the plane that touches the WGS 84 ellipsoid at the first one.

    Args:
        fixes: Latitude and longitude in degrees, height above the ellipsoid in m, shape (n, 3).

    Returns:
        East, north and up from the first in m, shape (n, 3).

    Raises:
        TrajectoryError: A latitude beyond ±90 or a longitude beyond ±360 degrees.
    """
    if (np.abs(fixes[:, 0]) > 90).any() or (np.abs(fixes[:, 1]) > 360).any():
        raise TrajectoryError("latitudes must lie within ±90 and longitudes within ±360 degrees")
    latitude, longitude, height = np.deg2rad(fixes[:, 0]), np.deg2rad(fixes[:, 1]), fixes[:, 2]
    radius = _SEMI_MAJOR_METRES / np.sqrt(1.0 - _ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    fixed = np.column_stack(
        (
            (radius + height) * np.cos(latitude) * np.cos(longitude),
            (radius + height) * np.cos(latitude) * np.sin(longitude),
            (radius * (1.0 - _ECCENTRICITY_SQUARED) + height) * np.sin(latitude),
        )
    )
    (sa, so), (ca, co) = ((function(latitude[0]), function(longitude[0])) for function in (np.sin, np.cos))
    turn = np.array(((-so, co, 0.0), (-sa * co, -sa * so, ca), (ca * co, ca * so, sa)))
    local: FloatArray = (fixed - fixed[0]) @ turn.T
    return local
