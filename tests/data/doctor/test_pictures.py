# SPDX-License-Identifier: Apache-2.0
"""Findings of images, depth and cameras, each in a recording that is clean otherwise."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from spoiling import found_in, spoil

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.doctor.findings import Finding
    from slamhive.data.recordings.entries import DatasetEntry

LEFT, RIGHT = "/camera/left/image_raw", "/camera/right/image_raw"
COLOR, DEPTH = "/camera/color/image_raw", "/camera/depth/image_raw"


@pytest.fixture
def spoiled(camera_entries: Any, tmp_path: Path) -> Any:
    """Change the messages of a topic by their number, and return what is found."""
    count = itertools.count()

    def make(topic: str, change: Any, spec: dict[str, Any] | None = None) -> dict[str, Finding]:
        numbers = dict.fromkeys([topic], -1)

        def changed(at: str, message: Any) -> Any:
            if at != topic:
                return message
            numbers[at] += 1
            return change(numbers[at], message)

        entry = spoil(camera_entries[0.5], tmp_path / f"spoiled{next(count)}", changed, spec)
        return found_in(entry)

    return make


def pixels(message: Any, letter: str = "u1") -> Any:
    return message.data.view(letter).reshape(message.height, -1)


def image(message: Any, encoding: str, values: Any) -> Any:
    data = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
    return replace(message, encoding=encoding, step=data.shape[1], data=data.reshape(-1))


def later(message: Any, nanoseconds: int) -> Any:
    time = message.header.stamp
    at = time.sec * 10**9 + time.nanosec + nanoseconds
    stamp = replace(time, sec=at // 10**9, nanosec=at % 10**9)
    return replace(message, header=replace(message.header, stamp=stamp))


def test_a_clean_recording_has_none(camera_entries: dict[float, DatasetEntry]) -> None:
    assert found_in(camera_entries[0.5]) == {}


@pytest.mark.parametrize(
    ("encoding", "change", "severity", "words"),
    [
        (
            "mono16",
            lambda _, m: image(m, "mono16", pixels(m).astype("<u2") * 257),
            "note",
            "values of 16 bits",
        ),
        (
            "mono16",
            lambda _, m: image(m, "mono16", pixels(m).astype("<u2") * 16),
            "warning",
            "too dark to track",
        ),
        ("bayer_rggb8", lambda _, m: replace(m, encoding="bayer_rggb8"), "note", "make colours of them"),
        ("yuv422", lambda _, m: replace(m, encoding="yuv422"), "error", "unknown encoding ('yuv422')"),
        ("mono8", lambda _, m: replace(m, step=0), "warning", "rows of 0 bytes (step)"),
        ("mono8", lambda k, m: replace(m, data=m.data[: -k or None]), "error", "14 can't be read"),
        (
            "mono8",
            lambda k, m: image(m, "rgb8", np.repeat(pixels(m), 3, axis=1)) if k > 7 else m,
            "warning",
            "mono8 (2)",
        ),
    ],
)
def test_encodings(  # noqa: PLR0917 - fixtures and a case
    camera_entries: Any, spoiled: Any, encoding: str, change: Any, severity: str, words: str
) -> None:
    sensors = camera_entries[0.5].dataset.as_json()["spec"]["sensors"]
    sensors["left"]["camera"]["encoding"] = encoding
    found = spoiled(LEFT, change, {"sensors": sensors})
    assert list(found) == ["images.encoding"]
    assert str(found["images.encoding"].severity) == severity
    assert words in found["images.encoding"].message


def test_images_that_show_nothing(spoiled: Any) -> None:
    grey = spoiled(LEFT, lambda k, m: image(m, "mono8", pixels(m) * 0 + 128) if k < 3 else m)
    assert list(grey) == ["images.constant"]
    assert (grey["images.constant"].count, grey["images.constant"].sensor) == (3, "left")
    assert grey["images.constant"].repair == {"repair": {"sensors": {"left": {"dropLeading": 3}}}}
    dark = spoiled(LEFT, lambda _, m: image(m, "mono8", pixels(m) // 8))
    assert list(dark) == ["images.dark"]
    assert dark["images.dark"].count == 3


def test_the_same_picture_again_while_it_moves(spoiled: Any) -> None:
    before: list[Any] = []

    def again(k: int, message: Any) -> Any:
        before.append(message.data)
        return replace(message, data=before[k - 1]) if k == 8 else message

    # At rest, which is all but messages 6 to 8, images without noise are alike in the clean one, too.
    found = spoiled(LEFT, again)
    assert list(found) == ["images.duplicate"]
    assert found["images.duplicate"].count == 1
    assert found["images.duplicate"].repair["repair"]["sensors"]["left"] == {"drop": [8]}


@pytest.mark.parametrize(
    ("change", "scale"),
    [
        (lambda z: np.rint(z / 1000), 1.0),
        (lambda z: np.minimum(z * 65.5, 65535), 65535.0),
    ],
)
def test_units_of_depth(spoiled: Any, change: Any, scale: float) -> None:
    def make(_: int, message: Any) -> Any:
        return image(message, "16UC1", change(pixels(message, "<u2").astype(float)).astype("<u2"))

    found = spoiled(DEPTH, make)
    assert list(found) == ["depth.unit"]
    repair = found["depth.unit"].repair
    assert repair["repair"]["sensors"] == {"depth": {"depthScale": scale}}
    if scale == 1.0:
        assert spoiled(DEPTH, make, repair) == {}


def test_depth_that_is_not_what_it_is_said_to_be(spoiled: Any) -> None:
    found = spoiled(DEPTH, lambda _, m: image(m, "32FC1", pixels(m, "<u2").astype("<f4") / 1000))
    assert list(found) == ["depth.format", "depth.unit"]
    assert "is 32-bit floats" in found["depth.format"].message
    assert found["depth.unit"].repair["repair"]["sensors"] == {"depth": {"depthScale": 1.0}}


def test_depth_that_is_not_registered(camera_entries: Any, spoiled: Any) -> None:
    def moved(_: int, message: Any) -> Any:
        return replace(message, header=replace(message.header, frame_id="depth_optical"))

    found = spoiled(DEPTH, moved)
    assert list(found) == ["depth.registered"]
    assert "of the frame 'depth_optical'" in found["depth.registered"].message
    sensors = camera_entries[0.5].dataset.as_json()["spec"]["sensors"]
    sensors["depth"]["T_body_sensor"][0][3] += 0.05
    away = spoiled(DEPTH, lambda _, m: m, {"sensors": sensors})
    assert "a camera of its own, 5.0 cm away" in away["depth.registered"].message


@pytest.mark.parametrize(("scatter", "repairs"), [(0, True), (3_000_000, False)])
def test_a_pair_stamped_apart(spoiled: Any, scatter: int, repairs: bool) -> None:
    found = spoiled(RIGHT, lambda k, m: later(m, 8_000_000 + scatter * (k % 3 - 1)))
    assert list(found) == ["stereo.offset"]
    offset = found["stereo.offset"]
    assert offset.value == pytest.approx(8.0, abs=0.01)
    assert bool(offset.repair) is repairs
    if repairs:
        assert offset.repair["repair"]["sensors"]["right"]["shift"] == pytest.approx(-0.008, abs=1e-5)


@pytest.mark.parametrize(
    ("change", "severity", "words"),
    [
        ({"K": np.zeros(9)}, "note", "is uncalibrated (K is 0)"),
        ({"D": np.full(14, 0.01)}, "warning", "states 14 coefficients, the last 6"),
        ({"width": 640, "height": 480}, "warning", "is for 640×480 pixels, but the images have 80×60"),
    ],
)
def test_camera_info_that_does_not_fit(spoiled: Any, change: Any, severity: str, words: str) -> None:
    found = spoiled("/camera/left/camera_info", lambda _, m: replace(m, **change))
    assert list(found) == ["camera.intrinsics"]
    assert str(found["camera.intrinsics"].severity) == severity
    assert words in found["camera.intrinsics"].message


def test_more_coefficients_than_algorithms_take(camera_entries: Any, spoiled: Any) -> None:
    sensors = camera_entries[0.5].dataset.as_json()["spec"]["sensors"]
    sensors["left"]["camera"]["coefficients"] += [0.0, 0.0, 0.0]
    found = spoiled(LEFT, lambda _, m: m, {"sensors": sensors})
    assert "leave out the zeros at their end" in found["camera.intrinsics"].message
