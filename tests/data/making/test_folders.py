# SPDX-License-Identifier: Apache-2.0
"""Folders in the forms of EuRoC, TUM and KITTI, read as their own programs read them."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import yaml

from slamhive.contract.posefiles import FRAMES
from slamhive.data.importers import import_recording
from slamhive.data.making.preparation import evict_variants, prepare
from slamhive.data.recordings.clouds import cloud_points
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.kinds import COMPRESSED_IMAGE
from slamhive.data.recordings.repairing import open_recording
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.jobs.prepare import _describe
from slamhive.model.algorithm import Algorithm, DataFormat
from slamhive.model.configuration import PreparedRecording
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError, InputError
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Camera, Role
from slamhive.plan.configuration import recording_place

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from slamhive.data.making.preparation import Variant

BAG, EUROC, TUM, KITTI = DataFormat.ROSBAG1, DataFormat.EUROC, DataFormat.TUM, DataFormat.KITTI
STEREO, RGBD = (Role.LEFT, Role.RIGHT), (Role.COLOR, Role.DEPTH)
START = 1_600_000_000 * 10**9
KEYS = {"Rosbag1": "bfbb626f4800b328", "Rosbag2": "0d0ab1a13f193d77", "Mcap": "33cb0a5fa039315c"}
"""Beginnings of the keys of bags before there were folders."""
LENS = {"width": 16, "height": 12, "fx": 20.0, "fy": 21.0, "cx": 7.4, "cy": 5.9}


POSE = [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


def make(
    entry: DatasetEntry, roles: Sequence[Role], cache: Path, form: DataFormat, **options: Any
) -> Variant:
    return prepare(entry, roles, InputOptions.model_validate(options), [form], cache)


def image(path: Path) -> Any:
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert pixels is not None, path
    return pixels


def asl_images(folder: Path) -> dict[int, Path]:
    """Read a camera's data.csv: its images by their stamps."""
    rows = [line.split(",") for line in (folder / "data.csv").read_text().splitlines()[1:]]
    return {int(stamp): folder / "data" / name for stamp, name in rows}


def tum_list(path: Path) -> list[tuple[float, Path]]:
    """Read a list as mono_tum does: three lines are skipped."""
    rows = [line.split() for line in path.read_text().splitlines()[3:]]
    return [(float(stamp), path.parent / name) for stamp, name in rows]


def tum_pairs(path: Path) -> list[tuple[float, Path, float, Path]]:
    """Read associations as rgbd_tum does: no line is skipped."""
    rows = [line.split() for line in path.read_text().splitlines()]
    return [(float(a), path.parent / b, float(c), path.parent / d) for a, b, c, d in rows]


def calibration(folder: Path) -> dict[str, Any]:
    lines = [line.split(":") for line in (folder / "calib.txt").read_text().splitlines()]
    return {name: np.array(text.split(), dtype=np.float64).reshape(3, 4) for name, text in lines}


def frames(variant: Variant) -> list[int]:
    return [int(line) for line in (variant.folder / FRAMES).read_text().split()]


def first_images(variant: Variant) -> list[Path]:
    """Return the images of the first camera, in the order of frames."""
    match variant.format:
        case DataFormat.EUROC:
            return list(asl_images(variant.path / "mav0/cam0").values())
        case DataFormat.TUM:
            return [path for _, path in tum_list(variant.path / "rgb.txt")]
        case _:
            folder = next(path for path in variant.path.iterdir() if path.name in {"image_0", "image_2"})
            return sorted(folder.iterdir())


def cameras(
    path: Path,
    streams: dict[str, Sequence[int]],
    pixels: Callable[[str, int], Any],
    encodings: dict[str, str],
) -> Path:
    """Write a bag of images without camera_info."""
    events = [(int(at), topic, k) for topic, stamps in streams.items() for k, at in enumerate(stamps)]
    with BagWriter(path) as bag:
        for at, topic, k in sorted(events):
            bag.image(topic, at, "cam", encodings.get(topic, "mono8"), pixels(topic, k))
    return path


def described(path: Path, sensors: dict[str, Any]) -> DatasetEntry:
    spec = {"recording": {"files": [{"path": path.name}]}, "sensors": sensors}
    return DatasetEntry(Dataset.model_validate({"metadata": {"name": path.stem}, "spec": spec}), path.parent)


