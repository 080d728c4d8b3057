# SPDX-License-Identifier: Apache-2.0
import struct
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from bagsamples import compress
from rosbags.typesys import Stores, get_typestore

from slamhive.data.recordings.images import (
    compressed_pixels,
    image_pixels,
    resize,
    scale_camera,
    scale_camera_info,
    scale_compressed,
    scale_image,
)
from slamhive.model.errors import DataError
from slamhive.model.sensors import Camera

STORES = {"ros1": get_typestore(Stores.ROS1_NOETIC), "ros2": get_typestore(Stores.ROS2_HUMBLE)}
CAMERA = Camera(
    width=753, height=481, fx=458.0, fy=457.0, cx=367.2, cy=248.4, distortion="RadialTangential",
    coefficients=[-0.28, 0.07, 0.0002, 0.00002, 0.0],
)  # fmt: skip


def make(ros: Any, kind: Any, **fields: Any) -> Any:
    types = STORES[ros].types
    time = types["builtin_interfaces/msg/Time"](0, 0)
    extra = {"seq": 0} if ros == "ros1" else {}
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="cam", **extra)
    return types[kind](header=header, **fields)


def image(pixels: Any, encoding: Any, *, big_endian: Any = False, padding: Any = 0) -> Any:
    raw = pixels.astype(pixels.dtype.newbyteorder(">")) if big_endian else pixels
    rows = np.ascontiguousarray(raw).view(np.uint8).reshape(len(pixels), -1)
    rows = np.hstack([rows, np.full((len(rows), padding), 99, dtype=np.uint8)])
    return make(
        "ros1", "sensor_msgs/msg/Image", height=pixels.shape[0], width=pixels.shape[1], encoding=encoding,
        is_bigendian=int(big_endian), step=rows.shape[1], data=rows.reshape(-1),
    )  # fmt: skip


def camera_info(ros: Any, camera: Any, tx: Any = -50.0) -> Any:
    k = np.array([camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1])
    p = np.array([440.0, 0, 370, tx, 0, 440, 250, 0, 0, 0, 1, 0])
    names = ("D", "K", "R", "P") if ros == "ros1" else ("d", "k", "r", "p")
    values = dict(zip(names, (np.array(camera.coefficients), k, np.eye(3).reshape(-1), p), strict=True))
    roi = STORES[ros].types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, do_rectify=False)
    return make(
        ros, "sensor_msgs/msg/CameraInfo", height=camera.height, width=camera.width,
        distortion_model="plumb_bob", binning_x=0, binning_y=0, roi=roi, **values,
    )  # fmt: skip


@pytest.mark.parametrize("scale", [0.5, 0.4, 1 / 3])
def test_a_ray_meets_the_same_place_of_the_scaled_image(scale: Any) -> None:
    scaled = scale_camera(CAMERA, scale)
    assert (scaled.width, scaled.height) == (round(753 * scale), round(481 * scale))
    assert scaled.coefficients == CAMERA.coefficients
    for x, y in [(0.0, 0.0), (0.3, -0.2)]:
        share = [
            (CAMERA.fx * x + CAMERA.cx + 0.5) / CAMERA.width,
            (CAMERA.fy * y + CAMERA.cy + 0.5) / CAMERA.height,
        ]
        found = [
            (scaled.fx * x + scaled.cx + 0.5) / scaled.width,
            (scaled.fy * y + scaled.cy + 0.5) / scaled.height,
        ]
        assert found == pytest.approx(share, abs=1e-12)


@pytest.mark.parametrize("ros", ["ros1", "ros2"])
def test_camera_info_agrees_with_the_scaled_camera(ros: Any) -> None:
    before, camera = camera_info(ros, CAMERA), scale_camera(CAMERA, 0.4)
    after = scale_camera_info(before, 0.4, "here")
    k, p, d, r = (getattr(after, name if ros == "ros1" else name.lower()) for name in "KPDR")
    assert k.tolist() == pytest.approx([camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1])
    sx, sy = camera.width / 753, camera.height / 481
    assert p.tolist() == pytest.approx(
        [440 * sx, 0, 370.5 * sx - 0.5, -50 * sx, 0, 440 * sy, 250.5 * sy - 0.5, 0, 0, 0, 1, 0]
    )
    assert d.tolist() == CAMERA.coefficients
    assert r.tolist() == np.eye(3).reshape(-1).tolist()
    assert (after.width, after.height) == (camera.width, camera.height)


def test_an_uncalibrated_camera_info_stays_uncalibrated() -> None:
    before = camera_info("ros1", CAMERA)
    after = scale_camera_info(replace(before, K=np.zeros(9), P=np.zeros(12)), 0.5, "here")
    assert not after.K.any()
    assert not after.P.any()
    with pytest.raises(DataError, match="states no image size"):
        scale_camera_info(replace(before, width=0), 0.5, "here")


