# SPDX-License-Identifier: Apache-2.0
"""The manifests of ORB-SLAM2 and ORB-SLAM3 as their own programs, run with stand-ins of these.

A stand-in reads settings and data as the real program does and writes the true poses in its way: what it saw
is compared with the calibration, what is made of its files with the truth.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from slamhive.contract.conversion import Converted, convert_all
from slamhive.contract.output import FILE, KEYFRAMES
from slamhive.contract.posefiles import FRAMES, PoseFiles
from slamhive.data.making.preparation import prepare
from slamhive.data.store.datasets import materialise
from slamhive.model.algorithm import Algorithm
from slamhive.model.configuration import PreparedRecording
from slamhive.model.dataset import Dataset
from slamhive.model.loading import load_file
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role, SensorMode
from slamhive.model.templates import TemplateMistake
from slamhive.plan.configuration import run_configuration
from slamhive.templating.rendering import Renderer

ROOT = Path(__file__).parents[2]
STANDIN = Path(__file__).parent / "standins" / "orb_slam.py"
PROGRAMS = ("mono_tum", "rgbd_tum", "stereo_kitti", "mono_inertial_euroc", "stereo_inertial_euroc")
MODES = [
    (name, mode)
    for name, modes in {
        "orb-slam2": ("mono", "stereo", "rgbd"),
        "orb-slam3-program": ("mono", "stereo", "rgbd"),
        "orb-slam3-inertial-program": ("mono-inertial", "stereo-inertial"),
    }.items()
    for mode in modes
]
RECORDING = {
    "seed": 6,
    "sensors": ["Stereo", "Rgbd", "Imu"],
    "durationSeconds": 7,
    "loops": 0.05,
    "camera": {"width": 160, "height": 120, "rate": 4},
}


def algorithm(name: str) -> Algorithm:
    (found,) = load_file(ROOT / "images" / "algorithms" / name / "algorithm.yaml")
    assert isinstance(found, Algorithm)
    return found


@dataclass(frozen=True)
class Recorded:
    """A short recording.

    Attributes:
        sensors: calibration as the generator says it, by role.
        truth: pose of the body by stamp in ns, (4, 4).
        variants: folder in which it is prepared, once in each way.
    """

    dataset: Dataset
    entry: Any
    sensors: dict[str, Any]
    truth: dict[int, np.ndarray]
    variants: Path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("recorded")
    dataset = Dataset.model_validate(
        {"metadata": {"name": "short"}, "spec": {"recording": {"synthetic": RECORDING}}}
    )
    entry = materialise(dataset, folder, folder)
    sensors = json.loads((entry.root / "sensors.json").read_text())["sensors"]
    truth = {}
    for line in (entry.root / "groundtruth.txt").read_text().splitlines()[1:]:
        stamp, *numbers = line.split()
        truth[int(stamp.replace(".", ""))] = matrix(np.array(numbers, float))
    return Recorded(dataset, entry, sensors, truth, folder / "variants")


def nanoseconds(seconds: str) -> int:
    whole, _, rest = seconds.partition(".")
    return int(whole + rest.ljust(9, "0"))


def matrix(row: np.ndarray) -> np.ndarray:
    """Return the pose (4, 4) of ``x y z qx qy qz qw``."""
    x, y, z, w = row[3:] / np.linalg.norm(row[3:])
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, 3] = row[:3]
    return T


@dataclass(frozen=True)
class Ran:
    """A run of a stand-in: how it ended, what it saw, and what was made of what it wrote."""

    status: int
    said: str
    seen: dict[str, Any]
    converted: Converted
    output: Path
    truth: dict[int, np.ndarray]

    def poses(self, name: str) -> dict[int, np.ndarray]:
        lines = [line.split() for line in (self.output / name).read_text().splitlines()]
        return {nanoseconds(stamp): matrix(np.array(row, float)) for stamp, *row in lines}


def run(
    recorded: Recorded,
    folder: Path,
    name: str,
    mode: str,
    *,
    late: int = 0,
    edit: tuple[str, str] = ("", ""),
    **parameters: Any,
) -> Ran:
    """Prepare the data, render the settings, edited or not, and run the script, as a run does."""
    spec = algorithm(name).spec
    declared = spec.mode(SensorMode(mode))
    options = InputOptions.model_validate({})
    variant = prepare(recorded.entry, declared.needs, options, spec.formats(declared), recorded.variants)
    run_folder = folder / "run"
    (run_folder / "output").mkdir(parents=True)
    (run_folder / "dataset").symlink_to(variant.folder)
    prepared = PreparedRecording.model_validate(
        {key: getattr(variant, key) for key in PreparedRecording.model_fields if hasattr(variant, key)}
        | {"recording": variant.path.name}
    )
    asked = {
        "algorithmRef": {"name": name},
        "sensors": mode,
        "parameters": spec.fill(parameters),
        "input": {"pace": "Lockstep"},
        "seed": 1,
    }
    told = run_configuration("r", asked, recorded.dataset, prepared, 1).as_json()
    files = run_folder / "files"
    files.mkdir()
    for path, template in spec.templates:
        (files / path).write_text(Renderer(told, str(run_folder), str(files)).text(template.replace(*edit)))
    bin_folder = folder / "bin"
    bin_folder.mkdir()
    for program in PROGRAMS:
        place = bin_folder / program
        place.write_text(f"#!{sys.executable}\n{STANDIN.read_text()}")
        place.chmod(0o755)
    frame = spec.output_of(declared).frame
    stamps = [int(line) for line in (variant.folder / FRAMES).read_text().split()]
    T_body_frame = np.array(variant.sensors[Role(frame)].T_body_sensor)
    truth = {stamp: recorded.truth[stamp] @ T_body_frame for stamp in stamps}
    rows = (f"{stamp} {' '.join(map(str, T[:3].reshape(-1)))}\n" for stamp, T in truth.items())
    (folder / "poses.txt").write_text("".join(rows))
    (folder / "vocabulary.txt").write_text("10 6 0 0\n")
    environment = {
        "PATH": f"{bin_folder}:{os.environ['PATH']}",
        "ORB_VOCABULARY": str(folder / "vocabulary.txt"),
        "ORB_POSES": str(folder / "poses.txt"),
        "ORB_LATE": str(late),
        "DISPLAY": ":0",
    }
    result = subprocess.run(
        ["sh", str(files / "run.sh")], env=environment, capture_output=True, text=True, check=False
    )
    output = run_folder / "output"
    told_files = spec.output_of(declared).pose_files(str(variant.folder / FRAMES))
    assert told_files is not None
    converted = convert_all(str(output), PoseFiles.from_json(told_files), FILE, KEYFRAMES)
    seen = output / "seen.json"
    found = json.loads(seen.read_text()) if seen.exists() else {}
    return Ran(result.returncode, result.stderr, found, converted, output, truth)


@pytest.mark.parametrize(("name", "mode"), MODES)
def test_poses_that_a_program_wrote_are_the_truth(
    recorded: Recorded, tmp_path: Path, name: str, mode: str
) -> None:
    ran = run(recorded, tmp_path, name, mode)
    assert (ran.status, ran.said) == (0, "")
    assert ran.converted.trajectory.problem is None
    assert ran.converted.keyframes is None
    found = ran.poses(FILE)
    stamps = list(ran.truth)[::5] if mode == "mono" else list(ran.truth)
    # Seconds are written to a microsecond, nanoseconds pass through a double.
    np.testing.assert_allclose(list(found), stamps, rtol=0, atol=600)
    first = np.linalg.inv(ran.truth[stamps[0]])
    for pose, stamp in zip(found.values(), stamps, strict=True):
        np.testing.assert_allclose(pose, first @ ran.truth[stamp], atol=1e-6)
    if mode in {"rgbd", "mono-inertial", "stereo-inertial"}:
        np.testing.assert_allclose(list(ran.poses(KEYFRAMES)), list(ran.truth)[::5], rtol=0, atol=600)


def lens(sensor: dict[str, Any]) -> dict[str, float]:
    """Return a camera's numbers as ORB-SLAM names them."""
    camera = sensor["camera"]
    names = ("k1", "k2", "p1", "p2")
    return {key: camera[key] for key in ("fx", "fy", "cx", "cy")} | dict(
        zip(names, camera["coefficients"], strict=False)
    )


