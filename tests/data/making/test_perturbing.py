# SPDX-License-Identifier: Apache-2.0
"""Perturbations of a recording, each against what it is to be, in bags and in folders."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import yaml
from pydantic import ValidationError
from rosbags.typesys import Stores, get_typestore
from variants import make, read, stamps

from slamhive.data.making.disturbing import RAIN_METRES, Shutter, Weather, disturbed_image, disturbed_scan
from slamhive.data.making.preparation import prepare
from slamhive.data.recordings.clouds import cloud_points
from slamhive.data.recordings.images import image_pixels
from slamhive.data.synthetic.streams import stream as numbers_of
from slamhive.model.algorithm import DataFormat
from slamhive.model.configuration import PreparedRecording, SensorView
from slamhive.model.errors import DataError
from slamhive.model.run import ImagesPerturbation, InputOptions, LidarPerturbation, Perturbation
from slamhive.model.sensors import Role
from slamhive.plan.configuration import run_configuration
from slamhive.plan.misleading import misled, right_pose

if TYPE_CHECKING:
    from pathlib import Path

TYPES = get_typestore(Stores.ROS1_NOETIC).types
BAG1, MCAP, EUROC, KITTI = DataFormat.ROSBAG1, DataFormat.MCAP, DataFormat.EUROC, DataFormat.KITTI


def ranges(points: Any) -> Any:
    return np.sqrt(sum(points[axis].astype(np.float64) ** 2 for axis in "xyz"))


def scans(variant: Any) -> list[Any]:
    return [cloud_points(message, "") for message in read(variant.path)["/points"]]


@pytest.fixture
def original(lidar_entry: Any) -> list[Any]:
    return [cloud_points(message, "") for message in read(lidar_entry.root / "recording.bag")["/points"]]


def test_noise_on_ranges_has_its_sigma_along_the_rays(
    lidar_entry: Any, tmp_path: Path, original: list[Any]
) -> None:
    variant = make(lidar_entry, [Role.LIDAR], tmp_path, {"lidar": {"rangeNoise": 0.05}})
    added = []
    for mine, before in zip(scans(variant), original, strict=True):
        assert mine["time"].tolist() == before["time"].tolist()
        mine_at, before_at = (np.column_stack([one[axis] for axis in "xyz"]) for one in (mine, before))
        assert np.cross(mine_at, before_at) == pytest.approx(0.0, abs=1e-4)
        added.append(ranges(mine) - ranges(before))
    noise = np.concatenate(added)
    assert len(noise) > 10_000
    assert (noise.mean(), noise.std()) == (pytest.approx(0, abs=2e-3), pytest.approx(0.05, rel=0.03))


def test_equal_seeds_give_equal_bytes_and_others_others(lidar_entry: Any, tmp_path: Path) -> None:
    wanted = {"lidar": {"rangeNoise": 0.05}}
    one, other = (make(lidar_entry, [Role.LIDAR], tmp_path / name, wanted) for name in "ab")
    assert one.key == other.key
    assert one.path.read_bytes() == other.path.read_bytes()
    third = make(lidar_entry, [Role.LIDAR], tmp_path, wanted | {"seed": 2})
    assert third.key != one.key
    assert third.path.read_bytes() != one.path.read_bytes()


@pytest.mark.parametrize(
    "perturb",
    [
        None,
        {"lidar": {"rangeNoise": 0}},
        {"seed": 7},
        {"seed": 7, "images": {"gamma": 1, "noise": 4}, "timeOffset": {"imu": 0.1, "lidar": 0}},
        {"rotation": {"lidar": 2}},
    ],
)
def test_what_changes_nothing_of_the_recording_is_the_variant_without(
    lidar_entry: Any, tmp_path: Path, perturb: Any
) -> None:
    plain = prepare(lidar_entry, [Role.LIDAR], InputOptions(), (BAG1,), tmp_path)
    assert make(lidar_entry, [Role.LIDAR], tmp_path, perturb).key == plain.key


def test_noise_does_not_depend_on_cut_rate_and_format(lidar_entry: Any, tmp_path: Path) -> None:
    wanted = {"lidar": {"rangeNoise": 0.05}}
    messages = read(make(lidar_entry, [Role.LIDAR], tmp_path, wanted).path)["/points"]
    clouds = [cloud_points(message, "") for message in messages]
    whole = dict(zip(stamps(messages).tolist(), clouds, strict=True))
    cut = make(lidar_entry, [Role.LIDAR], tmp_path, wanted, form=MCAP, start="2s", duration="2s", frameRate=5)
    messages = read(cut.path)["/points"]
    assert len(messages) == 10
    for stamp, message in zip(stamps(messages), messages, strict=True):
        assert cloud_points(message, "").tobytes() == whole[stamp].tobytes()
    folder = make(lidar_entry, [Role.LIDAR], tmp_path, wanted, form=KITTI)
    first = np.fromfile(folder.path / "velodyne" / "000000.bin", "<f4").reshape(-1, 4)
    assert first[:, 0].tolist() == next(iter(whole.values()))["x"].tolist()


def test_points_dropped_are_a_share_and_more_of_the_same(
    lidar_entry: Any, tmp_path: Path, original: list[Any]
) -> None:
    few, many = (
        scans(make(lidar_entry, [Role.LIDAR], tmp_path, {"lidar": {"dropPoints": share}}))
        for share in (0.2, 0.6)
    )
    total = sum(map(len, original))
    assert sum(map(len, few)) == pytest.approx(0.8 * total, rel=0.01)
    assert sum(map(len, many)) == pytest.approx(0.4 * total, rel=0.02)
    for least, most, before in zip(many, few, original, strict=True):
        rows = [set(points.tolist()) for points in (least, most, before)]
        assert rows[0] <= rows[1] <= rows[2]


def test_a_sector_has_no_points(lidar_entry: Any, tmp_path: Path, original: list[Any]) -> None:
    variant = make(lidar_entry, [Role.LIDAR], tmp_path, {"lidar": {"sector": 90}})
    for mine, before in zip(scans(variant), original, strict=True):
        behind = -before["x"] > np.abs(before["y"])
        assert 0 < behind.sum() < len(before)
        assert mine.tolist() == before[~behind].tolist()


def test_rain_is_nearer_along_the_rays_as_by_its_formula(
    lidar_entry: Any, tmp_path: Path, original: list[Any]
) -> None:
    few, many = (
        scans(make(lidar_entry, [Role.LIDAR], tmp_path, {"lidar": {"rain": share}})) for share in (0.1, 0.4)
    )
    before, light, heavy = (np.concatenate([ranges(one) for one in found]) for found in (original, few, many))
    # What is nearer from the rounding to float32 alone isn't of a drop.
    wet = [before - one > 1e-4 for one in (light, heavy)]
    assert [one.mean() for one in wet] == [pytest.approx(0.1, rel=0.03), pytest.approx(0.4, rel=0.03)]
    assert (wet[0] <= wet[1]).all()
    assert heavy[wet[0]] == pytest.approx(light[wet[0]], abs=1e-5)
    nearest = lidar_entry.dataset.spec.sensors["lidar"].lidar.min_range
    assert heavy.min() > nearest
    # Each is evenly distributed in its own distribution, cut off at what is behind it.
    seen, depth = (one[wet[1]] - nearest for one in (heavy, before))
    even = np.expm1(-seen / RAIN_METRES) / np.expm1(-depth / RAIN_METRES)
    assert np.histogram(even, 5, (0, 1))[0] / len(even) == pytest.approx(0.2, abs=0.02)
    for mine, was in zip(many, original, strict=True):
        mine_at, was_at = (np.column_stack([one[axis] for axis in "xyz"]) for one in (mine, was))
        assert np.cross(mine_at, was_at) == pytest.approx(0.0, abs=1e-4)
        assert mine["time"].tolist() == was["time"].tolist()


def test_what_is_no_return_stays_none_in_rain_and_noise() -> None:
    points = np.zeros(4, dtype=[(axis, "<f4") for axis in "xyz"])
    points["x"] = (np.nan, 0, np.inf, 0.3)
    fields = [TYPES["sensor_msgs/msg/PointField"](axis, 4 * k, 7, 1) for k, axis in enumerate("xyz")]
    header = TYPES["std_msgs/msg/Header"](0, TYPES["builtin_interfaces/msg/Time"](0, 0), "lidar")
    data = points.view(np.uint8)
    cloud = TYPES["sensor_msgs/msg/PointCloud2"](header, 1, 4, fields, False, 12, 48, data, False)
    weather = Weather(LidarPerturbation(rain=0.99, range_noise=1e-9), partial(_numbers, "lidar"), 0.5)
    found = cloud_points(disturbed_scan(cloud, weather, 0, "/points"), "")
    assert found["x"].tolist() == pytest.approx([np.nan, 0, np.inf, 0.3], nan_ok=True)


def test_scans_dropped_are_a_share_exactly(lidar_entry: Any, tmp_path: Path) -> None:
    plain, few, many = (
        make(lidar_entry, [Role.LIDAR], tmp_path, {"lidar": {"dropScans": share}}) for share in (0, 0.25, 0.5)
    )
    all_stamps, most, half = (stamps(read(one.path)["/points"]).tolist() for one in (plain, few, many))
    assert (len(most), len(half)) == (round(0.75 * len(all_stamps)), round(0.5 * len(all_stamps)))
    assert half[0] == all_stamps[0]
    assert set(half) < set(most) < set(all_stamps)
    assert many.frames == len(half)


# Cameras.


def photo(rows: int = 12, columns: int = 16) -> Any:
    return np.random.default_rng(3).integers(0, 256, (rows, columns), dtype=np.uint8)


def shot(pixels: Any, nanoseconds: int = 0, index: int = 0, **wanted: Any) -> Any:
    shutter = Shutter(ImagesPerturbation.model_validate(wanted), partial(_numbers, "cam"))
    return shutter.disturbed(pixels, index, nanoseconds)


def _numbers(sensor: str, purpose: str, index: int = 0) -> np.random.Generator:
    return numbers_of(1, f"{purpose} {sensor}", index)


def test_blur_is_the_mean_along_the_motion() -> None:
    line = np.zeros((3, 9), dtype=np.uint8)
    line[:, 4] = 200
    assert shot(line, blur=2)[1].tolist() == [0, 0, 0, 50, 100, 50, 0, 0, 0]
    assert shot(line, blur=4)[1].tolist() == [0, 0, 25, 50, 50, 50, 25, 0, 0]
    assert shot(line, blur=1e-6)[1].tolist() == line[1].tolist()


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_gamma_and_exposure_are_what_they_say(kind: Any) -> None:
    most = np.iinfo(kind).max
    pixels = np.array([[0, most // 4, most // 2, most]], dtype=kind)
    shares = pixels / most
    assert shot(pixels, gamma=2).tolist() == np.rint(shares**2 * most).tolist()
    assert shot(pixels, exposureStep=1).tolist() == pixels.tolist()
    assert shot(pixels, 999_999_999, exposureStep=1).tolist() == pixels.tolist()
    brighter = np.rint(np.minimum(shares * 2, 1) * most).tolist()
    assert shot(pixels, 1_000_000_000, exposureStep=1).tolist() == brighter
    assert shot(pixels, 2_000_000_000, exposureStep=1).tolist() == pixels.tolist()
    assert shot(pixels, 1_000_000_000, exposureStep=-1).tolist() == np.rint(shares / 2 * most).tolist()


def test_noise_has_its_sigma_and_differs_between_frames() -> None:
    grey = np.full((200, 300), 128, dtype=np.uint8)
    first, second = (shot(grey, index=k, noise=10).astype(float) for k in (0, 1))
    assert (first.mean(), first.std()) == (pytest.approx(128, abs=0.2), pytest.approx(10, rel=0.02))
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] == pytest.approx(0, abs=0.02)
    # White within an image, too, also where one piece of the row of numbers ends and another begins.
    assert np.corrcoef(first[:, 1:].ravel(), first[:, :-1].ravel())[0, 1] == pytest.approx(0, abs=0.02)
    assert np.corrcoef(first[1:].ravel(), first[:-1].ravel())[0, 1] == pytest.approx(0, abs=0.02)
    assert first.tolist() == shot(grey, noise=10).tolist()
    deep = shot(np.full((200, 300), 2**15, dtype=np.uint16), noise=10)
    assert deep.std() == pytest.approx(10 * 65535 / 255, rel=0.02)


def test_jpeg_and_occlusion_are_opencv_and_one_rectangle() -> None:
    pixels = photo(60, 80)
    encoded = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 10])[1]
    assert (
        shot(pixels, jpegQuality=10).tolist()
        == np.asarray(cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED)).tolist()
    )
    white = np.full((60, 80, 3), 255, dtype=np.uint8)
    covered = shot(white, occlusion=0.25) == 0
    rows, columns = covered[..., 0].any(axis=1), covered[..., 0].any(axis=0)
    assert (rows.sum(), columns.sum(), covered.sum()) == (30, 40, 30 * 40 * 3)
    assert shot(white, index=7, occlusion=0.25).tolist() == shot(white, occlusion=0.25).tolist()


def test_images_of_16_bits_have_no_jpeg() -> None:
    with pytest.raises(DataError, match=r"jpegQuality takes images of 8 bits, these have 16"):
        shot(np.zeros((4, 4), dtype=np.uint16), jpegQuality=50)


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "mono8", "bayer_rggb8"])
def test_colours_keep_their_order_and_transparency_stays(encoding: str) -> None:
    channels = {"rgb8": 3, "bgr8": 3, "rgba8": 4}.get(encoding, 1)
    pixels = np.random.default_rng(1).integers(0, 256, (8, 10, channels), dtype=np.uint8)
    message = image(pixels, encoding)
    shutter = Shutter(ImagesPerturbation(gamma=2.0), partial(_numbers, "cam"))
    found = image_pixels(disturbed_image(message, shutter, 0, 0, "/image"), "/image")
    expected = image_pixels(message, "/image").astype(np.float64) / 255
    if channels == 4:
        assert found[..., 3].tolist() == pixels[..., 3].tolist()
        found, expected = found[..., :3], expected[..., :3]
    assert found.tolist() == np.rint(expected**2 * 255).tolist()


def image(pixels: Any, encoding: str) -> Any:
    header = TYPES["std_msgs/msg/Header"](0, TYPES["builtin_interfaces/msg/Time"](0, 0), "cam")
    height, width = pixels.shape[:2]
    data = pixels.reshape(-1)
    step = len(data) // height
    return TYPES["sensor_msgs/msg/Image"](header, height, width, encoding, 0, step, data)


@pytest.fixture
def camera(tmp_path: Path, frames_of: Any) -> Any:
    """A camera of 20 Hz whose 100 images have their number in every pixel."""
    return frames_of(tmp_path / "camera.bag", rate=20, count=100)


def numbers(variant: Any, topic: str = "/cam/image_raw") -> list[int]:
    return [int(image_pixels(message, "")[0, 0]) for message in read(variant.path)[topic]]


def test_frames_dropped_are_a_share_exactly_with_their_camera_info(camera: Any, tmp_path: Path) -> None:
    plain = make(camera, [Role.CAMERA], tmp_path, None)
    variant = make(camera, [Role.CAMERA], tmp_path, {"images": {"dropFrames": 0.3}})
    found, before = read(variant.path), read(plain.path)
    kept = numbers(variant)
    assert len(kept) == variant.frames == 70
    assert kept == sorted(set(kept))
    assert kept[0] == 0
    assert stamps(found["/cam/image_raw"]).tolist() == stamps(before["/cam/image_raw"])[kept].tolist()
    assert stamps(found["/cam/camera_info"]).tolist() == stamps(found["/cam/image_raw"]).tolist()
    fewer = numbers(make(camera, [Role.CAMERA], tmp_path, {"images": {"dropFrames": 0.6}}))
    assert len(fewer) == 40
    assert set(fewer) < set(kept)


def test_frames_are_dropped_of_those_of_the_rate(camera: Any, tmp_path: Path) -> None:
    variant = make(camera, [Role.CAMERA], tmp_path, {"images": {"dropFrames": 0.2}}, frameRate=10)
    kept = numbers(variant)
    assert len(kept) == 40
    assert all(number % 2 == 0 for number in kept)


def test_duplicates_show_the_image_before_with_stamps_of_their_own(camera: Any, tmp_path: Path) -> None:
    variant = make(camera, [Role.CAMERA], tmp_path, {"images": {"duplicateFrames": 0.25}})
    seen = numbers(variant)
    assert len(seen) == 100
    assert sum(number != k for k, number in enumerate(seen)) == 25
    assert all(number in {k, seen[k - 1]} for k, number in enumerate(seen) if k)
    both = {"images": {"dropFrames": 0.3, "duplicateFrames": 0.25}}
    fewer = numbers(make(camera, [Role.CAMERA], tmp_path, both))
    assert (len(fewer), len(set(fewer))) == (70, 70 - round(0.25 * 70))
    before = read(make(camera, [Role.CAMERA], tmp_path, None).path)
    assert stamps(read(variant.path)["/cam/image_raw"]).tolist() == stamps(before["/cam/image_raw"]).tolist()


@pytest.mark.parametrize("form", [BAG1, MCAP, EUROC])
def test_pairs_are_dropped_and_stand_still_together(
    camera_entries: Any, tmp_path: Path, form: DataFormat
) -> None:
    roles = [Role.LEFT, Role.RIGHT]
    wanted = {"images": {"dropFrames": 0.25, "duplicateFrames": 0.25, "gamma": 2}}
    plain, variant = (make(camera_entries[1.0], roles, tmp_path, one, form) for one in (None, wanted))
    assert variant.frames == round(0.75 * plain.frames)
    frames = [pictures(one) for one in (plain, variant)]
    still = []
    for before, after in zip(*(found.values() for found in frames), strict=True):
        assert len(after) == variant.frames
        assert after.keys() <= before.keys()
        held = None
        same = []
        for stamp, pixels in after.items():
            expected = np.rint((before[stamp] / 255.0) ** 2 * 255)
            same.append(bool((pixels != expected).any()))
            held = held if same[-1] else expected
            assert (pixels == held).all()
        still.append(same)
    assert still[0] == still[1]
    assert 0 < sum(still[0]) <= round(0.25 * variant.frames)  # at rest an image is as the one before it


def pictures(variant: Any) -> dict[str, dict[int, Any]]:
    """Return the images of each camera by their stamps."""
    if variant.format is not EUROC:
        found = {}
        for role in ("left", "right"):
            messages = read(variant.path)[variant.sensors[Role(role)].topic]
            found[role] = dict(
                zip(stamps(messages).tolist(), [image_pixels(one, "") for one in messages], strict=True)
            )
        return found
    result = {}
    for name in ("cam0", "cam1"):
        place = variant.path / "mav0" / name
        rows = [line.split(",") for line in (place / "data.csv").read_text().splitlines()[1:]]
        result[name] = {
            int(stamp): cv2.imread(str(place / "data" / file), cv2.IMREAD_UNCHANGED) for stamp, file in rows
        }
    return result


# Inertial sensors.

IMU_ROLES = (Role.LIDAR, Role.IMU)


def forces(variant: Any) -> tuple[Any, Any]:
    """Return accelerations and turning rates, (n, 3) each."""
    messages = read(variant.path)["/imu"]
    vectors = [(one.linear_acceleration, one.angular_velocity) for one in messages]
    rows = np.array([[(v.x, v.y, v.z) for v in pair] for pair in vectors])
    return rows[:, 0], rows[:, 1]


@pytest.mark.parametrize("form", [BAG1, MCAP])
def test_bias_and_saturation_are_exact(lidar_entry: Any, tmp_path: Path, form: DataFormat) -> None:
    wanted = {
        "accelerometerBias": 0.5,
        "gyroscopeBias": -0.1,
        "accelerometerRange": 5,
        "gyroscopeRange": 0.2,
    }
    force, rate = forces(make(lidar_entry, IMU_ROLES, tmp_path, None))
    found = forces(make(lidar_entry, IMU_ROLES, tmp_path, {"imu": wanted}, form))
    assert found[0].tolist() == np.clip(force + 0.5, -5, 5).tolist()
    assert found[1].tolist() == np.clip(rate - 0.1, -0.2, 0.2).tolist()
    assert (found[0] == 5).any()


def test_noise_of_samples_has_its_sigma(lidar_entry: Any, tmp_path: Path) -> None:
    before = forces(make(lidar_entry, IMU_ROLES, tmp_path, None))
    wanted = {"accelerometerNoise": 0.3, "gyroscopeNoise": 0.02}
    after = forces(make(lidar_entry, IMU_ROLES, tmp_path, {"imu": wanted}))
    added = [mine - theirs for mine, theirs in zip(after, before, strict=True)]
    assert [one.std() for one in added] == [pytest.approx(0.3, rel=0.05), pytest.approx(0.02, rel=0.05)]
    assert abs(np.corrcoef(added[0].ravel(), added[1].ravel())[0, 1]) < 0.06


def test_a_lower_rate_leaves_samples_out(lidar_entry: Any, tmp_path: Path) -> None:
    plain = make(lidar_entry, IMU_ROLES, tmp_path, None)
    rate = plain.sensors[Role.IMU].rate
    variant = make(lidar_entry, IMU_ROLES, tmp_path, {"imu": {"rate": rate / 4}})
    before, after = (stamps(read(one.path)["/imu"]) for one in (plain, variant))
    assert after.tolist() == before[::4].tolist()
    assert variant.sensors[Role.IMU].rate == pytest.approx(rate / 4)


# Clocks.


@pytest.mark.parametrize("form", [BAG1, MCAP])
def test_an_offset_moves_the_stamps_of_its_sensor_alone(
    lidar_entry: Any, tmp_path: Path, form: DataFormat
) -> None:
    wanted = {"timeOffset": {"imu": 0.0125}, "drift": {"imu": 1e-3}}
    plain, variant = (make(lidar_entry, IMU_ROLES, tmp_path, one, form) for one in (None, wanted))
    before, after = (read(one.path) for one in (plain, variant))
    was = stamps(before["/imu"])
    expected = was + 12_500_000 + np.rint((was - was[0]) * 1e-3).astype(np.int64)
    assert stamps(after["/imu"]).tolist() == expected.tolist()
    assert stamps(after["/points"]).tolist() == stamps(before["/points"]).tolist()
    assert np.array_equal(forces(variant), forces(plain))
    assert variant.start_time == plain.start_time


def test_jitter_has_its_sigma_and_keeps_the_order(camera: Any, tmp_path: Path) -> None:
    plain, variant = (
        make(camera, [Role.CAMERA], tmp_path, one) for one in (None, {"jitter": {"camera": 0.002}})
    )
    found = read(variant.path)
    was, now = stamps(read(plain.path)["/cam/image_raw"]), stamps(found["/cam/image_raw"])
    assert (now - was).std() == pytest.approx(2e6, rel=0.25)
    assert (np.diff(now) > 0).all()
    assert stamps(found["/cam/camera_info"]).tolist() == now.tolist()
    assert (variant.path.parent / "frames.txt").read_text().split() == [str(stamp) for stamp in now]
    assert variant.start_time == pytest.approx(now[0] / 1e9, abs=1e-6)
    wild = make(camera, [Role.CAMERA], tmp_path, {"jitter": {"camera": 1.0}})
    assert (np.diff(stamps(read(wild.path)["/cam/image_raw"])) >= 0).all()


def test_a_folder_has_the_moved_stamps(camera_entries: Any, tmp_path: Path) -> None:
    roles = [Role.LEFT, Role.RIGHT]
    plain, variant = (
        make(camera_entries[1.0], roles, tmp_path, one, EUROC)
        for one in (None, {"timeOffset": {"right": 0.01}})
    )
    before, after = pictures(plain), pictures(variant)
    assert list(after["cam0"]) == list(before["cam0"])
    assert list(after["cam1"]) == [stamp + 10_000_000 for stamp in before["cam1"]]


def test_a_stamp_that_no_message_can_have_is_refused(tmp_path: Path, bag_writer: Any, frames_of: Any) -> None:
    path = tmp_path / "early.bag"
    with bag_writer(path) as bag:
        for k in range(10):
            bag.image("/cam/image_raw", (k + 1) * 10**8, "cam", "mono8", np.zeros((12, 16), dtype=np.uint8))
    entry = frames_of.describe(path, {"camera": ("Camera", "/cam/image_raw")})
    with pytest.raises(DataError, match=r"a stamp of /cam/image_raw in .* would be -0.9 s"):
        make(entry, [Role.CAMERA], tmp_path, {"timeOffset": {"camera": -1}})


# What an algorithm is told.


def test_told_extrinsics_are_wrong_by_so_much_and_no_others() -> None:
    views = {
        role: SensorView.model_validate({"name": role, "type": "Lidar", "topic": f"/{role}"})
        for role in IMU_ROLES
    }
    pose = np.eye(4)
    pose[:3, 3] = (1, 2, 3)
    views[Role.LIDAR] = views[Role.LIDAR].replace(T_body_sensor=pose.tolist())
    asked = {"rotation": {"lidar": 2}, "translation": {"lidar": 0.05}}
    told = misled(views, Perturbation.model_validate(asked))
    assert told[Role.IMU] == views[Role.IMU]
    found = np.array(told[Role.LIDAR].T_body_sensor)
    assert np.linalg.norm(found[:3, 3] - pose[:3, 3]) == pytest.approx(0.05)
    assert np.degrees(np.arccos((np.trace(found[:3, :3]) - 1) / 2)) == pytest.approx(2)
    assert found[:3, :3] @ found[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    more = np.array(misled(views, Perturbation(rotation={"lidar": 4}))[Role.LIDAR].T_body_sensor)
    assert more[:3, :3] == pytest.approx(found[:3, :3] @ found[:3, :3])
    right = right_pose(told[Role.LIDAR].T_body_sensor, "lidar", Perturbation.model_validate(asked))
    assert right == pytest.approx(pose, abs=1e-12)
    other = misled(views, Perturbation.model_validate(asked | {"seed": 2}))
    assert other[Role.LIDAR] != told[Role.LIDAR]


def test_a_folder_says_the_wrong_extrinsics_and_the_variant_keeps_the_right_ones(
    camera_entries: Any, tmp_path: Path
) -> None:
    roles = [Role.LEFT, Role.RIGHT]
    wanted = {"translation": {"right": 0.1}}
    plain, variant = (make(camera_entries[1.0], roles, tmp_path, one, EUROC) for one in (None, wanted))
    assert variant.sensors == plain.sensors
    assert variant.key != plain.key
    told = yaml.safe_load((variant.path / "mav0/cam1/sensor.yaml").read_text())["T_BS"]["data"]
    right = np.array(plain.sensors[Role.RIGHT].T_body_sensor)
    assert np.linalg.norm(np.reshape(told, (4, 4))[:3, 3] - right[:3, 3]) == pytest.approx(0.1)
    unturned = yaml.safe_load((variant.path / "mav0/cam0/sensor.yaml").read_text())["T_BS"]["data"]
    assert unturned == pytest.approx(np.ravel(plain.sensors[Role.LEFT].T_body_sensor).tolist())


def test_the_configuration_is_wrong_and_what_evaluation_reads_is_not(
    lidar_entry: Any, tmp_path: Path
) -> None:
    wanted = {"rotation": {"imu": 3}}
    variant = make(lidar_entry, IMU_ROLES, tmp_path, wanted)
    prepared = PreparedRecording(
        format=variant.format,
        recording=variant.path.name,
        sensors=variant.sensors,
        start_time=variant.start_time,
        duration_seconds=variant.duration_seconds,
    )
    spec = {
        "algorithmRef": {"name": "odometry"},
        "sensors": "lidar-inertial",
        "parameters": {},
        "input": {"pace": "Lockstep", "perturb": wanted},
        "seed": 1,
    }
    told = run_configuration("run", spec, lidar_entry.dataset, prepared, 1).sensors
    right = lidar_entry.dataset.spec.sensors
    assert told["lidar"].T_body_sensor == right["lidar"].T_body_sensor
    turn = np.linalg.inv(right["imu"].T_body_sensor)[:3, :3] @ np.array(told["imu"].T_body_sensor)[:3, :3]
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(3)
    assert {view.name: view.T_body_sensor for view in variant.sensors.values()} == {
        name: right[name].T_body_sensor for name in ("lidar", "imu")
    }


def test_a_role_that_is_none_is_refused_in_a_run() -> None:
    with pytest.raises(ValidationError, match="timeOffset: unknown role 'lidr'; did you mean 'lidar'"):
        Perturbation.model_validate({"timeOffset": {"lidr": 1}})