def camera_sensor(topic: str, *, at: float = 0.0, kind: str = "Camera", **more: Any) -> dict[str, Any]:
    lens = LENS | more.pop("camera", {})
    pose = [[1, 0, 0, at], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    return {"type": kind, "topic": topic, "T_body_sensor": pose, "camera": lens} | more


def ns(*milliseconds: float) -> list[int]:
    return [START + round(at * 1e6) for at in milliseconds]


@pytest.mark.parametrize(("form", "roles"), [(EUROC, STEREO), (TUM, RGBD), (KITTI, STEREO)])
def test_a_folder_at_half_size_is_what_is_rendered_at_half_size(
    camera_entries: Any, tmp_path: Path, form: DataFormat, roles: Any
) -> None:
    mine = make(camera_entries[1.0], roles, tmp_path, form, resolution=0.5)
    direct = make(camera_entries[0.5], roles, tmp_path, form)
    assert frames(mine) == frames(direct)
    pairs = list(zip(first_images(mine), first_images(direct), strict=True))
    assert len(pairs) == mine.frames > 10
    for one, other in pairs[::4]:
        assert one.name == other.name
        a, b = image(one).astype(np.float64), image(other).astype(np.float64)
        assert a.shape[:2] == b.shape[:2] == (60, 80)
        inner = (slice(3, -3), slice(3, -3))
        error = np.abs(a - b)[inner].mean()
        assert error < 6.0
        for shift in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            moved = 0.5 * (b + np.roll(b, shift, axis=(0, 1)))
            assert error < 0.8 * np.abs(a - moved)[inner].mean()
    for role in roles:
        a, b = mine.sensors[role], direct.sensors[role]
        assert np.allclose(a.T_body_sensor, b.T_body_sensor, atol=1e-9)
        for name in ("width", "height", "fx", "fy", "cx", "cy", "coefficients"):
            assert getattr(a.camera, name) == pytest.approx(getattr(b.camera, name), rel=1e-6)


def test_depth_at_half_size_is_rendered_depth(camera_entries: Any, tmp_path: Path) -> None:
    mine = make(camera_entries[1.0], RGBD, tmp_path, TUM, resolution=0.5)
    direct = make(camera_entries[0.5], RGBD, tmp_path, TUM)
    both = [tum_pairs(variant.path / "associations.txt") for variant in (mine, direct)]
    for (*_, one), (*_, other) in zip(*both, strict=True):
        a, b = image(one).astype(np.float64), image(other).astype(np.float64)
        assert image(one).dtype == np.uint16
        assert np.median(np.abs(a - b) / np.maximum(b, 1)) < 0.01


@pytest.mark.slow
def test_what_is_written_for_euroc_is_imported_as_it_was(tmp_path: Path, shared: Path) -> None:
    source = shared / "euroc_v1_01_start"
    dataset, _ = import_recording(source, tmp_path / "first", "v101", "Euroc")
    entry = DatasetEntry(dataset, tmp_path / "first")
    variant = make(entry, (Role.CAMERA, Role.IMU), tmp_path / "cache", EUROC)
    base = next(path.parent for path in source.rglob("cam0"))
    there, here = (asl_images(folder) for folder in (base / "cam0", variant.path / "mav0/cam0"))
    assert list(there) == list(here) == frames(variant)
    assert [path.name for path in here.values()] == [f"{stamp}.png" for stamp in here]
    assert (variant.path / "times.txt").read_text().split() == [str(stamp) for stamp in here]
    assert all((image(there[stamp]) == image(here[stamp])).all() for stamp in here)
    again, _ = import_recording(variant.path, tmp_path / "second", "v101", "Euroc")
    topics = {"/cam0/image_raw", "/cam0/camera_info", "/imu0"}
    with (
        open_recording(dataset, tmp_path / "first") as one,
        open_recording(again, tmp_path / "second") as other,
    ):
        pairs = list(zip(one.messages(topics), other.messages(topics), strict=True))
    assert len(pairs) == 2 * 95 + 29_120
    for (connection, stamp, raw), (twin, at, bytes_) in pairs:
        assert (connection.topic, stamp, raw) == (twin.topic, at, bytes_)
    assert set(dataset.spec.sensors) == set(again.spec.sensors)
    for name, sensor in dataset.spec.sensors.items():
        back = again.spec.sensors[name]
        assert back.replace(rate=None) == sensor.replace(rate=None)
        assert back.rate == pytest.approx(sensor.rate, rel=0.01)


@pytest.mark.parametrize(
    ("distortion", "coefficients"),
    [
        ("None", []),
        ("RadialTangential", [0.1, -0.2, 0.001, 0.002, 0.0]),
        ("RadialTangential", [0.1, -0.2, 0.001, 0.002, 0.03]),
        ("RadialTangential", [0.1, -0.2, 0.001, 0.002, 0.03, 1e-05, 0.2, 0.3]),
        ("Equidistant", [0.01, -0.02, 0.003, 1e-05]),
    ],
)
def test_lenses_come_back_from_euroc(tmp_path: Path, distortion: str, coefficients: Any) -> None:
    path = cameras(tmp_path / "rig.bag", {"/cam": ns(0, 50)}, lambda *_: np.ones((12, 16), np.uint8), {})
    lens = {"distortion": distortion, "coefficients": coefficients}
    entry = described(path, {"camera": camera_sensor("/cam", at=0.1, camera=lens)})
    variant = make(entry, (Role.CAMERA,), tmp_path / "cache", EUROC)
    again, _ = import_recording(variant.path, tmp_path / "back", "rig", "Euroc")
    assert again.spec.sensors["camera"].camera == entry.dataset.spec.sensors["camera"].camera
    assert again.spec.sensors["camera"].T_body_sensor[0][3] == 0.1


@pytest.mark.parametrize(
    ("given", "written"),
    [
        (("mono8", np.uint8, 1), "mono8"),
        (("mono16", np.uint16, 1), "mono16"),
        (("rgb8", np.uint8, 3), "bgr8"),
        (("bgr8", np.uint8, 3), "bgr8"),
        (("bgra8", np.uint8, 4), "bgr8"),
        (("rgba8", np.uint8, 4), "bgr8"),
        (("rgb16", np.uint16, 3), "bgr16"),
    ],
)
@pytest.mark.parametrize("form", [EUROC, TUM, KITTI])
def test_pixels_stay_what_they_are(tmp_path: Path, form: DataFormat, given: Any, written: str) -> None:
    encoding, dtype, channels = given
    shape = (12, 16) if channels == 1 else (12, 16, channels)
    pixels = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (3, *shape)).astype(dtype)
    path = cameras(tmp_path / "c.bag", {"/cam": ns(0, 50, 100)}, lambda _, k: pixels[k], {"/cam": encoding})
    variant = make(described(path, {"camera": camera_sensor("/cam")}), (Role.CAMERA,), tmp_path / "v", form)
    for k, file in enumerate(first_images(variant)):
        expected = pixels[k]
        if channels > 1:
            expected = expected[..., :3] if encoding.startswith("bgr") else expected[..., 2::-1]
        assert image(file).dtype == dtype
        assert (image(file) == expected).all()
    camera = variant.sensors[Role.CAMERA].camera
    assert camera is not None
    assert camera.encoding == written
    if form is KITTI:
        assert file.parent.name == ("image_0" if channels == 1 else "image_2")


