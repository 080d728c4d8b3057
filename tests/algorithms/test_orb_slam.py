# SPDX-License-Identifier: Apache-2.0
"""Tests of what the adapter of ORB-SLAM3 does around it: rectification, registration, settings, pairs."""

from __future__ import annotations

import faulthandler
import importlib
import os
import signal
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
        patch.setitem(sys.modules, "pyorbslam3", ModuleType("pyorbslam3"))
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


PERIOD = 66_666_667


def recording(items: list[Item]) -> Any:
    return SimpleNamespace(items=lambda: iter(items))


def test_images_of_one_time_are_put_together(adapter: Any) -> None:
    items = [Item(role, k * PERIOD, k) for k in range(6) for role in ("left", "right")]
    kept = [item for item in items if (item.role, item.data) not in {("left", 1), ("right", 3)}]
    kept[-1] = Item("right", 5 * PERIOD + PERIOD // 10, 5)
    pairs = [images for images, _ in adapter.frames(recording(kept), ["left", "right"], 15.0)]
    assert [[item.role for item in pair] for pair in pairs] == [["left", "right"]] * 4
    assert [[item.data for item in pair] for pair in pairs] == [[0, 0], [2, 2], [4, 4], [5, 5]]


@pytest.mark.parametrize("late", [0, 3 * PERIOD], ids=["in order", "late in the recording"])
def test_each_image_comes_with_the_inertial_samples_since_the_one_before(adapter: Any, late: int) -> None:
    images = [(k * PERIOD, Item("camera", k * PERIOD, k)) for k in range(1, 6)]
    samples = [(k * PERIOD // 10 + late, Item("imu", k * PERIOD // 10, k)) for k in range(56)]
    written = [item for _, item in sorted(images + samples, key=lambda pair: pair[0])]
    found = [
        (image.data, [sample.data for sample in taken])
        for (image,), taken in adapter.frames(recording(written), ["camera"], 15.0, inertial=True)
    ]
    assert found == [(k, list(range(10 * k - 9 if k > 1 else 0, 10 * k + 1))) for k in range(1, 6)]


def test_images_whose_inertial_samples_have_ended_do_not_fill_the_memory(adapter: Any) -> None:
    images = [Item("camera", k * PERIOD, k) for k in range(300)]
    written = [Item("imu", 0, None), *images]
    with pytest.raises(AdapterError, match=r"samples of the sensor imu end 0\.1 s before an image"):
        list(adapter.frames(recording(written), ["camera"], 15.0, inertial=True))
    with pytest.raises(AdapterError, match="sensor imu has no samples"):
        list(adapter.frames(recording(images), ["camera"], 15.0, inertial=True))


ORB = {"nFeatures": 1000, "nLevels": 8, "iniThFAST": 20, "minThFAST": 7, "scaleFactor": 2, "thDepth": 40}
MORE = {"loopClosing": False, "virtualBaseline": 0.08}
POSES = {
    "left": pose((0.02, -0.01, 0.03), (0.2, 0.1, 0.1)),
    "right": pose((0.0, 0.02, 0.01), (0.32, 0.105, 0.09)),
    "imu": pose((1.2, 0.3, -0.4), (-0.02, 0.03, 0.01)),
}
ROLES = {"mono": {"camera": "left"}, "stereo": {"left": "left", "right": "right"}}
ROLES["rgbd"] = {"color": "left", "depth": "right"}
NOISE = {
    "accelerometerNoise": 0.01,
    "gyroscopeNoise": 0.001,
    "accelerometerRandomWalk": 2e-4,
    "gyroscopeRandomWalk": 3e-5,
}


def rig_of(adapter: Any, maker: Maker, mode: str, **parameters: Any) -> tuple[Run, Any]:
    """A run in a mode, and its rig."""
    sensors: dict[str, Any] = {}
    for role, name in ROLES[mode.removesuffix("-inertial")].items():
        details = {"left": LEFT, "right": RIGHT}[name] | {"width": 480, "height": 360, "model": "Pinhole"}
        sensors[role] = {"type": "Camera", "topic": f"/{role}", "rate": 14.6}
        sensors[role] |= {"T_body_sensor": POSES[name].tolist()}
        sensors[role]["camera"] = details | {"distortion": "RadialTangential", "depthScale": 5000.0}
    if mode.endswith("-inertial"):
        sensors["imu"] = {"type": "Imu", "topic": "/imu", "rate": 200, "imu": NOISE}
        sensors["imu"] |= {"T_body_sensor": POSES["imu"].tolist()}
    maker.configure(sensors, mode=mode, parameters=ORB | {"nLevels": 3} | MORE | parameters)
    run = Run.from_folder(maker.folder)
    cameras = {role: adapter.Pinhole.of(run.sensor(role)) for role in adapter.cameras_of(run)}
    return run, adapter.Rig.of(run, cameras)


class Settings:
    """A settings file as ORB-SLAM3 reads it: each key with the type that it demands, or it ends."""

    def __init__(self, path: Path) -> None:
        self._file = cv2.FileStorage(str(path), cv2.FileStorage_READ)

    def node(self, key: str) -> Any:
        node = self._file.getNode(key)
        assert not node.empty(), f"{key} required parameter does not exist"
        return node

    def real(self, key: str) -> float:
        assert self.node(key).isReal(), key
        return float(self.node(key).real())

    def integer(self, key: str) -> int:
        assert self.node(key).isInt(), key
        return int(self.node(key).real())

    def matrix(self, key: str) -> np.ndarray:
        """Of single precision: its bytes are read as such."""
        found = self.node(key).mat()
        assert (found.dtype, found.shape) == (np.float32, (4, 4)), key
        return np.asarray(found)


MODES = [kind + ending for kind in ROLES for ending in ("", "-inertial")]


@pytest.mark.parametrize("mode", MODES)
def test_settings_have_all_keys_of_the_mode_and_numbers_as_orb_slam_wants_them(
    adapter: Any, maker: Maker, mode: str
) -> None:
    run, rig = rig_of(adapter, maker, mode)
    path = maker.folder / "settings.yaml"
    path.write_text(adapter.settings(run, rig))
    settings = Settings(path)
    assert settings.node("Camera.type").string() == "PinHole"
    assert (settings.integer("Camera.width"), settings.integer("Camera.height")) == (480, 360)
    assert settings.integer("Camera.fps") == 15
    assert settings.integer("loopClosing") == 0
    assert settings.real("ORBextractor.scaleFactor") == 2.0
    assert settings.integer("ORBextractor.nFeatures") == 1000
    assert settings.real("Viewer.ViewpointF") > 0
    # A single camera's images are handed over as they are, the others' without distortion.
    assert settings.real("Camera1.k1") == pytest.approx(-0.21 if mode.startswith("mono") else 0.0)
    if mode.startswith("stereo"):
        baseline = np.linalg.norm(POSES["left"][:3, 3] - POSES["right"][:3, 3])
        np.testing.assert_allclose(settings.matrix("Stereo.T_c1_c2")[:3, 3], [baseline, 0, 0], rtol=1e-6)
        assert settings.real("Camera2.fx") == settings.real("Camera1.fx")
        assert settings.real("Stereo.ThDepth") == 40.0
    elif mode.startswith("rgbd"):
        assert settings.real("RGBD.DepthMapFactor") == 5000.0
        assert settings.real("Stereo.b") == 0.08
        assert settings.real("Camera1.fx") == pytest.approx(LEFT["fx"])
    if mode.endswith("-inertial"):
        names = ("AccWalk", "GyroWalk", "NoiseAcc", "NoiseGyro", "Frequency")
        assert [settings.real(f"IMU.{name}") for name in names] == [2e-4, 3e-5, 0.01, 0.001, 200.0]
        expected = np.linalg.inv(POSES["imu"]) @ rig.camera.T_body_camera
        np.testing.assert_allclose(settings.matrix("IMU.T_b_c1"), expected, atol=1e-6)


@pytest.mark.parametrize("mode", MODES)
def test_poses_are_given_of_the_declared_frame(adapter: Any, maker: Maker, mode: str) -> None:
    """The IMU with one, else the first camera as it is mounted, whatever was done to its images."""
    _, rig = rig_of(adapter, maker, mode)
    body_in_world = pose((0.3, 0.2, -0.9), (4, 5, 6))
    declared = body_in_world @ POSES["imu" if mode.endswith("-inertial") else "left"]
    tracked = body_in_world @ rig.camera.T_body_camera
    np.testing.assert_allclose(tracked @ rig.T_camera_frame, declared, atol=1e-12)
    saved = declared if mode.endswith("-inertial") else tracked
    np.testing.assert_allclose(saved @ rig.T_saved_frame, declared, atol=1e-12)
    turned = POSES["left"][:3, :3].T @ rig.camera.T_body_camera[:3, :3]
    assert (np.trace(turned) < 3 - 1e-6) == mode.startswith("stereo")


def test_images_must_be_large_enough_for_the_pyramid(adapter: Any, maker: Maker) -> None:
    run, rig = rig_of(adapter, maker, "mono", nLevels=5)
    with pytest.raises(
        AdapterError, match="480 by 360 pixels are too small for nLevels 5 with scaleFactor 2"
    ):
        adapter.settings(run, rig)


def test_frames_are_moved_into_the_world_of_the_keyframes(adapter: Any) -> None:
    """ORB-SLAM3 writes frames as seen from its first keyframe, so that z would not point up."""
    first = pose((0.5, -0.4, 0.1), (1, 2, 3))
    poses = {k: first @ pose((0.1 * k, 0, 0), (k, 0, 0)) for k in range(6)}
    frames, keyframes = adapter.Trajectory(), adapter.Trajectory()
    for k, truth in poses.items():
        frames.add(k, np.linalg.inv(first) @ truth)
        if k in {2, 4}:
            keyframes.add(k, truth)
    moved = adapter.in_world_of(frames, keyframes)
    np.testing.assert_allclose(moved.poses, list(poses.values()), atol=1e-12)
    assert adapter.in_world_of(adapter.Trajectory(), keyframes).stamps == []


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_what_may_kill_the_process_is_done_in_another(adapter: Any, tmp_path: Path) -> None:
    def crash() -> None:
        faulthandler.disable()  # pytest's would print the stack
        os.kill(os.getpid(), signal.SIGSEGV)

    adapter.in_child((tmp_path / "made").touch, 30.0)
    adapter.in_child(crash, 30.0)
    adapter.in_child(signal.pause, 0.0)
    assert (tmp_path / "made").exists()


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


def test_a_grey_image_and_one_in_colour_become_a_pair_of_grey_ones(adapter: Any) -> None:
    left, right = camera(adapter, LEFT, np.eye(4)), camera(adapter, RIGHT, pose((0, 0, 0), (0.1, 0, 0)))
    colour = np.full((360, 480, 3), (200, 100, 50), dtype=np.uint8)
    first, second = adapter.Rectification(left, right)(colour, colour[:, :, 0])
    assert (first.shape, second.shape) == ((360, 480), (360, 480))
    assert abs(int(first[180, 240]) - 124) <= 1, "0.299 R + 0.587 G + 0.114 B (ITU-R BT.601)"
    assert second[180, 240] == 200