def test_colour_is_averaged_and_depth_is_picked() -> None:
    pixels = np.array([[0, 100, 10, 10], [100, 200, 10, 10]], dtype=np.uint8)
    assert resize(pixels, 0.5, nearest=False).tolist() == [[100, 10]]
    depth = np.arange(1, 82, dtype=np.uint16).reshape(9, 9)
    assert resize(depth, 1 / 3, nearest=True).tolist() == [[11, 14, 17], [38, 41, 44], [65, 68, 71]]
    assert np.array_equal(resize(depth[:8, :8], 0.5, nearest=True), depth[1:8:2, 1:8:2])


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize("big_endian", [False, True])
def test_byte_order_and_padding_are_understood(big_endian: Any, padding: Any) -> None:
    depth = np.arange(1, 13, dtype=np.uint16).reshape(3, 4) * 300
    scaled = scale_image(
        image(depth, "16UC1", big_endian=big_endian, padding=padding), 0.5, depth=True, where="x"
    )
    assert image_pixels(scaled, "x").tolist() == resize(depth, 0.5, nearest=True).tolist()
    assert (scaled.step, scaled.is_bigendian) == (2 * scaled.width, 0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"encoding": "yuv422"}, "unknown encoding 'yuv422'"),
        ({"data": np.zeros(5, dtype=np.uint8)}, "has 5 bytes"),
        ({"step": 2}, "rows of 2"),
    ],
)
def test_images_that_cannot_be_scaled(change: Any, words: Any) -> None:
    message = replace(image(np.zeros((3, 4), dtype=np.uint8), "mono8"), **change)
    with pytest.raises(
        DataError, match=words.replace("'", ".").replace("unknown encoding ", "unknown encoding .")
    ):
        scale_image(message, 0.5, depth=False, where="/cam")


def test_bayer_data_becomes_colours() -> None:
    colour = np.zeros((8, 8, 3), dtype=np.uint8)
    colour[:] = (30, 120, 200)  # blue, green, red
    for pattern in ("rggb", "bggr", "gbrg", "grbg"):
        mosaic = np.zeros((8, 8), dtype=np.uint8)
        for k, letter in enumerate(pattern):
            mosaic[k // 2 :: 2, k % 2 :: 2] = colour[0, 0, "bgr".index(letter)]
        for wide in (1, 257):
            bits = 8 if wide == 1 else 16
            message = image(mosaic * np.array(wide, dtype=f"u{bits // 8}"), f"bayer_{pattern}{bits}")
            assert np.array_equal(image_pixels(message, "x"), colour.astype(int) * wide)
            scaled = scale_image(message, 0.5, depth=False, where="x")
            assert (scaled.encoding, scaled.width, scaled.step) == (f"bgr{bits}", 4, 12 * bits // 8)
    assert scale_camera(CAMERA.replace(encoding="bayer_rggb8"), 0.5).encoding == "bgr8"


def test_rows_of_0_bytes_are_not_padded() -> None:
    pixels = np.arange(12, dtype=np.uint16).reshape(3, 4)
    message = image(pixels, "mono16")
    assert np.array_equal(image_pixels(replace(message, step=0), "x"), pixels)
    with pytest.raises(DataError, match="has 23 bytes in rows of 0"):
        image_pixels(replace(message, step=0, data=message.data[:-1]), "x")


def test_compressed_images_stay_lossless() -> None:
    pixels = np.random.default_rng(1).integers(0, 255, (8, 8, 3), dtype=np.uint8)
    data = cv2.imencode(".png", pixels)[1].reshape(-1)
    message = make("ros1", "sensor_msgs/msg/CompressedImage", format="bgr8; png compressed bgr8", data=data)
    scaled = scale_compressed(message, 0.5, depth=False, where="/cam")
    assert np.array_equal(cv2.imdecode(scaled.data, -1), resize(pixels, 0.5, nearest=False))
    with pytest.raises(DataError, match="can't be decoded"):
        scale_compressed(replace(message, data=data[:20]), 0.5, depth=False, where="/cam")


DEPTH = np.array([[0, 0, 0, 1500], [1501, 1499, 0, 65535], [1, 0, 9, 9]], dtype=np.uint16)


def compressed_depth(stored: Any, described: str, a: float = 0.0, b: float = 0.0) -> Any:
    data = compress(stored, described, struct.pack("<iff", 0, a, b))
    return make("ros1", "sensor_msgs/msg/CompressedImage", format=described, data=data)


@pytest.mark.parametrize("end", ["", " png", " rvl"])
def test_compressed_depth_is_what_was_compressed(end: str) -> None:
    message = compressed_depth(DEPTH, f"16UC1; compressedDepth{end}")
    assert np.array_equal(compressed_pixels(message, "/depth"), DEPTH)
    for scale in (1.0, 0.5):
        scaled = scale_compressed(message, scale, depth=True, where="/depth")
        assert scaled.format == "16UC1; compressedDepth png"
        assert np.array_equal(compressed_pixels(scaled, "x"), resize(DEPTH, scale, nearest=True))


@pytest.mark.parametrize("end", ["png", "rvl"])
def test_depth_in_metres_is_no_longer_quantised(end: str) -> None:
    metres = np.array([[0.5, 1.0, 2.0], [4.0, 8.0, 9.5]])
    # As compressed_depth_image_transport does it: 1 cm at 1 m, and 10 m at most.
    a, b = 10_100.0, 1 - 10_100.0 / 10
    stored = np.rint(a / metres + b).astype(np.uint16)
    stored[0, 0] = 0
    message = compressed_depth(stored, f"32FC1; compressedDepth {end}", a, b)
    for one in (message, scale_compressed(message, 1.0, depth=True, where="/depth")):
        depth = compressed_pixels(one, "/depth")
        assert depth.dtype == np.float32
        assert depth[0, 0] == 0
        assert depth.reshape(-1)[1:] == pytest.approx(metres.reshape(-1)[1:], rel=0.01)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (compressed_depth(DEPTH.astype(np.uint8), "16UC1; compressedDepth png"), "PNG of 16 bits, and RVL"),
        (compressed_depth(DEPTH, "32FC1; compressedDepth png"), "quantised by A = 0"),
        (compressed_depth(np.ones((4, 4), np.uint16), "16UC1; compressedDepth rvl"), ""),
    ],
)
def test_compressed_depth_that_is_damaged_is_refused(message: Any, words: str) -> None:
    if not words:
        message, words = replace(message, data=message.data[:20]), "it ends after 0 of 16 pixels"
    with pytest.raises(DataError, match=words):
        compressed_pixels(message, "/depth")
