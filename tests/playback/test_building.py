# SPDX-License-Identifier: Apache-2.0
"""Tests of the player's request, its report, and the end of a run that follows from it."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from pydantic import ValidationError

from slamhive.engine import AttemptEnd
from slamhive.local.home.catalog import load_workshop
from slamhive.local.programs.interpreters import interpreter
from slamhive.local.programs.unavailable import Unavailable
from slamhive.model.algorithm import AlgorithmSpec
from slamhive.model.configuration import RunConfiguration
from slamhive.model.errors import InputError
from slamhive.model.results import Reason
from slamhive.monitor.playing import played_mean_cores
from slamhive.playback.building import play_request
from slamhive.playback.judging import judge
from slamhive.playback.outcome import Played, read_report
from slamhive.playback.player.session import Session
from slamhive.playback.pod import player_pod
from slamhive.playback.protocol import PlayError, PlayRequest

if TYPE_CHECKING:
    from pathlib import Path

EYE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
POSES = {"topic": "/odometry", "type": "Odometry"}


def spec(mode: str = "lidar", output: dict[str, Any] | None = None, **ros1: Any) -> AlgorithmSpec:
    return AlgorithmSpec.model_validate(
        {
            "image": "node:1",
            "modes": [{"name": mode}],
            "output": output or {"frame": "body"},
            "paces": ["Realtime", "Lockstep"],
            "realtime": {"queue": 1},
            "ros1": {"poses": POSES} | ros1,
        }
    )


def configuration(mode: str = "lidar", pace: str = "Realtime", **sensor: Any) -> RunConfiguration:
    pose = {"T_body_sensor": EYE}
    camera = {"width": 64, "height": 48, "fx": 50, "fy": 50, "cx": 32, "cy": 24}
    sensors: dict[str, Any] = {
        "lidar": {"name": "lidar", "type": "Lidar", "topic": "/points", "rate": 5.0, "stamp": "ScanStart"}
    }
    if mode == "stereo":
        sensors = {
            role: {"name": role, "type": "Camera", "topic": f"/cam/{role}/image_raw", "camera": camera}
            for role in ("left", "right")
        }
    return RunConfiguration.model_validate(
        {
            "run": "r",
            "algorithm": "node",
            "mode": mode,
            "dataset": {"name": "d", "recording": {"format": "Rosbag1", "path": "dataset/recording.bag"}},
            "sensors": {role: view | pose | sensor for role, view in sensors.items()},
            "input": {"pace": pace, "rate": 2.0},
            "seed": 1,
            "cores": 1,
        }
    )


def request(algorithm: AlgorithmSpec, told: RunConfiguration) -> PlayRequest | None:
    return play_request(algorithm, told, run="/run", folder="/player", mark="A=b")


def test_a_request() -> None:
    found = request(spec(topics={"lidar": "/velodyne"}, settle="1500ms"), configuration(timeOffset=0.25))
    assert found is not None
    assert (found.recording, found.output) == ("/run/dataset/recording.bag", "/run/output")
    assert (found.topics, found.remap) == ({"/points": "/velodyne"}, {})
    assert (found.rate, found.settle_seconds) == (2.0, 1.5)
    assert (found.frames.topic, found.frames.period, found.frames.time_offset) == ("/velodyne", 0.2, 0.25)
    assert PlayRequest.from_json(found.to_json()) == found


def test_in_lockstep_nothing_is_played() -> None:
    assert request(spec(), configuration(pace="Lockstep")) is None
    assert player_pod(spec(), configuration(pace="Lockstep"), "algorithm") is None


def test_calibration_goes_with_its_camera() -> None:
    found = request(spec("stereo", topics={"left": "/stereo/l/image"}), configuration("stereo"))
    assert found is not None
    assert found.topics == {
        "/cam/left/image_raw": "/stereo/l/image",
        "/cam/right/image_raw": "/cam/right/image_raw",
    }
    assert found.remap == {"/cam/left/camera_info": "/stereo/l/camera_info"}


@pytest.mark.parametrize(
    ("sensor", "pose", "match"),
    [
        ("ScanStart", "ScanEnd", "After"),
        ("ScanMid", "ScanEnd", "After"),
        ("ScanEnd", "ScanStart", "Before"),
        ("ScanStart", "ScanStart", "At"),
        ("ScanStart", "Header", "At"),
        ("Sample", "ScanEnd", "At"),
    ],
)
def test_which_frame_a_pose_belongs_to(sensor: str, pose: str, match: str) -> None:
    found = request(spec(output={"frame": "lidar", "stamp": pose}), configuration(stamp=sensor))
    assert found is not None
    assert found.frames.match == match


@pytest.mark.parametrize(
    ("stamped", "means", "recorded", "moved", "match"),
    [
        ("ScanStart", "ScanMid", 20.0, 0.025, "At"),
        ("ScanStart", "ScanMid", None, 0.1, "At"),  # the scans' rate, which is 5 Hz
        ("ScanEnd", "ScanMid", 10.0, -0.05, "After"),
        ("ScanMid", "ScanMid", 10.0, 0.0, "After"),
    ],
)
def test_messages_that_are_stamped_with_another_instant_than_their_poses_mean(
    stamped: str, means: str, recorded: float | None, moved: float, match: str
) -> None:
    poses = POSES | {"stamp": stamped}
    told = configuration()
    told = told.replace(input=told.input.replace(recorded_frame_rate=recorded))
    found = request(spec(output={"frame": "lidar", "stamp": means}, poses=poses, keyframes=poses), told)
    assert found is not None
    assert found.poses.moved == pytest.approx(moved)
    assert found.keyframes == found.poses
    assert found.frames.match == match
    assert PlayRequest.from_json(found.to_json()) == found


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"poses": {}, "frames": {}}', "null"])
def test_what_is_no_request(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        PlayRequest.from_json(text)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"paces": ["Lockstep"]}, "ros1: needs the pace Realtime"),
        ({"recording": ["Rosbag1", "Mcap"]}, "ros1: needs recording"),
        ({"ros1": {"poses": POSES | {"type": "TF"}}}, "parent: TF needs"),
        ({"ros1": {"poses": POSES | {"frame": "base"}}}, "for TF alone"),
        ({"ros1": {"poses": POSES | {"topic": "odometry"}}}, "pattern"),
        ({"ros1": {"poses": POSES, "topics": {"radar": "/r"}}}, "topics: its keys are roles"),
        ({"ros1": {}}, "poses"),
        (
            {"ros1": {"poses": POSES | {"stamp": "ScanStart"}}},
            "output.stamp: where ros1.poses.stamp .* expected ScanStart, ScanMid or ScanEnd",
        ),
        ({"ros1": {"poses": POSES, "keyframes": POSES | {"type": "TF"}}}, "parent: TF needs"),
    ],
)
def test_bad_manifests(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        AlgorithmSpec.model_validate(spec().as_json() | change)


FAILED = {"state": "Failed", "reason": "AlgorithmFailed", "message": "deaf"}


@pytest.mark.parametrize(
    ("report", "played"),
    [
        ({"state": "Ended"}, Played(True)),
        ({"state": "Ended", "message": "odd"}, Played(True, None, "odd")),
        ({"state": "Playing"}, Played(False)),
        (FAILED, Played(False, "AlgorithmFailed", "deaf")),
        (FAILED | {"reason": "Because"}, Played(False, "SystemFault", "deaf")),
        ([], None),
    ],
)
def test_reports(tmp_path: Path, report: Any, played: Played | None) -> None:
    (tmp_path / "playback.json").write_text(json.dumps(report))
    assert read_report(tmp_path) == played


def test_no_report(tmp_path: Path) -> None:
    assert read_report(tmp_path) is None
    (tmp_path / "playback.json").symlink_to("/dev/zero")
    assert read_report(tmp_path) is None


@pytest.mark.parametrize(
    ("told_to_go", "played"),
    [(True, Played(False)), (False, Played(False, "SystemFault", "rosbag play has ended"))],
)
def test_a_bag_that_ends_as_the_player_is_told_to_go_has_not_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told_to_go: bool, played: Played
) -> None:
    """All of a container is told to end at once: the bag may be gone before the player looks again."""
    told: list[bool] = []

    def obstacle() -> None:
        told.append(told_to_go)
        raise PlayError("rosbag play has ended")

    wire = SimpleNamespace(variables={}, check=lambda: None, obstacle=obstacle, end=lambda: None)
    monkeypatch.setattr(Session, "_connect", lambda _: wire)
    found = request(spec(), configuration())
    assert found is not None
    places: dict[str, Any] = {
        "recording": __file__,
        "output": str(tmp_path),
        "folder": str(tmp_path / "player"),
    }
    assert Session(replace(found, **places), lambda: any(told)).run() == (not told_to_go)
    assert read_report(tmp_path) == played


CRASH = AttemptEnd(signal=11, reason=Reason.ALGORITHM_FAILED, message="segmentation fault")
CANCELLED = AttemptEnd(signal=15, reason=Reason.CANCELLED, message="cancelled")


@pytest.mark.parametrize(
    ("end", "played", "reason", "message"),
    [
        (CRASH, None, Reason.ALGORITHM_FAILED, "segmentation fault"),
        (CRASH, Played(True), None, None),
        (CRASH, Played(False), Reason.ALGORITHM_FAILED, "segmentation fault"),
        (CRASH, Played(False, "AlgorithmFailed", "deaf"), Reason.ALGORITHM_FAILED, "deaf"),
        (CANCELLED, Played(False), Reason.SYSTEM_FAULT, "the player was killed"),
        (CANCELLED, Played(False, "SystemFault", "no bag"), Reason.SYSTEM_FAULT, "no bag"),
        (
            AttemptEnd(reason=Reason.OUT_OF_MEMORY, message="4 GiB"),
            Played(False, "SystemFault", "no bag"),
            Reason.OUT_OF_MEMORY,
            "4 GiB",
        ),
    ],
)
def test_how_an_attempt_ended(
    end: AttemptEnd, played: Played | None, reason: Reason | None, message: str | None
) -> None:
    judged = judge(end, played)
    assert (judged.reason, judged.message) == (reason, message)
    assert (judged.exit_code == 0) is (reason is None)


@pytest.mark.parametrize(
    ("report", "cores"),
    [
        ({"playStart": 101.0, "playEnd": 103.0}, 0.75),
        ({"playStart": 100.0, "playEnd": 200.0}, 0.5),
        ({"playStart": 101.0}, None),
        ({"playStart": 103.0, "playEnd": 101.0}, None),
        ({"playStart": 1.0, "playEnd": 2.0}, None),
        ("nonsense", None),
    ],
)
def test_mean_cores_are_those_while_it_was_played(tmp_path: Path, report: Any, cores: float | None) -> None:
    table = tmp_path / "usage.csv"
    table.write_text(
        "time_seconds,cpu_cores,memory_bytes,anonymous_bytes\n1,0.0,1,1\n2,0.5,1,1\n4,1.0,1,1\n5,0,1,1\n"
    )
    (tmp_path / "playback.json").write_text(json.dumps(report))
    found = played_mean_cores(str(tmp_path), str(table), 100.0)
    assert found == (None if cores is None else pytest.approx(cores))


def test_where_ros_is_missing_the_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamhive.local.programs.interpreters.find_ros", lambda: None)
    with pytest.raises(Unavailable, match=r"ROS 1 for Python 3\.11 .*apt-get install python3-rospy"):
        interpreter(load_workshop().algorithm("kiss-icp-ros"))


@pytest.mark.parametrize(
    ("topic", "fits"),
    [("/points", True), ("points", True), ("/lidar_0/a1", True), ("/lidar-0", False), ("/0", False)],
)
def test_a_topic_that_ros_2_does_not_have_is_named(topic: str, fits: bool) -> None:
    told = configuration(topic=topic)
    fields = spec().model_dump(mode="json", by_alias=True, exclude_unset=True)
    del fields["ros1"]
    fields |= {"recording": ["Rosbag2"], "ros2": {"poses": POSES}}
    node = AlgorithmSpec.model_validate(fields)
    if fits:
        asked = request(node, told)
        assert asked is not None
        assert (asked.ros, asked.topics) == (2, {topic: topic})
        return
    with pytest.raises(InputError, match=f"'{topic}' can't be played to a ROS 2 node: expected letters"):
        request(node, told)


def test_a_request_of_another_version_is_said_to_be_one() -> None:
    """An image of the player that was built before may have the same tag."""
    known = {"poses": {"topic": "/p", "type": "Path"}, "frames": {"topic": "/f", "period": 1}}
    with pytest.raises(ValueError, match=r"whose image may be older than slamhive: .*'of_tomorrow'"):
        PlayRequest.from_json(json.dumps(known | {"of_tomorrow": 1}))
