# SPDX-License-Identifier: Apache-2.0
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamhive.data.importers.carmen import POINT
from slamhive.data.inspecting.inspection import inspect
from slamhive.model.sensors import Imu, Lidar, Stamp, TimesSince


def changed(entry: Any, name: str, **changes: Any) -> Any:
    """Declare a sensor otherwise."""
    sensors = entry.dataset.spec.sensors
    sensor = sensors[name].replace(**changes)
    spec = entry.dataset.spec.replace(sensors={**sensors, name: sensor})
    return type(entry)(entry.dataset.replace(spec=spec), entry.root)


@pytest.mark.parametrize("fixture", ["lidar_entry", "camera_entries"])
def test_a_generated_dataset_is_without_fault(request: pytest.FixtureRequest, fixture: str) -> None:
    entry = request.getfixturevalue(fixture)
    report = inspect(entry[0.5] if isinstance(entry, dict) else entry)
    assert (report.errors, report.warnings, report.other_topics) == ([], [], [])
    assert report.ground_truth is not None
    assert report.ground_truth.overlap_seconds == pytest.approx(report.duration_seconds, abs=0.1)
    declared = (entry[0.5] if isinstance(entry, dict) else entry).dataset.spec.sensors
    assert {sensor.name: sensor.rate for sensor in report.sensors} == {
        name: pytest.approx(sensor.rate) for name, sensor in declared.items()
    }
    json.dumps(report.as_json())


@pytest.mark.parametrize(
    ("name", "change", "kind", "words"),
    [
        ("lidar", {"rate": 20.0}, "warnings", "states 20 Hz, the recording has 10 Hz"),
        ("lidar", {"lidar": Lidar(ring_field="rings")}, "errors", "no field 'rings'; did you mean 'ring'"),
        (
            "lidar",
            {"lidar": Lidar(time_field="t")},
            "errors",
            "timeField: points on /points have no field 't'",
        ),
        ("imu", {"topic": "/imu/data", "imu": Imu()}, "errors", "no topic '/imu/data'"),
    ],
)
def test_what_a_manifest_says_wrongly(
    lidar_entry: Any, name: str, change: Any, kind: str, words: str
) -> None:
    report = inspect(changed(lidar_entry, name, **change))
    assert [words in sentence for sentence in getattr(report, kind)] == [True]


@pytest.mark.parametrize(
    ("stamp", "since", "words"),
    [
        ("ScanStart", None, None),
        ("ScanEnd", "ScanStart", None),
        ("ScanMid", "ScanStart", None),
        ("Sample", None, None),
        ("ScanEnd", None, "after the header stamp, but stamp is ScanEnd and lidar.timesSince is Header"),
        ("ScanMid", None, "but stamp is ScanMid and lidar.timesSince is Header"),
        ("ScanStart", "ScanEnd", "s, but stamp is ScanStart and lidar.timesSince is ScanEnd"),
    ],
)
def test_times_of_points_on_the_wrong_side_of_their_stamp(
    lidar_entry: Any, stamp: str, since: str | None, words: str | None
) -> None:
    lidar = Lidar(time_field="time", times_since=None if since is None else TimesSince(since))
    report = inspect(changed(lidar_entry, "lidar", stamp=Stamp(stamp), lidar=lidar))
    said = [sentence for sentence in report.warnings if "the times of points run from 0 to 0.09" in sentence]
    assert [words in sentence for sentence in said] == [True] * (words is not None)


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        (
            {"width": 320},
            "errors",
            "states 320×60 pixels, but the images on /camera/left/image_raw have 80×60",
        ),
        ({"encoding": "rgb8"}, "warnings", "states rgb8, but the images on /camera/left/image_raw are mono8"),
        ({"fx": 80.0}, "warnings", "but /camera/left/camera_info says"),
        ({"cx": -10.0}, "warnings", "lies outside of the image"),
    ],
)
def test_calibration_that_does_not_fit(camera_entries: Any, change: Any, kind: str, words: str) -> None:
    entry = camera_entries[0.5]
    camera = entry.dataset.spec.sensors["left"].camera.replace(**change)
    report = inspect(changed(entry, "left", camera=camera))
    assert any(words in sentence for sentence in getattr(report, kind))


def test_gaps_are_listed_longest_first(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> None:
    stamps = np.arange(1, 101) * 10**8
    stamps[30:] += 2 * 10**9
    stamps[60:] += 5 * 10**9
    with bag_writer(tmp_path / "a.bag") as bag:
        for stamp in stamps.tolist():
            bag.points("/points", stamp, "lidar", np.zeros(3, dtype=POINT))
    report = inspect(bag_entry(tmp_path / "a.bag", {"lidar": ("Lidar", "/points")}))
    assert [round(gap.seconds, 3) for gap in report.sensors[0].gaps] == [5.1, 2.1]
    assert report.sensors[0].rate == pytest.approx(10)
    said = " ".join(report.warnings)
    assert "2 gaps in /points, the longest 5.100 s" in said
    assert "a gap is more than 0.3 s, 3 periods" in said
    assert report.sensors[0].gap_threshold == pytest.approx(0.3)


def test_a_sensor_that_covers_little_is_said(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> None:
    with bag_writer(tmp_path / "a.bag") as bag:
        for k in range(101):
            bag.imu("/imu", 10**9 + k * 10**8, "imu", np.zeros(3), np.array([0.0, 0.0, 9.81]))
            if 20 <= k <= 70:
                bag.points("/points", 10**9 + k * 10**8, "lidar", np.zeros(3, dtype=POINT))
    report = inspect(bag_entry(tmp_path / "a.bag", {"imu": ("Imu", "/imu"), "lidar": ("Lidar", "/points")}))
    assert {sensor.name: sensor.covered for sensor in report.sensors} == {"imu": 1.0, "lidar": 0.5}
    assert [text for text in report.warnings if "covers" in text] == [
        (
            "sensors.lidar: /points covers 5.0 s of the recording's 10.0 s (50%), from 3.000 s to 8.000 s; "
            "said below 90%, as a run with it has no more"
        )
    ]


@pytest.mark.parametrize(
    "expected",
    [
        (1.0, "warnings", "units of g"),
        (np.nan, "errors", "not a finite number"),
        (30.0, "warnings", "about 9.8"),
    ],
)
def test_imu_samples(
    tmp_path: Path, bag_writer: Any, bag_entry: Any, expected: tuple[float, str, str]
) -> None:
    force, kind, words = expected
    with bag_writer(tmp_path / "a.bag") as bag:
        for k in range(1, 50):
            bag.imu("/imu", k * 10**7, "imu", np.zeros(3), np.array([0.0, 0.0, force]))
    report = inspect(bag_entry(tmp_path / "a.bag", {"imu": ("Imu", "/imu")}))
    assert any(words in sentence for sentence in getattr(report, kind))
