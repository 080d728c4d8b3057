# SPDX-License-Identifier: Apache-2.0
"""Sequences of KITTI odometry: a small one in the real layout, real poses, and one of our own export."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from layouts.kitti import FRAMES, P0, SECOND, TR, write_sequence

from slamhive.data.importers import ImportOptions, import_recording, layout_module
from slamhive.data.making.exporting import all_roles, export_dataset
from slamhive.data.recordings.repairing import open_recording
from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.algorithm import DataFormat
from slamhive.model.errors import DataError, InputError
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role, Stamp
from slamhive_eval import read_kitti

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def test_a_sequence(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_sequence(tmp_path / "kitti", cameras=(0, 1, 2, 3))
    found = take_in(tmp_path / "kitti", "Kitti")
    assert [*found.spec.sensors] == ["left", "right", "camera2", "camera3", "lidar"]
    right = found.spec.sensors["right"]
    assert right.T_body_sensor[0][3] == pytest.approx(386.1448 / 718.856 + 0.003 * 32 / 718.856, rel=1e-6)
    assert right.T_body_sensor[2][3] == -0.003
    assert found.spec.sensors["left"].T_body_sensor == np.eye(4).tolist()
    assert (right.camera.fx, right.camera.cy, right.camera.width) == (718.856, 11.0, 80)
    for name, number in (("left", 0), ("right", 1), ("camera3", 3)):
        images = found.messages(name)
        assert [stamp for stamp, _ in images] == [SECOND + k * SECOND // 10 for k in range(FRAMES)]
        assert [pixels.flat[0] for _, pixels in images] == [10 * k + number for k in range(FRAMES)]
    assert found.spec.sensors["camera3"].camera.encoding == "bgr8"
    lidar = found.spec.sensors["lidar"]
    assert np.array(lidar.T_body_sensor)[:3].ravel().tolist() == [float(word) for word in TR.split()]
    clouds = found.messages("lidar")
    assert clouds[5][1].tobytes() == (folder / "velodyne" / "000005.bin").read_bytes()
    truth = ground_truth(found.entry)
    assert truth.poses.positions.tolist() == [[0.5, 0, k] for k in range(FRAMES)]
    assert truth.poses.stamps.tolist() == [1 + k / 10 for k in range(FRAMES)]


def test_clouds_are_deskewed_so_points_have_no_times(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    found = take_in(write_sequence(tmp_path), "Kitti")
    lidar = found.spec.sensors["lidar"]
    assert (lidar.stamp, lidar.lidar.time_field, lidar.lidar.rings) == (Stamp.SAMPLE, None, 64)
    assert "deskewed already" in found.notes
    assert "0.205°" in found.notes


def test_times_from_0_get_a_second(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    found = take_in(write_sequence(tmp_path), "Kitti")
    assert "1 s was added" in found.notes
    folder = write_sequence(tmp_path / "own")
    (folder / "times.txt").write_text("".join(f"1.7000000{k}1e+09\n" for k in range(FRAMES)))
    later = take_in(folder, "Kitti")
    assert later.stamps("left")[:2] == [1700000001 * SECOND, 1700000011 * SECOND]
    assert "added" not in later.notes


def test_a_missing_image_moves_no_other(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_sequence(tmp_path)
    (folder / "image_1" / "000002.png").unlink()
    found = take_in(folder, "Kitti")
    assert "image_1: 1 of 6 frames have no file (the first is 000002.png)" in found.notes
    right = found.messages("right")
    assert [stamp for stamp, _ in right] == [SECOND + k * SECOND // 10 for k in (0, 1, 3, 4, 5)]
    assert [pixels.flat[0] for _, pixels in right] == [1, 11, 31, 41, 51]
    assert len(found.stamps("left")) == 6


def test_a_stamp_that_steps_back(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_sequence(tmp_path)
    (folder / "poses.txt").write_text("")
    times = [f"{0.1 * k:.6e}\n" for k in range(FRAMES)]
    (folder / "times.txt").write_text("".join(times[:3] + times[1:2] + times[4:]))
    with pytest.raises(
        DataError, match=r"1 of 6 stamps of frames .*\(the first is line 4\); stamps must asc"
    ):
        take_in(folder, "Kitti")


def test_sequences_are_chosen(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    write_sequence(tmp_path, "07")
    write_sequence(tmp_path, "11")
    (tmp_path / "poses" / "11.txt").unlink()
    with pytest.raises(InputError, match="choose one of: 07, 11"):
        take_in(tmp_path, "Kitti")
    with pytest.raises(InputError, match=r"no sequence .08. in it; it has: 07, 11"):
        take_in(tmp_path, "Kitti", "08")
    found = take_in(tmp_path, "Kitti", "11")
    assert found.spec.ground_truth is None
    assert "KITTI has it of 00 to 10" in found.notes


@pytest.mark.parametrize(
    ("path", "text", "words"),
    [
        ("calib.txt", None, r"calib.txt: No such file"),
        ("times.txt", None, r"times.txt: No such file"),
        ("calib.txt", "P0: 1 2 3\n", r"calib.txt, line 1: P0: 12 numbers are needed, found '1 2 3'"),
        ("calib.txt", f"P0: {P0.format(0, 0, 0)}\nP1: {P0.format(0, 0, 0)}\n", "no line 'Tr'"),
        ("calib.txt", P0, "no line 'P0'"),
        ("times.txt", "0\n0.1\n", r"000005.\w+: frame 5 has no line in times.txt, which has 2"),
        ("times.txt", "0\nx\n", "times.txt, line 2: 'x' is not a time"),
        ("velodyne/000003.bin", "12345", "5 bytes are no whole number of points of 16"),
        ("image_0/000003.png", "no image", "can't be decoded"),
        ("image_0/left.png", "", "its name is no number"),
        ("../../poses/08.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "1 poses, but 6 times"),
        ("../../poses/08.txt", "2 0 0 0 0 1 0 0 0 0 1 0\n" * 6, "pose 1 of 6 has no rotation matrix"),
    ],
)
def test_what_is_wrong_is_named(
    tmp_path: Path, take_in: Callable[..., Any], path: str, text: str | None, words: str
) -> None:
    folder = write_sequence(tmp_path)
    (folder / path).unlink() if text is None else (folder / path).write_text(text)
    with pytest.raises(DataError, match=words):
        take_in(folder, "Kitti")


def test_calibration_that_is_not_the_images(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_sequence(tmp_path)
    text = (folder / "calib.txt").read_text()
    (folder / "calib.txt").write_text(text.replace("3.2e+01", "6.07e+02"))
    with pytest.raises(DataError, match=r"principal point \(607, 11\) can't be those of .* 80×24 pixels"):
        take_in(folder, "Kitti")
    (folder / "calib.txt").write_text(text)
    cv2.imwrite(str(folder / "image_0" / "000004.png"), np.zeros((24, 40), dtype=np.uint8))
    with pytest.raises(DataError, match=r"000004\.png: 40×24 mono8"):
        take_in(folder, "Kitti")


def test_poses_of_the_real_sequence_00(shared: Path, tmp_path: Path) -> None:
    real, folder = shared / "trajectories", write_sequence(tmp_path, "00")
    (folder / "times.txt").write_bytes((real / "KITTI_00_gt_times.txt").read_bytes())
    (tmp_path / "poses" / "00.txt").write_bytes((real / "KITTI_00_gt.txt").read_bytes())
    dataset, notes = import_recording(folder, tmp_path / "out", "a", "Kitti")
    truth = ground_truth(_entry(dataset, tmp_path / "out")).poses
    expected = read_kitti(real / "KITTI_00_gt.txt", real / "KITTI_00_gt_times.txt")
    assert truth.positions.tolist() == expected.positions.tolist()
    assert np.abs(truth.quaternions - expected.quaternions).max() < 1e-12
    assert np.abs(truth.stamps - 1 - expected.stamps).max() < 1e-9
    assert "4535 of 4541 frames have no file" in " ".join(notes)


def _entry(dataset: Any, folder: Path) -> Any:
    from slamhive.data.recordings.entries import DatasetEntry

    return DatasetEntry(dataset, folder)


def _export(entry: Any, folder: Path) -> Any:
    truth = ground_truth(entry)
    roles = all_roles(entry, DataFormat.KITTI)
    return export_dataset(entry, roles, InputOptions(), DataFormat.KITTI, folder, truth=truth)


def test_an_exported_lidar_recording_comes_back(
    lidar_entry: Any, tmp_path: Path, take_in: Callable[..., Any]
) -> None:
    _export(lidar_entry, tmp_path / "export")
    found = take_in(tmp_path / "export", "Kitti")
    before, after = lidar_entry.dataset.spec.sensors["lidar"], found.spec.sensors["lidar"]
    assert after.lidar == before.lidar.replace(time_field=None, ring_field=None)
    assert after.stamp == before.stamp
    with open_recording(lidar_entry.dataset, lidar_entry.root) as recording:
        from slamhive.data.recordings.clouds import cloud_points

        original = []
        for connection, _, raw in recording.messages([before.topic]):
            message = recording.decode(raw, connection.msgtype)
            stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
            original.append((stamp, cloud_points(message, "scan")))
    again = found.messages("lidar")
    assert [stamp for stamp, _ in again] == [stamp for stamp, _ in original]
    for (_, one), (_, other) in zip(original, again, strict=True):
        assert all(np.array_equal(one[name], other[name]) for name in "xyz")
    _require_same_poses(lidar_entry, found, np.array(before.T_body_sensor))


@pytest.mark.slow
def test_an_exported_stereo_recording_comes_back(
    camera_entries: Any, tmp_path: Path, take_in: Callable[..., Any]
) -> None:
    entry = camera_entries[0.5]
    made = _export(entry, tmp_path / "export")  # whose cameras are rectified
    found = take_in(tmp_path / "export", "Kitti")
    assert {*found.spec.sensors} == {"left", "right"}
    for name, folder in (("left", "image_2"), ("right", "image_3")):
        before, after = made.views[Role(name)], found.spec.sensors[name]
        place = tmp_path / "export" / folder
        place = place if place.is_dir() else tmp_path / "export" / folder.replace("2", "0").replace("3", "1")
        files = sorted(place.iterdir())
        images = found.messages(name)
        assert len(images) == len(files)
        for path, (_, pixels) in zip(files, images, strict=True):
            assert np.array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), pixels)
        assert after.camera.fx == pytest.approx(before.camera.fx, rel=1e-12)
        assert after.camera.cx == pytest.approx(before.camera.cx, abs=1e-9)
    baseline = found.spec.sensors["right"].T_body_sensor[0][3]
    poses = [np.array(made.views[Role(name)].T_body_sensor) for name in ("left", "right")]
    assert baseline == pytest.approx((np.linalg.inv(poses[0]) @ poses[1])[0, 3], abs=1e-9)
    _require_same_poses(entry, found, poses[0])


def _require_same_poses(entry: Any, found: Any, first: Any) -> None:
    """Check that both datasets' truth gives the same poses of the sensor that the import has as its body."""
    before, after = ground_truth(entry), ground_truth(found.entry)
    expected = before.poses.moved(np.linalg.inv(before.T_body_frame) @ first)
    body = after.poses.moved(np.linalg.inv(after.T_body_frame))
    assert body.stamps.tolist() == expected.stamps.tolist()
    assert np.abs(body.positions - expected.positions).max() < 1e-9
    assert np.abs(body.matrices - expected.matrices).max() < 1e-9


