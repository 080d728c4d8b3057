# SPDX-License-Identifier: Apache-2.0
"""Files of ROS 2 recordings that aren't as a recorder leaves them when all goes well."""

from __future__ import annotations

import io
import shutil
import sqlite3
import struct
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from slamhive.data.recordings.reading import Recording, guess_format
from slamhive.model.algorithm import RecordingFormat
from slamhive.model.errors import DataError

STORE = get_typestore(Stores.ROS2_HUMBLE)
IMU, TIME = "sensor_msgs/msg/Imu", 10**18


def imu(number: int) -> bytes:
    kind = STORE.types
    header = kind["std_msgs/msg/Header"](kind["builtin_interfaces/msg/Time"](10**9, number), "imu")
    zero, turn = kind["geometry_msgs/msg/Vector3"](0, 0, 0), kind["geometry_msgs/msg/Quaternion"](0, 0, 0, 1)
    message = kind[IMU](header, turn, np.zeros(9), zero, np.zeros(9), zero, np.zeros(9))
    return bytes(STORE.serialize_cdr(message, IMU))


def folder(
    path: Path,
    numbers: Any,
    plugin: StoragePlugin = StoragePlugin.SQLITE3,
    *,
    static: bool = False,
    **how: Any,
) -> Path:
    writer = Writer(path, version=9, storage_plugin=plugin)
    if how:
        writer.set_compression(how["mode"], CompressionFormat.ZSTD)
    with writer:
        one = writer.add_connection("/imu", IMU, typestore=STORE)
        for number in numbers:
            writer.write(one, TIME + number, imu(number))
        if static:
            kind = "tf2_msgs/msg/TFMessage"
            empty = STORE.types[kind]([])
            topic = writer.add_connection("/tf_static", kind, typestore=STORE)
            writer.write(topic, TIME + numbers[0], STORE.serialize_cdr(empty, kind))
    return path


