# SPDX-License-Identifier: Apache-2.0
"""Scans of LiDARs in messages of their makers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from spoiling import found_in

from slamhive.data.inspecting.quick import require_usable
from slamhive.data.inspecting.suggestion import suggest_dataset
from slamhive.data.making.preparation import prepare
from slamhive.data.recordings.clouds import cloud_points, point_times
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.reading import Recording, guess_format
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError
from slamhive.model.formats import DataFormat
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role

if TYPE_CHECKING:
    from pathlib import Path

START = 1_600_000_000
LIVOX = "livox_ros_driver{}/msg/CustomMsg"
POINT = """================================================================================
MSG: {0}/CustomPoint
uint32 offset_time
float32 x
float32 y
float32 z
uint8 reflectivity
uint8 tag
uint8 line
"""
SCAN = """std_msgs/Header header
uint64 timebase
uint32 point_num
uint8 lidar_id
uint8[3] rsvd
CustomPoint[] points
"""
PACKETS = "velodyne_msgs/msg/VelodyneScan"
SCANS, POINTS = 5, 7


def write(path: Path, kind: str, *, frame: str = "livox", scan: str = SCAN, cut: int | None = None) -> Path:
    """Write scans of Livox, in which point k is at (k, number of the scan, 1), k · 10 ms after the stamp."""
    is_ros1 = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    package = kind.split("/", maxsplit=1)[0]
    store.register(get_types_from_msg(scan + POINT.format(package), kind))
    types: Any = store.types
    make, point = types[kind], types[kind.replace("Msg", "Point")]
    plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
    folder = path.with_suffix(".folder") if path.suffix == ".mcap" else path
    with Writer1(path) if is_ros1 else Writer2(folder, version=8, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/livox/lidar", kind, typestore=store)
        for number in range(SCANS):
            at = START * 10**9 + number * 10**8
            header = {"stamp": types["builtin_interfaces/msg/Time"](*divmod(at, 10**9)), "frame_id": frame}
            fields: dict[str, Any] = {
                "header": types["std_msgs/msg/Header"](**header, **({"seq": number} if is_ros1 else {})),
                "timebase": at,
                "point_num": POINTS,
                "lidar_id": 1,
                "rsvd": np.zeros(3, np.uint8),
                "points": [
                    point(k * 10_000_000, float(k), float(number), 1.0, 40 + k, 16, k % 4)
                    for k in range(POINTS)
                ],
            }
            names = [name for name, _ in store.fielddefs[kind][1]]
            message = make(**{name: fields[name] for name in names})
            raw = (store.serialize_ros1 if is_ros1 else store.serialize_cdr)(message, kind)
            writer.write(connection, at, raw if cut is None else raw[:cut])
    if path.suffix == ".mcap":
        next(folder.glob("*.mcap")).rename(path)
    return path


def dataset(path: Path) -> DatasetEntry:
    manifest = suggest_dataset([path], "livox", path.parent).manifest
    return DatasetEntry(Dataset.model_validate(manifest), path.parent)


@pytest.mark.parametrize("name", ["scans.bag", "scans", "scans.mcap"])
@pytest.mark.parametrize("driver", ["", "2"])
@pytest.mark.parametrize("frame", ["livox", "livox_frame", ""])
def test_scans_of_livox_are_point_clouds(tmp_path: Path, name: str, driver: str, frame: str) -> None:
    path = write(tmp_path / name, LIVOX.format(driver), frame=frame)
    with Recording([path], guess_format(path)) as recording:
        assert recording.topics["/livox/lidar"].message_type == "sensor_msgs/msg/PointCloud2"
        scans = [recording.decode(raw, one.msgtype) for one, _, raw in recording.messages({"/livox/lidar"})]
    assert len(scans) == SCANS
    for number, scan in enumerate(scans):
        assert (scan.header.frame_id, scan.width, scan.row_step) == (frame, POINTS, scan.data.size)
        points = cloud_points(scan, "")
        assert points["x"].tolist() == list(range(POINTS))
        assert points["y"].tolist() == [number] * POINTS
        assert points["reflectivity"].tolist() == list(range(40, 40 + POINTS))
        assert points["line"].tolist() == [k % 4 for k in range(POINTS)]
        found = point_times(points, "offset_time", 0)
        assert found is not None
        np.testing.assert_allclose(found[0], np.arange(POINTS) / 100)


@pytest.mark.parametrize(
    ("name", "form"), [("scans.bag", DataFormat.ROSBAG1), ("scans.mcap", DataFormat.MCAP)]
)
def test_runs_get_point_clouds_of_livox_scans(tmp_path: Path, name: str, form: DataFormat) -> None:
    path = write(tmp_path / name, LIVOX.format("2"))
    entry = dataset(path)
    lidar = entry.dataset.spec.sensors["lidar"]
    assert (str(lidar.type), lidar.topic) == ("Lidar", "/livox/lidar")
    assert lidar.lidar is not None
    assert (lidar.lidar.time_field, lidar.lidar.ring_field) == ("offset_time", "line")
    require_usable(entry.dataset, entry.root)
    found = found_in(entry)
    assert {code: str(one.severity) for code, one in found.items()} == {"points.format": "note"}
    # Its own form isn't that of the files, so that nothing is linked.
    variant = prepare(entry, [Role.LIDAR], InputOptions(), [form], tmp_path / "cache")
    with Recording([variant.path], guess_format(variant.path)) as recording:
        assert [one.msgtype for one in recording.connections] == ["sensor_msgs/msg/PointCloud2"]
        assert not recording.is_converted


def test_who_asks_for_the_topic_itself_gets_what_is_in_the_files(tmp_path: Path) -> None:
    path = write(tmp_path / "scans.bag", LIVOX.format(""))
    with Recording([path], guess_format(path), scans=()) as recording:
        assert recording.topics["/livox/lidar"].message_type == LIVOX.format("")


def test_messages_of_other_fields_are_none_of_livox(tmp_path: Path) -> None:
    path = write(tmp_path / "scans.bag", LIVOX.format(""), scan=SCAN.replace("uint64 timebase\n", ""))
    with Recording([path], guess_format(path)) as recording:
        assert not recording.is_converted


@pytest.mark.parametrize("name", ["scans.bag", "scans.mcap"])
@pytest.mark.parametrize("cut", [30, 60, 100])
def test_a_scan_of_livox_that_breaks_off(tmp_path: Path, name: str, cut: int) -> None:
    path = write(tmp_path / name, LIVOX.format("2"), cut=cut)
    with (
        Recording([path], guess_format(path)) as recording,
        pytest.raises(DataError, match=r"scans.*: /livox/lidar: a scan of Livox .* breaks off after"),
    ):
        recording.first("/livox/lidar")


def test_packets_are_named_with_their_driver(tmp_path: Path) -> None:
    path = tmp_path / "packets.bag"
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("std_msgs/Header header\nuint8[] packets", PACKETS))
    types: Any = store.types
    header = types["std_msgs/msg/Header"](0, types["builtin_interfaces/msg/Time"](START, 0), "velodyne")
    with Writer1(path) as writer:
        connection = writer.add_connection("/velodyne_packets", PACKETS, typestore=store)
        message = types[PACKETS](header, np.zeros(3, np.uint8))
        writer.write(connection, START * 10**9, store.serialize_ros1(message, PACKETS))
    notes = suggest_dataset([path], "packets").missing
    assert any("packets of a Velodyne LiDAR" in one and "velodyne_pointcloud" in one for one in notes)
