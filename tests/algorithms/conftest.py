# SPDX-License-Identifier: Apache-2.0
"""Makes the adapters' helpers importable, and run folders with small recordings."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

ALGORITHMS = Path(__file__).parents[2] / "images" / "algorithms"
sys.path.insert(0, str(ALGORITHMS))

NS = 1_000_000_000
START = 1_600_000_000 * NS
STORES = {"Rosbag1": get_typestore(Stores.ROS1_NOETIC), "Rosbag2": get_typestore(Stores.ROS2_HUMBLE)}


@dataclass
class Maker:
    """Makes messages and writes them to a run folder."""

    folder: Path
    kind: str = "Rosbag1"
    messages: list[tuple[str, int, Any]] = field(default_factory=list)

    def make(self, name: str, /, **values: Any) -> Any:
        return STORES[self.kind].types[name](**values)

    def header(self, stamp: int) -> Any:
        time = self.make("builtin_interfaces/msg/Time", sec=stamp // NS, nanosec=stamp % NS)
        more = {"seq": 0} if self.kind == "Rosbag1" else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id="sensor", **more)

    def cloud(self, stamp: int, records: np.ndarray, *, big: bool = False) -> Any:
        codes = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
        fields = [
            self.make(
                "sensor_msgs/msg/PointField",
                name=name,
                offset=records.dtype.fields[name][1],
                datatype=codes[records.dtype[name].str[1:]],
                count=1,
            )
            for name in records.dtype.names
        ]
        size = records.dtype.itemsize
        return self.make(
            "sensor_msgs/msg/PointCloud2",
            header=self.header(stamp),
            height=1,
            width=len(records),
            fields=fields,
            is_bigendian=big,
            point_step=size,
            row_step=size * len(records),
            data=np.frombuffer(records.tobytes(), np.uint8),
            is_dense=True,
        )

    def image(self, data: bytes, shape: tuple[int, int], encoding: str, step: int, *, big: bool) -> Any:
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header(START),
            height=shape[0],
            width=shape[1],
            encoding=encoding,
            is_bigendian=int(big),
            step=step,
            data=np.frombuffer(data, np.uint8),
        )

    def imu(self, stamp: int) -> Any:
        vector = self.make("geometry_msgs/msg/Vector3", x=0.1, y=0.2, z=0.3)
        none = np.zeros(9)
        return self.make(
            "sensor_msgs/msg/Imu",
            header=self.header(stamp),
            orientation=self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=none,
            angular_velocity=vector,
            angular_velocity_covariance=none,
            linear_acceleration=vector,
            linear_acceleration_covariance=none,
        )

    def add(self, topic: str, stamp: int, message: Any) -> None:
        self.messages.append((topic, stamp, message))

    def write(self, extra_topics: tuple[str, ...] = ()) -> Path:
        """Write the messages, and a topic without any for each extra one."""
        store, name = STORES[self.kind], "dataset" if self.kind == "Rosbag2" else "recording.bag"
        path = self.folder / name
        writer = Writer1(path) if self.kind == "Rosbag1" else Writer2(path, version=9)
        with writer:
            topics = {topic: message.__msgtype__ for topic, _, message in self.messages}
            topics |= dict.fromkeys(extra_topics, "sensor_msgs/msg/PointCloud2")
            connections = {t: writer.add_connection(t, kind, typestore=store) for t, kind in topics.items()}
            serialize = store.serialize_ros1 if self.kind == "Rosbag1" else store.serialize_cdr
            for topic, stamp, message in self.messages:
                writer.write(connections[topic], stamp, serialize(message, message.__msgtype__))
        return path

    def configure(self, sensors: dict[str, Any], recording: str = "recording.bag", **more: Any) -> None:
        config = {
            "kind": "RunConfiguration",
            "mode": "lidar",
            "dataset": {"recording": {"format": self.kind, "path": recording}},
            "sensors": sensors,
            "parameters": {},
        }
        (self.folder / "config.yaml").write_text(yaml.safe_dump(config | more), encoding="utf-8")


@pytest.fixture
def maker(tmp_path: Path) -> Maker:
    return Maker(tmp_path)


@pytest.fixture
def maker2(tmp_path: Path) -> Maker:
    """Makes ROS 2 bags."""
    return Maker(tmp_path, "Rosbag2")


@pytest.fixture
def points() -> np.ndarray:
    """Four points, the third of which isn't finite, with padding between the fields."""
    kind = np.dtype(
        {
            "names": ["x", "y", "z", "ring", "time"],
            "formats": ["<f4", "<f4", "<f4", "<u2", "<f4"],
            "offsets": [0, 4, 8, 16, 20],
            "itemsize": 32,
        }
    )
    records = np.zeros(4, kind)
    records["x"] = [1, 2, np.nan, 4]
    records["y"] = [5, 6, 7, 8]
    records["ring"] = [0, 1, 2, 3]
    records["time"] = [0.0, 0.025, 0.05, 0.075]
    return records
