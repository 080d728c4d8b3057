# SPDX-License-Identifier: Apache-2.0
"""Frames that a program makes: what it is given as files, what becomes of what it writes, what is refused."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import yaml
from variants import read

from slamhive.data.making.preparation import prepare
from slamhive.data.making.programmed import folder_by_program, prepare_by_program
from slamhive.data.recordings.clouds import cloud_points
from slamhive.data.recordings.images import image_pixels
from slamhive.model.errors import InputError
from slamhive.model.formats import DataFormat
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role
from slamhive.model.variant import PreparingProgram

if TYPE_CHECKING:
    from collections.abc import Callable

BAG1, EUROC, KITTI, TUM = DataFormat.ROSBAG1, DataFormat.EUROC, DataFormat.KITTI, DataFormat.TUM
STEREO, RGBD = (Role.LEFT, Role.RIGHT), (Role.COLOR, Role.DEPTH)


@dataclass
class Maker:
    """A program that is a function of the folders that it is given and writes into."""

    folder: Path
    does: Callable[[Path, Path], None]
    gives: Any = None
    digest: str = "1"
    name: str = "test"
    calls: list[int] = field(default_factory=list)

    @property
    def program(self) -> PreparingProgram:
        return PreparingProgram.model_validate({"image": "lab/test:1", "gives": self.gives})

    def work(self, key: str) -> Path:
        work = self.folder / key
        work.mkdir(parents=True)
        return work

    def run(self, work: Path, frames: int, _: Callable[[float], None]) -> Path:
        self.calls.append(frames)
        (work / "out").mkdir()
        self.does(work / "in", work / "out")
        return work / "out"

    def failure(self, sentence: str, _: Path) -> InputError:
        return InputError(f"it {sentence}")

    def close(self, work: Path, *, keep_log: bool = False) -> None:
        shutil.rmtree(work)
        assert isinstance(keep_log, bool)


@pytest.fixture
def make(tmp_path: Path) -> Any:
    def made(entry: Any, roles: Any, does: Any, form: Any = BAG1, **given: Any) -> Any:
        options = InputOptions.model_validate(given.pop("options", {}))
        maker = given.pop("maker", None) or Maker(tmp_path / "work", does, **given)
        wanted = (entry, roles, options, (form,), tmp_path / "cache")
        variant = prepare_by_program(*wanted, maker, lambda _: None)
        assert folder_by_program(*wanted, maker) == variant.folder
        assert not [*(tmp_path / "work").iterdir()]
        return variant

    return made


def told(message: Any) -> tuple[int, int, str]:
    stamp = message.header.stamp
    return stamp.sec, stamp.nanosec, message.header.frame_id


def everything(given: Path, out: Path) -> None:
    for path in given.iterdir():
        if path.is_dir():
            shutil.copytree(path, out / path.name)


def blackened(role: str) -> Callable[[Path, Path], None]:
    """Return a program that makes the upper half of a camera's images black."""

    def does(given: Path, out: Path) -> None:
        (out / role).mkdir()
        for path in (given / role).glob("*.png"):
            pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            pixels[: len(pixels) // 2] = 0
            cv2.imwrite(str(out / role / path.name), pixels)

    return does


@pytest.mark.parametrize("roles", [STEREO, RGBD, (Role.LIDAR, Role.IMU)])
def test_what_a_program_leaves_as_it_was_is_the_recording(
    make: Any, camera_entries: Any, lidar_entry: Any, tmp_path: Path, roles: Any
) -> None:
    entry = lidar_entry if Role.LIDAR in roles else camera_entries[1.0]
    variant = make(entry, roles, everything)
    plain = prepare(entry, roles, InputOptions(), (BAG1,), tmp_path / "cache")
    assert variant.sensors == plain.sensors
    assert (variant.told, variant.start_time) == (plain.told, plain.start_time)
    before, after = read(plain.path), read(variant.path)
    assert after.keys() == before.keys()
    for topic, messages in before.items():
        assert len(after[topic]) == len(messages)
        for old, new in zip(messages, after[topic], strict=True):
            if hasattr(old, "point_step"):
                assert cloud_points(new, "").tobytes() == cloud_points(old, "").tobytes()
            elif hasattr(old, "encoding"):
                assert (new.encoding, told(new)) == (old.encoding, told(old))
                assert np.array_equal(image_pixels(new, ""), image_pixels(old, ""))


@pytest.mark.parametrize("form", [BAG1, EUROC])
def test_images_are_those_that_the_program_wrote_whatever_the_form(
    make: Any, camera_entries: Any, form: Any, tmp_path: Path
) -> None:
    options = {"duration": "3s", "resolution": 0.5}
    variant = make(camera_entries[1.0], STEREO, blackened("left"), form, options=options)
    assert (variant.resolution, variant.sensors[Role.LEFT].camera.width) == (0.5, 80)
    assert variant.recorded_seconds > 6
    if form is BAG1:
        messages = read(variant.path)
        left, right = (
            [image_pixels(one, "") for one in messages[variant.sensors[role].topic]] for role in STEREO
        )
    else:
        left, right = (
            [cv2.imread(str(path), -1) for path in sorted(variant.path.glob(f"mav0/{camera}/data/*.png"))]
            for camera in ("cam0", "cam1")
        )
    assert len(left) == len(right) == variant.frames == 6
    assert all(not one[:30].any() and one[30:].any() for one in left)
    assert all(one[:30].any() for one in right)
    assert len([*(tmp_path / "cache").glob("*/variant.json")]) == 2


def test_a_program_runs_once_for_all_forms_and_again_when_it_changes(
    make: Any, lidar_entry: Any, tmp_path: Path
) -> None:
    def halved(given: Path, out: Path) -> None:
        (out / "lidar").mkdir()
        for path in (given / "lidar").glob("*.npy"):
            np.save(out / "lidar" / path.name, np.load(path)[::2])

    maker = Maker(tmp_path / "work", halved)
    variant = make(lidar_entry, [Role.LIDAR], None, maker=maker)
    plain = prepare(lidar_entry, [Role.LIDAR], InputOptions(), (BAG1,), tmp_path / "cache")
    old, new = (read(one.path)["/points"] for one in (plain, variant))
    for before, after in zip(old, new, strict=True):
        assert cloud_points(after, "").tolist() == cloud_points(before, "")[::2].tolist()
    make(lidar_entry, [Role.LIDAR], None, KITTI, maker=maker)
    make(lidar_entry, [Role.LIDAR], None, maker=maker)
    assert maker.calls == [80]
    maker.digest = "2"
    again = make(lidar_entry, [Role.LIDAR], None, maker=maker)
    assert maker.calls == [80, 80]
    assert again.key == variant.key  # equal bytes: the same recording, whoever made them


def test_depth_is_given_beside_the_images_that_it_follows(make: Any, camera_entries: Any) -> None:
    def deep(given: Path, out: Path) -> None:
        (out / "depth").mkdir()
        for number, path in enumerate(sorted((given / "color").glob("*.png"))):
            height, width = cv2.imread(str(path)).shape[:2]
            cv2.imwrite(str(out / "depth" / path.name), np.full((height, width), 1000 + number, np.uint16))

    entry = camera_entries[1.0]
    spec = entry.dataset.spec
    sensors = {name: one for name, one in spec.sensors.items() if name != "depth"}
    without = type(entry)(entry.dataset.replace(spec=spec.replace(sensors=sensors)), entry.root)
    gives = {"depth": {"follows": "color", "depthScale": 500}}
    variant = make(without, RGBD, deep, gives=gives)
    color, depth = variant.sensors[Role.COLOR], variant.sensors[Role.DEPTH]
    assert (depth.type, depth.camera.depth_scale, depth.camera.fx) == ("DepthCamera", 500, color.camera.fx)
    messages = read(variant.path)
    images, depths = messages[color.topic], messages[depth.topic]
    assert [*map(told, images)] == [*map(told, depths)]
    assert [int(image_pixels(one, "")[0, 0]) for one in depths] == [1000 + k for k in range(len(images))]
    folder = make(without, RGBD, deep, TUM, gives=gives)
    assert len([*folder.path.glob("depth/*.png")]) == len(images)


def test_calibration_is_what_the_program_says(make: Any, camera_entries: Any) -> None:
    def calibrated(given: Path, out: Path) -> None:
        told = yaml.safe_load((given / "sensors.yaml").read_text())
        told["sensors"]["left"]["camera"] |= {"fx": 123.5, "cx": 70.25}
        (out / "sensors.yaml").write_text(yaml.safe_dump(told))

    variant = make(camera_entries[1.0], STEREO, calibrated)
    left = variant.sensors[Role.LEFT]
    assert (left.camera.fx, left.camera.cx) == (123.5, 70.25)
    infos = read(variant.path)[left.topic.rpartition("/")[0] + "/camera_info"]
    assert infos
    assert {(one.K[0], one.K[2], one.P[0]) for one in infos} == {(123.5, 70.25, 123.5)}
    assert variant.sensors[Role.RIGHT].camera.fx != 123.5


def test_what_an_algorithm_is_told_wrongly_is_so_once(make: Any, camera_entries: Any, tmp_path: Path) -> None:
    options = InputOptions.model_validate({"perturb": {"rotation": {"left": 5}}})
    told = prepare(camera_entries[1.0], STEREO, options, (EUROC,), tmp_path / "plain")
    mine = make(camera_entries[1.0], STEREO, everything, EUROC, options=options.as_json())
    name = "mav0/cam0/sensor.yaml"
    assert (mine.path / name).read_bytes() == (told.path / name).read_bytes()


def without(name: str) -> Callable[[Path, Path], None]:
    def does(given: Path, out: Path) -> None:
        everything(given, out)
        (out / name).unlink()

    return does


def put(name: str, data: bytes | Any) -> Callable[[Path, Path], None]:
    def does(given: Path, out: Path) -> None:
        everything(given, out)
        (out / name).parent.mkdir(exist_ok=True)
        (out / name).unlink(missing_ok=True)
        if isinstance(data, bytes):
            (out / name).write_bytes(data)
        elif isinstance(data, Path):
            (out / name).symlink_to(data)
        elif name.endswith(".npy"):
            np.save(out / name, data)
        else:
            cv2.imwrite(str(out / name), data)

    return does


FLAT = np.zeros((2, 3))


@pytest.mark.parametrize(
    ("does", "sentence"),
    [
        (lambda *_: None, "it wrote nothing; expected frames of lidar"),
        (
            without("lidar/000009.npy"),
            "it wrote 9 of 10 frames of lidar; the first that is missing is lidar/000009",
        ),
        (
            put("lidar/000010.npy", FLAT),
            "it wrote 11 frames of lidar, expected 10; lidar/000010.npy is none of them",
        ),
        (put("mask/000000.png", b""), "it wrote 'mask', which is none of lidar, sensors.yaml"),
        (put("lidar/000003.npy", b"x"), "it wrote lidar/000003.npy, which can't be read as NPY"),
        (
            put("lidar/000003.npy", FLAT),
            r"it wrote lidar/000003.npy with an array of shape \(2, 3\); expected one row",
        ),
        (put("lidar/000003.npy", Path("/etc/passwd")), "it wrote lidar/000003.npy, which is no file"),
        (put("sensors.yaml", b"{"), "it wrote sensors.yaml that can't be read"),
        (
            put("sensors.yaml", b"sensors: {left: {}}"),
            "it wrote sensors.yaml with 'left'; its sensors are lidar",
        ),
        (
            put("sensors.yaml", b"sensors: {lidar: {T_body_sensor: 1}}"),
            "it wrote sensors.yaml: sensors.lidar.T_body_sensor: ",
        ),
    ],
)
def test_what_a_program_does_wrong_is_one_sentence(
    make: Any, lidar_entry: Any, tmp_path: Path, does: Any, sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        make(lidar_entry, [Role.LIDAR], does, options={"duration": "1s"})
    assert not [*(tmp_path / "work").iterdir()]
    assert len([*(tmp_path / "cache").glob("[0-9a-f]*")]) == 1  # the recording as it was stays


@pytest.mark.parametrize(
    ("image", "sentence"),
    [
        (
            np.zeros((60, 80), np.uint8),
            "as 80×60 pixels of uint8, 1 channel; it was given 160×120 pixels of uint8",
        ),
        (np.zeros((120, 160), np.uint16), "as 160×120 pixels of uint16, 1 channel; it was given"),
        (b"", "which can't be read as PNG"),
    ],
)
def test_images_keep_size_and_type(make: Any, camera_entries: Any, image: Any, sentence: str) -> None:
    with pytest.raises(InputError, match=f"it wrote left/000001.png,? {sentence}"):
        make(camera_entries[1.0], STEREO, put("left/000001.png", image))


def test_what_is_to_be_given_has_to_be(make: Any, camera_entries: Any) -> None:
    gives = {"depth": {"follows": "color", "depthScale": 500}}
    with pytest.raises(InputError, match="it wrote nothing for 'depth', which it is to give"):
        make(camera_entries[1.0], RGBD, everything, gives=gives)
    flat = put("depth/000000.png", np.zeros((120, 160), np.uint8))
    with pytest.raises(InputError, match="it wrote 1 of 15 frames of depth"):
        make(camera_entries[1.0], RGBD, flat, gives=gives)


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({}, "give an image, or local"),
        ({"image": "a", "gives": {"imu": {"follows": "color"}}}, "gives.imu: only cameras can be given"),
        (
            {"image": "a", "gives": {"depth": {"follows": "imu"}}},
            "gives.depth.follows: expected the role of a",
        ),
        ({"image": "a", "gives": {"depth": {"follows": "color"}}}, "gives.depth.depthScale: needed"),
    ],
)
def test_a_program_is_described_whole(fields: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        PreparingProgram.model_validate(fields)
