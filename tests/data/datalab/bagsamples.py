# SPDX-License-Identifier: Apache-2.0
"""A short generated drive, as bags with the topics, points and images of published datasets."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from slamhive.data.recordings.reading import Recording
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.data.recordings.writing import RecordingWriter
from slamhive.model.formats import RecordingFormat
from slamhive_eval import Trajectory
from slamhive_eval.rotation import from_roll_pitch_yaw

if TYPE_CHECKING:
    from pathlib import Path

START = 1_600_000_000_123_456_789
SCANS, PERIOD = 12, 10**8
OUSTER = [
    *((name, "<f4") for name in ("x", "y", "z", "intensity")),
    *(("t", "<u4"), ("reflectivity", "<u2"), ("ring", "u1"), ("noise", "<u2"), ("range", "<u4")),
]
HESAI = [*((name, "<f4") for name in ("x", "y", "z", "intensity")), ("timestamp", "<f8"), ("ring", "<u2")]
VELODYNE = [*((name, "<f4") for name in ("x", "y", "z", "intensity")), ("ring", "<u2"), ("time", "<f4")]
IMU, GREY, COLOR, FIX = "imu", "grey", "color", "fix"
"""Contents of a topic: the fields of a scan's points, or one of these."""


def drive() -> Trajectory:
    """Return the body's poses at 100 Hz: a bend that climbs, longer than the scans."""
    times = np.arange(-10, SCANS * 10 + 10) * 0.01
    positions = np.column_stack((3 * times, np.sin(times), 0.1 * times))
    angles = np.column_stack((0.02 * times, -0.03 * times, 0.5 * times))
    # Float64 holds seconds since 1970 to 0.2 µs.
    return Trajectory(START / 1e9 + times, positions, from_roll_pitch_yaw(angles))


def scan(fields: list[tuple[str, str]], stamp: int, *, back: bool = False) -> Any:
    """Return points of 16 rings over one turn, whose times count from its start, or ``back`` from its end."""
    columns, rings = 36, 16
    points = np.zeros(columns * rings, dtype=fields)
    turn = np.repeat(np.arange(columns), rings)
    points["x"], points["y"] = 5 * np.cos(turn * np.pi / 18), 5 * np.sin(turn * np.pi / 18)
    points["z"] = points["ring"] = np.tile(np.arange(rings), columns)
    since = turn * (PERIOD // columns) - back * PERIOD
    if "t" in points.dtype.names:
        points["t"] = since
    elif "timestamp" in points.dtype.names:
        points["timestamp"] = (stamp + since) / 1e9
    else:
        points["time"] = since / 1e9
    return points


class SampleWriter(BagWriter):
    """Writes what publishers record beside what importers write."""

    def compressed(
        self, topic: str, stamp: int, pixels: Any, described: str = "png", head: bytes = b""
    ) -> None:
        """Write a CompressedImage: what its format says, and what comes before the image."""
        kind = "sensor_msgs/msg/CompressedImage"
        data = compress(pixels, described, head)
        message = self._types[kind](header=self._header(topic, stamp, "camera"), format=described, data=data)
        self._write(topic, kind, stamp, message)

    def fix(self, topic: str, stamp: int) -> None:
        """Write a NavSatFix."""
        kind = "sensor_msgs/msg/NavSatFix"
        status = self._types["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
        message = self._types[kind](
            header=self._header(topic, stamp, "gnss"),
            status=status,
            latitude=31.0,
            longitude=121.0 + 1e-7 * (stamp % 100),
            altitude=10.0,
            position_covariance=np.full(9, 0.1),
            position_covariance_type=2,
        )
        self._write(topic, kind, stamp, message)


def compress(pixels: Any, described: str, head: bytes = b"") -> Any:
    """Return the data of a CompressedImage: a PNG, or RVL where its format says so."""
    body = rvl(pixels) if described.endswith("rvl") else cv2.imencode(".png", pixels)[1].tobytes()
    return np.frombuffer(head + body, dtype=np.uint8)


def rvl(depth: Any) -> bytes:
    """Compress depth as RVL, as its description has it."""
    groups: list[int] = []

    def number(value: int) -> None:
        while value > 7:
            groups.append(value & 7 | 8)
            value >>= 3
        groups.append(value)

    values, at, before = depth.reshape(-1).astype(int).tolist(), 0, 0
    while at < len(values):
        for has_depth in (False, True):
            end = at
            while end < len(values) and bool(values[end]) == has_depth:
                end += 1
            number(end - at)
            for value in values[at:end] if has_depth else ():
                step, before = value - before, value
                number(step << 1 if step >= 0 else (-step << 1) - 1)
            at = end
    groups += [0] * (-len(groups) % 8)
    words = [
        sum(group << 28 - 4 * k for k, group in enumerate(groups[w : w + 8]))
        for w in range(0, len(groups), 8)
    ]
    return struct.pack(f"<ii{len(words)}I", depth.shape[1], depth.shape[0], *words)


def write_bag(
    path: Path, topics: dict[str, Any], *, first: int = 0, count: int = SCANS, back: bool = False
) -> Path:
    """Write a bag of some of the scans.

    Args:
        path: The bag.
        topics: What each topic carries; of images with their size, (kind, (height, width)).
        first: The first scan.
        count: How many.
        back: Whether times of points count back from the end of their scan.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    events = [(START + k * PERIOD, topic) for k in range(first, first + count) for topic in topics]
    samples = [topic for topic, kind in topics.items() if kind == IMU]
    begin, end = START + first * PERIOD, START + (first + count - 1) * PERIOD
    events += [
        (at, topic) for at in range(begin, end, 5_000_000) for topic in samples if (at - begin) % PERIOD
    ]
    with SampleWriter(path) as bag:
        for stamp, topic in sorted(events):
            kind = topics[topic]
            if kind == IMU:
                bag.imu(topic, stamp, "imu", np.array([0.0, 0.0, 0.5]), np.array([0.1, 0.0, 9.8]))
            elif kind == FIX:
                bag.fix(topic, stamp)
            elif isinstance(kind, tuple):
                number = (stamp - START) // PERIOD
                shape = kind[1] if kind[0] == GREY else (*kind[1], 3)
                pixels = np.full(shape, 10 + number, dtype=np.uint8)
                if kind[0] == GREY:
                    bag.image(topic, stamp, "camera", "mono8", pixels)
                else:
                    bag.compressed(topic, stamp, pixels)
            else:
                bag.points(topic, stamp, "lidar", scan(kind, stamp, back=back))
    return path


def as_rosbag2(bag: Path, folder: Path, name: str) -> Path:
    """Write the messages of a ROS 1 bag into a ROS 2 folder whose database has a name of its own."""
    source = Recording([bag], RecordingFormat.ROSBAG1)
    with source, RecordingWriter(source, folder, RecordingFormat.ROSBAG2) as writer:
        for connection, at, raw in source.messages({*source.topics}):
            writer.write(connection, at, raw)
    database = next(folder.glob("*.db3"))
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(database.name, f"{name}.db3"))
    database.rename(folder / f"{name}.db3")
    return folder
