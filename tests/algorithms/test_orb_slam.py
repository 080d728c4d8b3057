# SPDX-License-Identifier: Apache-2.0
"""Tests of what the adapter of ORB-SLAM3 does around it: rectification, registration, settings, pairs."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from adapter_recording import Item
from adapter_support import AdapterError, Run, Sensor

if TYPE_CHECKING:
    from collections.abc import Iterator

    from conftest import Maker

FOLDER = Path(__file__).parents[2] / "images" / "algorithms" / "orb-slam3"
LEFT = {"fx": 309.6, "fy": 310.8, "cx": 243.4, "cy": 176.8, "coefficients": [-0.21, 0.07, 5e-4, -3e-4, 0.0]}
RIGHT = {"fx": 311.5, "fy": 312.8, "cx": 238.1, "cy": 181.1, "coefficients": [-0.2, 0.06, -4e-4, 5e-4, 0.0]}


@pytest.fixture(scope="module")
def adapter() -> Iterator[Any]:
    """The adapter's module, without ORB-SLAM3."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        patch.setitem(sys.modules, "orbslam3", ModuleType("orbslam3"))
        for name in ("adapter", "cameras"):
            patch.delitem(sys.modules, name, raising=False)
        yield importlib.import_module("adapter")
        for name in ("adapter", "cameras"):
            sys.modules.pop(name, None)


def pose(rotation: tuple[float, float, float], translation: tuple[float, float, float]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(np.array(rotation, float))[0], translation
    return T


def camera(adapter: Any, details: dict[str, Any], T_body_camera: np.ndarray) -> Any:
    details = {"width": 480, "height": 360, "distortion": "RadialTangential"} | details
    return adapter.Pinhole.of(Sensor("left", "/left", "Sample", 0, 15.0, T_body_camera, details))


def project(camera: Any, points: np.ndarray) -> np.ndarray:
    """Pixels `(n, 2)` of points `(n, 3)` in the body frame."""
    T = np.linalg.inv(camera.T_body_camera)
    return cv2.projectPoints(points, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], camera.K, camera.distortion)[0][
        :, 0
    ]


def test_rectified_pairs_differ_along_rows_by_what_depth_says(adapter: Any) -> None:
    left = camera(adapter, LEFT, pose((0.02, -0.01, 0.03), (0.2, 0.1, 0.1)))
    right = camera(adapter, RIGHT, pose((0.0, 0.02, 0.01), (0.32, 0.105, 0.09)))
    rectify = adapter.Rectification(left, right)
    points = np.random.default_rng(1).uniform([-1, -0.7, 2], [1, 0.7, 6], (200, 3))

    T_rectified = np.linalg.inv(left.T_body_camera @ rectify.T_left_rectified)
    inside = points @ T_rectified[:3, :3].T + T_rectified[:3, 3]
    ideal = inside @ rectify.K.T
    ideal = ideal[:, :2] / ideal[:, 2:]
    for seen, shift, (map_x, map_y) in zip(
        (project(left, points), project(right, points)),
        (np.zeros(200), rectify.K[0, 0] * rectify.baseline / inside[:, 2]),
        [cv2.convertMaps(*maps, cv2.CV_32FC1) for maps in rectify._maps],
        strict=True,
    ):
        u, v = (ideal - np.column_stack([shift, np.zeros(200)])).T.astype(np.float32)
        found = [cv2.remap(values, u[None], v[None], cv2.INTER_LINEAR)[0] for values in (map_x, map_y)]
        visible = (u > 1) & (u < 478) & (v > 1) & (v < 358)
        assert visible.sum() > 100
        np.testing.assert_allclose(np.column_stack(found)[visible], seen[visible], atol=0.1)


def test_a_pair_must_not_be_swapped(adapter: Any) -> None:
    left, right = camera(adapter, LEFT, pose((0, 0, 0), (0.1, 0, 0))), camera(adapter, RIGHT, np.eye(4))
    with pytest.raises(AdapterError, match="right must be to the right"):
        adapter.Rectification(left, right)


def test_depth_that_is_registered_follows_the_colour_without_distortion(adapter: Any) -> None:
    color = camera(adapter, LEFT, np.eye(4))
    undistort = adapter.Undistortion(color, camera(adapter, LEFT, np.eye(4)), 1000.0)
    columns = np.tile(np.arange(480, dtype=np.uint16), (360, 1))
    image, depth = undistort(columns.astype(np.uint8), columns)
    assert not undistort.camera.distortion.any()
    ray = np.array([[0.3, 0.2, 1.0]])
    u, v = np.rint(project(undistort.camera, ray)[0]).astype(int)
    assert abs(depth[v, u] - project(color, ray)[0, 0]) < 1.5
    assert depth.dtype == np.uint16
    assert image.shape == (360, 480)