def test_a_sequence_is_added_by_its_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from typer.testing import CliRunner

    from slamhive.cli.datasets import app

    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    write_sequence(tmp_path / "kitti", "07")
    write_sequence(tmp_path / "kitti", "08")
    order = ["add", str(tmp_path / "kitti"), "--name", "kitti-08", "--sequence", "08"]
    result = CliRunner().invoke(app, order, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert "deskewed already" in " ".join(result.output.split())
    assert "kitti-08" in CliRunner().invoke(app, ["list"]).output


def test_images_of_16_bits_become_8(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_sequence(tmp_path, cameras=(0,))
    for k in range(FRAMES):
        pixels = np.full((24, 80), (50 + k) * 256 + 7, dtype=np.uint16)
        cv2.imwrite(str(folder / "image_0" / f"{k:06}.png"), pixels)
    found = take_in(folder, "Kitti")
    assert found.spec.sensors["camera"].camera.encoding == "mono8"
    assert "image_0: images of 16 bits become images of 8" in found.notes
    assert [pixels.flat[0] for _, pixels in found.messages("camera")] == [50 + k for k in range(FRAMES)]


def test_poses_with_the_numbers_of_their_frames(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_sequence(tmp_path)
    path = tmp_path / "poses" / "08.txt"
    lines = [f"{k} {line}" for k, line in enumerate(path.read_text().splitlines()) if k != 2]
    path.write_text("\n".join(lines) + "\n")
    truth = ground_truth(take_in(folder, "Kitti").entry)
    assert truth.poses.positions.tolist() == [[0.5, 0, k] for k in (0, 1, 3, 4, 5)]
    assert truth.poses.stamps.tolist() == pytest.approx([1 + k / 10 for k in (0, 1, 3, 4, 5)])
    path.write_text("\n".join([*lines, lines[-1].replace("5 ", "9 ", 1)]) + "\n")
    with pytest.raises(
        DataError, match=r"08.txt, line 6: frame 9: expected ascending .* from 0 to 5, as .* 6"
    ):
        layout_module("Kitti").read(folder, ImportOptions())
