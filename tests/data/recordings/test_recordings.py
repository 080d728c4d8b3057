# SPDX-License-Identifier: Apache-2.0
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamhive.data.importers.carmen import POINT
from slamhive.data.inspecting.inspection import inspect
from slamhive.data.making.preparation import prepare
from slamhive.data.recordings.reading import Recording, guess_format
from slamhive.data.recordings.repairing import open_recording
from slamhive.model.algorithm import DataFormat, RecordingFormat
from slamhive.model.errors import DataError
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role


def prepared(entry: Any, cache: Path, *roles: Role) -> None:
    prepare(entry, roles or (Role.CAMERA,), InputOptions(), [DataFormat.ROSBAG1], cache)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda _: b"", "an empty file of 0 bytes"),
        (lambda data: data[: len(data) // 2], "cut off, or that was not closed: `rosbag reindex` on a copy"),
        (lambda data: data[:100], "`rosbag reindex`"),
        (lambda data: b"PK" + data, "doesn't begin as a recording of this format does: copy it again"),
        (lambda data: data[:-50], "`rosbag reindex`"),
        (lambda _: bytes(5000), "it holds zeros"),
    ],
)
def test_damaged_bags_are_refused_in_a_sentence(
    tmp_path: Path, frames_of: Any, damage: Any, words: str
) -> None:
    entry = frames_of(tmp_path / "a.bag", rate=10, count=5)
    path = tmp_path / "a.bag"
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(DataError, match=words) as error:
        prepared(entry, tmp_path / "cache")
    assert str(path) in str(error.value)
    assert inspect(entry).errors == [str(error.value)]


def test_any_cut_or_flipped_byte_is_refused_or_harmless(tmp_path: Path, frames_of: Any) -> None:
    entry = frames_of(tmp_path / "a.bag", rate=10, count=3)
    path = tmp_path / "a.bag"
    whole = path.read_bytes()
    places = np.random.default_rng(3).integers(0, len(whole), 60).tolist()
    for place in places:
        for broken in (whole[:place], whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :]):
            path.write_bytes(broken)
            # Anything but a DataError fails the test.
            with suppress(DataError), open_recording(entry.dataset, entry.root) as recording:
                recording.scan(recording.topics)


@pytest.mark.parametrize(
    ("name", "words"), [("nothing.bag", "no such file"), ("x.txt", "a ROS 1 bag ends in .bag")]
)
def test_what_is_no_recording(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / "x.txt").write_text("hello")
    with pytest.raises(DataError, match=words):
        guess_format(tmp_path / name)


def test_a_bag_without_messages(tmp_path: Path, bag_writer: Any) -> None:
    with bag_writer(tmp_path / "a.bag"):
        pass
    with pytest.raises(DataError, match="empty: there is no message in it"):
        Recording([tmp_path / "a.bag"], RecordingFormat.ROSBAG1)


def test_a_format_that_it_is_not(tmp_path: Path, frames_of: Any) -> None:
    frames_of(tmp_path / "a.bag", rate=10, count=2)
    with pytest.raises(DataError, match=r"recording\.format says Mcap, but this is Rosbag1"):
        Recording([tmp_path / "a.bag"], RecordingFormat.MCAP)


@pytest.mark.parametrize(
    ("topic", "kind", "words"),
    [
        ("/cam/image", "Camera", "no topic '/cam/image' in .*did you mean '/cam/image_raw'"),
        ("/cam/image_raw", "Lidar", "messages of type sensor_msgs/msg/Image; a sensor of type Lidar needs"),
        ("/cam/camera_info", "Camera", "needs sensor_msgs/msg/Image or sensor_msgs/msg/CompressedImage"),
    ],
)
def test_topics_that_do_not_fit(tmp_path: Path, frames_of: Any, topic: str, kind: str, words: str) -> None:
    frames_of(tmp_path / "a.bag", rate=10, count=2)
    role = Role.LIDAR if kind == "Lidar" else Role.CAMERA
    entry = frames_of.describe(tmp_path / "a.bag", {role.value: (kind, topic)})
    with pytest.raises(DataError, match=words) as error:
        prepared(entry, tmp_path / "cache", role)
    assert inspect(entry).errors[0] == str(error.value)


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        ([10, 30, 20, 40], "message 3 of 4 is stamped .* after "),
        ([0, 0, 0, 0], "all stamps are 0 s"),
        ([10, 20, 30, 10**9], "days after the one before it"),
    ],
)
def test_stamps_that_cannot_be(
    tmp_path: Path, bag_writer: Any, bag_entry: Any, stamps: Any, words: str
) -> None:
    path = tmp_path / "a.bag"
    with bag_writer(path) as bag:
        for k, stamp in enumerate(stamps):
            bag.recorded_at = (10 + k) * 10**9
            bag.points("/points", stamp * 10**9, "lidar", np.zeros(3, dtype=POINT))
    entry = bag_entry(path, {"lidar": ("Lidar", "/points")})
    with pytest.raises(DataError, match=words):
        prepared(entry, tmp_path / "cache", Role.LIDAR)
