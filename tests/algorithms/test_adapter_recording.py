# SPDX-License-Identifier: Apache-2.0
"""Tests of adapters' reading of recordings: messages to arrays, their order, and errors for broken ones."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from adapter_recording import (
    Cloud,
    Item,
    Recording,
    decode_cloud,
    decode_image,
    decode_imu,
    inertial_order,
    pose_stamp,
    register_scans,
    scan_window,
)
from adapter_support import AdapterError, Run, Sensor

if TYPE_CHECKING:
    from conftest import Maker

NS = 1_000_000_000
START = 1_600_000_000 * NS
LIDAR = Sensor("lidar", "/points", "ScanStart", 0, 10.0, np.eye(4), {})
DEPTH = replace(LIDAR, role="depth")
CONFIG: dict[str, Any] = {"type": "Lidar", "topic": "/points", "stamp": "ScanStart", "rate": 10.0}


def reading(
    maker: Maker, sensors: dict[str, Any] | None = None, recording: str = "recording.bag"
) -> Recording:
    maker.configure(sensors or {"lidar": CONFIG}, recording)
    return Recording(Run.from_folder(maker.folder), {"lidar": decode_cloud})


def scan(stamp: int, times: list[float] | None = None) -> Item:
    return Item(
        "lidar", stamp, Cloud(np.zeros((2, 3)), None if times is None else np.array(times), None, None)
    )


def test_decodes_finite_points_with_their_fields(maker: Maker, points: np.ndarray) -> None:
    cloud = decode_cloud(maker.cloud(START, points), LIDAR)
    assert cloud.points.tolist() == [[1, 5, 0], [2, 6, 0], [4, 8, 0]]
    assert cloud.rings.tolist() == [0, 1, 3]
    np.testing.assert_allclose(cloud.times, [0, 0.025, 0.075], atol=1e-9)
    assert cloud.intensities is None


def test_decodes_big_endian_points(maker: Maker, points: np.ndarray) -> None:
    swapped = points.astype(points.dtype.newbyteorder(">"))
    cloud = decode_cloud(maker.cloud(START, swapped, big=True), LIDAR)
    assert cloud.points.tolist() == [[1, 5, 0], [2, 6, 0], [4, 8, 0]]


@pytest.mark.parametrize(
    ("name", "kind", "values"),
    [
        ("time", "<f4", [0.0, 0.025, 0.05]),
        ("t", "<u4", [0, 25_000_000, 50_000_000]),
        ("timestamp", "<f8", [START / NS, START / NS + 0.025, START / NS + 0.05]),
        ("timestamp", "<f8", [START, START + 25e6, START + 50e6]),
    ],
)
def test_understands_what_drivers_write_as_time(
    maker: Maker, name: str, kind: str, values: list[Any]
) -> None:
    records = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (name, kind)])
    records[name] = values
    np.testing.assert_allclose(
        decode_cloud(maker.cloud(START, records), LIDAR).times, [0, 0.025, 0.05], atol=1e-6
    )


@pytest.mark.parametrize(
    ("stamp", "since", "values", "expected"),
    [
        ("ScanEnd", "ScanStart", [0, 0.025, 0.05], [-0.05, -0.025, 0]),
        ("ScanMid", "ScanStart", [0, 0.025, 0.05], [-0.025, 0, 0.025]),
        ("ScanStart", "ScanStart", [0, 0.025, 0.05], [0, 0.025, 0.05]),
        ("ScanStart", "ScanEnd", [-0.05, -0.025, 0], [0, 0.025, 0.05]),
        ("ScanEnd", "Header", [-0.05, -0.025, 0], [-0.05, -0.025, 0]),
        ("ScanEnd", "ScanStart", [START, START + 25e6, START + 50e6], [0, 0.025, 0.05]),
    ],
)
def test_times_since_an_end_of_the_scan(
    maker: Maker, stamp: str, since: str, values: list[float], expected: list[float]
) -> None:
    records = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<f8")])
    records["t"] = values
    sensor = replace(LIDAR, stamp=stamp, details={"timesSince": since})
    times = decode_cloud(maker.cloud(START, records), sensor).times
    np.testing.assert_allclose(times, expected, atol=1e-6)


def test_a_point_without_a_return_still_tells_how_long_the_scan_lasted(maker: Maker) -> None:
    records = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4")])
    records["t"] = [0, 25_000_000, 50_000_000]
    records["x"][2] = np.nan
    sensor = replace(LIDAR, stamp="ScanEnd", details={"timesSince": "ScanStart"})
    np.testing.assert_allclose(decode_cloud(maker.cloud(START, records), sensor).times, [-0.05, -0.025])


def test_points_without_a_time_are_left_out(maker: Maker) -> None:
    records = np.zeros(4, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<f4")])
    records["x"], records["t"] = [1, 2, 3, 4], [0, np.nan, 0.05, 0.1]
    cloud = decode_cloud(maker.cloud(START, records), LIDAR)
    assert cloud.points[:, 0].tolist() == [1, 3, 4]
    np.testing.assert_allclose(cloud.times, [0, 0.05, 0.1])


@pytest.mark.parametrize("time", [0.0, 0.05, np.nan])
def test_a_scan_whose_points_have_one_time_has_none(maker: Maker, time: float) -> None:
    records = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<f4")])
    records["t"] = time
    cloud = decode_cloud(maker.cloud(START, records), LIDAR)
    assert (len(cloud.points), cloud.times) == (3, None)


def test_rows_of_0_bytes_are_rows_without_padding(maker: Maker, points: np.ndarray) -> None:
    message = replace(maker.cloud(START, points), height=2, width=2, row_step=0)
    assert decode_cloud(message, LIDAR).points.tolist() == [[1, 5, 0], [2, 6, 0], [4, 8, 0]]


def test_takes_the_fields_that_the_calibration_names(maker: Maker) -> None:
    records = np.zeros(1, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("time", "<f4"), ("dt", "<f4")])
    records["dt"] = 0.5
    sensor = replace(LIDAR, details={"timeField": "dt"})
    assert decode_cloud(maker.cloud(START, records), sensor).times.tolist() == [0.5]


def test_refuses_another_message_on_the_topic(maker: Maker) -> None:
    with pytest.raises(AdapterError, match=r"/points isn't a sensor_msgs/PointCloud2"):
        decode_cloud(maker.imu(START), LIDAR)


@pytest.mark.parametrize(
    ("stamp", "times", "window"),
    [
        ("ScanStart", [0.01, 0.09], (10, 90)),
        ("ScanEnd", [-0.1, 0.0], (-100, 0)),
        ("ScanStart", None, (0, 100)),
        ("ScanMid", None, (-50, 50)),
        ("ScanEnd", None, (-100, 0)),
        ("Sample", None, (0, 0)),
    ],
)
def test_window_of_a_scan(stamp: str, times: list[float] | None, window: tuple[int, int]) -> None:
    start, end = scan_window(scan(START, times), replace(LIDAR, stamp=stamp))
    assert (start - START, end - START) == (window[0] * 1_000_000, window[1] * 1_000_000)


@pytest.mark.parametrize(
    ("times", "deskew", "milliseconds"), [([0.0, 0.1], True, 100), ([0.0, 0.1], False, 50), (None, True, 50)]
)
def test_instant_of_a_pose(times: list[float] | None, deskew: bool, milliseconds: int) -> None:
    assert pose_stamp(scan(START, times), LIDAR, deskew) - START == milliseconds * 1_000_000


@pytest.mark.parametrize("kind", ["maker", "maker2"])
def test_reads_a_recording_on_a_thread_that_is_accounted(
    request: pytest.FixtureRequest, points: np.ndarray, kind: str
) -> None:
    maker: Maker = request.getfixturevalue(kind)
    for index in range(10):
        maker.add("/points", START + index, maker.cloud(START + index * NS, points))
    path = maker.write()
    recording = reading(maker, {"lidar": CONFIG | {"timeOffset": -0.5}}, path.name)
    items = list(recording.items())
    assert [item.stamp for item in items] == [START + index * NS - NS // 2 for index in range(10)]
    assert recording.offered == {"lidar": 10}
    assert recording.cpu_seconds > 0


def test_leaves_out_scans_that_are_not_later(maker: Maker, points: np.ndarray) -> None:
    for index, second in enumerate([0, 1, 1, 0, 2]):
        maker.add("/points", START + index, maker.cloud(START + second * NS, points))
    maker.write()
    recording = reading(maker)
    assert [(item.stamp - START) // NS for item in recording.items()] == [0, 1, 2]
    assert recording.dropped == {"lidar": 2}


def test_reading_ends_when_nobody_asks_any_more(maker: Maker, points: np.ndarray) -> None:
    for index in range(50):
        maker.add("/points", START + index, maker.cloud(START + index * NS, points))
    maker.write()
    recording = reading(maker)
    items = recording.items()
    next(items)
    items.close()
    assert 0 < recording.offered["lidar"] < 50


def test_names_the_topics_that_there_are(maker: Maker) -> None:
    maker.add("/imu", START, maker.imu(START))
    maker.write()
    with pytest.raises(AdapterError) as error:
        list(reading(maker).items())
    assert str(error.value) == "recording.bag has no topic /points for the sensor lidar; it has /imu"


def test_says_that_a_topic_is_empty(maker: Maker) -> None:
    maker.write(extra_topics=("/points",))
    with pytest.raises(AdapterError, match=r"recording\.bag has no message on /points \(lidar\)"):
        list(reading(maker).items())


@pytest.mark.parametrize("keep", [0, 10, 0.5])
def test_says_that_a_recording_is_broken(maker: Maker, points: np.ndarray, keep: float) -> None:
    maker.add("/points", START, maker.cloud(START, points))
    path = maker.write()
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content)) if isinstance(keep, float) else keep])
    with pytest.raises(AdapterError, match=r"recording\.bag can't be read: "):
        list(reading(maker).items())


def test_registers_scan_after_scan(maker: Maker, points: np.ndarray) -> None:
    maker.add("/points", START, maker.cloud(START, points))
    maker.add("/points", START + 1, maker.cloud(START + NS, points[:0]))
    maker.add("/points", START + 2, maker.cloud(START + 2 * NS, points))
    maker.write()
    maker.configure({"lidar": CONFIG})
    run = Run.from_folder(maker.folder)
    seen: list[int] = []

    def register(cloud: Cloud) -> np.ndarray:
        seen.append(len(cloud.points))
        return np.eye(4)

    register_scans(run, register, deskew=True, confidence=lambda: -1.5 if len(seen) < 2 else np.nan)
    assert seen == [3, 3]
    said = (run.output / "health.csv").read_text().splitlines()
    assert said == ["stamp,value,flag", "1600000000.075000003,-1.5,", "1600000002.075000003,,"]
    stamps = [line.split()[0] for line in (run.output / "trajectory.txt").read_text().splitlines()]
    assert stamps == ["1600000000.075000003", "1600000002.075000003"]
    assert '"framesDropped": 1' in (run.output / "metrics.json").read_text()


def test_inertial_samples_come_before_the_scan_of_their_time() -> None:
    items = [scan(0, [0.0, 1.0])]
    items += [Item("imu", stamp * NS // 10, None) for stamp in range(25)]
    items += [scan(NS, [0.0, 1.0]), scan(2 * NS, [0.0, 1.0])]
    order = [(item.role, item.stamp * 10 // NS) for item in inertial_order(items, LIDAR)]
    assert order.index(("lidar", 0)) == 11
    assert order.index(("lidar", 10)) == 22
    assert order[-1] == ("lidar", 20)
    assert len(order) == len(items)


def test_decodes_inertial_samples(maker: Maker) -> None:
    sample = decode_imu(maker.imu(START), LIDAR)
    assert sample.gyroscope.tolist() == sample.accelerometer.tolist() == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ("encoding", "kind", "channels", "big"),
    [
        ("mono8", "u1", 1, False),
        ("8UC1", "u1", 1, False),
        ("16UC1", "<u2", 1, False),
        ("16UC1", ">u2", 1, True),
        ("32FC1", "<f4", 1, False),
        ("rgb8", "u1", 3, False),
        ("bgr8", "u1", 3, False),
        ("rgba8", "u1", 4, False),
        ("bgra8", "u1", 4, False),
    ],
)
def test_decodes_images(maker: Maker, encoding: str, kind: str, channels: int, big: bool) -> None:
    values = np.arange(2 * 3 * channels, dtype=kind).reshape(2, 3 * channels)
    rows = b"".join(row.tobytes() + b"\xff" * 5 for row in values)
    message = maker.image(rows, (2, 3), encoding, values[0].nbytes + 5, big=big)
    expected = values.reshape(2, 3, channels)
    expected = expected[:, :, 0] if channels == 1 else expected[:, :, :3]
    if encoding.startswith("bgr"):
        expected = expected[:, :, ::-1]
    image = decode_image(message, DEPTH)
    assert np.array_equal(image, expected)
    assert image.dtype.isnative


def test_cameras_have_the_upper_8_of_16_bits(maker: Maker) -> None:
    values = np.array([[0, 255, 256, 65535]], dtype=np.uint16)
    raw = maker.image(values.tobytes(), (1, 4), "mono16", 8, big=False)
    png = np.frombuffer(cv2.imencode(".png", values)[1].tobytes(), np.uint8)
    kind = "sensor_msgs/msg/CompressedImage"
    for message in (raw, maker.make(kind, header=maker.header(START), format="png", data=png)):
        image = decode_image(message, replace(LIDAR, role="camera"))
        assert image.dtype == np.uint8
        assert image.tolist() == [[0, 0, 1, 255]]
        assert decode_image(message, DEPTH).tolist() == values.tolist()


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_data_becomes_colours(maker: Maker, pattern: str) -> None:
    mosaic = np.zeros((8, 8), dtype=np.uint8)
    for k, letter in enumerate(pattern):
        mosaic[k // 2 :: 2, k % 2 :: 2] = {"r": 200, "g": 120, "b": 30}[letter]
    # Rows of 0 bytes, as some drivers state, aren't padded.
    image = decode_image(maker.image(mosaic.tobytes(), (8, 8), f"bayer_{pattern}8", 0, big=False), LIDAR)
    assert (image == (200, 120, 30)).all()


def test_refuses_images_that_it_does_not_know(maker: Maker) -> None:
    with pytest.raises(AdapterError, match="encoded yuv422; known are mono8"):
        decode_image(maker.image(b"\0" * 4, (2, 2), "yuv422", 2, big=False), LIDAR)


@pytest.mark.parametrize("image", [np.arange(12, dtype=np.uint16).reshape(3, 4), np.eye(4, dtype=np.uint8)])
def test_decodes_compressed_images(maker: Maker, image: np.ndarray) -> None:
    data = np.frombuffer(cv2.imencode(".png", image)[1].tobytes(), np.uint8)
    message = maker.make(
        "sensor_msgs/msg/CompressedImage", header=maker.header(START), format="png", data=data
    )
    assert np.array_equal(decode_image(message, DEPTH), image)


def test_depth_in_metres_is_no_longer_quantised(maker: Maker) -> None:
    a, b, metres = 10_100.0, 1 - 10_100.0 / 10, np.array([[1.0, 2.0, 9.0]])
    stored = np.hstack((np.rint(a / metres + b), [[0]])).astype(np.uint16)
    data = struct.pack("<iff", 0, a, b) + cv2.imencode(".png", stored)[1].tobytes()
    message = maker.make(
        "sensor_msgs/msg/CompressedImage", header=maker.header(START), format="32FC1; compressedDepth png",
        data=np.frombuffer(data, np.uint8),
    )  # fmt: skip
    depth = decode_image(message, LIDAR)
    assert depth.dtype == np.float32
    assert depth[0] == pytest.approx([*metres[0], 0.0], rel=0.01)