def depth_rig(tmp_path: Path, depth: Any, encoding: str, scale: float | None) -> DatasetEntry:
    grey = np.full((12, 16), 7, np.uint8)
    path = cameras(
        tmp_path / "d.bag",
        {"/color": ns(0, 50), "/depth": ns(4, 54)},
        lambda topic, _: depth if topic == "/depth" else grey,
        {"/depth": encoding},
    )
    lens = {"encoding": encoding} | ({"depthScale": scale} if scale else {})
    return described(
        path,
        {"color": camera_sensor("/color"), "depth": camera_sensor("/depth", kind="DepthCamera", camera=lens)},
    )


def test_depth_keeps_its_units(tmp_path: Path) -> None:
    depth = np.arange(12 * 16, dtype=np.uint16).reshape(12, 16) * 300
    variant = make(depth_rig(tmp_path, depth, "16UC1", 1000), RGBD, tmp_path / "v", TUM)
    ((_, _, at, path), _) = tum_pairs(variant.path / "associations.txt")
    assert at == pytest.approx(1_600_000_000.004, abs=1e-6)
    assert (image(path) == depth).all()
    camera = variant.sensors[Role.DEPTH].camera
    assert camera is not None
    assert camera.depth_scale == 1000
    assert "1000.0 per metre" in (variant.path / "depth.txt").read_text().splitlines()[1]


def test_depth_in_metres_becomes_units_of_the_usual_factor(tmp_path: Path) -> None:
    depth = np.full((12, 16), 2.0, np.float32)
    depth[0, :5] = np.nan, np.inf, -1.0, 13.2, 13.1
    variant = make(depth_rig(tmp_path, depth, "32FC1", 1), RGBD, tmp_path / "v", TUM)
    (*_, path) = tum_pairs(variant.path / "associations.txt")[0]
    written = image(path)
    assert written.dtype == np.uint16
    assert written[0, :5].tolist() == [0, 0, 0, 0, 65500]
    assert (written[1:] == 10_000).all()
    camera = variant.sensors[Role.DEPTH].camera
    assert camera is not None
    assert (camera.depth_scale, camera.encoding) == (5000, "16UC1")


