# SPDX-License-Identifier: Apache-2.0
"""Trajectories of TartanAir and scenes of Replica, which have depth and no stamps."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from layouts.dense import FRAMES, SECOND, write_images, write_scene, write_trajectory

from slamhive.data.importers import replica, tartanair
from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.errors import DataError
from slamhive_eval.rotation import to_matrix

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make TartanAir's images small."""
    lens = {"width": 16, "height": 12, "fx": 8.0, "fy": 8.0, "cx": 8.0, "cy": 6.0}
    versions = tuple(version._replace(lens=lens) for version in tartanair.VERSIONS)
    monkeypatch.setattr(tartanair, "VERSIONS", versions)


@pytest.mark.usefixtures("small")
def test_poses_of_tartanair_become_those_of_images(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    found = take_in(write_trajectory(tmp_path / "P000"), "TartanAir")
    truth = ground_truth(found.entry).poses
    assert found.spec.gravity_aligned
    assert truth.positions.tolist() == [[10 + k, -20, 5] for k in range(FRAMES)]
    # In a world of x forward, y left, z up: the image's z looks forward, its x to the right, its y down.
    ahead, right = to_matrix(truth.quaternions[0]), to_matrix(truth.quaternions[2])
    assert ahead.T.tolist() == pytest.approx(np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]]), abs=1e-12)
    assert right[:, 2].tolist() == pytest.approx([0, -1, 0], abs=1e-6)
    baseline = np.array(found.spec.sensors["right"].T_body_sensor)[:3, 3]
    assert baseline.tolist() == pytest.approx([0.3, 0, 0], abs=1e-6)


@pytest.mark.usefixtures("small")
def test_tartanair_has_no_stamps(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    found = take_in(write_trajectory(tmp_path / "P000"), "TartanAir")
    assert "10 Hz is assumed" in found.notes
    assert found.stamps("left") == [SECOND, SECOND + SECOND // 10, SECOND + SECOND // 5]
    assert ground_truth(found.entry).poses.stamps.tolist() == [1.0, 1.1, 1.2]


@pytest.mark.usefixtures("small")
def test_depth_of_both_versions(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    first = write_trajectory(tmp_path / "P000")
    second = tmp_path / "P001"
    write_images(second / "image_lcam_front", "{:06}_lcam_front.png")
    (second / "depth_lcam_front").mkdir()
    for k in range(FRAMES):
        depth = np.full((12, 16, 1), 1.25 + k, dtype="<f4")
        name = f"{k:06}_lcam_front_depth.png"
        cv2.imwrite(str(second / "depth_lcam_front" / name), depth.view(np.uint8))
    (second / "pose_lcam_front.txt").write_bytes((first / "pose_left.txt").read_bytes())
    for folder in (first, second):
        found = take_in(folder, "TartanAir")
        assert [pixels[3, 4] for _, pixels in found.messages("depth")] == [1.25, 2.25, 3.25]
        depth = found.spec.sensors["depth"]
        assert (depth.camera.encoding, depth.camera.depth_scale) == ("32FC1", 1)
    assert {*found.spec.sensors} == {"color", "depth"}


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("image_right/000001_right.png", "image_right: 2 images, but .*pose_left.txt has 3 poses"),
        ("pose_left.txt", r"pose_left\.txt: No such file"),
        ("depth_left/000002_left_depth.npy", "depth_left: 2 images"),
    ],
)
def test_what_tartanair_lacks(tmp_path: Path, take_in: Callable[..., Any], path: str, words: str) -> None:
    folder = write_trajectory(tmp_path / "P000")
    (folder / path).unlink()
    with pytest.raises(DataError, match=words):
        take_in(folder, "TartanAir")


def test_images_of_another_size_than_tartanairs(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    with pytest.raises(DataError, match="16×12 pixels, but TartanAir's lens is for 640×480"):
        take_in(write_trajectory(tmp_path / "P000"), "TartanAir")


def test_a_scene_of_replica(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    found = take_in(write_scene(tmp_path), "Replica")
    assert {*found.spec.sensors} == {"color", "depth"}
    depth = found.spec.sensors["depth"]
    assert (depth.camera.depth_scale, depth.camera.encoding, depth.camera.cx) == (6553.5, "16UC1", 7.5)
    # 16 bits stay 16 bits.
    assert [pixels[0, 0] for _, pixels in found.messages("depth")] == [6553, 6853, 7153]
    colors = [int(pixels[5, 5, 1]) for _, pixels in found.messages("color")]
    assert colors == pytest.approx([3, 53, 103], abs=2)
    assert "30 Hz is assumed" in found.notes
    assert found.stamps("color") == found.stamps("depth") == [SECOND, 1_033_333_333, 1_066_666_667]
    assert ground_truth(found.entry).poses.positions[2].tolist() == [2, 0, 0]


def test_what_is_wrong_of_replica_is_named(tmp_path: Path, take_in: Callable[..., Any]) -> None:
    folder = write_scene(tmp_path)
    (tmp_path / "cam_params.json").write_text("{}")
    with pytest.raises(DataError, match=r"cam_params\.json: no camera with w, h"):
        take_in(folder, "Replica")
    (tmp_path / "cam_params.json").unlink()
    with pytest.raises(DataError, match=r"16×12 pixels, but NICE-SLAM's camera is for 1200×680"):
        take_in(folder, "Replica")
    assert replica.LENS["cx"] == 599.5
    cv2.imwrite(str(folder / "results" / "depth000001.png"), np.zeros((12, 16), dtype=np.uint8))
    camera = {"w": 16, "h": 12, "fx": 8.0, "fy": 8.0, "cx": 7.5, "cy": 5.5, "scale": 6553.5}
    (folder / "cam_params.json").write_text(json.dumps({"camera": camera}))
    with pytest.raises(DataError, match=r"depth000001\.png: a depth image must have one channel of 16 bits"):
        take_in(folder, "Replica")
    (folder / "traj.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n" * 2)
    with pytest.raises(DataError, match=r"3 images, but .*traj\.txt has 2 poses"):
        take_in(folder, "Replica")
