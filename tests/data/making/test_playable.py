# SPDX-License-Identifier: Apache-2.0
"""Prepared bags of ROS 2 can be played by a program that knows nothing but what is in them."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
import struct
from contextlib import closing
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest
import yaml
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slamhive.data.making.preparation import Variant, prepare, recording_state
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.model.dataset import DataFile, Dataset
from slamhive.model.errors import DataError
from slamhive.model.formats import DataFormat, RecordingFormat
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role
from slamhive.playback.player.ros2.bags import Ros2Bag

if TYPE_CHECKING:
    from pathlib import Path

BAG1, BAG2, MCAP = DataFormat.ROSBAG1, DataFormat.ROSBAG2, DataFormat.MCAP
START = 1_600_000_000 * 10**9
IMU, POINTS, TF = "sensor_msgs/msg/Imu", "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"
OWN = "lab_msgs/msg/Beat"
BEAT = (
    "std_msgs/Header header\ntime taken\nduration late\nfloat32[3] of\nlab_msgs/Part[] parts\nstring note\n"
)
PART = "uint8 kind\nfloat64 value\n"


class Played(NamedTuple):
    """A topic as a player finds it."""

    type: str
    is_latched: bool
    times: list[int]
    messages: list[Any]


def play(path: Path) -> dict[str, Played]:
    """Read a bag by its own definitions, strictly."""
    found = {}
    with Reader(path) as reader:
        for connection in reader.connections:
            assert re.fullmatch(r"\w+/msg/\w+", connection.msgtype)
            assert connection.msgdef.format == MessageDefinitionFormat.MSG
            assert connection.ext.serialization_format == "cdr"
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
            times, messages = [], []
            for _, time, raw in reader.messages([connection]):
                assert bytes(raw[:2]) == b"\0\1"
                times.append(time)
                messages.append(store.deserialize_cdr(raw, connection.msgtype))
            latched = [one.durability.value == 1 for one in connection.ext.offered_qos_profiles]
            assert connection.topic not in found
            found[connection.topic] = Played(connection.msgtype, any(latched), times, messages)
        assert sum(len(one.times) for one in found.values()) == reader.message_count
    return found


def entry_of(path: Path, form: RecordingFormat, sensors: dict[str, tuple[str, str]]) -> DatasetEntry:
    spec = {
        "recording": {"format": form, "files": [DataFile(path=path.name)]},
        "sensors": {name: {"type": kind, "topic": topic} for name, (kind, topic) in sensors.items()},
    }
    dataset = Dataset.model_validate({"metadata": {"name": "walk"}, "spec": spec})
    return DatasetEntry(dataset, path.parent)


def made(entry: DatasetEntry, roles: Any, cache: Path, form: DataFormat, topics: Any = ()) -> Variant:
    return prepare(entry, roles, InputOptions(), [form], cache, topics=topics)


def noetic() -> Any:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    return store


HUMBLE, NOETIC = get_typestore(Stores.ROS2_HUMBLE), noetic()


def with_own(store: Any) -> Any:
    one = get_typestore(Stores.EMPTY)
    one.register(store.fielddefs)
    text = (
        BEAT
        if store is NOETIC
        else BEAT.replace("time taken", "builtin_interfaces/Time taken").replace(
            "duration late", "builtin_interfaces/Duration late"
        )
    )
    one.register(get_types_from_msg(PART, "lab_msgs/msg/Part") | get_types_from_msg(text, OWN))
    return one


def message(store: Any, kind: str, number: int) -> Any:
    types, is_ros1 = store.types, "seq" in dict(store.fielddefs["std_msgs/msg/Header"][1])
    time = types["builtin_interfaces/msg/Time"](1_600_000_000, number)
    header = types["std_msgs/msg/Header"](**({"seq": number} if is_ros1 else {}), stamp=time, frame_id="imu")
    if kind == OWN:
        late = types["builtin_interfaces/msg/Duration"](-1, 5)
        parts = [types["lab_msgs/msg/Part"](k, 0.5 * k) for k in range(number)]
        return types[OWN](header, time, late, np.arange(3, dtype=np.float32), parts, f"beat {number}")
    if kind == IMU:
        vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1)
        return types[IMU](
            header, turn, np.zeros(9), vector(0, 0, number), np.zeros(9), vector(0, 0, 9.8), np.zeros(9)
        )
    if kind == TF:
        pose = types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0),
            types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1),
        )
        return types[TF]([types["geometry_msgs/msg/TransformStamped"](header, "lidar", pose)])
    raise ValueError(kind)


def ros1(path: Path, topics: dict[str, tuple[str, int, int]]) -> Path:
    """Write a ROS 1 bag; topics: type, number of messages, whether latched."""
    store = with_own(NOETIC)
    with Writer1(path) as writer:
        for topic, (kind, count, latching) in topics.items():
            one = writer.add_connection(topic, kind, typestore=store, latching=latching)
            for number in range(count):
                raw = store.serialize_ros1(message(store, kind, number), kind)
                writer.write(one, START + number, raw)
    return path


def ros2(
    path: Path,
    topics: dict[str, tuple[str, int]],
    plugin: StoragePlugin = StoragePlugin.SQLITE3,
    mode: CompressionMode = CompressionMode.NONE,
    *,
    big: bool = False,
) -> Path:
    """Write a ROS 2 bag without any quality of service; topics: type and number of messages."""
    store = with_own(HUMBLE)
    writer = Writer(path, version=8, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        for topic, (kind, count) in topics.items():
            one = writer.add_connection(topic, kind, typestore=store)
            for number in range(count):
                raw = store.serialize_cdr(message(store, kind, number), kind, little_endian=not big)
                writer.write(one, START + number, bytes(raw))
    return path


def without_definitions(folder: Path) -> Path:
    """Take out what a bag of Humble or older doesn't have."""
    (database,) = folder.glob("*.db3")
    with closing(sqlite3.connect(database)) as file, file:
        file.execute("DROP TABLE message_definitions")
        file.execute("UPDATE schema SET schema_version = 3")
    about = yaml.safe_load((folder / "metadata.yaml").read_text())
    about["rosbag2_bagfile_information"]["version"] = 5
    for topic in about["rosbag2_bagfile_information"]["topics_with_message_count"]:
        del topic["topic_metadata"]["type_description_hash"]
        topic["topic_metadata"]["offered_qos_profiles"] = ""
    (folder / "metadata.yaml").write_text(yaml.safe_dump(about))
    return folder