def test_rectified_images_are_those_of_the_cameras_that_are_told(camera_entries: Any, tmp_path: Path) -> None:
    entry = camera_entries[1.0]
    plain = make(entry, STEREO, tmp_path, EUROC)
    variant = make(entry, STEREO, tmp_path, KITTI)
    left, right = (np.array(variant.sensors[role].T_body_sensor) for role in STEREO)
    apart = np.linalg.inv(left) @ right
    assert np.allclose(apart[:3, :3], np.eye(3), atol=1e-9)
    assert np.allclose(apart[1:3, 3], 0, atol=1e-9)
    assert apart[0, 3] == pytest.approx(0.12, rel=0.01)
    matrices = calibration(variant.path)
    camera = variant.sensors[Role.LEFT].camera
    assert camera is not None
    assert (camera.distortion, camera.coefficients) == ("None", [])
    assert matrices["P0"].tolist() == [
        [camera.fx, 0, camera.cx, 0],
        [0, camera.fy, camera.cy, 0],
        [0, 0, 1, 0],
    ]
    assert -matrices["P1"][0, 3] / matrices["P1"][0, 0] == pytest.approx(apart[0, 3], rel=1e-9)
    index = 5
    for role, folder, number in ((Role.LEFT, "image_0", 0), (Role.RIGHT, "image_1", 1)):
        rectified = image(variant.path / folder / f"{index:06}.png").astype(np.float64)
        original = image(list(asl_images(plain.path / f"mav0/cam{number}").values())[index])
        then, now = plain.sensors[role], variant.sensors[role]
        assert then.camera is not None
        assert now.camera is not None
        rows, columns = np.mgrid[2:118:3, 2:158:3]
        rays = np.stack(
            [
                (columns - now.camera.cx) / now.camera.fx,
                (rows - now.camera.cy) / now.camera.fy,
                np.ones(rows.shape),
            ]
        ).reshape(3, -1)
        turned = np.array(then.T_body_sensor)[:3, :3].T @ np.array(now.T_body_sensor)[:3, :3] @ rays
        matrix = np.array(
            [[then.camera.fx, 0, then.camera.cx], [0, then.camera.fy, then.camera.cy], [0, 0, 1]]
        )
        places, _ = cv2.projectPoints(
            turned.T, np.zeros(3), np.zeros(3), matrix, np.array(then.camera.coefficients)
        )
        x, y = np.moveaxis(places.astype(np.float32), -1, 0)
        expected = cv2.remap(original.astype(np.float32), x, y, cv2.INTER_LINEAR).reshape(rows.shape)
        assert np.abs(rectified[rows, columns] - expected).mean() < 1.0
        assert np.abs(np.roll(rectified, 1, axis=1)[rows, columns] - expected).mean() > 3.0


def test_poses_are_measured_as_those_of_the_rectified_camera(camera_entries: Any, tmp_path: Path) -> None:
    entry = camera_entries[1.0]
    variant = make(entry, STEREO, tmp_path, KITTI)
    told = _describe(entry, variant, None, tmp_path / ".hashes")
    left = variant.sensors[Role.LEFT].T_body_sensor
    assert left != entry.dataset.spec.sensors["left"].T_body_sensor
    # An Algorithm may call the left camera `camera`: it is then found by its name in the dataset.
    assert told.extrinsics["left"] == told.sensors[Role.LEFT].T_body_sensor == left
    assert told.extrinsics["color"] == entry.dataset.spec.sensors["color"].T_body_sensor


def test_a_rectified_pair_stays_as_it_is(tmp_path: Path) -> None:
    pixels = np.random.default_rng(3).integers(0, 255, (12, 16), dtype=np.uint8)
    path = cameras(tmp_path / "r.bag", {"/l": ns(0, 50), "/r": ns(0, 50)}, lambda *_: pixels, {})
    sensors = {"left": camera_sensor("/l", at=1.0), "right": camera_sensor("/r", at=1.54)}
    variant = make(described(path, sensors), STEREO, tmp_path / "v", KITTI)
    assert (image(variant.path / "image_1/000001.png") == pixels).all()
    assert calibration(variant.path)["P1"][0, 3] == pytest.approx(-20.0 * 0.54)
    camera = variant.sensors[Role.LEFT].camera
    assert camera is not None
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (20.0, 21.0, 7.4, 5.9)


def test_fisheye_images_are_rectified(tmp_path: Path) -> None:
    pixels = np.full((12, 16), 9, np.uint8)
    path = cameras(tmp_path / "f.bag", {"/l": ns(0, 50), "/r": ns(0, 50)}, lambda *_: pixels, {})
    lens = {"distortion": "Equidistant", "coefficients": [0.01, -0.02, 0.003, 0.0]}
    sensors = {"left": camera_sensor("/l", camera=lens), "right": camera_sensor("/r", at=0.1, camera=lens)}
    for roles in (STEREO, (Role.CAMERA,)):
        variant = make(described(path, sensors), roles, tmp_path / "v", KITTI)
        camera = variant.sensors[roles[0]].camera
        assert camera is not None
        assert camera.distortion == "None"
        assert image(variant.path / "image_0/000000.png")[6, 8] == 9