def pose(sensor: dict[str, Any]) -> np.ndarray:
    return np.array(sensor["T_body_sensor"])


def rectified(sensors: dict[str, Any]) -> tuple[dict[str, float], float]:
    """Rectify the pair by OpenCV: the camera that both become, and the baseline."""
    left, right = sensors["left"], sensors["right"]
    K = [
        np.array([[c["fx"], 0, c["cx"]], [0, c["fy"], c["cy"]], [0, 0, 1]])
        for c in (left["camera"], right["camera"])
    ]
    D = [np.array(sensor["camera"]["coefficients"]) for sensor in (left, right)]
    T = np.linalg.inv(pose(right)) @ pose(left)
    _, _, P_left, P_right, *_ = cv2.stereoRectify(
        K[0], D[0], K[1], D[1], (160, 120), T[:3, :3], T[:3, 3:], flags=cv2.CALIB_ZERO_DISPARITY, alpha=0
    )
    values = {"fx": P_left[0, 0], "fy": P_left[1, 1], "cx": P_left[0, 2], "cy": P_left[1, 2]}
    return values | dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0), -P_right[0, 3] / P_right[0, 0]


ASKED = {"nFeatures": 700, "scaleFactor": 1.3, "nLevels": 4, "iniThFAST": 15, "minThFAST": 5, "rgb": False}


