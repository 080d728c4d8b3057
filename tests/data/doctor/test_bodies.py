# SPDX-License-Identifier: Apache-2.0
"""Findings of sensors that may be of another body than the ground truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from spoiling import found_in

from slamhive.data.synthetic.messages import MessageMaker, typestore

if TYPE_CHECKING:
    from pathlib import Path

START = 1_600_000_000 * 10**9
POINT = np.ones(5, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
MAKER = MessageMaker(typestore())
AWAY = np.eye(4)
AWAY[0, 3] = 0.3
SENSORS = {"lidar": ("Lidar", "/points"), "imu": ("Imu", "/imu")}


@pytest.fixture
def severity_of(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> Any:
    """Return the severity of frames.missing; None where it isn't found."""

    def make(
        sensors: Any = SENSORS, *, linked: str = "", lidar: Any = None, truth: Any = None
    ) -> tuple[str | None, str]:
        with bag_writer(tmp_path / "a.bag") as bag:
            if linked:
                bag.static_transforms(START, linked, {"lidar": np.eye(4)})
            for k in range(20):
                at = START + k * 10**8
                bag.points("/points", at, "lidar", POINT)
                bag.imu("/imu", at, "imu", np.zeros(3), np.array([0.0, 0.0, 9.81]))
                bag._write(
                    "/fix", "sensor_msgs/msg/NavSatFix", at, MAKER.fix(at, "gps", np.array([49, 8, k]))
                )
                bag.planar_odometry("/truth", at, np.array([0.1 * k, 0.0, 0.0]), np.zeros(2))
        lines = [f"{START / 1e9 + 0.1 * k} {0.1 * k} 0 0 0 0 0 1\n" for k in range(20)]
        (tmp_path / "poses.txt").write_text("".join(lines))
        spec = {"file": "poses.txt"} if truth is None else truth
        entry = bag_entry(tmp_path / "a.bag", sensors, **({"groundTruth": spec} if spec else {}))
        if lidar is not None:
            entry.dataset.spec.sensors["lidar"] = entry.dataset.spec.sensors["lidar"].replace(
                T_body_sensor=lidar.tolist()
            )
        finding = found_in(entry).get("frames.missing")
        return (None, "") if finding is None else (str(finding.severity), finding.message)

    return make


def test_two_devices_in_one_place_are_a_guess(severity_of: Any) -> None:
    severity, message = severity_of()
    assert severity == "warning"
    assert "sensors.imu is of 'imu', this sensor of 'lidar'" in message


@pytest.mark.parametrize(("topic", "frame"), [("/truth", "base_link"), ("/fix", "gps")])
def test_a_truth_of_another_frame_is_named(severity_of: Any, topic: str, frame: str) -> None:
    severity, message = severity_of({"lidar": SENSORS["lidar"]}, truth={"topic": topic})
    assert severity == "warning"
    assert f"groundTruth is of {frame!r}" in message


def test_a_single_sensor_may_be_the_body(severity_of: Any) -> None:
    assert severity_of({"lidar": SENSORS["lidar"]})[0] == "note"


@pytest.mark.parametrize(
    "known",
    [
        {"lidar": AWAY},
        {"linked": "imu"},
        {"truth": {"file": "poses.txt", "frame": "lidar"}},
        {"truth": {}},
        {"sensors": {"lidar": SENSORS["lidar"]}, "linked": "base_link", "truth": {"topic": "/truth"}},
        {"sensors": {"lidar": SENSORS["lidar"]}, "linked": "base_link"},
    ],
    ids=["stated", "linked", "whose", "none", "linked truth", "linked alone"],
)
def test_what_is_known_is_no_finding(severity_of: Any, known: Any) -> None:
    assert severity_of(**known)[0] is None
