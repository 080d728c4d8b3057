# SPDX-License-Identifier: Apache-2.0
"""Folders in EuRoC's layout, as EuRoC, TUM VI, Monado and LaMAria publish them, and their traps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from layouts.asl import CAMCHAIN, MOCAP, START, lamaria_calibration, lamaria_truth, monado, tum_vi

from slamhive.data.importers import ImportOptions, layout_module, layout_of
from slamhive.data.inspecting.inspection import inspect
from slamhive.data.making.exporting import export_dataset
from slamhive.data.making.preparation import prepare
from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.errors import DataError, InputError
from slamhive.model.formats import DataFormat
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role

if TYPE_CHECKING:
    from pathlib import Path

STEREO = (Role.LEFT, Role.RIGHT)


def test_tum_vi(asl: Any, imported: Any, tmp_path: Path) -> None:
    found = imported(tum_vi(asl, tmp_path / "room1"), "Euroc")
    left = found.sensors["left"]
    assert left.camera.distortion == "Equidistant"
    assert (left.camera.fx, left.camera.cy, left.camera.encoding) == (5.1, 2.4, "mono8")
    # The chain says where the IMU is in the camera; p_cam = T_cam_imu p_imu of the camera's centre is 0.
    pose = np.array(left.T_body_sensor)
    assert pose[:3, 3] == pytest.approx([0.2, -0.1, -0.3])
    assert pose[:3, 0] == pytest.approx([0, 1, 0])
    assert (left.time_offset, left.rate) == (0.004, 20.0)
    assert found.sensors["imu"].imu.gyroscope_random_walk == 2.2e-5
    assert len(ground_truth(found.entry).poses) == 48
    assert inspect(found.entry).errors == []


def test_images_of_16_bits_become_8(asl: Any, imported: Any, tmp_path: Path) -> None:
    found = imported(tum_vi(asl, tmp_path / "room1"), "Euroc")
    assert found.first_pixels("left") == [1, 2, 3, 4, 5, 6, 7, 8]
    assert "cam0: images of 16 bits become images of 8" in found.notes
    for form in (DataFormat.EUROC, DataFormat.KITTI):
        variant = prepare(found.entry, STEREO, InputOptions(), [form], tmp_path / form)
        assert variant.sensors[Role.LEFT].camera.encoding == "mono8"


def test_monado(asl: Any, imported: Any, tmp_path: Path) -> None:
    found = imported(monado(asl, tmp_path / "MIO01"), "Euroc")
    left = found.sensors["left"]
    assert (left.camera.distortion, left.camera.coefficients) == ("Equidistant", [0.1, 0.2, 0.3, 0.4])
    pose = np.array(left.T_body_sensor)
    assert pose[:3, 3].tolist() == [0.1, 0.2, 0.3]
    assert np.allclose(np.diag(pose), [-1, -1, 1, 1])
    assert found.sensors["imu"].imu.accelerometer_noise == 0.016
    assert (found.sensors["imu"].rate, left.time_offset) == (1000.0, 0.002)
    assert ground_truth(found.entry).poses.quaternions[0].tolist() == [0.5, 0.5, 0.5, 0.5]


def test_a_camera_of_monado_that_is_not_known(asl: Any, imported: Any, tmp_path: Path) -> None:
    folder = monado(asl, tmp_path / "MIO01")
    text = (folder / "calibration.json").read_text()
    (folder / "calibration.json").write_text(text.replace("kb4", "ds"))
    with pytest.raises(DataError, match=r"calibration\.json: camera_type 'ds' is not known; allowed: kb4"):
        imported(folder, "Euroc")


def test_lamaria(asl: Any, imported: Any, tmp_path: Path) -> None:
    folder = asl(tmp_path / "R_01", base="aria")
    (folder / "pinhole_calibrations").mkdir()
    (folder / "pinhole_calibrations" / "R_01.json").write_text(lamaria_calibration())
    (folder / "ground_truth" / "pGT").mkdir(parents=True)
    (folder / "ground_truth" / "pGT" / "R_01.txt").write_text(lamaria_truth())
    (folder / "ground_truth" / "control_points").mkdir()
    found = imported(folder, "Euroc")
    assert "control points are left out: they are seen in images" in found.notes
    assert found.sensors["left"].camera.distortion == "None"
    assert np.allclose(np.diag(np.array(found.sensors["left"].T_body_sensor)), [-1, -1, 1, 1])
    assert ground_truth(found.entry).poses.stamps[0] == pytest.approx(START / 1e9)
    assert "imu0: its noise is not stated" in found.notes
    assert inspect(found.entry).errors == []


@pytest.mark.parametrize("form", [DataFormat.EUROC, DataFormat.KITTI])
def test_stereo_is_paired_by_stamp_in_folders(
    euroc: Any, imported: Any, tmp_path: Path, form: DataFormat
) -> None:
    # As in V2_03: the right camera misses images in the midst, so its rows are others than the left one's.
    found = imported(euroc(tmp_path / "V2_03", missing={(1, 2), (1, 3), (0, 6)}), "Euroc")
    assert found.first_pixels("right") == [1, 2, 5, 6, 7, 8]
    assert "left and right have 7 and 6 images; 2 and 1 of them have no partner" in found.notes
    variant = prepare(found.entry, STEREO, InputOptions(), [form], tmp_path / "cache")
    folders = ("mav0/cam0/data", "mav0/cam1/data") if form is DataFormat.EUROC else ("image_0", "image_1")
    left, right = (sorted((variant.path / folder).glob("*.png")) for folder in folders)
    assert [path.name for path in left] == [path.name for path in right]
    values = [[int(cv2.imread(str(path), 0)[3, 4]) for path in paths] for paths in (left, right)]
    assert values == [[1, 2, 5, 6, 8], [1, 2, 5, 6, 8]]
    assert variant.frames == 5


@pytest.mark.parametrize("rate", [None, 10.0])
def test_stereo_is_paired_by_stamp_in_bags(
    euroc: Any, imported: Any, tmp_path: Path, rate: float | None
) -> None:
    found = imported(euroc(tmp_path / "V2_03", missing={(1, 2), (1, 3)}), "Euroc")
    options = InputOptions(frame_rate=rate)
    variant = prepare(found.entry, STEREO, options, [DataFormat.ROSBAG1], tmp_path / "cache")
    left, right = (
        {stamp: int(message.data[0]) for stamp, message in found.messages(name, variant.path)}
        for name in ("left", "right")
    )
    # Its own stamp stays with each image: a node that synchronises by stamps gets what belongs together.
    partners = {stamp - 1000: value for stamp, value in right.items()}
    assert all(left[stamp] == value for stamp, value in partners.items())
    if rate is not None:
        assert partners.keys() == left.keys()


def test_missing_images_are_left_out_and_named(euroc: Any, imported: Any, tmp_path: Path) -> None:
    folder = euroc(tmp_path / "mh")
    gone = folder / "mav0" / "cam0" / "data" / f"{START + 100_000_000}.png"
    gone.unlink()
    found = imported(folder, "Euroc")
    assert found.first_pixels("left") == [1, 2, 4, 5, 6, 7, 8]
    assert f"cam0/data.csv: 1 of 8 images do not exist and are left out: {gone.name}" in found.notes


def test_a_folder_without_most_of_its_images(euroc: Any, imported: Any, tmp_path: Path) -> None:
    folder = euroc(tmp_path / "mh")
    for path in sorted((folder / "mav0" / "cam1" / "data").iterdir())[3:]:
        path.unlink()
    with pytest.raises(DataError, match=r"line 5: .*does not exist, nor do 4 others of the 8 images"):
        imported(folder, "Euroc")


def test_headers_with_spaces_and_stamps_in_scientific_notation(
    euroc: Any, imported: Any, tmp_path: Path
) -> None:
    folder = euroc(tmp_path / "mh")
    digits = [str(START + 5_000_000 * k) for k in range(10)]
    rows = [f"{text[0]}.{text[1:]}e+18 1 2 3 4 5 {k}" for k, text in enumerate(digits)]
    head = "timestamp [ns]  w_x [rad s^-1]  w_y  w_z  a_x  a_y  a_z\n"
    (folder / "mav0" / "imu0" / "data.csv").write_text(head + "\n".join(rows) + "\n")
    found = imported(folder, "Euroc")
    assert found.stamps("imu") == [START + 5_000_000 * k for k in range(10)]
    assert [message.linear_acceleration.z for _, message in found.messages("imu")] == list(range(10))


@pytest.mark.parametrize(
    ("separator", "head", "more"),
    [
        (",", "\ufeff", ""),
        (";", "stamp;file\r\n", ""),
        (",", "#timestamp,filename,exposure\n", ",0.012,7"),
        (" ", "", " 0.012 7"),
    ],
)
def test_lists_that_others_wrote(
    euroc: Any, imported: Any, tmp_path: Path, *, separator: str, head: str, more: str
) -> None:
    folder = euroc(tmp_path / "mh")
    for name in ("cam0", "imu0"):
        path = folder / "mav0" / name / "data.csv"
        rows = path.read_text().splitlines()[1:]
        end = "\r\n" if "\r" in head else "\n"
        lines = [row.replace(",", separator) + more for row in rows]
        path.write_bytes((head + end.join(lines) + end).encode())
    found = imported(folder, "Euroc")
    assert found.first_pixels("left") == [1, 2, 3, 4, 5, 6, 7, 8]
    assert found.stamps("left") == [START + 50_000_000 * k for k in range(8)]
    assert found.stamps("imu")[0] == START


def test_names_of_images_with_spaces(euroc: Any, imported: Any, tmp_path: Path) -> None:
    folder = euroc(tmp_path / "mh")
    path = folder / "mav0" / "cam0" / "data.csv"
    for image in path.with_name("data").iterdir():
        image.rename(image.with_name(f"frame {image.name}"))
    path.write_text(path.read_text().replace(",1", ",frame 1"))
    assert imported(folder, "Euroc").first_pixels("left") == [1, 2, 3, 4, 5, 6, 7, 8]


def test_rows_out_of_order_are_sorted(euroc: Any, imported: Any, tmp_path: Path) -> None:
    folder = euroc(tmp_path / "mh")
    path = folder / "mav0" / "cam0" / "data.csv"
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *rows[4:], *rows[:4]]) + "\n")
    left = layout_module("Euroc").read(folder, ImportOptions()).streams[0]
    assert left.stamps.tolist() == [START + 50_000_000 * k for k in range(8)]
    found = imported(folder, "Euroc")
    assert found.first_pixels("left") == [1, 2, 3, 4, 5, 6, 7, 8]
    assert "1 rows are stamped before the one above them; sorted by time" in found.notes


@pytest.mark.parametrize(
    ("gone", "words"),
    [
        ("mav0/cam1/data.csv", r"cam1/data.csv does not exist: it lists the images and their stamps"),
        ("mav0/imu0/data.csv", r"imu0/data.csv does not exist: it lists the samples"),
        (
            "mav0/cam1/sensor.yaml",
            r"cam1/sensor.yaml does not exist, and there is no calibration of all .*TUM",
        ),
    ],
)
def test_nearly_the_layout(euroc: Any, imported: Any, tmp_path: Path, gone: str, words: str) -> None:
    folder = euroc(tmp_path / "mh")
    (folder / gone).unlink()
    with pytest.raises(DataError, match=words):
        imported(folder, "Euroc")


@pytest.mark.parametrize(
    "case",
    [
        ("  - [0.0, 0.0, 0.0, 1.0]\n  camera", "  camera", "cam0.T_cam_imu: 16 numbers are needed, found 12"),
        ("T_cam_imu", "T_cn_cnm1", "cam0: T_cam_imu is missing"),
        ("equidistant", "fov", "distortion_model 'fov' is not known; allowed: .* radtan"),
        ("cam1:", "cam2:", "camchain.yaml: cam1 is missing"),
        ("[8, 6]", "[8, 7]", r"8×6 mono8, but .*camchain.yaml and the first image say 8×7"),
    ],
)
def test_a_camchain_that_does_not_fit(
    asl: Any, imported: Any, tmp_path: Path, case: tuple[str, str, str]
) -> None:
    before, after, words = case
    folder = tum_vi(asl, tmp_path / "room1")
    (folder / "dso" / "camchain.yaml").write_text(CAMCHAIN.replace(before, after, 1))
    with pytest.raises(DataError, match=words):
        imported(folder, "Euroc")


def test_ground_truth_of_the_start_and_the_end_alone(asl: Any, imported: Any, tmp_path: Path) -> None:
    folder = tum_vi(asl, tmp_path / "corridor1")
    rows = [f"{START + 10**9 * t},{t},0,0,1,0,0,0" for t in (0, 1, 60, 61)]
    (folder / "mav0" / "mocap0" / "data.csv").write_text(MOCAP + "\n".join(rows) + "\n")
    assert "ground truth has no poses from 1 to 60 s of the recording" in imported(folder, "Euroc").notes


def test_poses_of_markers_are_no_ground_truth(euroc: Any, imported: Any, tmp_path: Path) -> None:
    folder = euroc(tmp_path / "mh")
    (folder / "mav0" / "leica0").mkdir()
    found = imported(folder, "Euroc")
    assert found.dataset.spec.ground_truth is None
    assert "leica0 hold poses of a marker, not of the body" in found.notes


def test_v1_01_has_a_better_ground_truth_elsewhere(euroc: Any, imported: Any, tmp_path: Path) -> None:
    folder = euroc(tmp_path / "V1_01_easy")
    (folder / "mav0" / "state_groundtruth_estimate0").mkdir()
    rows = [f"{START + 5_000_000 * k},{k},0,0,1,0,0,0,0,0,0,0,0,0,0,0,0" for k in range(4)]
    path = folder / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    path.write_text("#timestamp, p_RS_R_x [m]\n" + "\n".join(rows) + "\n")
    (folder / "groundtruth.txt").write_text("another")
    found = imported(folder, "Euroc")
    taken = "groundTruth: mav0/state_groundtruth_estimate0/data.csv is taken; there is groundtruth.txt, too"
    assert taken in found.notes
    assert "orientation of V1_01's published ground truth is inaccurate" in found.notes
    assert len(ground_truth(found.entry).poses) == 4


def test_a_generated_recording_comes_back_from_euroc(
    camera_entries: Any, imported: Any, tmp_path: Path
) -> None:
    entry, roles = camera_entries[0.5], (*STEREO, Role.IMU)
    roles = tuple(role for role in roles if role in entry.dataset.spec.sensors)
    truth = ground_truth(entry)
    made = export_dataset(entry, roles, InputOptions(), DataFormat.EUROC, tmp_path / "hall", truth=truth)
    found = imported(tmp_path / "hall", "Euroc")
    exported = sorted((tmp_path / "hall" / "mav0" / "cam0" / "data").glob("*.png"))
    assert len(exported) == made.selection.frames(made.selection.primary)
    for role in STEREO:
        view, again = made.views[role], found.sensors[role]
        assert again.camera == view.camera
        assert np.allclose(again.T_body_sensor, view.T_body_sensor, atol=0)
        assert len(found.stamps(role)) == len(exported)
    assert found.stamps("left") == made.selection.stamps.tolist()
    for path, pixels in zip(exported, found.pixels("left"), strict=True):
        assert (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) == pixels).all()
    assert np.array_equal(ground_truth(found.entry).poses.positions, truth.poses.positions)
    assert found.notes == ""


def test_one_of_several_sequences(euroc: Any, tmp_path: Path) -> None:
    for name in ("MH_01", "MH_02"):
        euroc(tmp_path / "hall" / name)
    assert layout_of(tmp_path / "hall") == "Euroc"
    read = layout_module("Euroc").read
    assert len(read(tmp_path / "hall", ImportOptions(sequence="MH_02")).streams) == 3
    with pytest.raises(InputError, match=r"several sequences in it; choose .* by --sequence: MH_01, MH_02"):
        read(tmp_path / "hall", ImportOptions())
    with pytest.raises(InputError, match="no sequence 'MH_03' in it"):
        read(tmp_path / "hall", ImportOptions(sequence="MH_03"))


def test_what_fails_leaves_nothing(euroc: Any, imported: Any, tmp_path: Path) -> None:
    folder = euroc(tmp_path / "mh")
    last = max((folder / "mav0" / "cam1" / "data").iterdir())
    last.write_bytes(b"no image")
    with pytest.raises(DataError, match=f"{last.name}: can't be decoded as an image"):
        imported(folder, "Euroc")
    assert [path.name for path in tmp_path.iterdir() if not path.name.endswith(".lock")] == ["mh"]
