# SPDX-License-Identifier: Apache-2.0
import hashlib
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Reader

from slamhive.data.synthetic import (
    STANDARD_CAMERA,
    STANDARD_LIDAR,
    TRAINING_CAMERA,
    SyntheticOutput,
    generate,
)
from slamhive.data.synthetic.messages import typestore
from slamhive.data.synthetic.trajectory import SyntheticMotion
from slamhive.model.synthetic import SyntheticRecording

START = 1_600_000_000
Messages = dict[str, list[tuple[int, Any]]]


@pytest.fixture(scope="module")
def messages(made: SyntheticOutput) -> Messages:
    store, result = typestore(), defaultdict(list)
    with Reader(made.recording) as reader:
        for connection, time, raw in reader.messages():
            message = store.deserialize_ros1(raw, connection.msgtype)
            result[connection.topic].append((time, message))
    return result


def stamp(message: Any) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


@pytest.mark.parametrize(
    ("topic", "series"),
    [
        ("/points", (70, 0.0, 0.1)),
        ("/imu", (1401, 0.0, 0.005)),
        ("/camera/left/image_raw", (36, 0.0, 0.2)),
        ("/camera/right/camera_info", (36, 0.0, 0.2)),
        ("/camera/color/image_raw", (36, 0.0, 0.2)),
        ("/camera/depth/image_raw", (35, 0.013, 0.2)),
        ("/camera/depth/camera_info", (35, 0.013, 0.2)),
    ],
)
def test_each_topic_has_its_stamps_and_record_times(
    messages: Messages, made: SyntheticOutput, topic: str, series: tuple[int, float, float]
) -> None:
    count, first, step = series
    stamps = [stamp(message) for _, message in messages[topic]]
    expected = [START * 10**9 + round((first + k * step) * 1e9) for k in range(count)]
    assert stamps == expected
    assert {time - at for (time, _), at in zip(messages[topic], stamps, strict=True)} == {4_000_000}
    assert made.messages[topic] == count


def test_ground_truth_has_every_stamp_and_the_exact_pose(
    messages: Messages, made: SyntheticOutput, everything: SyntheticRecording
) -> None:
    lines = made.groundtruth.read_text().splitlines()[1:]
    words = [line.split() for line in lines]
    nanoseconds = np.array([int(word[0].replace(".", "")) for word in words])
    assert all(len(word[0].split(".")[1]) == 9 for word in words)
    assert (np.diff(nanoseconds) > 0).all()
    asked = {stamp(m) for topic in messages if topic != "/tf_static" for _, m in messages[topic]}
    asked |= {stamp(m) + part for _, m in messages["/points"] for part in (50_000_000, 100_000_000)}
    assert set(nanoseconds.tolist()) == asked
    motion = SyntheticMotion(everything).at((nanoseconds - START * 10**9) / 1e9)
    numbers = np.array([word[1:] for word in words], dtype=float)
    np.testing.assert_allclose(numbers[:, :3], motion.position, atol=1e-11)
    np.testing.assert_allclose(np.linalg.norm(numbers[:, 3:], axis=1), 1.0, atol=1e-11)


def test_calibration_and_transforms_agree(messages: Messages, made: SyntheticOutput) -> None:
    stated = json.loads(made.calibration.read_text())["sensors"]
    assert stated == made.sensors
    assert set(stated) == {"lidar", "imu", "left", "right", "color", "depth"}
    ((_, message),) = messages["/tf_static"]
    transforms = {t.child_frame_id: t for t in message.transforms}
    for entry in stated.values():
        t, T = transforms[entry["frameId"]], np.array(entry["T_body_sensor"])
        assert t.header.frame_id == "base_link"
        moved, q = t.transform.translation, t.transform.rotation
        np.testing.assert_allclose([moved.x, moved.y, moved.z], T[:3, 3])
        assert 1 - 2 * (q.y**2 + q.z**2) == pytest.approx(T[0, 0])
        assert 2 * (q.x * q.y + q.z * q.w) == pytest.approx(T[1, 0])


@pytest.mark.parametrize(
    ("role", "encoding", "channels"), [("left", "mono8", 1), ("color", "rgb8", 3), ("depth", "16UC1", 2)]
)
def test_images_and_their_intrinsics_are_as_stated(
    messages: Messages, made: SyntheticOutput, role: str, encoding: str, channels: int
) -> None:
    _, image = messages[f"/camera/{role}/image_raw"][7]
    _, info = messages[f"/camera/{role}/camera_info"][7]
    stated = made.sensors[role]["camera"]
    assert (image.width, image.height, image.encoding) == (96, 72, encoding)
    assert (image.step, image.data.size) == (96 * channels, 96 * 72 * channels)
    assert image.header.frame_id == info.header.frame_id == made.sensors[role]["frameId"]
    np.testing.assert_array_equal(info.K[[0, 4, 2, 5]], [stated[k] for k in ("fx", "fy", "cx", "cy")])
    np.testing.assert_array_equal(info.D, stated["coefficients"])


def test_points_are_laid_out_as_drivers_do(messages: Messages) -> None:
    _, cloud = messages["/points"][3]
    layout = [(f.name, f.offset, f.datatype) for f in cloud.fields]
    assert layout == [
        ("x", 0, 7),
        ("y", 4, 7),
        ("z", 8, 7),
        ("intensity", 12, 7),
        ("ring", 16, 4),
        ("time", 20, 7),
    ]
    assert cloud.data.size == cloud.row_step == cloud.width * cloud.point_step
    assert cloud.width > 0.9 * 8 * 90


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_and_another_one_others(
    made: SyntheticOutput, everything: SyntheticRecording, tmp_path: Path
) -> None:
    again = generate(everything, tmp_path / "again")
    for name in ("recording", "groundtruth", "calibration"):
        assert digest(getattr(again, name)) == digest(getattr(made, name))
    other = generate(everything.model_copy(update={"seed": 6}), tmp_path / "other")
    assert digest(other.recording) != digest(made.recording)
    assert digest(other.groundtruth) != digest(made.groundtruth)


def test_an_interrupted_generation_leaves_nothing_to_mistake_for_a_recording(tmp_path: Path) -> None:
    spec = SyntheticRecording(sensors=("Imu",), loops=0.1, duration_seconds=8.0)
    generate(spec, tmp_path)

    def stop(share: float) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate(spec, tmp_path, stop)
    assert {path.name for path in tmp_path.iterdir()} == {"groundtruth.txt", "sensors.json"}


def test_progress_rises_to_one(tmp_path: Path) -> None:
    shares: list[float] = []
    spec = SyntheticRecording(sensors=("Imu",), loops=0.1, duration_seconds=8.0)
    generate(spec, tmp_path, shares.append)
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)


def test_standard_recordings_are_laps_of_thirty_metres_in_thirty_seconds() -> None:
    for spec in (STANDARD_LIDAR, STANDARD_CAMERA):
        assert spec.total_seconds == 30.0
        assert SyntheticMotion(spec).length(0.0, 30.0) == pytest.approx(30.5, abs=0.5)
    assert len({STANDARD_LIDAR.seed, STANDARD_CAMERA.seed, TRAINING_CAMERA.seed}) == 3
