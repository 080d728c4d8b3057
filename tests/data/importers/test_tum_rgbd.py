# SPDX-License-Identifier: Apache-2.0
"""Folders in TUM RGB-D's layout, as TUM, Bonn, ETH3D, ICL-NUIM and OpenLORIS publish them: their traps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from layouts.tum_rgbd import DELAYS, eth3d, icl, loris, rgbd

from slamhive.data.importers import layout_of
from slamhive.data.inspecting.inspection import inspect
from slamhive.data.making.exporting import export_dataset
from slamhive.data.making.preparation import prepare
from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.errors import DataError
from slamhive.model.formats import DataFormat
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role
from slamhive_eval import read_tum
from slamhive_eval.rotation import to_matrix

if TYPE_CHECKING:
    from pathlib import Path

RGBD = (Role.COLOR, Role.DEPTH)


@pytest.mark.parametrize(
    "case",
    [
        ("rgbd_dataset_freiburg1_xyz", "", 517.306408, 0.262383),
        ("rgbd_dataset_freiburg2_desk_validation", "", 520.908620, 0.231222),
        ("fr3_office", "", 535.4, None),
        ("renamed", "rgbd_dataset_freiburg2_desk.bag", 520.908620, 0.231222),
        ("rgbd_bonn_balloon", "", 542.822841, 0.039903),
    ],
)
def test_cameras_are_known_by_name(
    png: Any, imported: Any, tmp_path: Path, case: tuple[str, str, float, float | None]
) -> None:
    name, comment, fx, k1 = case
    found = imported(rgbd(png, tmp_path / name, comment=comment), "TumRgbd")
    for role in RGBD:
        camera = found.sensors[role].camera
        assert camera.fx == fx
        assert camera.coefficients[:1] == ([] if k1 is None else [k1])
    assert (found.sensors["depth"].camera.depth_scale, found.sensors["depth"].camera.encoding) == (
        5000,
        "16UC1",
    )
    report = inspect(found.entry)
    assert report.errors == []
    assert report.ground_truth is not None


def test_colour_and_depth_keep_their_stamps_and_are_paired_by_them(
    png: Any, imported: Any, tmp_path: Path
) -> None:
    found = imported(rgbd(png, tmp_path / "fr1_xyz"), "TumRgbd")
    late = np.array(found.stamps("depth")) - np.array(found.stamps("color"))[:7]
    assert (late / 1e9).tolist() == pytest.approx(DELAYS, abs=1e-6)
    assert found.first_pixels("depth") == [1, 2, 3, 4, 5, 6, 7]
    variant = prepare(found.entry, RGBD, InputOptions(), [DataFormat.TUM], tmp_path / "cache")
    pairs = [line.split() for line in (variant.path / "associations.txt").read_text().splitlines()]
    # Frame 2 was measured nearer to the colour image after it: there is no depth for it.
    assert all(abs(float(pair[0]) - float(pair[2])) < 1 / 60 for pair in pairs)
    values = [[int(cv2.imread(str(variant.path / pair[k]), -1).flat[0]) for k in (1, 3)] for pair in pairs]
    assert len(values) >= 5
    assert all(color == depth or color == depth + 1 for color, depth in values)


def test_an_accelerometer_alone_is_no_imu(png: Any, imported: Any, tmp_path: Path) -> None:
    folder = rgbd(png, tmp_path / "fr1_xyz")
    (folder / "accelerometer.txt").write_text("# a\n1305031102.1 0 0 9.8\n")
    found = imported(folder, "TumRgbd")
    assert set(found.sensors) == {"color", "depth"}
    assert "accelerometer.txt is left out: without a gyroscope it is no IMU" in found.notes


def test_real_ground_truth_stays_what_it_is(png: Any, imported: Any, shared: Path, tmp_path: Path) -> None:
    folder = rgbd(png, tmp_path / "fr1_xyz")
    real = shared / "trajectories" / "freiburg1_xyz-groundtruth.txt"
    (folder / "groundtruth.txt").write_bytes(real.read_bytes())
    poses = ground_truth(imported(folder, "TumRgbd").entry).poses
    assert np.array_equal(poses.positions, read_tum(real).positions)
    assert np.diff(poses.stamps).min() < 0.02


def test_eth3d(png: Any, imported: Any, tmp_path: Path) -> None:
    found = imported(eth3d(png, tmp_path / "cables_1"), "TumRgbd")
    camera = found.sensors["color"].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (7.5, 7.6, 3.5, 2.5)
    assert (camera.width, camera.height, camera.distortion) == (8, 6, "None")


def test_eth3d_without_depth_and_ground_truth(png: Any, imported: Any, tmp_path: Path) -> None:
    folder = eth3d(png, tmp_path / "cables_1")
    for path in (folder / "depth").iterdir():
        path.unlink()
    (folder / "depth").rmdir()
    (folder / "depth.txt").unlink()
    (folder / "groundtruth.txt").unlink()
    found = imported(folder, "TumRgbd")
    assert set(found.sensors) == {"camera"}
    assert "no depth.txt and no folder depth: imported without depth" in found.notes
    assert "no groundtruth.txt" in found.notes


def test_eth3d_stereo(png: Any, imported: Any, tmp_path: Path) -> None:
    folder = eth3d(png, tmp_path / "cables_1")
    for path in (folder / "depth").iterdir():
        path.unlink()
    (folder / "depth").rmdir()
    (folder / "depth.txt").unlink()
    names = sorted(path.name for path in (folder / "rgb").iterdir())
    for k, name in enumerate(names):
        if k != 3:
            png(folder / "rgb2" / name, 100 + k)
    (folder / "calibration2.txt").write_text("7.1 7.2 3.1 2.1\n")
    (folder / "extrinsics_1_2.txt").write_text("1 0 0 -0.1\n0 1 0 0\n0 0 1 0\n")
    found = imported(folder, "TumRgbd")
    # The second camera is on the left; the file takes its points to the first one.
    assert found.sensors["left"].camera.fx == 7.1
    assert found.sensors["left"].T_body_sensor[0][3] == -0.1
    assert found.first_pixels("left") == [100, 101, 102, 104, 105, 106, 107]
    assert "rgb2: 1 of 8 images do not exist" in found.notes
    assert (found.sensors["right"].camera.fx, found.sensors["right"].T_body_sensor[0][3]) == (7.5, 0)


def test_icl_nuim_becomes_right_handed(png: Any, imported: Any, tmp_path: Path) -> None:
    found = imported(icl(png, tmp_path / "kt0"), "TumRgbd")
    published = np.loadtxt(tmp_path / "kt0" / "livingRoom0.gt.freiburg")
    poses, camera = ground_truth(found.entry).poses, found.sensors["color"].camera
    point = np.array([0.7, -0.4, 3.0])
    for row, position, quaternion in zip(published, poses.positions, poses.quaternions, strict=True):
        seen = to_matrix(row[None, 4:])[0].T @ (point - row[1:4])
        pixel = (481.20 * seen[0] / seen[2] + 319.5, -480.00 * seen[1] / seen[2] + 239.5)
        # The same point of the world, whose y axis points the other way now.
        here = to_matrix(quaternion[None])[0].T @ (point * [1, -1, 1] - position)
        again = (camera.fx * here[0] / here[2] + camera.cx, camera.fy * here[1] / here[2] + camera.cy)
        assert again == pytest.approx(pixel, abs=1e-6)
    assert "left-handed" in found.notes


def test_icl_nuim_s_frames_are_numbers(png: Any, imported: Any, tmp_path: Path) -> None:
    found = imported(icl(png, tmp_path / "kt0"), "TumRgbd")
    # In the order of their numbers, not of their names: 10.png is the last.
    assert found.first_pixels("color") == found.first_pixels("depth") == [1, 2, 3, 4, 10]
    stamps = np.array(found.stamps("color"))
    assert ((stamps - 10**9) * 30 / 1e9).tolist() == pytest.approx([1, 2, 3, 4, 10], abs=1e-6)
    assert ground_truth(found.entry).poses.stamps.tolist() == pytest.approx((stamps / 1e9).tolist())


def test_openloris(png: Any, imported: Any, tmp_path: Path) -> None:
    found = imported(loris(png, tmp_path / "cafe1-1"), "TumRgbd")
    camera = found.sensors["color"].camera
    assert (camera.fx, camera.cx, camera.fy, camera.cy) == (6.11, 4.33, 6.12, 2.49)
    assert found.sensors["depth"].camera.depth_scale == 1000
    # The IMU stands in the colour camera's frame, and that in base_link, whose poses the ground truth has.
    assert np.array(found.sensors["imu"].T_body_sensor)[:3, 3] == pytest.approx([0.4, -0.02, 1.2])
    assert found.dataset.spec.ground_truth.frame == "body"
    assert inspect(found.entry).errors == []


def test_forces_are_interpolated_at_the_stamps_of_the_gyroscope(
    png: Any, imported: Any, tmp_path: Path
) -> None:
    found = imported(loris(png, tmp_path / "cafe1-1"), "TumRgbd")
    messages = found.messages("imu")
    first = 1305031102 * 10**9
    assert messages[0][0] == first + 500_000
    for stamp, message in messages:
        assert message.linear_acceleration.x == pytest.approx((stamp - first) * 250 / 1e9, abs=1e-6)
        assert message.angular_velocity.z == pytest.approx((stamp - first + 2e6) * 400 / 1e9, abs=1e-3)


@pytest.mark.parametrize(
    ("gone", "words"),
    [
        ("depth.txt", "depth.txt does not exist: it lists the depth images"),
        ("rgb.txt", "rgb.txt does not exist: it lists the colour images"),
        ("calibration.txt", "no calibration: .*freiburg1, .* no calibration.txt, which holds fx fy cx cy"),
    ],
)
def test_nearly_the_layout(png: Any, imported: Any, tmp_path: Path, gone: str, words: str) -> None:
    folder = eth3d(png, tmp_path / "desk")
    (folder / gone).unlink()
    assert layout_of(folder) == "TumRgbd"
    with pytest.raises(DataError, match=words):
        imported(folder, "TumRgbd")


@pytest.mark.parametrize(
    ("gone", "words"),
    [
        ("aligned_depth.txt", "aligned_depth.txt does not exist"),
        ("trans_matrix.yaml", "trans_matrix.yaml does not exist: it holds the poses of sensors.yaml"),
        ("sensors.yaml", "sensors.yaml: No such file"),
    ],
)
def test_nearly_openloris(png: Any, imported: Any, tmp_path: Path, gone: str, words: str) -> None:
    folder = loris(png, tmp_path / "cafe1-1")
    (folder / gone).unlink()
    with pytest.raises(DataError, match=words):
        imported(folder, "TumRgbd")


def test_calibration_that_disagrees_with_the_images(png: Any, imported: Any, tmp_path: Path) -> None:
    folder = rgbd(png, tmp_path / "fr1_xyz", size=(6, 8))
    with pytest.raises(
        DataError, match=r"8×6 mono8, but the published calibration of TUM RGB-D .* say 640×480"
    ):
        imported(folder, "TumRgbd")


def test_depth_of_freiburg2_has_5000_units_a_metre(png: Any, imported: Any, tmp_path: Path) -> None:
    found = imported(rgbd(png, tmp_path / "rgbd_dataset_freiburg2_desk"), "TumRgbd", "two")
    assert found.sensors["depth"].camera.depth_scale == 5000
    assert "5208" in found.notes
    assert "5208" not in imported(rgbd(png, tmp_path / "rgbd_dataset_freiburg1_desk"), "TumRgbd").notes


@pytest.mark.parametrize(
    ("text", "wrong"),
    [("fx 7.5\nfy 7.6\n", r"needed and nothing else, found 'fx'"), ("7.5 7.5 3\n", "needed, found 3")],
)
def test_a_calibration_is_four_numbers(
    text: str, wrong: str, png: Any, imported: Any, tmp_path: Path
) -> None:
    folder = eth3d(png, tmp_path / "desk")
    (folder / "calibration.txt").write_text(text)
    with pytest.raises(DataError, match=rf"calibration\.txt: 4 numbers are {wrong}"):
        imported(folder, "TumRgbd")


def test_pictures_of_depth_are_refused(png: Any, imported: Any, tmp_path: Path) -> None:
    folder = eth3d(png, tmp_path / "desk")
    for path in (folder / "depth").iterdir():
        png(path, 5)
    with pytest.raises(DataError, match="one channel of 16 bits, not mono8"):
        imported(folder, "TumRgbd")


def test_missing_depth_is_left_out_and_named(png: Any, imported: Any, tmp_path: Path) -> None:
    folder = eth3d(png, tmp_path / "desk")
    gone = sorted((folder / "depth").iterdir())[2]
    gone.unlink()
    found = imported(folder, "TumRgbd")
    assert found.first_pixels("depth") == [1, 2, 4, 5, 6, 7]
    assert f"1 of 7 images do not exist and are left out: {gone.name}" in found.notes


def test_a_generated_recording_comes_back_from_tum(
    camera_entries: Any, imported: Any, tmp_path: Path
) -> None:
    entry, truth = camera_entries[0.5], ground_truth(camera_entries[0.5])
    made = export_dataset(entry, RGBD, InputOptions(), DataFormat.TUM, tmp_path / "desk", truth=truth)
    found = imported(tmp_path / "desk", "TumRgbd")
    for role, folder in zip(RGBD, ("rgb", "depth"), strict=True):
        assert found.sensors[role].camera == made.views[role].camera
        assert found.sensors[role].T_body_sensor == made.views[role].T_body_sensor
        files = sorted((tmp_path / "desk" / folder).iterdir())
        assert [f"{stamp // 10**9}.{stamp % 10**9:09}.png" for stamp in found.stamps(role)] == [
            path.name for path in files
        ]
        for path, pixels in zip(files, found.pixels(role), strict=True):
            assert (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) == pixels).all()
    assert np.array_equal(ground_truth(found.entry).poses.positions, truth.poses.positions)
