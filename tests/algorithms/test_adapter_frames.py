# SPDX-License-Identifier: Apache-2.0
"""Tests of what an adapter that is a ROS node makes of messages as they come, whichever ROS brings them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from adapter_frames import InertialScans, JoinedFrames, write_numbers
from adapter_support import Run, Stopwatch

if TYPE_CHECKING:
    from collections.abc import Callable

    from adapter_frames import Arrivals

    from conftest import Maker

MS = 1_000_000


@pytest.fixture
def run(maker: Maker) -> Run:
    """A run with two cameras, a LiDAR, and an IMU whose clock is 3 ms behind."""
    camera = {"type": "Camera", "rate": 10.0}
    sensors = {
        "left": {"topic": "/left", **camera},
        "right": {"topic": "/right", **camera},
        "lidar": {"type": "Lidar", "topic": "/points", "stamp": "ScanStart", "rate": 10.0},
        "imu": {"type": "Imu", "topic": "/imu", "rate": 100.0, "timeOffset": 0.003},
    }
    maker.configure(sensors, "recording.bag")
    return Run.from_folder(maker.folder)


class Cloud:
    """A scan without times of points."""

    times = None


def as_it_is(message: Any, _: object) -> Any:
    return message


def ending(frames: Callable[[Callable[[], bool]], Arrivals]) -> Arrivals:
    """Return frames whose node is told to end when nothing waits any more."""
    made = frames(lambda: not made._waiting)
    return made


def joined(run: Run, queue: int = 8) -> JoinedFrames:
    decoders = {"left": as_it_is, "right": as_it_is}
    return ending(lambda ended: JoinedFrames(run, decoders, ended, queue))  # type: ignore[return-value]


def stamps(frames: JoinedFrames) -> list[list[int]]:
    return [[item.stamp // MS for item in frame] for frame in frames]


def test_images_of_one_time_are_a_frame_whichever_comes_first(run: Run) -> None:
    frames = joined(run)
    for role, at in [("right", 0), ("left", 1), ("left", 100), ("right", 102)]:
        frames.take(role, at * MS, role)
    assert stamps(frames) == [[1, 0], [100, 102]]
    assert (frames.offered, frames.dropped) == (2, 0)


def test_an_image_without_a_partner_is_left_out(run: Run) -> None:
    frames = joined(run)
    for role, at in [
        ("left", 0),
        ("left", 100),
        ("right", 100),
        ("right", 200),
        ("left", 300),
        ("right", 300),
    ]:
        frames.take(role, at * MS, role)
    assert stamps(frames) == [[100, 100], [300, 300]]
    assert frames.offered == 2


def test_the_oldest_that_waits_is_lost(run: Run) -> None:
    frames = joined(run, queue=2)
    for at in (0, 100, 200, 300):
        frames.take("left", at * MS, None)
        frames.take("right", at * MS, None)
    assert stamps(frames) == [[200, 200], [300, 300]]
    assert (frames.offered, frames.dropped) == (4, 2)


def inertial(run: Run, queue: int = 1) -> InertialScans:
    decoders = {"lidar": as_it_is, "imu": as_it_is}
    return ending(lambda ended: InertialScans(run, decoders, ended, queue))  # type: ignore[return-value]


def order(scans: InertialScans) -> list[tuple[str, int]]:
    return [(item.role, item.stamp // MS) for item in scans]


def test_a_scan_comes_behind_the_samples_of_its_time_on_its_own_clock(run: Run) -> None:
    scans = inertial(run)
    scans.take("lidar", 0, Cloud())
    for at in range(40, 160, 20):
        scans.take("imu", at * MS, None)
    samples = [("imu", at + 3) for at in range(40, 160, 20)]
    assert order(scans) == [*samples[:3], ("lidar", 0)]


def test_scans_are_lost_and_samples_are_not(run: Run) -> None:
    scans = inertial(run)
    for at in range(0, 400, 20):
        if at % 100 == 0:
            scans.take("lidar", at * MS, Cloud())
        scans.take("imu", at * MS, None)
    found = order(scans)
    assert [one for one in found if one[0] == "lidar"] == [("lidar", 300)]
    assert len(found) == 20 + 1
    assert (scans.offered, scans.dropped) == (4, 3)


def test_a_message_that_is_no_later_than_the_last_is_left_out(run: Run) -> None:
    scans = inertial(run, queue=8)
    for at in (0, 100, 100, 50, 200):
        scans.take("lidar", at * MS, Cloud())
    scans.take("imu", 400 * MS, None)
    assert [at for role, at in order(scans) if role == "lidar"] == [0, 100, 200]
    assert scans.offered == 3


def test_own_numbers_stand_beside_the_player_s(run: Run) -> None:
    path = run.output / "metrics.json"
    path.write_text(json.dumps({"framesOffered": 3, "framesDropped": 0}))
    frames, watch = joined(run, queue=1), Stopwatch()
    for at in (0, 100):
        frames.take("left", at * MS, None)
        frames.take("right", at * MS, None)
    watch.seconds = [0.25, 0.75]
    write_numbers(run, frames, watch, keyframes=2)
    assert json.loads(path.read_text()) == {
        "framesOffered": 3,
        "framesDropped": 1,
        "framesProcessed": 2,
        "timePerFrame": {"mean": 0.5, "max": 0.75},
        "keyframes": 2,
    }