SENSORS = {"imu": ("Imu", "/imu")}


@pytest.mark.parametrize("form", [BAG2, MCAP])
def test_of_ros_1(tmp_path: Path, form: DataFormat) -> None:
    """Latched topics stay latched, and types of one's own have their definitions."""
    topics = {"/imu": (IMU, 3, 0), "/tf_static": (TF, 1, 0), "/map": (OWN, 1, 1), "/beat": (OWN, 3, 0)}
    entry = entry_of(ros1(tmp_path / "walk.bag", topics), RecordingFormat.ROSBAG1, SENSORS)
    found = play(made(entry, [Role.IMU], tmp_path / "cache", form, ["/map", "/beat"]).path)
    assert {topic: (one.type, one.is_latched, len(one.times)) for topic, one in found.items()} == {
        "/imu": (IMU, False, 3),
        "/tf_static": (TF, True, 1),
        "/map": (OWN, True, 1),
        "/beat": (OWN, False, 3),
    }
    beat = found["/beat"].messages[2]
    assert (beat.note, [part.value for part in beat.parts]) == ("beat 2", [0.0, 0.5])
    assert (beat.late.sec, beat.late.nanosec, beat.taken.nanosec) == (-1, 5, 2)
    assert [one.angular_velocity.z for one in found["/imu"].messages] == [0.0, 1.0, 2.0]
    assert found["/tf_static"].messages[0].transforms[0].child_frame_id == "lidar"


@pytest.mark.parametrize("form", [BAG2, MCAP])
def test_the_player_is_told_types_with_their_hashes_and_what_is_latched(
    tmp_path: Path, form: DataFormat
) -> None:
    topics = {"/imu": (IMU, 3, 0), "/map": (OWN, 1, 1)}
    entry = entry_of(ros1(tmp_path / "walk.bag", topics), RecordingFormat.ROSBAG1, SENSORS)
    variant = made(entry, [Role.IMU], tmp_path / "cache", form, ["/map"])
    bag = Ros2Bag(str(variant.path), {"/imu": "/played"})
    found = [(one.time, one.topic) for one in bag.messages() if one.topic == "/played"]
    bag._reader.close()
    hashes = {kind: with_own(HUMBLE).hash_rihs01(kind) for kind in (IMU, OWN)}
    assert bag.topics == {"/played": (IMU, hashes[IMU], False), "/map": (OWN, hashes[OWN], True)}
    # As rosidl has it of the packages of Iron and later.
    assert hashes[IMU].startswith("RIHS01_7d9a00ff")
    assert found == [(START + number, "/played") for number in range(3)]


WHOLE = {"/imu": (IMU, 3), "/tf_static": (TF, 1)}


