# SPDX-License-Identifier: Apache-2.0
"""Settings of the original SLAM Hive's runs of VINS-Mono and VINS-Fusion, reproduced key by key.

Each published configuration is taken apart into what a Dataset says (calibration, topics) and what are our
Algorithm's parameters; the files that are rendered of both are read by OpenCV and compared with all of it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import yaml

from slamhive.model.loading import load_file
from slamhive.model.sensors import ROLES, SensorMode
from slamhive.templating.rendering import Renderer

if TYPE_CHECKING:
    from slamhive.model.algorithm import AlgorithmSpec

ROOT = Path(__file__).parents[2]
PUBLISHED = ROOT.parent / "shared" / "data" / "icra2023" / "runs"
MODES = {
    "vins-mono": ("vins-mono", "mono-inertial"),
    "vins-fusion-mono-imu": ("vins-fusion", "mono-inertial"),
    "vins-fusion-stereo": ("vins-fusion", "stereo"),
    "vins-fusion-stereo-imu": ("vins-fusion", "stereo-inertial"),
}
READ_BY_NOTHING = {"vins-fusion": {"freq"}, "vins-mono": set()}
"""Keys of theirs that no program reads, so that we don't write them."""
BLOCKS = {
    "mirror_parameters": ("xi",),
    "distortion_parameters": ("k1", "k2", "p1", "p2"),
    "projection_parameters": ("fx", "fy", "cx", "cy", "gamma1", "gamma2", "u0", "v0"),
}


def published() -> list[Any]:
    """Return the configurations that are ours to reproduce, by number of the run."""
    if not PUBLISHED.is_dir():
        reason = f"the published configurations are not in {PUBLISHED}"
        return [pytest.param("", {}, marks=pytest.mark.skip(reason=reason))]
    found = []
    for path in sorted(PUBLISHED.glob("*/config.yaml")):
        config = yaml.load(path.read_text(), yaml.CSafeLoader)
        if config["slam-hive-algorithm"] in MODES:
            found.append(pytest.param(path.parent.name, config, id=path.parent.name))
    return found


def spec_of(name: str) -> AlgorithmSpec:
    (algorithm,) = load_file(ROOT / "images" / "algorithms" / name / "algorithm.yaml")
    return algorithm.spec  # type: ignore[union-attr,return-value]


def camera_of(told: dict[str, Any], prefix: str, pose: Any, topic: str) -> dict[str, Any]:
    """Return a camera as a Dataset would describe it, from the original's parameters of it."""
    names = {"fx": "gamma1", "fy": "gamma2", "cx": "u0", "cy": "v0"}
    is_mei = f"{prefix}xi" in told
    camera = {ours: told[prefix + (theirs if is_mei else ours)] for ours, theirs in names.items()}
    camera |= {"width": told["image_width"], "height": told["image_height"]}
    camera |= {"model": "Mei" if is_mei else "Pinhole", "distortion": "RadialTangential"}
    camera["coefficients"] = [told[f"{prefix}{name}"] for name in BLOCKS["distortion_parameters"]]
    if is_mei:
        camera["xi"] = told[f"{prefix}xi"]
    return {"name": topic, "type": "Camera", "topic": topic, "T_body_sensor": pose, "camera": camera}


