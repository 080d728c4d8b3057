# SPDX-License-Identifier: Apache-2.0
from typing import Any

import cv2
import numpy as np
import pytest

from slamhive.data.synthetic import rig
from slamhive.data.synthetic.camera import CameraModel
from slamhive.data.synthetic.optics import Lens
from slamhive.data.synthetic.trajectory import SyntheticMotion
from slamhive.model.sensors import Sensor
from slamhive.model.synthetic import SyntheticRecording

NOON = 12.0


def lens_of(camera: CameraModel) -> Lens:
    return camera._camera.lens


def project(lens: Any, points: np.ndarray) -> np.ndarray:
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), lens.matrix, lens.coefficients)
    return np.asarray(pixels[:, 0])


@pytest.mark.parametrize("role", ["left", "right", "color"])
def test_lenses_invert_those_of_opencv(studio: Any, role: str) -> None:
    lens = rig.cameras(studio.spec)[role].lens
    points = np.random.default_rng(1).uniform([-2, -1.4, 3], [2, 1.4, 5], (300, 3))
    np.testing.assert_allclose(lens.rays(project(lens, points)), points / points[:, 2:], atol=1e-9)


@pytest.mark.parametrize("scale", [0.5, 0.37, 2.0])
def test_scaling_keeps_what_a_pixel_looks_at(studio: Any, scale: float) -> None:
    full = rig.cameras(studio.spec)["left"]
    camera = studio.spec.camera.model_copy(update={"scale": scale})
    small = rig.cameras(studio.spec.model_copy(update={"camera": camera}))["left"]
    assert (small.lens.width, small.lens.height) == (round(240 * scale), round(180 * scale))
    # The image's corners stay its corners: they are half a pixel outside the centres of the corner pixels.
    corners = np.array([[-0.5, -0.5], [full.lens.width - 0.5, full.lens.height - 0.5]])
    scaled = np.array([[-0.5, -0.5], [small.lens.width - 0.5, small.lens.height - 0.5]])
    np.testing.assert_allclose(small.lens.rays(scaled), full.lens.rays(corners), atol=1e-9)


@pytest.mark.parametrize("role", ["left", "color"])
def test_depth_is_what_rays_measure(studio: Any, role: str) -> None:
    camera = studio.camera(role)
    view = camera._view(NOON)
    pixels = np.random.default_rng(2).integers(0, [240, 180], (500, 2))
    pose = camera.pose(NOON)
    rays = (lens_of(camera).rays(pixels.astype(float)) @ pose[:3, :3].T).T.astype(np.float32)
    depth, face = studio.world.cast(pose[:3, 3:].astype(np.float32), rays)
    same = view.face[pixels[:, 1], pixels[:, 0]] == face
    assert same.mean() > 0.995  # a ray along an outline may go either way
    np.testing.assert_allclose(view.depth[pixels[:, 1], pixels[:, 0]][same], depth[same], rtol=1e-5)


def test_depth_images_are_in_millimetres_up_to_ten_metres(studio: Any) -> None:
    camera = studio.camera("color")
    image, exact = camera.depth(NOON, 0), camera._view(NOON).depth
    near = exact < 9.99
    assert np.abs(image[near] / rig.DEPTH_SCALE - exact[near]).max() < 6e-4
    assert not image[exact > 10.01].any()


@pytest.mark.parametrize("at", [5.0, NOON, 20.0])
def test_corners_of_boxes_are_seen_where_pinhole_and_distortion_say(studio: Any, at: float) -> None:
    camera = studio.camera("left")
    lens, pose, view = lens_of(camera), camera.pose(at), camera._view(at)
    seen = 0
    for box in range(1, len(studio.world.lower)):
        low, high = studio.world.lower[box], studio.world.upper[box]
        corners = np.array([np.where([i & 1, i & 2, i & 4], high, low) for i in range(8)])
        local = (corners - pose[:3, 3]) @ pose[:3, :3]
        local = local[(local[:, 2] > 0.3) & (np.abs(local[:, :2]) < local[:, 2:]).all(axis=1)]
        if len(local) == 0:
            continue
        rvec = np.zeros(3)
        pixels, _ = cv2.projectPoints(local, rvec, rvec, lens.matrix, lens.coefficients)
        for (u, v), point in zip(pixels[:, 0], local, strict=True):
            if not (3 <= u < 237 and 3 <= v < 177):
                continue
            around = np.s_[round(v) - 1 : round(v) + 2, round(u) - 1 : round(u) + 2]
            if view.depth[around].min() < point[2] * 0.98:
                continue  # something stands before it
            hits = view.face[around] // 6 == box
            if hits.any():
                assert np.abs(view.depth[around][hits] - point[2]).min() < 0.04 * point[2]
                wide = np.s_[round(v) - 3 : round(v) + 4, round(u) - 3 : round(u) + 4]
                assert len(np.unique(view.face[wide])) > 1
                seen += 1
    assert seen >= 5


