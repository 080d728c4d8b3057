# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamhive.data.inspecting.inspection import inspect

START = 1_600_000_000
SENSORS = {"lidar": ("Lidar", "/points"), "imu": ("Imu", "/imu")}


@pytest.fixture
def recorded(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> Any:
    """Make a dataset of a LiDAR and an IMU whose headers lead the recorder by so many seconds."""

    def make(lidar: float, imu: float, late: float = 0.0) -> Any:
        points = np.ones(5, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
        with bag_writer(tmp_path / "walk.bag") as bag:
            for k in range(600):
                at = START + k / 10
                bag.recorded_at = round(at * 1e9)
                bag.imu("/imu", round((at + imu) * 1e9), "imu", np.zeros(3), np.array([0.0, 0.0, 9.81]))
                bag.recorded_at = round((at + late + 0.08) * 1e9)
                bag.points("/points", round((at + lidar) * 1e9), "lidar", points)
        return bag_entry(tmp_path / "walk.bag", SENSORS)

    return make


@pytest.mark.parametrize(
    ("ahead", "words"),
    [
        (37.0, "37 s ahead of those of imu, by the times of recording, which is TAI − UTC"),
        (-18.0, "which is GPS − UTC"),
        (7200.0, "2 h, a time zone"),
        (-315_964_782.0, "the epoch of GPS"),
        (3.0 - START, "they count from the sensor's start"),
    ],
)
def test_a_sensor_of_another_epoch_is_named_with_its_shift_and_explains_the_rest(
    recorded: Any, ahead: float, words: str
) -> None:
    report = inspect(recorded(ahead, 0.0))
    (finding,) = [one for one in report.findings if one.code == "clock.epoch"]
    assert words in finding.message
    assert finding.repair["repair"]["sensors"]["lidar"]["shift"] == pytest.approx(-ahead, abs=0.1)
    assert report.errors == [finding.message]
    assert report.duration_seconds == pytest.approx(59.9)
    assert not any("covers" in warning or "lasts for" in warning for warning in report.warnings)


@pytest.mark.parametrize(
    ("lidar", "imu", "late"),
    [(0.0, 0.0, 0.0), (130.0 - START, 130.0 - START, 0.0), (0.0, 0.0, 2.0), (0.0, 0.0, 37.0)],
    ids=["clean", "simulated time", "queued", "merged"],
)
def test_one_clock_is_no_finding(recorded: Any, lidar: float, imu: float, late: float) -> None:
    report = inspect(recorded(lidar, imu, late))
    assert [one.code for one in report.findings if one.code.startswith("clock.")] == []