@pytest.mark.parametrize(("name", "mode"), MODES)
def test_settings_are_the_calibration_in_the_program_s_words(
    recorded: Recorded, tmp_path: Path, name: str, mode: str
) -> None:
    more: dict[str, Any] = {} if mode.startswith("mono") else {"thDepth": 35}
    more |= {"virtualBaseline": 0.1} if mode == "rgbd" else {}
    more |= {} if name == "orb-slam2" else {"loopClosing": False}
    more |= {} if name == "orb-slam2" or mode == "rgbd" else {"newWidth": 80}
    ran = run(recorded, tmp_path, name, mode, **ASKED, **more)
    assert (ran.status, ran.said) == (0, "")
    sensors, seen = recorded.sensors, dict(ran.seen)
    assert seen.pop("sizes") == [[160, 120]]
    is_new = name != "orb-slam2" and mode != "rgbd"
    first = {"mono": "left", "stereo": "left", "rgbd": "color"}[mode.removesuffix("-inertial")]
    expected: dict[str, Any] = {f"ORBextractor.{key}": ASKED[key] for key in list(ASKED)[:5]}
    expected |= {"Camera.RGB": 0, "Camera.fps": 4}
    values, T_left_right = lens(sensors[first]), np.linalg.inv(pose(sensors["left"])) @ pose(sensors["right"])
    distance = float(np.linalg.norm(T_left_right[:3, 3]))
    if mode == "stereo":
        values, distance = rectified(sensors)
        T_left_right = np.eye(4)
        T_left_right[0, 3] = distance
    expected |= {f"{'Camera1' if is_new else 'Camera'}.{key}": value for key, value in values.items()}
    if name != "orb-slam2":
        expected |= {"loopClosing": 0}
    if is_new:
        expected |= {"File.version": "1.0", "Camera.type": "PinHole", "Camera.newWidth": 80}
        expected |= {"Camera.width": 160, "Camera.height": 120}
        expected |= {key: value for key, value in seen.items() if key.startswith("Viewer.")}
        if mode.startswith("stereo"):
            second = values if mode == "stereo" else lens(sensors["right"])
            expected |= {f"Camera2.{key}": value for key, value in second.items()}
            expected |= {"Stereo.ThDepth": 35, "Stereo.T_c1_c2": T_left_right.tolist()}
    elif mode == "stereo":
        expected |= {"Camera.bf": distance * values["fx"], "ThDepth": 35}
    elif mode == "rgbd":
        expected |= {"Camera.bf": 0.1 * values["fx"], "ThDepth": 35, "DepthMapFactor": 1000}
    if mode.endswith("inertial"):
        noise = sensors["imu"]["imu"]
        expected |= {
            "IMU.NoiseGyro": noise["gyroscopeNoise"],
            "IMU.NoiseAcc": noise["accelerometerNoise"],
            "IMU.GyroWalk": noise["gyroscopeRandomWalk"],
            "IMU.AccWalk": noise["accelerometerRandomWalk"],
            "IMU.Frequency": 200,
            "IMU.T_b_c1": (np.linalg.inv(pose(sensors["imu"])) @ pose(sensors[first])).tolist(),
        }
    assert set(seen) == set(expected)
    for key, value in expected.items():
        if isinstance(value, str):
            assert seen[key] == value
        else:
            np.testing.assert_allclose(seen[key], value, rtol=1e-6, atol=1e-7, err_msg=key)