@pytest.mark.parametrize("form", [BAG2, MCAP])
@pytest.mark.parametrize("topics", [WHOLE, WHOLE | {"/beat": (OWN, 2)}], ids=["whole", "chosen"])
@pytest.mark.parametrize("how", ["sqlite3", "mcap", "file", "message", "storage", "old", "big"])
def test_of_ros_2(tmp_path: Path, form: DataFormat, topics: Any, how: str) -> None:
    """However it was recorded; also where its messages stay as they are."""
    plugin = StoragePlugin.MCAP if how in {"mcap", "storage"} else StoragePlugin.SQLITE3
    modes = {
        "file": CompressionMode.FILE,
        "message": CompressionMode.MESSAGE,
        "storage": CompressionMode.STORAGE,
    }
    bag = ros2(tmp_path / "walk", topics, plugin, modes.get(how, CompressionMode.NONE), big=how == "big")
    if how == "old":
        without_definitions(bag)
    stored = RecordingFormat.ROSBAG2
    if how in {"mcap", "storage"}:
        bag, stored = next(bag.glob("*.mcap")), RecordingFormat.MCAP
    found = play(made(entry_of(bag, stored, SENSORS), [Role.IMU], tmp_path / "cache", form).path)
    assert {topic: (one.type, one.is_latched, len(one.times)) for topic, one in found.items()} == {
        "/imu": (IMU, False, 3),
        "/tf_static": (TF, True, 1),
    }
    assert [one.angular_velocity.z for one in found["/imu"].messages] == [0.0, 1.0, 2.0]
    assert found["/imu"].times == [START, START + 1, START + 2]


@pytest.mark.parametrize("form", [BAG2, MCAP])
def test_a_type_whose_definition_is_nowhere_is_named(tmp_path: Path, form: DataFormat) -> None:
    bag = without_definitions(ros2(tmp_path / "walk", WHOLE | {"/beat": (OWN, 2)}))
    entry = entry_of(bag, RecordingFormat.ROSBAG2, SENSORS)
    with pytest.raises(DataError, match=r"modes\.topics: /beat .* lab_msgs/msg/Beat.* definition"):
        made(entry, [Role.IMU], tmp_path / "cache", form, ["/beat"])


@pytest.mark.parametrize(("plugin", "stored"), [(StoragePlugin.MCAP, MCAP), (StoragePlugin.SQLITE3, BAG2)])
def test_what_can_be_played_as_it_is_stays_as_it_is(tmp_path: Path, plugin: Any, stored: DataFormat) -> None:
    first = made(
        entry_of(ros2(tmp_path / "walk", WHOLE, plugin), RecordingFormat.ROSBAG2, SENSORS),
        [Role.IMU],
        tmp_path / "cache",
        stored,
    )
    (taken,) = [first.path] if stored is MCAP else first.path.glob("*.db3")
    entry = entry_of(first.path, RecordingFormat(stored), SENSORS)
    again = made(entry, [Role.IMU], tmp_path / "other", stored)
    (left,) = [again.path] if stored is MCAP else again.path.glob("*.db3")
    assert left.read_bytes() == taken.read_bytes()


@pytest.mark.parametrize("form", [BAG2, MCAP])
def test_a_file_of_a_folder_by_itself(tmp_path: Path, form: DataFormat) -> None:
    folder = ros2(tmp_path / "walk", WHOLE)
    (file,) = folder.glob("*.db3")
    (folder / "metadata.yaml").unlink()
    found = play(
        made(entry_of(file, RecordingFormat.ROSBAG2, SENSORS), [Role.IMU], tmp_path / "c", form).path
    )
    assert {topic: len(one.times) for topic, one in found.items()} == {"/imu": 3, "/tf_static": 1}


def mcap(path: Path, channels: list[tuple[str, str | None, str, bytes]], later: Any = ()) -> Path:
    """Write an MCAP file of a message a channel: topic, type (None: no schema), definition, message.

    ``later`` are more times (ns after the start) of the last message.
    """

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    records: list[tuple[int, bytes]] = [(1, text("ros2") + text(""))]
    for number, (topic, kind, definition, raw) in enumerate(channels, 1):
        if kind is not None:
            records.append((3, struct.pack("<H", number) + text(kind) + text("ros2msg") + text(definition)))
        about = (
            struct.pack("<HH", number, 0 if kind is None else number) + text(topic) + text("cdr") + text("")
        )
        records += [(4, about), (5, struct.pack("<HIQQ", number, 0, START, START) + raw)]
        records += [(5, struct.pack("<HIQQ", number, 0, START + at, START + at) + raw) for at in later]
    records += [(15, struct.pack("<I", 0)), (2, struct.pack("<QQI", 0, 0, 0))]
    body = b"".join(struct.pack("<BQ", code, len(data)) + data for code, data in records)
    path.write_bytes(b"\x89MCAP0\r\n" + body + b"\x89MCAP0\r\n")
    return path


def defined(kind: str) -> str:
    return with_own(HUMBLE).generate_msgdef(kind, ros_version=2)[0]


