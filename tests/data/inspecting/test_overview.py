# SPDX-License-Identifier: Apache-2.0
"""Tests of the overview of a recording: what is drawn, that it is small, and that it is made once."""

from __future__ import annotations

import base64
import json
import re
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from slamhive.data.importers.carmen import POINT
from slamhive.data.inspecting import overview as module
from slamhive.data.inspecting.overview import BINS, look_over, overview
from slamhive.data.inspecting.overviews import kept_overview
from slamhive.reporting.dataset_page import dataset_page

if TYPE_CHECKING:
    from pathlib import Path

SECOND = 10**9


@pytest.fixture
def entry(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> Any:
    """A dataset of 10 s: a camera with a gap from 4 to 6 s, a LiDAR, an IMU that turns at 5 s."""
    points = np.zeros(3000, dtype=POINT)
    points["x"] = np.linspace(0, 5, 3000)
    with bag_writer(tmp_path / "walk.bag") as bag:
        for k in range(101):
            at = 5 * SECOND + k * SECOND // 10
            rate = np.array([0.0, 0.0, 1.0 if k == 50 else 0.0])
            bag.imu("/imu", at, "imu", rate, np.array([0.0, 0.0, 9.81]))
            if not 40 < k < 60:
                pixels = np.full((480, 640), 2 * k, dtype=np.uint8)
                bag.image("/cam", at, "cam", "mono8", pixels)
            if k % 10 == 0:
                bag.points("/points", at, "lidar", points)
    lines = [f"{5 + k / 10} {k / 10} 0 0.5 0 0 0 1" for k in range(101)]
    (tmp_path / "truth.txt").write_text("\n".join(lines))
    sensors = {"camera": ("Camera", "/cam"), "lidar": ("Lidar", "/points"), "imu": ("Imu", "/imu")}
    return bag_entry(tmp_path / "walk.bag", sensors, groundTruth={"file": "truth.txt"})


def test_what_is_drawn(entry: Any) -> None:
    found = look_over(entry)
    assert (found.start, found.seconds, found.notes) == (5.0, 10.0, [])
    views = {view.name: view for view in found.sensors}
    camera, lidar, imu = views["camera"], views["lidar"], views["imu"]
    assert camera.gaps == [[4.0, 6.0]]
    assert sum(camera.rates) * 10 / BINS == pytest.approx(camera.messages)
    assert len(camera.pictures) == 11  # of 12 moments two lie in the gap, and have one image
    times = [one["t"] for one in camera.pictures]
    assert (times[0], times[-1]) == (0.0, 10.0)
    image = cv2.imdecode(np.frombuffer(base64.b64decode(camera.pictures[-1]["data"]), np.uint8), 0)
    assert image.shape == (240, 320)
    assert np.abs(image.astype(int) - 200).max() <= 2
    assert [one["t"] for one in lidar.clouds] == [0.0, 4.0, 7.0, 10.0]
    assert max(lidar.clouds[0]["x"]) == pytest.approx(5.0, abs=0.01)
    assert len(lidar.clouds[0]["x"]) <= 1500
    low, high = imu.imu["gyro"]["z"]
    assert [k for k, value in enumerate(high) if value == 1.0] == [BINS // 2]
    assert low[BINS // 2] == 1.0
    assert imu.imu["accel"]["z"][0][0] == pytest.approx(9.81)
    assert found.truth is not None
    assert (found.truth["count"], found.truth["first"], found.truth["last"]) == (101, 0.0, 10.0)
    assert found.truth["x"][-1] == 10.0


def test_it_is_made_once_and_anew_where_the_dataset_differs(entry: Any, tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    made = overview(entry, folder)
    (file,) = folder.glob("walk-*.json")
    file.write_text(json.dumps(made | {"start": -1.0}))
    assert overview(entry, folder)["start"] == -1.0
    assert (kept_overview(folder, "walk") or {})["start"] == -1.0
    assert kept_overview(folder, "wal") is None
    (tmp_path / "truth.txt").write_text("5 0 0 0 0 0 0 1\n6 1 0 0 0 0 0 1\n")
    assert overview(entry, folder)["truth"]["count"] == 2


def test_of_a_large_recording_spans_are_read(entry: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = look_over(entry)
    monkeypatch.setattr(module, "LARGE_BYTES", 1)
    monkeypatch.setattr(module, "_SPAN_NS", SECOND // 100)
    found = look_over(entry)
    assert "spans of 0.01 s were read" in found.notes[0]
    assert [view.gaps for view in found.sensors] == [[], [], []]
    assert [len(view.pictures) for view in found.sensors] == [len(view.pictures) for view in whole.sensors]


def test_the_page_stands_alone(entry: Any) -> None:
    page = dataset_page(look_over(entry).as_json(), "A walk & more")
    assert "A walk &amp; more" in page
    assert page.count("<img ") == 11
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    assert "<script" not in page
    assert "1 gap of 2 s" in page


def test_a_dataset_without_sensors_and_without_truth(entry: Any) -> None:
    spec = entry.dataset.spec.replace(sensors={}, ground_truth=None)
    bare = type(entry)(entry.dataset.replace(spec=spec), entry.root)
    found = look_over(bare)
    assert (found.sensors, found.truth) == ([], None)
    assert "walk" in dataset_page(found.as_json(), "")