@pytest.mark.parametrize(("key", "mode"), [("ThDepth", "rgbd"), ("Stereo.ThDepth", "stereo")])
def test_a_whole_number_is_no_real_one(recorded: Recorded, tmp_path: Path, key: str, mode: str) -> None:
    ran = run(recorded, tmp_path, "orb-slam3-program", mode, edit=("thDepth|float", "thDepth|int"))
    assert (ran.status, ran.said) == (1, f"{key} parameter must be a real number, aborting...\n")


@pytest.mark.parametrize("parameter", ["newWidth", "newHeight"])
def test_a_size_that_its_settings_do_not_know_is_refused(
    recorded: Recorded, tmp_path: Path, parameter: str
) -> None:
    with pytest.raises(TemplateMistake, match="doesn't read newWidth and newHeight in rgbd"):
        run(recorded, tmp_path, "orb-slam3-program", "rgbd", **{parameter: 80})


@pytest.mark.parametrize("name", ["orb-slam2", "orb-slam3-program"])
def test_rows_without_stamps_are_refused_where_they_are_fewer_than_frames(
    recorded: Recorded, tmp_path: Path, name: str
) -> None:
    ran = run(recorded, tmp_path, name, "stereo", late=3)
    count = len(ran.truth)
    assert ran.status == 3
    assert ran.said.startswith(f"CameraTrajectory.txt has {count - 3} rows for {count} frames")


def test_a_dataset_s_noise_may_be_replaced(recorded: Recorded, tmp_path: Path) -> None:
    asked = {"noiseGyro": 1.7e-4, "noiseAcc": 2e-3, "gyroWalk": 1.9393e-5, "accWalk": 3e-3}
    ran = run(recorded, tmp_path, "orb-slam3-inertial-program", "mono-inertial", **asked)
    names = {"NoiseGyro": 1.7e-4, "NoiseAcc": 2e-3, "GyroWalk": 1.9393e-5, "AccWalk": 3e-3}
    assert {key: ran.seen[f"IMU.{key}"] for key in names} == names


PUBLISHED = ROOT.parent / "shared" / "data" / "icra2023" / "runs"
WHERE = {
    "orb-slam2-ros-mono": ("orb-slam2", "mono"),
    "orb-slam2-ros-stereo": ("orb-slam2", "stereo"),
    "orb-slam2-ros-rgbd": ("orb-slam2", "rgbd"),
    "orb-slam3-ros-mono": ("orb-slam3-program", "mono"),
    "orb-slam3-ros-stereo": ("orb-slam3-program", "stereo"),
    "orb-slam3-ros-mono-inertial": ("orb-slam3-inertial-program", "mono-inertial"),
    "orb-slam3-ros-stereo-inertial": ("orb-slam3-inertial-program", "stereo-inertial"),
}
RECTIFICATION = {f"{side}_{name}" for side in ("LEFT", "RIGHT") for name in "DKRP"}
"""Keys of theirs by which their node rectified images: ours are rectified before they are read."""


def published() -> list[Any]:
    if not PUBLISHED.is_dir():
        reason = f"the published configurations are not in {PUBLISHED}"
        return [pytest.param({}, marks=pytest.mark.skip(reason=reason))]
    paths = sorted(PUBLISHED.glob("*/config.yaml"))
    found = [(path, yaml.load(path.read_text(), yaml.CSafeLoader)) for path in paths]
    return [
        pytest.param(config, id=path.parent.name)
        for path, config in found
        if config["slam-hive-algorithm"] in WHERE
    ]