def test_scans_of_kitti(lidar_entry: Any, tmp_path: Path) -> None:
    variant = make(lidar_entry, (Role.LIDAR,), tmp_path, KITTI, lidar={"maxRange": 5}, duration="2s")
    bag = make(lidar_entry, (Role.LIDAR,), tmp_path, BAG, lidar={"maxRange": 5}, duration="2s")
    files = sorted((variant.path / "velodyne").iterdir())
    assert [path.name for path in files[:2]] == ["000000.bin", "000001.bin"]
    view = variant.sensors[Role.LIDAR]
    assert view.lidar is not None
    assert (view.lidar.max_range, view.lidar.time_field, view.lidar.ring_field) == (5, None, None)
    dataset = lidar_entry.dataset.replace(spec=lidar_entry.dataset.spec.replace(ground_truth=None))
    entry = DatasetEntry(dataset, bag.folder)
    with open_recording(entry.dataset, entry.root) as recording:
        for (connection, _, raw), path in zip(recording.messages({"/points"}), files, strict=True):
            points = cloud_points(recording.decode(raw, connection.msgtype), "/points")
            found = np.fromfile(path, dtype="<f4").reshape(-1, 4)
            assert len(found) > 100
            for column, name in enumerate(("x", "y", "z", "intensity")):
                assert (found[:, column] == points[name]).all()
    times = [float(line) for line in (variant.path / "times.txt").read_text().split()]
    assert times == pytest.approx([0.1 * k for k in range(20)])
    assert frames(variant) == [START + k * 10**8 for k in range(20)]
    assert np.array_equal(calibration(variant.path)["Tr"], np.eye(3, 4))


def test_scans_and_images_of_kitti_are_numbered_together(tmp_path: Path) -> None:
    path = tmp_path / "car.bag"
    with BagWriter(path) as bag:
        events = [(at, "scan", k) for k, at in enumerate(ns(0, 100, 200, 300))]
        events += [(at, "image", k) for k, at in enumerate(ns(110, 190, 250, 310, 400))]
        for at, kind, k in sorted(events):
            if kind == "image":
                bag.image("/cam", at, "cam", "mono8", np.full((12, 16), k, np.uint8))
            else:
                points = np.array([(k, 2, np.nan), (k, 1, 1)], dtype=[(axis, "<f4") for axis in "xyz"])
                bag.points("/points", at, "lidar", points)
    lidar = {
        "type": "Lidar",
        "topic": "/points",
        "T_body_sensor": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]],
    }
    entry = described(path, {"camera": camera_sensor("/cam", at=0.5), "lidar": lidar})
    variant = make(entry, (Role.CAMERA, Role.LIDAR), tmp_path / "v", KITTI)
    images = sorted((variant.path / "image_0").iterdir())
    scans = sorted((variant.path / "velodyne").iterdir())
    assert [int(image(file)[0, 0]) for file in images] == [0, 1, 3]
    assert [np.fromfile(file, "<f4").tolist() for file in scans] == [[1, 1, 1, 0], [2, 1, 1, 0], [3, 1, 1, 0]]
    assert frames(variant) == ns(110, 190, 310)
    assert (variant.path / "times.txt").read_text().split() == ["0.000000000", "0.080000000", "0.200000000"]
    point = calibration(variant.path)["Tr"] @ [0, 0, 0, 1]
    assert point.tolist() == [-0.5, 0, 2]


def pair_with_gaps(tmp_path: Path) -> DatasetEntry:
    """A pair whose cameras each lack a frame, the right one 1 ms late, one frame twice."""
    streams = {"/l": ns(0, 50, 50, 100, 200), "/r": ns(1, 51, 151, 201)}
    path = cameras(tmp_path / "g.bag", streams, lambda _, k: np.full((12, 16), k + 10, np.uint8), {})
    offset = {"timeOffset": -0.25}
    sensors = {
        "left": camera_sensor("/l") | offset,
        "right": camera_sensor("/r", at=0.1) | offset,
        "color": camera_sensor("/l") | offset,
        "depth": camera_sensor("/r", kind="DepthCamera", camera={"depthScale": 1000}) | offset,
    }
    return described(path, sensors)


@pytest.mark.parametrize(("form", "roles"), [(EUROC, STEREO), (TUM, RGBD), (KITTI, STEREO)])
def test_frames_are_paired_by_their_stamps_and_complete(tmp_path: Path, form: DataFormat, roles: Any) -> None:
    variant = make(pair_with_gaps(tmp_path), roles, tmp_path / "v", form)
    left, right = ns(-250, -200, -50), ns(-249, -199, -49)
    assert frames(variant) == left
    assert variant.frames == 3
    assert (variant.start_time, variant.duration_seconds) == (1_599_999_999.75, 0.2)
    assert {view.time_offset for view in variant.sensors.values()} == {0.0}
    path = variant.path
    if form is EUROC:
        ones, others = (asl_images(path / f"mav0/cam{k}") for k in (0, 1))
        assert (list(ones), list(others)) == (left, right)
        # Programs look for the right image by the left one's name.
        assert [file.name for file in others.values()] == [file.name for file in ones.values()]
        pairs = zip(ones.values(), others.values(), strict=True)
        assert (path / "times.txt").read_text().split() == [str(stamp) for stamp in left]
    elif form is TUM:
        rows = tum_pairs(path / "associations.txt")
        assert [round(row[2] - row[0], 6) for row in rows] == [0.001] * 3
        assert [path for _, path in tum_list(path / "rgb.txt")] == [row[1] for row in rows]
        assert [path for _, path in tum_list(path / "depth.txt")] == [row[3] for row in rows]
        pairs = ((row[1], row[3]) for row in rows)
    else:
        pairs = zip(*(sorted((path / f"image_{k}").iterdir()) for k in (0, 1)), strict=True)
    assert [(image(a)[0, 0], image(b)[0, 0]) for a, b in pairs] == [(10, 10), (11, 11), (14, 13)]


