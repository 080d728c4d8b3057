# SPDX-License-Identifier: Apache-2.0
"""Settings and scripts of ROS 2 systems in images of one's own: types, frames, stamps, what is started."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from slamhive.model.algorithm import Algorithm
from slamhive.model.loading import load_file
from slamhive.model.templates import TemplateMistake
from slamhive.templating.rendering import Renderer

ALGORITHMS = Path(__file__).parents[2] / "images" / "algorithms"
EYE = np.eye(4)
TURNED = np.eye(4)
TURNED[:3, :3], TURNED[:3, 3] = Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_matrix(), [1.0, 2.0, 3.0]
FIELDS = {"rings": 32, "columns": 720, "timeField": "time", "ringField": "ring"}
PROGRAMS = {
    "fast-lio-ros2": ("lidar-inertial", ["fast_lio/fastlio_mapping"]),
    "glim": ("lidar-inertial", ["glim_ros/glim_rosnode"]),
    "lio-sam-ros2": (
        "lidar-inertial",
        [
            *("lio_sam/lio_sam_imuPreintegration", "lio_sam/lio_sam_imageProjection"),
            *("lio_sam/lio_sam_featureExtraction", "lio_sam/lio_sam_mapOptimization"),
        ],
    ),
    "mola-lidar-odometry": ("lidar", ["mola_launcher/mola-cli"]),
    "orb-slam3-ros2": ("stereo", ["orb_slam3_ros2_wrapper/stereo"]),
    "rtabmap-odometry": ("lidar", ["rtabmap_odom/icp_odometry"]),
}
systems = pytest.mark.parametrize("name", sorted(PROGRAMS))


def algorithm_of(name: str) -> Algorithm:
    (algorithm,) = load_file(ALGORITHMS / name / "algorithm.yaml")
    assert isinstance(algorithm, Algorithm)
    return algorithm


def rendered(
    name: str,
    folder: str = "/run",
    stamp: str = "ScanStart",
    parameters: dict[str, Any] | None = None,
    **lidar: Any,
) -> dict[str, str]:
    """Return the settings files of a system for an IMU that is mounted as `TURNED` and 3 ms late."""
    spec = algorithm_of(name).spec
    imu = dict.fromkeys(("accelerometerNoise", "gyroscopeNoise"), 0.01) | {"gravity": 9.81}
    imu |= dict.fromkeys(("accelerometerRandomWalk", "gyroscopeRandomWalk"), 0.01)
    lens = {
        "model": "Pinhole",
        "width": 640,
        "height": 480,
        "fx": 400.0,
        "fy": 400.0,
        "cx": 320.0,
        "cy": 240.0,
    }
    sensors: dict[str, Any] = {
        "lidar": {"type": "Lidar", "topic": "/points", "stamp": stamp, "rate": 10.0, "frameId": "os_lidar"},
        "imu": {"type": "Imu", "topic": "/imu", "rate": 200.0, "timeOffset": -0.003, "imu": imu},
        "left": {"type": "Camera", "topic": "/left", "rate": 20.0, "frameId": "left", "camera": lens},
        "right": {"type": "Camera", "topic": "/right", "rate": 20.0, "frameId": "right", "camera": lens},
    }
    sensors["lidar"]["lidar"] = {key: value for key, value in (FIELDS | lidar).items() if value is not None}
    for role, sensor in sensors.items():
        sensor["T_body_sensor"] = (TURNED if role == "imu" else EYE).tolist()
    told: dict[str, Any] = dict.fromkeys(("algorithm", "run", "seed", "input"))
    told |= {"sensors": sensors, "parameters": spec.fill(parameters or {}), "cores": 3}
    told |= {"mode": PROGRAMS[name][0], "dataset": {"recording": {"path": "dataset/recording"}}}
    renderer = Renderer(told, folder, f"{folder}/files")
    return {path: renderer.text(template) for path, template in spec.templates}


def node_parameters(name: str, **options: Any) -> dict[str, Any]:
    """Return the parameters for any node in the one file of them that a system has."""
    (text,) = (text for path, text in rendered(name, **options).items() if text.startswith("/**:"))
    found: dict[str, Any] = yaml.safe_load(text)["/**"]["ros__parameters"]
    return found


@systems
def test_whole_numbers_for_doubles_get_a_point(name: str) -> None:
    spec = algorithm_of(name).spec
    whole = {
        key: int(np.ceil(parameter.minimum or 1))
        for key, parameter in spec.parameters.items()
        if parameter.type == "Number" and np.ceil(parameter.minimum or 1) <= (parameter.maximum or np.inf)
    }

    def numbers(value: Any) -> list[Any]:
        if isinstance(value, dict):
            return [one for inner in value.values() for one in numbers(inner)]
        return [value]

    def types(parameters: dict[str, Any]) -> list[type]:
        files = rendered(name, parameters=parameters)
        parsed = [json.loads(text) for path, text in files.items() if path.endswith(".json")]
        parsed += [yaml.safe_load(text) for text in files.values() if text.startswith("/**:")]
        return [type(one) for value in parsed for one in numbers(value)]

    assert types(whole) == types({})


@pytest.mark.parametrize("name", ["fast-lio-ros2", "lio-sam-ros2"])
@pytest.mark.parametrize(
    ("stamp", "lidar", "message"),
    [
        ("ScanEnd", {}, "takes the stamp of a scan for its start, and these are stamped ScanEnd"),
        ("ScanStart", {"rings": None}, "needs the LiDAR's rings"),
        ("ScanStart", {"timeField": "timestamp"}, "timeField and ringField say otherwise"),
        ("ScanStart", {"ringField": "line"}, "timeField and ringField say otherwise"),
    ],
)
def test_a_lidar_that_can_not_be_read_is_refused(
    name: str, stamp: str, lidar: dict[str, Any], message: str
) -> None:
    with pytest.raises(TemplateMistake, match=message):
        rendered(name, stamp=stamp, **lidar)


def test_fast_lio_has_the_lidar_s_pose_on_the_imu_and_subtracts_the_imu_s_delay() -> None:
    found = node_parameters("fast-lio-ros2")
    place = np.linalg.inv(TURNED)
    np.testing.assert_allclose(found["mapping"]["extrinsic_T"], place[:3, 3])
    np.testing.assert_allclose(found["mapping"]["extrinsic_R"], place[:3, :3].ravel())
    assert found["common"]["time_offset_lidar_to_imu"] == pytest.approx(0.003)
    assert (found["preprocess"]["lidar_type"], found["preprocess"]["timestamp_unit"]) == (2, 0)
    ouster = node_parameters("fast-lio-ros2", timeField="t")["preprocess"]
    assert (ouster["lidar_type"], ouster["timestamp_unit"]) == (3, 3)


def test_glim_has_the_imu_s_pose_on_the_lidar_and_adds_what_its_clock_is_off() -> None:
    files = rendered("glim")
    assert {path for path in files if path.endswith(".json")} >= {
        f"glim/{name}" for name in json.loads(files["glim/config.json"])["global"].values() if name
    }
    pose = json.loads(files["glim/config_sensors.json"])["sensors"]["T_lidar_imu"]
    np.testing.assert_allclose(pose[:3], TURNED[:3, 3])
    np.testing.assert_allclose(Rotation.from_quat(pose[3:]).as_matrix(), TURNED[:3, :3])
    ros = json.loads(files["glim/config_ros.json"])["glim_ros"]
    assert ros["imu_time_offset"] == pytest.approx(-0.003)
    assert (ros["points_topic"], ros["imu_topic"]) == ("/points", "/imu")


def test_lio_sam_multiplies_an_orientation_by_the_inverse_of_what_turns_the_axes() -> None:
    found = node_parameters("lio-sam-ros2")
    np.testing.assert_allclose(found["extrinsicRot"], TURNED[:3, :3].ravel())
    np.testing.assert_allclose(found["extrinsicRPY"], TURNED[:3, :3].T.ravel())
    assert found["use_sim_time"] is True


def test_orb_slam_s_wrapper_gives_the_camera_s_own_poses() -> None:
    found = node_parameters("orb-slam3-ros2")
    base = Rotation.from_quat([found[f"robot_q{axis}"] for axis in "xyzw"]).as_matrix()
    # By which the wrapper turns a camera's axes: z ahead becomes x ahead.
    turned = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    np.testing.assert_allclose(base @ turned, np.eye(3), atol=1e-12)
    assert [found[f"robot_{axis}"] for axis in "xyz"] == [0.0, 0.0, 0.0]


@systems
def test_the_programs_themselves_are_started_with_the_player_s_arguments(name: str, tmp_path: Path) -> None:
    log, files = tmp_path / "log", tmp_path / "files"
    for path, text in rendered(name, str(tmp_path)).items():
        (files / path).parent.mkdir(parents=True, exist_ok=True)
        (files / path).write_text(text)
    for program in PROGRAMS[name][1]:
        path = tmp_path / "install" / "lib" / program
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f'#!/bin/sh\necho "${{0##*/lib/}} $*" >> {log}\nsleep 0.2\n')
        path.chmod(0o755)
    system = tmp_path / "install/share/mola_lidar_odometry/mola-cli-launchs/lidar_odometry_ros2.yaml"
    system.parent.mkdir(parents=True)
    for path in (system, tmp_path / "words"):
        path.write_text("")
    variables = {"PATH": "/usr/bin:/bin", "BASH_ENV": "/dev/null", "ORB_VOCABULARY": str(tmp_path / "words")}
    there = {**variables, "AMENT_PREFIX_PATH": f"{tmp_path / 'other'}:{tmp_path / 'install'}"}
    command = ["bash", files / "run.sh", "--ros-args", "-p", "use_sim_time:=true"]
    done = subprocess.run(command, env=there, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    started = log.read_text().splitlines()
    assert {line.split()[0] for line in started} == set(PROGRAMS[name][1])
    assert all("--ros-args" in line for line in started)
    done = subprocess.run(command, env=variables, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2
    assert "BASH_ENV has to name the setup.bash of its workspace" in done.stderr
