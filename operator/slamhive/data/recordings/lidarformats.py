# SPDX-License-Identifier: Apache-2.0
"""LiDAR scans in messages of their makers: Livox's are read as PointCloud2, packets named with a driver.

Messages of livox_ros_driver and livox_ros_driver2 have the same fields (their msg/CustomMsg.msg).
"""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.recordings.kinds import POINT_CLOUD
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_LIVOX = re.compile(r"livox_ros_driver2?/msg/CustomMsg")
_FIELDS = {
    "CustomMsg": ["header", "timebase", "point_num", "lidar_id", "rsvd", "points"],
    "CustomPoint": ["offset_time", "x", "y", "z", "reflectivity", "tag", "line"],
}
_POINT = [
    ("x", 4, 7),
    ("y", 8, 7),
    ("z", 12, 7),
    ("offset_time", 0, 6),
    ("reflectivity", 16, 2),
    ("tag", 17, 2),
    ("line", 18, 2),
]
"""Fields of a point, where it has them (bytes), and their datatypes in sensor_msgs/PointField."""
_POINT_BYTES = 19
_PACKETS = {
    "velodyne_msgs/msg/VelodyneScan": ("Velodyne", "velodyne_pointcloud"),
    "ouster_ros/msg/PacketMsg": ("Ouster", "ouster_ros (its replay launch file)"),
    "ouster_msgs/msg/PacketMsg": ("Ouster", "ouster_ros (its replay launch file)"),
    "ouster_sensor_msgs/msg/PacketMsg": ("Ouster", "ouster_ros (its replay launch file)"),
    "hesai_lidar/msg/PandarScan": ("Hesai", "hesai_lidar"),
    "pandar_msgs/msg/PandarScan": ("Hesai", "hesai_lidar"),
    "hesai_ros_driver/msg/UdpFrame": ("Hesai", "hesai_ros_driver"),
    "rslidar_msgs/msg/rslidarScan": ("RoboSense", "rslidar_sdk"),
    "rslidar_msg/msg/RslidarPacket": ("RoboSense", "rslidar_sdk"),
}
"""Makers of LiDARs whose packets are recorded, and what turns them into PointCloud2."""


def packets_text(topic: str, message_type: str) -> str | None:
    """Return a sentence on a topic of a LiDAR's packets and the way on; None for other messages."""
    if message_type not in _PACKETS:
        return None
    maker, driver = _PACKETS[message_type]
    return (
        f"{topic} has packets of a {maker} LiDAR ({message_type}), which aren't read: play the recording "
        f"through {driver} and record the PointCloud2 that it publishes"
    )


def is_livox(message_type: str, store: Typestore) -> bool:
    """Tell whether messages are Livox's scans, with the fields that are known here."""
    if not _LIVOX.fullmatch(message_type):
        return False
    package = message_type.rsplit("/", 1)[0]
    defined = {name: store.fielddefs.get(f"{package}/{name}") for name in _FIELDS}
    # Some files of ROS 2 come without definitions.
    return all(
        one is None or [field for field, _ in one[1]] == _FIELDS[name] for name, one in defined.items()
    )


def add_point_cloud(store: Typestore, *, is_ros2: bool) -> None:
    """Make the types of PointCloud2 known to a recording's types, where they aren't."""
    # Most commands know of recordings without reading one, and this takes a third of a second.
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    standard = get_typestore(Stores.ROS2_HUMBLE if is_ros2 else Stores.ROS1_NOETIC).fielddefs
    names = (
        POINT_CLOUD, "sensor_msgs/msg/PointField", "std_msgs/msg/Header", "builtin_interfaces/msg/Time",
    )  # fmt: skip
    store.register({name: standard[name] for name in names if name not in store.fielddefs})


def livox_cloud(raw: bytes, store: Typestore, *, is_ros2: bool) -> bytes:
    """Return a scan of Livox as a PointCloud2 of the same bytes; times (ns) are in ``offset_time``.

    Raises:
        DataError: It breaks off.
    """
    try:
        message = _cloud(raw, store.types, is_ros2=is_ros2)
    except (struct.error, ValueError, IndexError):
        raise DataError(f"a scan of Livox (CustomMsg) breaks off after {len(raw)} bytes") from None
    encode = store.serialize_cdr if is_ros2 else store.serialize_ros1
    return bytes(encode(message, POINT_CLOUD))


def _cloud(raw: bytes, types: Any, *, is_ros2: bool) -> Any:
    """Build the PointCloud2, from bytes of ROS 1, or of XCDR version 1, whose numbers are aligned."""
    order = ">" if is_ros2 and not raw[1] & 1 else "<"
    begin = 4 if is_ros2 else 0

    def aligned(place: int, size: int) -> int:
        return begin + -(-(place - begin) // size) * size if is_ros2 else place

    # The header: stamp and frame, in ROS 1 with a number before them.
    number = 0 if is_ros2 else struct.unpack_from("<I", raw, 0)[0]
    seconds, nanoseconds, letters = struct.unpack_from(f"{order}III", raw, 4)
    frame = raw[16 : 16 + letters].rstrip(b"\0").decode(errors="replace")
    # Then timebase (u64), point_num (u32), lidar_id (u8) and rsvd (3 · u8), and the number of points.
    place = aligned(aligned(16 + letters, 8) + 16, 4)
    (count,) = struct.unpack_from(f"{order}I", raw, place)
    place += 4
    step = aligned(begin + _POINT_BYTES, 4) - begin
    data = np.frombuffer(raw, np.uint8, (count - 1) * step + _POINT_BYTES if count else 0, place)
    if step > _POINT_BYTES:
        data = np.concatenate([data, np.zeros(step - _POINT_BYTES if count else 0, np.uint8)])
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    values = {"stamp": stamp, "frame_id": frame} | ({} if is_ros2 else {"seq": number})
    field = types["sensor_msgs/msg/PointField"]
    return types[POINT_CLOUD](
        header=types["std_msgs/msg/Header"](**values),
        height=1,
        width=count,
        fields=[field(name, offset, datatype, 1) for name, offset, datatype in _POINT],
        is_bigendian=order == ">",
        point_step=step,
        row_step=count * step,
        data=data,
        is_dense=True,
    )