def configuration(config: dict[str, Any], mode: str, spec: AlgorithmSpec) -> dict[str, Any]:
    """Return the configuration of our run of the same experiment; the body is the IMU, as in EuRoC."""
    told, asked = config["dataset-parameters"], config["algorithm-parameters"] | config["dataset-parameters"]
    cameras = [role for role in ROLES[SensorMode(mode)] if role != "imu"]
    sensors = {}
    for number, role in enumerate(cameras):
        if f"body_T_cam{number}" in told:
            pose = np.reshape(told[f"body_T_cam{number}"], (4, 4))
        else:
            pose = np.eye(4)
            pose[:3, :3] = np.reshape(told["extrinsicRotation"], (3, 3))
            pose[:3, 3] = told["extrinsicTranslation"]
        prefix = f"cam{number}_" if len(cameras) > 1 else ""
        topic = told.get(f"image{number}_topic") or told["image_topic"]
        sensors[str(role)] = camera_of(told, prefix, pose.tolist(), topic) | {"rate": 20.0}
    if "imu" in ROLES[SensorMode(mode)]:
        # Other noise than theirs: what they say has to come by way of the parameters.
        noise = dict.fromkeys(("accelerometerNoise", "gyroscopeNoise"), 0.5)
        noise |= dict.fromkeys(("accelerometerRandomWalk", "gyroscopeRandomWalk"), 0.5)
        imu = {"name": "imu0", "type": "Imu", "topic": told["imu_topic"], "rate": 200.0}
        sensors["imu"] = imu | {"T_body_sensor": np.eye(4).tolist(), "imu": noise | {"gravity": 9.0}}
    given = {
        name: bool(asked[name]) if declared.type == "Boolean" else asked[name]
        for name, declared in spec.parameters.items()
        if name in asked
    }
    return {
        "run": "r",
        "algorithm": config["slam-hive-algorithm"],
        "mode": mode,
        "dataset": {"name": "d", "recording": {"format": "Rosbag1", "path": "dataset/recording.bag"}},
        "sensors": sensors,
        "parameters": spec.fill(given),
        "input": {"pace": "Realtime", "frameRate": 20.0, "resolution": 1.0, "start": 0.0, "rate": 1.0},
        "seed": 1,
        "cores": 2,
    }


def value_in(folder: Path, key: str) -> Any:
    """Return OpenCV's reading of a key of theirs, wherever it stands in the files of ours."""
    file, name = "vins.yaml", key
    if key[:5] in {"cam0_", "cam1_"}:
        file, name = f"{key[:4]}.yaml", key[5:]
    for place in dict.fromkeys((file, "cam0.yaml")):
        if not (folder / place).exists():
            continue
        storage = cv2.FileStorage(str(folder / place), cv2.FILE_STORAGE_READ)
        block = next((block for block, names in BLOCKS.items() if name in names), None)
        node = storage.getNode(block).getNode(name) if block else storage.getNode(name)
        if node.empty():
            continue
        if node.isString():
            return node.string()
        return node.real() if node.isInt() or node.isReal() else node.mat()
    raise AssertionError(f"{key} stands nowhere")


@pytest.mark.parametrize(("run", "config"), published())
def test_settings_are_those_of_the_original(run: str, config: dict[str, Any], tmp_path: Path) -> None:
    name, mode = MODES[config["slam-hive-algorithm"]]
    spec = spec_of(name)
    told = configuration(config, mode, spec)
    for path, template in spec.templates:
        (tmp_path / path).write_text(Renderer(told, "/slamhive", "/slamhive/files").text(template))
    left_out = READ_BY_NOTHING[name]
    wanted = config["algorithm-parameters"] | config["dataset-parameters"]
    assert left_out <= set(wanted)
    for key, value in wanted.items():
        if key in left_out:
            continue
        found = value_in(tmp_path, key)
        if isinstance(value, str):
            # Their camera's name is a name alone.
            assert found == value or key == "camera_name"
        else:
            assert np.ravel(found) == pytest.approx(np.ravel(np.array(value, float)), rel=1e-12), key


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason=f"the published configurations are not in {PUBLISHED}")
def test_all_that_was_published_of_both_is_reproduced() -> None:
    found = [parameter.values[1]["slam-hive-algorithm"] for parameter in published()]
    assert {name: found.count(name) for name in MODES} == {
        "vins-mono": 3,
        "vins-fusion-mono-imu": 5,
        "vins-fusion-stereo": 3,
        "vins-fusion-stereo-imu": 3,
    }
