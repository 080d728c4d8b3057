# SPDX-License-Identifier: Apache-2.0
"""Settings of VINS-Mono and VINS-Fusion that follow from a dataset: lens, noise, time offset, resolution."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import pytest

from slamhive.model.algorithm import Algorithm
from slamhive.model.loading import load_file
from slamhive.model.sensors import ROLES, SensorMode
from slamhive.templating.rendering import Renderer

ALGORITHMS = Path(__file__).parents[2] / "images" / "algorithms"
EYE = [[float(row == column) for column in range(4)] for row in range(4)]
FISHEYE = {
    "width": 376,
    "height": 240,
    "model": "Pinhole",
    "fx": 230.0,
    "fy": 229.0,
    "cx": 183.5,
    "cy": 124.0,
    "distortion": "Equidistant",
    "coefficients": [0.1, -0.2, 0.03, -0.004],
}
NOISE = {
    "accelerometerNoise": 0.002,
    "gyroscopeNoise": 0.00017,
    "accelerometerRandomWalk": 0.003,
    "gyroscopeRandomWalk": 0.00002,
    "gravity": 9.805,
}

inertial = pytest.mark.parametrize(
    ("name", "mode"),
    [("vins-mono", "mono-inertial"), ("vins-fusion", "mono-inertial"), ("vins-fusion", "stereo-inertial")],
)


def rendered(name: str, mode: str, folder: Path, **parameters: Any) -> dict[str, cv2.FileStorage]:
    """Return the settings files as OpenCV reads them, of images at half their size."""
    (algorithm,) = load_file(ALGORITHMS / name / "algorithm.yaml")
    assert isinstance(algorithm, Algorithm)
    sensors: dict[str, Any] = {
        str(role): {"topic": f"/{role}", "T_body_sensor": EYE, "camera": FISHEYE, "timeOffset": 0.004}
        for role in ROLES[SensorMode(mode)]
    }
    if "imu" in sensors:
        sensors["imu"] = {"topic": "/imu", "T_body_sensor": EYE, "imu": NOISE, "timeOffset": -0.001}
        sensors["imu"]["rate"] = 400.0
    told = dict.fromkeys(("algorithm", "run", "seed", "cores"))
    told |= {"mode": mode, "sensors": sensors, "parameters": algorithm.spec.fill(parameters)}
    told |= {"dataset": {"recording": {"path": "dataset/recording.bag"}}, "input": {"resolution": 0.5}}
    found = {}
    for path, template in algorithm.spec.templates:
        (folder / path).write_text(Renderer(told, "/run", "/run/files").text(template))
        if path.endswith(".yaml"):
            found[path] = cv2.FileStorage(str(folder / path), cv2.FILE_STORAGE_READ)
    return found


@inertial
def test_noise_gravity_and_time_offset_are_the_dataset_s(name: str, mode: str, tmp_path: Path) -> None:
    file = rendered(name, mode, tmp_path)["vins.yaml"]
    found = {key: file.getNode(key).real() for key in ("acc_n", "gyr_n", "acc_w", "gyr_w", "g_norm", "td")}
    assert found == pytest.approx(
        {"acc_n": 0.04, "gyr_n": 0.0034, "acc_w": 0.06, "gyr_w": 0.0004, "g_norm": 9.805, "td": 0.005}
    )


@inertial
def test_parameters_go_before_the_dataset(name: str, mode: str, tmp_path: Path) -> None:
    file = rendered(name, mode, tmp_path, acc_n=1, td=0.25, estimate_td=True)["vins.yaml"]
    found = [file.getNode(key).real() for key in ("acc_n", "td", "estimate_td", "gyr_n")]
    assert found == pytest.approx([1.0, 0.25, 1, 0.0034])


@inertial
def test_distances_in_pixels_follow_the_size_of_the_images(name: str, mode: str, tmp_path: Path) -> None:
    file = rendered(name, mode, tmp_path, min_dist=31)["vins.yaml"]
    assert (file.getNode("min_dist").isInt(), file.getNode("min_dist").real()) == (True, 16)
    # These are meant at a focal length of 460 px, whatever the image's.
    assert [file.getNode(key).real() for key in ("F_threshold", "keyframe_parallax")] == [1.0, 10.0]


@pytest.mark.parametrize(
    ("name", "mode", "files"),
    [
        ("vins-mono", "mono-inertial", ["vins.yaml"]),
        ("vins-fusion", "mono-inertial", ["cam0.yaml"]),
        ("vins-fusion", "stereo", ["cam0.yaml", "cam1.yaml"]),
    ],
)
def test_a_fisheye_lens_is_kannala_and_brandt_s(
    name: str, mode: str, files: list[str], tmp_path: Path
) -> None:
    found = rendered(name, mode, tmp_path)
    for path in files:
        assert found[path].getNode("model_type").string() == "KANNALA_BRANDT"
        lens = found[path].getNode("projection_parameters")
        names = ("k2", "k3", "k4", "k5", "mu", "mv", "u0", "v0")
        assert [lens.getNode(key).real() for key in names] == [*FISHEYE["coefficients"], 230, 229, 183.5, 124]


def test_without_an_imu_nothing_of_it_is_written(tmp_path: Path) -> None:
    file = rendered("vins-fusion", "stereo", tmp_path)["vins.yaml"]
    assert file.getNode("imu").real() == 0
    assert [key for key in ("imu_topic", "acc_n", "g_norm") if not file.getNode(key).empty()] == []
    assert file.getNode("td").real() == 0