def cdr(kind: str) -> bytes:
    store = with_own(HUMBLE)
    return bytes(store.serialize_cdr(message(store, kind, 1), kind))


@pytest.mark.parametrize("form", [BAG2, MCAP])
def test_a_file_without_an_index_gets_one(tmp_path: Path, form: DataFormat) -> None:
    """Its messages may lie in any order."""
    path = mcap(tmp_path / "walk.mcap", [("/imu", IMU, defined(IMU), cdr(IMU))], later=[3, 0, 1])
    entry = entry_of(path, RecordingFormat.MCAP, SENSORS)
    found = play(made(entry, [Role.IMU], tmp_path / "cache", form).path)
    assert found["/imu"].times == [START, START, START + 1, START + 3]


@pytest.mark.parametrize("form", [BAG2, MCAP])
def test_a_standard_type_is_known_where_its_definition_is_missing(tmp_path: Path, form: DataFormat) -> None:
    path = mcap(tmp_path / "walk.mcap", [("/imu", IMU, "", cdr(IMU)), ("/beat", OWN, defined(OWN), cdr(OWN))])
    entry = entry_of(path, RecordingFormat.MCAP, SENSORS)
    found = play(made(entry, [Role.IMU], tmp_path / "cache", form, ["/beat"]).path)
    assert found["/imu"].messages[0].angular_velocity.z == 1.0
    assert found["/beat"].messages[0].note == "beat 1"


@pytest.mark.parametrize(
    ("channel", "words"),
    [
        (
            ("/imu", None, "", b"\0\1\0\0"),
            r"sensors\.imu\.topic: /imu in .* is no channel of ROS 2 \(cdr, no sch",
        ),
        (("/imu", IMU, defined(IMU), b"\0\7" + cdr(IMU)[2:]), "type sensor_msgs/msg/Imu begins with 00 07"),
    ],
)
def test_what_no_player_can_play_is_said(tmp_path: Path, channel: Any, words: str) -> None:
    other = ("/beat", OWN, defined(OWN), cdr(OWN))
    entry = entry_of(mcap(tmp_path / "walk.mcap", [channel, other]), RecordingFormat.MCAP, SENSORS)
    with pytest.raises(DataError, match=words):
        made(entry, [Role.IMU], tmp_path / "cache", MCAP)


def test_one_latched_publisher_of_several_is_enough(tmp_path: Path) -> None:
    store = with_own(NOETIC)
    with Writer1(tmp_path / "walk.bag") as writer:
        imu = writer.add_connection("/imu", IMU, typestore=store)
        maps = [
            writer.add_connection("/map", OWN, typestore=store, callerid=f"/node{k}", latching=k)
            for k in range(2)
        ]
        for k, one in enumerate([imu, *maps]):
            kind = IMU if one is imu else OWN
            writer.write(one, START + k, store.serialize_ros1(message(store, kind, k), kind))
    entry = entry_of(tmp_path / "walk.bag", RecordingFormat.ROSBAG1, SENSORS)
    found = play(made(entry, [Role.IMU], tmp_path / "cache", BAG2, ["/map"]).path)
    assert (found["/map"].is_latched, len(found["/map"].times)) == (True, 2)


def test_a_variant_of_an_earlier_version_is_made_anew(tmp_path: Path) -> None:
    entry = entry_of(ros2(tmp_path / "walk", WHOLE), RecordingFormat.ROSBAG2, SENSORS)
    variant = made(entry, [Role.IMU], tmp_path / "cache", BAG2)
    shutil.rmtree(variant.path)
    shutil.copytree(tmp_path / "walk", variant.path)
    about = variant.folder / "variant.json"
    told = json.loads(about.read_text())
    del told["playable"]
    told["state"] = recording_state(variant.path)
    about.unlink()
    about.write_text(json.dumps(told))
    assert made(entry, [Role.IMU], tmp_path / "cache", BAG2) == variant
    assert play(variant.path)["/tf_static"].is_latched


@pytest.mark.parametrize("form", [BAG2, MCAP])
def test_of_the_generator(camera_entries: Any, tmp_path: Path, form: DataFormat) -> None:
    entry = camera_entries[0.5]
    variant = made(entry, [Role.LEFT, Role.RIGHT, Role.COLOR, Role.DEPTH], tmp_path, form)
    found = play(variant.path)
    kinds = {one.type for one in found.values()}
    assert kinds == {"sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", TF}
    for view in variant.sensors.values():
        assert view.camera is not None
        images = found[view.topic].messages
        assert {(one.width, one.height) for one in images} == {(view.camera.width, view.camera.height)}
        info = found[view.topic.replace("image_raw", "camera_info")].messages[0]
        assert (info.k[0], info.k[2]) == (view.camera.fx, view.camera.cx)