@pytest.mark.parametrize(("form", "roles"), [(EUROC, STEREO), (TUM, RGBD), (KITTI, STEREO)])
def test_rate_and_cut_of_folders(camera_entries: Any, tmp_path: Path, form: DataFormat, roles: Any) -> None:
    variant = make(camera_entries[1.0], roles, tmp_path, form, frameRate=1, start="1s", duration="4s")
    assert frames(variant) == [START + k * 10**9 for k in range(1, 5)]
    assert len(first_images(variant)) == variant.frames == 4
    assert variant.frame_rate == 1.0
    bag = make(camera_entries[1.0], roles, tmp_path, BAG, frameRate=1, start="1s", duration="4s")
    assert frames(bag) == frames(variant)


def test_samples_of_an_imu(tmp_path: Path) -> None:
    path = tmp_path / "i.bag"
    with BagWriter(path) as bag:
        for k, at in enumerate(ns(*range(0, 1000, 5))):
            bag.imu("/imu", at, "imu", np.array([1e-05, 0.2, k]), np.array([0.1, -9.81, 1 / 3]))
            if k % 20 == 0:
                bag.image("/cam", at, "cam", "mono8", np.zeros((12, 16), np.uint8))
    imu = {"type": "Imu", "topic": "/imu", "timeOffset": 0.001, "imu": {"gyroscopeNoise": 1e-05}}
    entry = described(path, {"camera": camera_sensor("/cam"), "imu": imu})
    cut = {"start": "300ms", "duration": "200ms"}
    roles = (Role.CAMERA, Role.IMU)
    euroc = make(entry, roles, tmp_path / "v", EUROC, **cut).path / "mav0/imu0"
    rows = [line.split(",") for line in (euroc / "data.csv").read_text().splitlines()[1:]]
    # A quarter of a second more at either side.
    assert (int(rows[0][0]), int(rows[-1][0])) == (START + 51 * 10**6, START + 746 * 10**6)
    assert [float(text) for text in rows[0][1:]] == [1e-05, 0.2, 10, 0.1, -9.81, 1 / 3]
    known = yaml.safe_load((euroc / "sensor.yaml").read_text())
    assert known["gyroscope_noise_density"] == 1e-05
    assert known["rate_hz"] == 200
    tum = make(entry, roles, tmp_path / "v", TUM, **cut).path
    force, rate = (np.loadtxt(tum / f"{name}.txt", comments="#") for name in ("accelerometer", "gyroscope"))
    assert len(force) == len(rate) == len(rows)
    assert force[0].tolist() == pytest.approx([1_600_000_000.051, 0.1, -9.81, 1 / 3])
    assert rate[-1].tolist() == pytest.approx([1_600_000_000.746, 1e-05, 0.2, 149])


def test_a_folder_holds_what_was_asked_for_and_nothing_else(camera_entries: Any, tmp_path: Path) -> None:
    def names(form: DataFormat, roles: Any) -> set[str]:
        path = make(camera_entries[1.0], roles, tmp_path, form).path
        found = {str(file.relative_to(path)) for file in path.rglob("*") if file.is_file()}
        return {name for name in found if not name.endswith(".png")}

    assert names(EUROC, (Role.CAMERA,)) == {"times.txt", "mav0/cam0/data.csv", "mav0/cam0/sensor.yaml"}
    assert names(TUM, RGBD) == {"rgb.txt", "depth.txt", "associations.txt"}
    assert names(KITTI, STEREO) == {"times.txt", "calib.txt"}


def test_folders_are_made_once_and_again_when_changed(camera_entries: Any, tmp_path: Path) -> None:
    variant = make(camera_entries[1.0], RGBD, tmp_path, TUM)
    first = first_images(variant)[0]
    made = first.stat().st_mtime_ns
    assert make(camera_entries[1.0], RGBD, tmp_path, TUM).key == variant.key
    assert first.stat().st_mtime_ns == made
    assert first.stat().st_mode & 0o222 == 0
    first.chmod(0o644)
    first.write_bytes(b"changed")
    make(camera_entries[1.0], RGBD, tmp_path, TUM)
    assert image(first).shape == (120, 160, 3)
    shutil.rmtree(first.parent)
    make(camera_entries[1.0], RGBD, tmp_path, TUM)
    assert image(first).shape == (120, 160, 3)