def test_the_right_image_shows_the_points_of_the_left(studio: Any) -> None:
    left, right = studio.camera("left"), studio.camera("right")
    images = left.image(NOON, 0), right.image(NOON, 0)
    rows, columns = np.mgrid[20:160:3, 40:200:3].reshape(2, -1)
    depth = left._view(NOON).depth[rows, columns]
    rays = lens_of(left).rays(np.stack([columns, rows], axis=1).astype(float))
    to_right = np.linalg.inv(right.pose(NOON)) @ left.pose(NOON)
    points = (rays * depth[:, None]) @ to_right[:3, :3].T + to_right[:3, 3]
    pixels = project(lens_of(right), points).astype(np.float32)
    found = cv2.remap(images[1], pixels[None, :, 0], pixels[None, :, 1], cv2.INTER_LINEAR)[0]
    # Away from what only one eye sees, the depths agree too.
    behind = cv2.remap(right._view(NOON).depth, pixels[None, :, 0], pixels[None, :, 1], cv2.INTER_NEAREST)[0]
    both = np.abs(behind - points[:, 2]) < 0.01 * points[:, 2]
    assert both.mean() > 0.9
    difference = found[both].astype(float) - images[0][rows, columns][both]
    moved = images[1][rows, columns][both].astype(float) - images[0][rows, columns][both]
    assert np.abs(difference).mean() < 0.35 * np.abs(moved).mean()


def test_rectification_puts_a_point_on_one_row_and_gives_its_disparity(studio: Any) -> None:
    left, right = (rig.cameras(studio.spec)[role] for role in ("left", "right"))
    points = np.random.default_rng(3).uniform([-1.5, -1, 2], [1.5, 1, 6], (100, 3))
    across = np.linalg.inv(right.pose) @ left.pose
    moved = points @ across[:3, :3].T + across[:3, 3]
    rows = []
    for camera, local in ((left, points), (right, moved)):
        turned = local @ camera.rectification.T @ camera.projection[:, :3].T
        rows.append(turned[:, :2] / turned[:, 2:])
    z = (points @ left.rectification.T)[:, 2]
    np.testing.assert_allclose(rows[0][:, 1], rows[1][:, 1], atol=1e-6)
    np.testing.assert_allclose(rows[0][:, 0] - rows[1][:, 0], -right.projection[0, 3] / z, atol=1e-6)
    assert np.linalg.norm(across[:3, 3]) == pytest.approx(0.12, abs=1e-3)


@pytest.mark.parametrize("role", ["left", "color"])
def test_rendering_small_is_like_rendering_large_and_averaging(studio: Any, role: str) -> None:
    large = studio.camera(role).image(NOON, 0)
    small = studio.camera(role, scale=0.5).image(NOON, 0)
    averaged = cv2.resize(large, (120, 90), interpolation=cv2.INTER_AREA)
    shifted = np.roll(averaged, 1, axis=1)
    error = np.abs(small.astype(float) - averaged).mean()
    assert error < 7.0
    assert error < 0.4 * np.abs(small.astype(float) - shifted).mean()