def test_depth_of_another_camera_is_moved_to_the_colour_s_pixels(adapter: Any) -> None:
    color = camera(adapter, LEFT, np.eye(4))
    depth_camera = camera(adapter, RIGHT, pose((0.01, 0.02, 0.0), (0.05, 0.01, 0.02)))
    undistort = adapter.Undistortion(color, depth_camera, 1000.0)
    # A wall at z = 3 m of the depth camera.
    _, found = undistort(np.zeros((360, 480), np.uint8), np.full((360, 480), 3000, np.uint16))
    point = depth_camera.T_body_camera @ [0.4, -0.2, 3.0, 1.0]
    u, v = np.rint(project(undistort.camera, point[None, :3])[0]).astype(int)
    near = found[v - 1 : v + 2, u - 1 : u + 2]
    assert abs(np.median(near[near > 0]) - 1000 * point[2]) < 10


def test_the_nearer_depth_counts(adapter: Any) -> None:
    plain = {"distortion": "None", "coefficients": []}
    color = camera(adapter, LEFT | plain, np.eye(4))
    K = np.array([[1e6, 0, 0.5], [0, 1e6, 0], [0, 0, 1]])
    small = SimpleNamespace(size=(2, 1), K=K, distortion=np.zeros(5), T_body_camera=np.eye(4))
    found = sys.modules["cameras"].DepthRegistration(small, color)(
        np.array([[2000, 1000]], np.uint16), 1000.0
    )
    assert found[found > 0].tolist() == [1000]


@pytest.mark.parametrize(
    "details",
    [
        LEFT | {"distortion": "Equidistant", "coefficients": [0.1, 0, 0, 0]},
        LEFT | {"model": "Mei"},
        LEFT | {"coefficients": [0.1] * 8},
    ],
)
def test_refuses_cameras_that_it_would_get_wrong(adapter: Any, details: dict[str, Any]) -> None:
    with pytest.raises(AdapterError, match="this adapter takes Pinhole cameras"):
        camera(adapter, details, np.eye(4))


def test_images_of_one_time_are_put_together(adapter: Any) -> None:
    period = 66_666_667
    items = [Item(role, k * period, k) for k in range(6) for role in ("left", "right")]
    kept = [item for item in items if (item.role, item.data) not in {("left", 1), ("right", 3)}]
    kept[-1] = Item("right", 5 * period + period // 10, 5)
    recording = SimpleNamespace(items=lambda: iter(kept))
    pairs = list(adapter.frames(recording, ["left", "right"], 15.0))
    assert [[item.role for item in pair] for pair in pairs] == [["left", "right"]] * 4
    assert [[item.data for item in pair] for pair in pairs] == [[0, 0], [2, 2], [4, 4], [5, 5]]


def test_settings_have_numbers_as_orb_slam_wants_them(adapter: Any, maker: Maker) -> None:
    names = {"nFeatures": 1000, "nLevels": 8, "iniThFAST": 20, "minThFAST": 7}
    sensor = {
        "type": "Camera",
        "topic": "/left",
        "rate": 14.6,
        "camera": LEFT | {"width": 480, "height": 360},
    }
    maker.configure(
        {"camera": sensor}, mode="mono", parameters=names | {"scaleFactor": 2, "loopClosing": False}
    )
    run = Run.from_folder(maker.folder)
    rig = adapter.Rig.of(run, {"camera": camera(adapter, LEFT, np.eye(4))})
    path = maker.folder / "settings.yaml"
    path.write_text(adapter.settings(run, rig))
    settings = cv2.FileStorage(str(path), cv2.FileStorage_READ)
    assert settings.getNode("ORBextractor.scaleFactor").isReal()
    assert settings.getNode("Camera.fps").isInt()
    assert settings.getNode("Camera.fps").real() == 15
    assert settings.getNode("loopClosing").real() == 0
    assert settings.getNode("Camera.type").string() == "PinHole"
    assert settings.getNode("Camera1.k1").real() == pytest.approx(-0.21)
    settings.release()


@pytest.mark.parametrize(
    ("image", "sentence"),
    [
        (np.zeros((2, 4), np.uint8), "left are 4 by 2 pixels; config.yaml says 480 by 360"),
        (np.zeros((360, 480), np.uint16), "left must have 8 bits; these are uint16"),
    ],
)
def test_refuses_images_that_it_would_get_wrong(adapter: Any, image: np.ndarray, sentence: str) -> None:
    with pytest.raises(AdapterError, match=sentence):
        adapter.check_image(Item("left", 0, image), camera(adapter, LEFT, np.eye(4)))