def test_forms_are_variants_of_their_own_and_bags_keep_their_names(tmp_path: Path) -> None:
    path = tmp_path / "pair.bag"
    stamps = [START + k * 10**8 for k in range(30)]
    camera = Camera.model_validate(LENS | {"coefficients": [0.1, 0.2, 0, 0, 0]})
    with BagWriter(path) as bag:
        for k, at in enumerate(stamps):
            for side in ("left", "right"):
                bag.camera_info(f"/{side}/camera_info", at, side, camera)
                bag.image(f"/{side}/image_raw", at, side, "mono8", np.full((12, 16), k, np.uint8))
    entry = described(
        path, {side: camera_sensor(f"/{side}/image_raw", at=k) for k, side in enumerate(STEREO)}
    )
    keys = {
        form: make(entry, STEREO, tmp_path / "v", form, frameRate=5).key for form in DataFormat if form != TUM
    }
    assert len(set(keys.values())) == len(keys)
    # Nothing that is prepared already is prepared again.
    assert {form: keys[form][:16] for form in ("Rosbag1", "Rosbag2", "Mcap")} == KEYS


@pytest.mark.parametrize(
    ("form", "roles", "change", "sentence"),
    [
        (KITTI, (Role.CAMERA, Role.IMU), {}, "Kitti can't hold .*camera, imu.*holds mono, stereo, lidar$"),
        (
            TUM,
            (Role.LIDAR,),
            {},
            "Tum can't .*sensors lidar.*holds mono, mono-inertial, rgbd, rgbd-inertial$",
        ),
        (EUROC, RGBD, {}, "Euroc can't hold .*color, depth"),
        (EUROC, (Role.LEFT, Role.RIGHT, Role.CAMERA), {}, "Euroc can't hold"),
        (EUROC, STEREO, {"left": {"camera": None}}, r"sensors\.left\.camera: intrinsics are needed"),
        (KITTI, STEREO, {"left": {"camera": None}}, r"sensors\.left\.camera: intrinsics are needed"),
        (
            KITTI,
            STEREO,
            {"right": {"camera": {**LENS, "model": "Mei", "xi": 1.0}}},
            "images of Mei .*Pinhole",
        ),
        (KITTI, STEREO, {"right": {"camera": {**LENS, "width": 20}}}, "16×12 and 20×12"),
        (KITTI, STEREO, {"left": {"T_body_sensor": POSE}}, r"must lie to the right .*\[-0\.4, 0\.0, 0\.0\]"),
        (
            KITTI,
            STEREO,
            {"right": {"camera": {**LENS, "distortion": "Equidistant"}}},
            "None and Equidistant can't be rectified together",
        ),
        (TUM, RGBD, {}, r"sensors\.depth\.camera\.depthScale: needed for depth images"),
        (EUROC, STEREO, {"right": {"topic": "/l"}}, "must be different sensors; found left, right"),
    ],
)
def test_what_a_form_can_not_hold_is_refused(
    tmp_path: Path, form: DataFormat, roles: Any, change: Any, sentence: str
) -> None:
    streams = {"/l": ns(0, 50), "/r": ns(0, 50)}
    path = cameras(tmp_path / "x.bag", streams, lambda *_: np.zeros((12, 16), np.uint8), {})
    sensors = {
        "left": camera_sensor("/l"),
        "right": camera_sensor("/r", at=0.1),
        "color": camera_sensor("/l"),
        "depth": camera_sensor("/r", kind="DepthCamera"),
        "imu": {"type": "Imu", "topic": "/imu"},
        "lidar": {"type": "Lidar", "topic": "/points"},
    }
    for name, fields in change.items():
        sensors[name] = sensors[name] | fields
    with pytest.raises(InputError, match=sentence):
        make(described(path, sensors), roles, tmp_path / "v", form)
    assert not (tmp_path / "v").exists()


@pytest.mark.parametrize(
    ("form", "encoding", "pixels", "sentence"),
    [
        (EUROC, "32FC1", np.zeros((12, 16), np.float32), "32FC1 have no place .*8 or 16 bits"),
        (KITTI, "mono8", np.zeros((6, 8), np.uint8), "states 16×12 pixels, but the images .*8×6"),
    ],
)
def test_images_that_a_folder_can_not_hold(
    tmp_path: Path, form: DataFormat, encoding: str, pixels: Any, sentence: str
) -> None:
    first = np.zeros((12, 16), np.uint8)
    path = cameras(
        tmp_path / "b.bag", {"/cam": ns(0, 50)}, lambda _, k: pixels if k or encoding != "mono8" else first,
        {"/cam": encoding},
    )  # fmt: skip
    with pytest.raises(DataError, match=sentence):
        make(described(path, {"camera": camera_sensor("/cam")}), (Role.CAMERA,), tmp_path / "v", form)
    assert [
        item.name for item in (tmp_path / "v").iterdir() if item.is_dir() and item.name != ".hashes"
    ] == []