def told_of(config: dict[str, Any], mode: str, spec: Any) -> dict[str, Any]:
    """Return the configuration of our run of a published one: calibration, and parameters."""
    given, asked = config["dataset-parameters"], dict(config["algorithm-parameters"])
    names = [key for key in ("k1", "k2", "p1", "p2", "k3") if key in given]
    size = {"width": given.get("width") or given.get("Camera_width") or 752}
    size |= {"height": given.get("height") or given.get("Camera_height") or 480}
    camera = {key: given[key] for key in ("fx", "fy", "cx", "cy")} | size
    camera |= {"model": "Pinhole", "distortion": "RadialTangential"}
    camera["coefficients"] = [float(given[key]) for key in names]
    view = {"type": "Camera", "topic": "/c", "rate": float(given["fps"]), "camera": camera}
    first = {"mono": "camera", "stereo": "left", "rgbd": "color"}[mode.removesuffix("-inertial")]
    T = np.reshape(given.get("T_b_c1", np.eye(4)), (4, 4)).astype(float)
    sensors = {first: view | {"name": first, "T_body_sensor": T.tolist()}}
    if first == "left":
        moved = np.eye(4)
        moved[0, 3] = given["bf"] / given["fx"]
        sensors["right"] = view | {"name": "right", "T_body_sensor": (T @ moved).tolist()}
        asked["thDepth"] = given["ThDepth"]
    if first == "color":
        depth = camera | {"depthScale": given["DepthMapFactor"]}
        sensors["depth"] = view | {"name": "depth", "T_body_sensor": T.tolist(), "camera": depth}
        asked |= {"thDepth": given["ThDepth"], "virtualBaseline": given["bf"] / given["fx"]}
    if mode.endswith("inertial"):
        noise = {
            "gyroscopeNoise": given["NoiseGyro"],
            "accelerometerNoise": given["NoiseAcc"],
            "gyroscopeRandomWalk": given["GyroWalk"],
            "accelerometerRandomWalk": given["AccWalk"],
            "gravity": 9.81,
        }
        imu = {"name": "imu", "type": "Imu", "topic": "/imu", "rate": given["Frequency"]}
        noise = {key: float(value) for key, value in noise.items()}
        sensors["imu"] = imu | {"T_body_sensor": np.eye(4).tolist(), "imu": noise}
    asked |= {key: given[key] for key in ("newWidth", "newHeight") if key in given}
    return {
        "run": "r",
        "algorithm": "a",
        "mode": mode,
        "dataset": {"name": "d", "recording": {"format": "Tum", "path": "dataset/recording"}},
        "sensors": sensors,
        "parameters": spec.fill(asked | {"rgb": bool(given["RGB"])}),
        "input": {"pace": "Lockstep", "frameRate": 20.0, "resolution": 1.0, "start": 0.0, "rate": 1.0},
        "seed": 1,
        "cores": 2,
    }


@pytest.mark.parametrize("config", published())
def test_settings_of_the_original_are_reproduced_key_by_key(config: dict[str, Any], tmp_path: Path) -> None:
    name, mode = WHERE[config["slam-hive-algorithm"]]
    spec = algorithm(name).spec
    (text,) = [template for path, template in spec.templates if path == "settings.yaml"]
    path = tmp_path / "settings.yaml"
    path.write_text(Renderer(told_of(config, mode, spec), "/slamhive", "/slamhive/files").text(text))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    is_new = not storage.getNode("File.version").empty()
    lens_keys = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    where = {key: f"{'Camera1' if is_new else 'Camera'}.{key}" for key in lens_keys}
    where |= {key: f"Camera.{key}" for key in ("fps", "RGB", "width", "height", "newWidth", "newHeight")}
    where |= {"Camera_width": "Camera.width", "Camera_height": "Camera.height"}
    where |= {key: f"ORBextractor.{key}" for key in list(ASKED)[:5]}
    where |= {"ThDepth": "Stereo.ThDepth" if is_new else "ThDepth", "DepthMapFactor": "DepthMapFactor"}
    where |= {key: f"IMU.{key}" for key in ("NoiseGyro", "NoiseAcc", "GyroWalk", "AccWalk", "Frequency")}
    where |= {"T_b_c1": "IMU.T_b_c1"}
    wanted = config["algorithm-parameters"] | config["dataset-parameters"]
    wanted.pop("bFishEye", None)
    for key in RECTIFICATION & set(wanted):
        wanted.pop(key)
    if is_new and "bf" in wanted:
        moved = storage.getNode("Stereo.T_c1_c2").mat()
        assert np.linalg.norm(moved[:3, 3]) * wanted["fx"] == pytest.approx(wanted.pop("bf"), rel=1e-6)
    where["bf"] = "Camera.bf"
    for key, value in wanted.items():
        node = storage.getNode(where[key])
        assert not node.empty(), key
        found = node.mat() if key == "T_b_c1" else node.real()
        np.testing.assert_allclose(np.ravel(found), np.ravel(np.array(value, float)), rtol=1e-6, err_msg=key)


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason=f"the published configurations are not in {PUBLISHED}")
def test_all_that_was_published_of_both_orb_slams_is_reproduced() -> None:
    names = [parameter.values[0]["slam-hive-algorithm"] for parameter in published()]
    everything = [yaml.load(path.read_text(), yaml.CSafeLoader) for path in PUBLISHED.glob("*/config.yaml")]
    assert len(names) == sum("orb-slam" in config["slam-hive-algorithm"] for config in everything)
    assert set(names) == set(WHERE)