def test_images_are_rich_in_corners(studio: Any) -> None:
    image = studio.camera("left", width=480, height=360).image(NOON, 0)
    points = cv2.goodFeaturesToTrack(image, 2000, 0.02, 5)
    cells = {(int(x // 60), int(y // 60)) for x, y in points.reshape(-1, 2)}
    assert len(points) > 800
    assert len(cells) == 8 * 6


@pytest.mark.slow
def test_an_open_shutter_blurs_motion_and_only_motion(studio: Any) -> None:
    sharp, blurred = (
        studio.camera("left", width=480, height=360),
        studio.camera("left", width=480, height=360, exposure_seconds=0.05),
    )
    np.testing.assert_array_equal(sharp.image(1.0, 0), blurred.image(1.0, 0))
    before, after = (cv2.Laplacian(camera.image(NOON, 0), cv2.CV_64F).var() for camera in (sharp, blurred))
    assert after < 0.7 * before


@pytest.mark.parametrize(("noise", "light"), [(1.0, 1.0), (4.0, 1.0), (1.0, 0.25)])
def test_noise_stays_when_the_light_goes(studio: Any, noise: float, light: float) -> None:
    def shoot(noise: float) -> np.ndarray:
        spec = studio.spec.model_copy(update={"noise": noise, "light": light})
        lens = rig.cameras(spec)["left"]
        camera = CameraModel(spec, lens, studio.world, studio.atlas.grey(), studio.trajectory)
        return camera.image(NOON, 0).astype(float)

    clean = shoot(0.0)
    assert clean.mean() == pytest.approx(studio.camera("left").image(NOON, 0).mean() * light, rel=0.03)
    expected = noise * np.sqrt(1.2**2 + 0.012 * clean.mean())
    assert (shoot(noise) - clean).std() == pytest.approx(expected, rel=0.12)


@pytest.mark.parametrize("mounted", ["Askew", "Euroc", "Mav"])
@pytest.mark.parametrize("sensor", ["Lidar", "Imu", "Stereo", "Rgbd"])
def test_calibration_is_valid_and_has_no_right_angles(sensor: str, mounted: str) -> None:
    spec = SyntheticRecording.model_validate({"sensors": [sensor], "rig": mounted})
    for role, entry in rig.sensors(spec).items():
        stated = {key: value for key, value in entry.items() if key != "name"}
        Sensor.model_validate(stated)
        assert entry["name"] == role
        T = np.array(entry["T_body_sensor"])
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.norm(T[:3, 3]) > 0.05
        assert (np.abs(T[:3, :3]) > 1e-3).all()


@pytest.mark.parametrize(
    ("mounted", "angles"),
    [
        (None, {"left": 109.2, "right": 108.3, "color": 111.4}),
        ("Askew", {"left": 109.2, "right": 108.3, "color": 111.4}),
        ("Euroc", {"left": 89.1, "right": 88.6, "color": 85.2}),
        ("Mav", {"left": 89.2, "right": 89.3}),
    ],
)
def test_the_rig_decides_how_imu_and_cameras_are_turned_against_each_other(
    mounted: str | None, angles: dict[str, float]
) -> None:
    spec = SyntheticRecording.model_validate({"sensors": ["Stereo", "Rgbd", "Imu"], "rig": mounted})
    poses = {role: np.array(entry["T_body_sensor"]) for role, entry in rig.sensors(spec).items()}
    for role, angle in angles.items():
        turned = poses["imu"][:3, :3].T @ poses[role][:3, :3]
        assert np.degrees(np.arccos((np.trace(turned) - 1.0) / 2.0)) == pytest.approx(angle, abs=0.1)
    assert np.linalg.norm((np.linalg.inv(poses["imu"]) @ poses["left"])[:3, 3]) < 0.5


def test_the_rig_of_a_vehicle_has_its_published_calibration() -> None:
    spec = SyntheticRecording.model_validate({"sensors": ["Stereo", "Imu"], "rig": "Mav"})
    poses = {role: np.array(entry["T_body_sensor"]) for role, entry in rig.sensors(spec).items()}
    left, right = (np.linalg.inv(poses["imu"]) @ poses[role] for role in ("left", "right"))
    # sensor.yaml of cam0 and cam1, to what their digits give of a rotation.
    published = [-0.0216401454975, -0.064676986768, 0.00981073058949]
    assert left[:3, 3] == pytest.approx(published, abs=1e-12)
    assert left[0, :3] == pytest.approx([0.0148655429818, -0.999880929698, 0.00414029679422], abs=1e-9)
    assert right[2, :3] == pytest.approx([-0.0253898008918, 0.0179005838253, 0.999517347078], abs=1e-9)
    assert np.linalg.norm((np.linalg.inv(left) @ right)[:3, 3]) == pytest.approx(0.11, abs=1e-3)


@pytest.mark.parametrize(("mounted", "nearest"), [("Askew", 83.0), ("Mav", 15.3), ("Euroc", 1.1)])
def test_the_imu_of_a_vehicle_is_off_the_vertical(mounted: str, nearest: float) -> None:
    """Yaw, pitch and roll of an estimator, VINS', have no yaw where its x axis is upright."""
    spec = SyntheticRecording.model_validate({"sensors": ["Imu"], "rig": mounted, "durationSeconds": 30})
    turned = SyntheticMotion(spec).at(np.arange(0.0, 30.0, 0.01)).rotation @ rig.imu_pose(spec)[:3, :3]
    angle = np.degrees(np.arccos(np.abs(turned[:, 2, 0])))
    assert angle.min() == pytest.approx(nearest, abs=0.2)
