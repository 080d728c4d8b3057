# SPDX-License-Identifier: Apache-2.0
"""Rules between fields of the models."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from slamhive.model.algorithm import AlgorithmSpec, Asset, LocalProgram, Parameter
from slamhive.model.base import QUEUE_NAME, ObjectMeta
from slamhive.model.dataset import DataFile, DatasetSpec, GroundTruth, Recording
from slamhive.model.errors import InputError
from slamhive.model.evaluation import RunSelector
from slamhive.model.posefiles import PoseFile
from slamhive.model.results import Usage
from slamhive.model.sensors import Sensor
from slamhive.model.sweep import Axis, Range, TemplateMeta

ALGORITHM: dict[str, Any] = {"image": "i", "modes": [{"name": "lidar"}], "output": {"frame": "lidar"}}
KITTI: dict[str, Any] = {"path": "poses.txt", "format": "Kitti"}
NODE: dict[str, Any] = ALGORITHM | {
    "recording": ["Rosbag1"],
    "paces": ["Realtime"],
    "realtime": {},
    "ros1": {"poses": {"topic": "/odometry", "type": "Odometry"}},
}
LIDAR: dict[str, Any] = {"type": "Lidar", "topic": "/p"}
FILES: dict[str, Any] = {"files": [{"path": "a.bag"}]}


@pytest.mark.parametrize(
    ("model", "fields", "message"),
    [
        (AlgorithmSpec, ALGORITHM | {"image": None}, "give an image, or local"),
        (LocalProgram, {"command": ["a"], "adapter": "b.py"}, "a program of its own has no adapter"),
        (LocalProgram, {"command": ["/bin/sh"]}, "'/bin/sh' is no path below the folder of this file"),
        (LocalProgram, {"command": []}, "at least 1 item"),
        (AlgorithmSpec, ALGORITHM | {"modes": [{"name": "lidar"}] * 2}, "each mode may be named once"),
        (AlgorithmSpec, ALGORITHM | {"paces": ["Realtime"]}, "realtime: needed"),
        (Asset, {"name": "a"}, "either path or url"),
        (Asset, {"name": "a", "url": "https://x"}, "needs its sha256"),
        (Asset, {"name": "../a", "path": "a"}, "pattern"),
        (Asset, {"name": "a", "path": "/a"}, "pattern"),
        (TemplateMeta, {"labels": {QUEUE_NAME: "Lab 1"}}, "found 'Lab 1'; try lab-1"),
        (ObjectMeta, {"name": "a", "labels": {QUEUE_NAME: "a" * 64}}, "at most 63 characters"),
        (Asset, {"name": "a:b", "path": "a"}, "pattern"),
        (AlgorithmSpec, ALGORITHM | {"assets": [{"name": "a", "path": "a"}] * 2}, "used once"),
        (AlgorithmSpec, ALGORITHM | {"image": " i"}, "pattern"),
        (PoseFile, {"path": "../a", "format": "Tum"}, "pattern"),
        (PoseFile, {"path": "trajectory.txt", "format": "Tum"}, "is the contract's own file"),
        (PoseFile, {"path": "a", "format": "Tum", "columns": {}}, "only the format Csv takes it"),
        (PoseFile, {"path": "a", "format": "Csv", "columns": {"x": "a"}}, "Extra inputs"),
        (PoseFile, {"path": "a", "format": "Euroc", "header": ["t"] * 8}, "only the format Csv takes it"),
        (
            PoseFile,
            {"path": "a", "format": "Csv", "header": ["t", "tx", "ty", "tz", "qx", "qy", "qz", "qw"]},
            "header: it has no column 'timestamp'",
        ),
        (
            PoseFile,
            {"path": "a", "format": "Tum", "stamps": "ms"},
            "'s', 'ns', 'frame-index' or 's-since-first'",
        ),
        (
            AlgorithmSpec,
            ALGORITHM | {"output": {"frame": "body", "stamp": "ScanEnd", "trajectory": KITTI}},
            "a frame index means the header stamp of its frame; expected Header in the mode lidar",
        ),
        (AlgorithmSpec, NODE | {"output": {"frame": "body", "keyframes": KITTI}}, "a ROS node's poses are"),
        (
            AlgorithmSpec,
            NODE | {"modes": [{"name": "lidar", "output": {"trajectory": KITTI}}]},
            "a ROS node's poses are",
        ),
        (Asset, {"name": "a", "path": "a/../../b"}, "pattern"),
        (DataFile, {"path": "a", "url": "https://x"}, "needs its sha256"),
        (DatasetSpec, {"recording": {}}, "either files or synthetic, or a sequence as catalogue"),
        (DatasetSpec, {}, "either files or synthetic, or a sequence as catalogue"),
        (DatasetSpec, {"catalogue": "euroc"}, "pattern"),
        (Recording, FILES | {"synthetic": {}}, "either files or synthetic"),
        (GroundTruth, {}, "either file or topic"),
        (
            DatasetSpec,
            {"recording": FILES, "sensors": {"lidar": LIDAR}, "groundTruth": {"file": "a", "frame": "lydar"}},
            "unknown frame 'lydar'; did you mean 'lidar'",
        ),
        (Sensor, LIDAR | {"imu": {}}, "takes no block 'imu'"),
        (Sensor, LIDAR | {"T_body_sensor": [[1, 0, 0, 0]] * 4}, "last row must be 0 0 0 1"),
        (RunSelector, {}, "name runs by"),
        (Range, {"from": 1, "to": 2, "step": 1, "count": 2}, "either step or count"),
        (Range, {"from": 0, "to": 2, "count": 3, "scale": "Log"}, "Log needs ends above zero"),
        (Range, {"from": 3, "to": 2, "step": 1}, "to must not be below from"),
        (Axis, {"path": "seed"}, "give one of values"),
        (
            Axis,
            {"path": "seed", "values": [1], "range": {"from": 1, "to": 2, "count": 2}},
            "give one of values",
        ),
        (Axis, {"values": [1]}, "path: needed"),
        (Axis, {"path": "seed", "points": {"a": {}}}, "has a name and no path"),
        (Parameter, {"type": "Integer", "default": 0.5}, "default: 0.5 is not allowed"),
        (Parameter, {"type": "Number"}, "null is not allowed"),
    ],
)
def test_what_does_not_fit_together_is_refused(model: Any, fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        model.model_validate(fields)


@pytest.mark.parametrize(
    ("declared", "value", "message"),
    [
        (
            {"type": "Number", "default": 1, "minimum": 0, "maximum": 2},
            3,
            "above the maximum, allowed: a number from 0",
        ),
        ({"type": "Number", "default": 1, "minimum": 0}, -1, "a number of at least 0"),
        ({"type": "Number", "default": 1}, True, "True is not allowed, only a number"),
        ({"type": "Integer", "default": 1}, 1.5, "only an integer"),
        ({"type": "Boolean", "default": True}, 1, "only true or false"),
        ({"type": "String", "default": "a", "values": ["a", "b"]}, "c", "only one of 'a', 'b'"),
        ({"type": "String", "default": "a"}, None, "null is not allowed"),
        ({"type": "String", "default": "a"}, "x" * 16384, None),
        ({"type": "String", "default": "a"}, "x" * 16385, "16385 characters are too many, at most 16384"),
        ({"type": "Number", "nullable": True}, None, None),
        ({"type": "Number", "default": 1.5}, 2, None),
    ],
)
def test_values_of_parameters(declared: dict[str, Any], value: Any, message: str | None) -> None:
    problem = Parameter.model_validate(declared).problem(value)
    assert problem is None if message is None else message in str(problem)


def test_parameters_have_a_length_in_all() -> None:
    names = [f"note{number}" for number in range(9)]
    declared = {name: {"type": "String", "default": ""} for name in names}
    spec = AlgorithmSpec.model_validate(ALGORITHM | {"parameters": declared})
    assert len(spec.fill(dict.fromkeys(names[:7], "x" * 16384))) == 9
    with pytest.raises(
        InputError, match=r"parameters: they take \d+ bytes, at most 131072 reach a container"
    ):
        spec.fill(dict.fromkeys(names, "x" * 16384))


def test_fields_have_their_outside_names_and_absent_ones_are_left_out() -> None:
    made = Sensor.model_validate(LIDAR | {"frameId": "f", "lidar": {"minRange": 1}}).as_json()
    assert made["frameId"] == "f"
    assert made["lidar"] == {"minRange": 1, "maxRange": 1000}
    assert "camera" not in made
    assert made["T_body_sensor"][3] == [0, 0, 0, 1]


@pytest.mark.parametrize(
    ("source", "kind", "working_set"),
    [
        ("cgroup-v1", "WorkingSet", 7),
        ("cgroup-v2", "WorkingSet", 7),
        ("proc", "Resident", None),
        ("slam-hive profiling.csv", "Container", None),
        (None, None, None),
    ],
)
def test_memory_of_earlier_records_says_what_it_is(
    source: str | None, kind: str | None, working_set: int | None
) -> None:
    told: dict[str, Any] = {"memory": {"peakBytes": 7, "meanBytes": 5.0}, "source": source}
    memory = Usage.model_validate(told).memory
    assert (memory.peak_bytes, memory.kind, memory.working_set_peak_bytes) == (7, kind, working_set)
    now = {"kind": "Resident", "workingSetPeakBytes": 9}
    memory = Usage.model_validate(told | {"memory": told["memory"] | now}).memory
    assert (memory.peak_bytes, memory.kind, memory.working_set_peak_bytes) == (7, "Resident", 9)


def test_a_mode_that_names_its_trajectory_names_its_keyframes_too() -> None:
    files = {"trajectory": {"path": "a", "format": "Tum"}, "keyframes": {"path": "b", "format": "Tum"}}
    modes = [
        {"name": "lidar"},
        {"name": "mono", "output": {"trajectory": files["keyframes"], "scale": False}},
        {"name": "stereo", "output": {"keyframes": KITTI}},
    ]
    spec = AlgorithmSpec.model_validate(ALGORITHM | {"modes": modes, "output": {"frame": "body"} | files})
    outputs = [spec.output_of(mode) for mode in spec.modes]
    found = [
        (one.trajectory and one.trajectory.path, one.keyframes and one.keyframes.path) for one in outputs
    ]
    assert found == [("a", "b"), ("b", None), ("a", "poses.txt")]
    assert [one.counts_frames for one in outputs] == [False, False, True]


def test_a_command_may_come_back_with_the_defaults_of_an_api_server() -> None:
    given = {"command": ["odometry"], "adapter": "adapter.py", "requirements": "requirements.txt"}
    assert LocalProgram.model_validate(given).files == ["odometry"]
