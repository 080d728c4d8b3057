# SPDX-License-Identifier: Apache-2.0
"""Motion blur by the time of exposure: as long and in the direction that the platform turned."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from variants import make, read, stamps

from slamhive.data.making.disturbing import Shutter, trace_of
from slamhive.data.making.smearing import ImageMotion
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.images import image_pixels
from slamhive.data.recordings.repairing import open_recording
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.data.synthetic.trajectory import SyntheticMotion
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError, InputError
from slamhive.model.run import ImagesPerturbation
from slamhive.model.sensors import Role
from slamhive.model.synthetic import SyntheticRecording

if TYPE_CHECKING:
    from pathlib import Path

START = 1_600_000_000 * 10**9
RATE = 0.5
CAMERA = {"width": 64, "height": 48, "fx": 40.0, "fy": 30.0, "cx": 31.5, "cy": 23.5}
# Columns: the camera's x, y, z in a body whose z it looks against.
TURNED = [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    "way", [(0.0, 0.0), (2.0, 0.0), (4.0, 0.0), (0.0, 3.3), (2.7, -1.9), (1e-7, 0.0), (-5, 8)]
)
def test_a_trace_is_the_mean_of_shifted_images(way: tuple[float, float]) -> None:
    found = trace_of(*way)
    places = (np.arange(20_000) + 0.5) / 20_000 - 0.5
    expected = np.zeros(found.shape)
    for right, down in zip(way[0] * places, way[1] * places, strict=True):
        rows, columns = (
            np.maximum(0.0, 1.0 - np.abs(np.arange(size) - size // 2 - at))
            for size, at in zip(found.shape, (down, right), strict=True)
        )
        expected += np.outer(rows, columns) / len(places)
    assert found == pytest.approx(expected, abs=1e-6)
    assert found.sum() == pytest.approx(1, abs=1e-12)


def recorded(path: Path, *, imu: bool) -> None:
    """Write 3 s of a camera in front of a grid; the body turns about its x, then its y, then its z axis."""
    pixels = np.zeros((48, 64), dtype=np.uint8)
    pixels[::8, ::8] = 200
    with BagWriter(path) as bag:
        for k in range(601):
            stamp = START + k * 5 * 10**6
            rate = np.eye(3)[min(k // 200, 2)] * RATE
            if imu:
                bag.imu("/imu", stamp, "imu", rate, np.array([0.0, 0.0, 9.81]))
            if k % 100 == 50:
                bag.image("/cam/image_raw", stamp, "cam", "mono8", pixels)


def described(path: Path, *sensors: str, **spec: Any) -> DatasetEntry:
    known = {
        "camera": {"type": "Camera", "topic": "/cam/image_raw", "camera": CAMERA, "T_body_sensor": TURNED},
        "imu": {"type": "Imu", "topic": "/imu", "T_body_sensor": np.diag([-1.0, -1.0, 1.0, 1.0]).tolist()},
    }
    body = {"recording": {"files": [{"path": path.name}]}, "sensors": {name: known[name] for name in sensors}}
    return DatasetEntry(
        Dataset.model_validate({"metadata": {"name": "turner"}, "spec": body | spec}), path.parent
    )


def test_images_are_blurred_by_the_gyro_in_its_direction(tmp_path: Path) -> None:
    path = tmp_path / "turner.bag"
    recorded(path, imu=True)
    entry = described(path, "camera", "imu")
    # The mode has no IMU; the dataset has.
    plain, variant = (
        make(entry, [Role.CAMERA], tmp_path, one) for one in (None, {"images": {"motionBlur": 50}})
    )
    before, after = (read(one.path)["/cam/image_raw"] for one in (plain, variant))
    assert stamps(after).tolist() == stamps(before).tolist()
    turn = RATE * 0.05
    # Body x is the camera's -y, body y its x; the IMU's x and y are against the body's.
    ways = [(-40 * turn, 0.0)] * 2 + [(0.0, -30 * turn)] * 2 + [(0.0, 0.0)] * 2
    for was, now, way in zip(before, after, ways, strict=True):
        expected = image_pixels(was, "")
        if any(way):
            expected = cv2.filter2D(expected, -1, trace_of(*way), borderType=cv2.BORDER_REPLICATE)
        assert image_pixels(now, "").tolist() == np.asarray(expected).tolist()
    assert variant.key != make(entry, [Role.CAMERA], tmp_path, {"images": {"motionBlur": 20}}).key


def test_without_an_imu_ground_truth_says_how_it_turned(camera_entries: Any) -> None:
    entry = camera_entries[1.0]
    sensor = entry.dataset.spec.sensors["left"]
    # Depth is taken 20 ms after colour, and the truth has a pose of each.
    at = np.array([3.51])
    with open_recording(entry.dataset, entry.root) as recording:
        motion = ImageMotion(entry, recording)
        found = motion.over(sensor, (START + at * 1e9).astype(np.int64), 0.02)
    assert motion.source == "groundTruth"
    spec = SyntheticRecording.model_validate({"sensors": ["Stereo"], "durationSeconds": 7, "loops": 0.1})
    turns = SyntheticMotion(spec).at(at).angular_rate @ np.array(sensor.T_body_sensor)[:3, :3] * 0.02
    expected = np.column_stack([-sensor.camera.fx * turns[:, 1], sensor.camera.fy * turns[:, 0]])
    assert np.linalg.norm(expected, axis=1).min() > 0.1
    assert found == pytest.approx(expected, rel=0.01, abs=1e-3)


def test_where_nothing_says_how_it_turned_it_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "turner.bag"
    recorded(path, imu=False)
    wanted = {"images": {"motionBlur": 10}}
    with pytest.raises(InputError, match="nothing says how turner turns: it has no IMU, and no ground truth"):
        make(described(path, "camera"), [Role.CAMERA], tmp_path, wanted)
    (tmp_path / "truth.txt").write_text("".join(f"{1.6e9 + k} 0 0 0 0 0 0 1\n" for k in range(20)))
    unturned = described(path, "camera", groundTruth={"file": "truth.txt"})
    with pytest.raises(DataError, match="nothing says how turner turns: no IMU whose rates aren't all alike"):
        make(unturned, [Role.CAMERA], tmp_path, wanted)


def test_without_a_focal_length_it_is_refused(tmp_path: Path, bag_entry: Any) -> None:
    path = tmp_path / "turner.bag"
    recorded(path, imu=True)
    entry = described(path, "camera", "imu")
    sensor = entry.dataset.spec.sensors["camera"].replace(camera=None)
    spec = entry.dataset.spec.model_copy(update={"sensors": entry.dataset.spec.sensors | {"camera": sensor}})
    bare = DatasetEntry(entry.dataset.model_copy(update={"spec": spec}), entry.root)
    with pytest.raises(InputError, match=r"sensors\.camera\.camera isn't stated, whose focal length"):
        make(bare, [Role.CAMERA], tmp_path, {"images": {"motionBlur": 10}})


def test_outside_of_what_the_gyro_knows_images_stay(tmp_path: Path) -> None:
    path = tmp_path / "turner.bag"
    recorded(path, imu=True)
    entry = described(path, "camera", "imu")
    with open_recording(entry.dataset, entry.root) as recording:
        motion = ImageMotion(entry, recording)
        late = np.array([START - 10**9, START + 10**8, START + 4 * 10**9])
        ways = motion.over(entry.dataset.spec.sensors["camera"], late, 0.02)
    assert (np.linalg.norm(ways, axis=1) > 0).tolist() == [False, True, False]
    still = Shutter(ImagesPerturbation(motion_blur=20), lambda *_: np.random.default_rng(1), ways)
    pixels = np.arange(48, dtype=np.uint8).reshape(6, 8)
    assert still.disturbed(pixels, 0, 0).tolist() == pixels.tolist()