def split(path: Path, *pieces: Any, listed: int | None = None) -> Path:
    """Make a folder of pieces, metadata.yaml of one of them (default: all)."""
    path.mkdir()
    parts = [folder(path / f"part{k}", numbers, static=k == 0) for k, numbers in enumerate(pieces)]
    stated = [
        yaml.safe_load((one / "metadata.yaml").read_text())["rosbag2_bagfile_information"] for one in parts
    ]
    whole = stated[listed if listed is not None else 0]
    if listed is None:
        whole["message_count"] = sum(one["message_count"] for one in stated)
    whole["relative_file_paths"] = [f"bag_{k}.db3" for k in range(len(parts))]
    for k, one in enumerate(parts):
        next(one.glob("*.db3")).rename(path / f"bag_{k}.db3")
        shutil.rmtree(one)
    (path / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": whole}))
    return path


def mcap(
    path: Path, *, profile: str = "ros2", encoding: str = "cdr", foreign: bool = False, order: Any = ()
) -> Path:
    """Write an MCAP file without a summary or chunks: its records one after the other."""

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    out = io.BytesIO()

    def record(code: int, data: bytes) -> None:
        out.write(struct.pack("<BQ", code, len(data)) + data)

    out.write(b"\x89MCAP0\r\n")
    record(1, text(profile) + text(""))
    definition = STORE.generate_msgdef(IMU, ros_version=2)[0]
    record(3, struct.pack("<H", 1) + text(IMU) + text("ros2msg") + text(definition))
    record(4, struct.pack("<HH", 1, 1) + text("/imu") + text(encoding) + text(""))
    if foreign:
        record(3, struct.pack("<H", 2) + text("Note") + text("jsonschema") + text("{}"))
        record(4, struct.pack("<HH", 2, 2) + text("/note") + text("json") + text(""))
        record(5, struct.pack("<HIQQ", 2, 0, TIME, TIME) + b"{}")
    for number in order:
        record(5, struct.pack("<HIQQ", 1, 0, TIME + number, TIME + number) + imu(number))
    record(15, struct.pack("<I", 0))
    record(2, struct.pack("<QQI", 0, 0, 0))
    out.write(b"\x89MCAP0\r\n")
    path.write_bytes(out.getvalue())
    return path


def read(*paths: Path) -> tuple[list[int], dict[str, str]]:
    """Return the numbers of the messages as they are read, and what was noticed by code."""
    with Recording(paths, guess_format(paths[0])) as recording:
        scan = recording.scan({"/imu"})["/imu"]
        assert (np.diff(scan.times) >= 0).all()
        assert (scan.stamps == scan.times).all()
        return (scan.times - TIME).tolist(), {notice.code: notice.text for notice in recording.notices}


def test_pieces_are_read_in_the_order_of_their_times(tmp_path: Path) -> None:
    numbers, notices = read(split(tmp_path / "bag", range(50, 100), range(20, 50), range(20)))
    assert numbers == list(range(100))
    assert notices == {"files.order": notices["files.order"]}
    assert "read as bag_2.db3, bag_1.db3, bag_0.db3" in notices["files.order"]


def test_messages_in_two_pieces_count_once(tmp_path: Path) -> None:
    numbers, notices = read(split(tmp_path / "bag", range(60), range(50, 100)))
    assert numbers == list(range(100))
    assert "bag_0.db3 and bag_1.db3 overlap" in notices["files.overlap"]


def test_topics_are_those_of_all_pieces_not_of_the_metadata(tmp_path: Path) -> None:
    bag = split(tmp_path / "bag", range(50), range(50, 100), listed=1)
    numbers, notices = read(bag)
    assert numbers == list(range(100))
    assert "states 50 messages and no /tf_static, its files hold 101" in notices["files.metadata"]
    with Recording([bag], RecordingFormat.ROSBAG2) as recording:
        assert recording.topics["/tf_static"].count == 1


def test_fewer_messages_than_stated_are_said(tmp_path: Path) -> None:
    bag = split(tmp_path / "bag", range(50), range(50, 100))
    with closing(sqlite3.connect(bag / "bag_1.db3")) as database, database:
        database.execute("DELETE FROM messages WHERE timestamp > ?", (TIME + 79,))
    numbers, notices = read(bag)
    assert numbers == list(range(80))
    assert notices["files.count"] == "metadata.yaml states 101 messages, its files hold 81"


def test_a_piece_opens_by_itself(tmp_path: Path) -> None:
    bag = split(tmp_path / "bag", range(50), range(50, 100))
    numbers, notices = read(bag / "bag_1.db3")
    assert numbers == list(range(50, 100))
    assert "extrinsics may be in the first piece" in notices["files.piece"]
    assert notices["files.missing"].startswith("bag_0.db3 beside it may be")
    numbers, notices = read(bag / "bag_1.db3", bag / "bag_0.db3")
    assert numbers == list(range(100))
    assert set(notices) == {"files.order"}


def test_a_missing_piece_is_named(tmp_path: Path) -> None:
    bag = split(tmp_path / "bag", range(50), range(50, 100))
    (bag / "bag_1.db3").unlink()
    with pytest.raises(DataError, match=r"lists bag_1\.db3, which isn't there: copy it too") as error:
        read(bag)
    assert "damaged" not in str(error.value)


def test_messages_in_a_write_ahead_log_are_read_and_the_files_left_alone(tmp_path: Path) -> None:
    source = folder(tmp_path / "source", range(30))
    with closing(sqlite3.connect(next(source.glob("*.db3")), isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        late = database.execute("SELECT * FROM messages WHERE id > 10").fetchall()
        database.execute("DELETE FROM messages WHERE id > 10")
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", late)
        bag = Path(shutil.copytree(source, tmp_path / "killed"))
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    numbers, notices = read(bag)
    assert numbers == list(range(30))
    assert "20 of 30 messages of source.db3 are in source.db3-wal" in notices["files.wal"]
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before


def test_a_file_of_a_bag_with_compressed_messages_opens_by_itself(tmp_path: Path) -> None:
    bag = folder(tmp_path / "bag", range(9), StoragePlugin.MCAP, mode=CompressionMode.MESSAGE)
    assert read(bag) == read(next(bag.glob("*.mcap"))) == (list(range(9)), {})


def test_channels_of_others_are_left_out_and_a_profile_is_free_text(tmp_path: Path) -> None:
    numbers, notices = read(mcap(tmp_path / "a.mcap", profile="", foreign=True, order=range(5)))
    assert numbers == list(range(5))
    assert notices == {"files.foreign": "channels that aren't ROS 2's are left out: /note (json, jsonschema)"}


def test_unindexed_messages_in_any_order_are_read(tmp_path: Path) -> None:
    assert read(mcap(tmp_path / "a.mcap", order=[3, 0, 4, 1, 2])) == (list(range(5)), {})


def test_ros_1_in_an_mcap_file_is_said_just_so(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="it holds messages of ROS 1 in an MCAP file") as error:
        read(mcap(tmp_path / "a.mcap", profile="ros1", encoding="ros1", order=range(5)))
    assert "damaged" not in str(error.value)


def test_a_summary_of_chunk_indexes_alone_is_enough(tmp_path: Path) -> None:
    bag = folder(tmp_path / "bag", range(9), StoragePlugin.MCAP)
    path = next(bag.glob("*.mcap"))
    data = path.read_bytes()
    begin = struct.unpack_from("<Q", data, len(data) - 28)[0]
    kept, at = b"", begin
    while at < len(data) - 37:
        code, size = struct.unpack_from("<BQ", data, at)
        kept += data[at : at + 9 + size] if code == 8 else b""
        at += 9 + size
    bare = tmp_path / "bare.mcap"
    bare.write_bytes(data[:begin] + kept + data[-37:])
    numbers, notices = read(bare)
    assert numbers == list(range(9))
    assert set(notices) == {"files.summary"}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("x.bag.active", "`rosbag reindex` on that copy closes it"),
        ("x_0.db3.zstd", "`zstd -d x_0.db3.zstd`"),
        ("killed", "`ros2 bag reindex killed` on a copy writes it"),
    ],
)
def test_what_a_killed_recorder_leaves_has_a_remedy(tmp_path: Path, name: str, words: str) -> None:
    if "." in name:
        (tmp_path / name).write_bytes(b"x")
    else:
        folder(tmp_path / name, range(3))
        (tmp_path / name / "metadata.yaml").unlink()
    with pytest.raises(DataError, match=words):
        guess_format(tmp_path / name)