def test_frames_that_never_belong_together(tmp_path: Path) -> None:
    path = tmp_path / "car.bag"
    with BagWriter(path) as bag:
        for at in ns(0, 100, 200):
            bag.image("/cam", at, "cam", "mono8", np.zeros((12, 16), np.uint8))
        for at in ns(5000, 5100):
            bag.points("/points", at, "lidar", np.ones(2, dtype=[(axis, "<f4") for axis in "xyz"]))
    entry = described(path, {"camera": camera_sensor("/cam"), "lidar": {"type": "Lidar", "topic": "/points"}})
    with pytest.raises(DataError, match="no message of /points is within 50 ms of a whole frame of /cam"):
        make(entry, (Role.CAMERA, Role.LIDAR), tmp_path / "v", KITTI)


def algorithm(recording: list[str], modes: list[Any]) -> Algorithm:
    spec = {"image": "x", "modes": modes, "output": {"frame": "body"}, "recording": recording}
    return Algorithm.model_validate({"metadata": {"name": "a"}, "spec": spec})


def test_each_mode_gets_the_forms_that_hold_it() -> None:
    spec = algorithm(["Euroc", "Tum"], [{"name": "stereo"}, {"name": "rgbd"}, {"name": "mono"}]).spec
    assert [spec.formats(mode) for mode in spec.modes] == [[EUROC], [TUM], [EUROC, TUM]]


@pytest.mark.parametrize(
    ("recording", "mode", "sentence"),
    [
        (["Kitti"], {"name": "stereo-inertial"}, "recording: Kitti can't hold the mode stereo-inertial"),
        (["Tum", "Euroc"], {"name": "lidar"}, "Tum and Euroc can't hold the mode lidar .*Tum holds mono"),
        (["Euroc"], {"name": "mono", "roles": ["camera", "lidar"]}, r"mode mono \(sensors camera, lidar\)"),
    ],
)
def test_a_manifest_whose_form_can_not_hold_a_mode_is_refused(
    recording: list[str], mode: Any, sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        algorithm(recording, [mode])


def test_an_algorithm_is_told_where_things_are(camera_entries: Any, tmp_path: Path) -> None:
    def told(form: DataFormat, roles: Any) -> Any:
        variant = make(camera_entries[1.0], roles, tmp_path, form)
        recording = PreparedRecording(
            format=variant.format,
            recording=variant.path.name,
            sensors=variant.sensors,
            start_time=variant.start_time,
            duration_seconds=variant.duration_seconds,
        )
        place = recording_place(recording, f"dataset/{recording.recording}").as_json()
        for path in place.get("files", {}).values():
            assert (variant.path / path).exists()
        return place

    assert told(EUROC, STEREO) == {
        "format": "Euroc",
        "path": "dataset/recording",
        "files": {"left": "mav0/cam0", "right": "mav0/cam1", "times": "times.txt"},
    }
    assert told(TUM, RGBD)["files"] == {
        "color": "rgb.txt",
        "depth": "depth.txt",
        "associations": "associations.txt",
    }
    assert told(KITTI, (Role.COLOR,))["files"] == {
        "color": "image_2",
        "times": "times.txt",
        "calibration": "calib.txt",
    }
    assert told(BAG, STEREO) == {"format": "Rosbag1", "path": "dataset/recording.bag"}


def test_folders_are_evicted_like_bags(camera_entries: Any, tmp_path: Path, monkeypatch: Any) -> None:
    variant = make(camera_entries[1.0], RGBD, tmp_path, TUM)
    monkeypatch.setattr("slamhive.data.files.once.GRACE_SECONDS", 0.0)
    assert evict_variants(tmp_path, 0) == [variant.folder.name]
    assert not variant.folder.exists()


class _Compressing(BagWriter):
    """Writes compressed images, too."""

    def compressed(self, topic: str, stamp: int, form: str, data: Any) -> None:
        header = self._header(topic, stamp, "cam")
        message = self._types[COMPRESSED_IMAGE](header=header, format=form, data=data.reshape(-1))
        self._write(topic, COMPRESSED_IMAGE, stamp, message)


def test_compressed_images_are_decoded(tmp_path: Path) -> None:
    pixels = np.random.default_rng(2).integers(0, 255, (12, 16, 3), dtype=np.uint8)
    with _Compressing(tmp_path / "c.bag") as bag:
        for at in ns(0, 50):
            bag.compressed("/cam", at, "rgb8; png compressed bgr8", cv2.imencode(".png", pixels)[1])
    entry = described(tmp_path / "c.bag", {"camera": camera_sensor("/cam")})
    variant = make(entry, (Role.CAMERA,), tmp_path / "v", EUROC)
    assert [(image(path) == pixels).all() for path in first_images(variant)] == [True, True]
    camera = variant.sensors[Role.CAMERA].camera
    assert camera is not None
    assert camera.encoding == "bgr8"
