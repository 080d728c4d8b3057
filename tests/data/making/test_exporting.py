# SPDX-License-Identifier: Apache-2.0
"""Exports: what a run would be given, in a folder of one's own."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from slamhive.data.importers import import_recording
from slamhive.data.inspecting.inspection import inspect
from slamhive.data.making import exporting
from slamhive.data.making.exporting import all_roles, export_dataset
from slamhive.data.making.preparation import prepare
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.algorithm import DataFormat
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.loading import load_file
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role
from slamhive_eval import read_tum

if TYPE_CHECKING:
    from pathlib import Path

EUROC, TUM, KITTI = DataFormat.EUROC, DataFormat.TUM, DataFormat.KITTI
BAGS = (DataFormat.ROSBAG1, DataFormat.ROSBAG2, DataFormat.MCAP)
STEREO = (Role.LEFT, Role.RIGHT)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("form", [EUROC, TUM, pytest.param(KITTI, marks=pytest.mark.slow)])
def test_an_export_is_what_a_run_gets(camera_entries: Any, tmp_path: Path, form: DataFormat) -> None:
    entry, options = camera_entries[1.0], InputOptions(resolution=0.5, frame_rate=1)
    roles = all_roles(entry, form)
    told: list[float] = []
    made = export_dataset(entry, roles, options, form, tmp_path / "a/b/out", progress=told.append)
    variant = prepare(entry, roles, options, [form], tmp_path / "cache")
    found, expected = contents(tmp_path / "a/b/out"), contents(variant.path)
    expected["frames.txt"] = (variant.folder / "frames.txt").read_bytes()
    about = yaml.safe_load(found.pop("sensors.yaml"))
    assert found == expected
    assert about["sensors"] == {role: view.as_json() for role, view in variant.sensors.items()}
    assert (about["startTime"], about["durationSeconds"]) == (variant.start_time, variant.duration_seconds)
    assert about["frames"] == variant.frames == made.selection.frames(made.selection.primary)
    assert all((tmp_path / "a/b/out" / path).exists() for path in about["files"].values())
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert [path.name for path in (tmp_path / "a/b").iterdir()] == ["out"]
    assert (tmp_path / "a/b/out/frames.txt").stat().st_mode & 0o200


@pytest.mark.parametrize("form", BAGS)
def test_a_bag_comes_with_the_manifest_that_makes_it_a_dataset(
    lidar_entry: Any, tmp_path: Path, form: DataFormat
) -> None:
    options = InputOptions(duration="4s")
    truth = ground_truth(lidar_entry)
    export_dataset(lidar_entry, all_roles(lidar_entry, form), options, form, tmp_path / "out", truth=truth)
    dataset = load_file(tmp_path / "out/dataset.yaml")[0]
    assert isinstance(dataset, Dataset)
    assert dataset.spec.recording.format == form
    report = inspect(DatasetEntry(dataset, tmp_path / "out"))
    assert report.errors == []
    assert {sensor.name: sensor.messages for sensor in report.sensors}["lidar"] == 40
    again = ground_truth(DatasetEntry(dataset, tmp_path / "out"))
    assert again is not None
    assert truth is not None
    assert again.poses.positions.tolist() == truth.poses.positions.tolist()  # type: ignore[union-attr]
    for name, sensor in dataset.spec.sensors.items():
        declared = lidar_entry.dataset.spec.sensors[name]
        assert sensor.replace(rate=None) == declared.replace(rate=None)


def test_an_untouched_bag_is_copied_never_linked(lidar_entry: Any, tmp_path: Path) -> None:
    original = lidar_entry.root / "recording.bag"
    assert not original.stat().st_mode & 0o222
    roles = (Role.LIDAR, Role.IMU)
    export_dataset(lidar_entry, roles, InputOptions(), DataFormat.ROSBAG1, tmp_path / "out")
    copy = tmp_path / "out/recording.bag"
    assert copy.read_bytes() == original.read_bytes()
    assert copy.stat().st_ino != original.stat().st_ino


def test_ground_truth_is_written_only_when_asked_for(camera_entries: Any, tmp_path: Path) -> None:
    entry = camera_entries[1.0]
    for form in DataFormat:
        export_dataset(entry, all_roles(entry, form), InputOptions(frame_rate=1), form, tmp_path / form)
        assert not [path for path in (tmp_path / form).rglob("*") if "truth" in path.name]
        text = b"".join(contents(tmp_path / form).values())
        assert b"groundTruth" not in text


def test_ground_truth_is_that_of_the_body(camera_entries: Any, tmp_path: Path) -> None:
    entry = camera_entries[1.0]
    plain = ground_truth(entry)
    assert plain is not None
    marker = np.array(entry.dataset.spec.sensors["left"].T_body_sensor)
    moved = dataclasses.replace(plain, poses=plain.poses.moved(marker), T_body_frame=marker)  # type: ignore[union-attr]
    export_dataset(entry, STEREO, InputOptions(frame_rate=1), EUROC, tmp_path / "out", truth=moved)
    found = read_tum(tmp_path / "out/groundtruth.txt")
    assert np.allclose(found.positions, plain.poses.positions, atol=1e-6)  # type: ignore[union-attr]
    dataset, _ = import_recording(tmp_path / "out", tmp_path / "back", "back", "Euroc")
    truth = ground_truth(DatasetEntry(dataset, tmp_path / "back"))
    assert truth is not None
    assert np.allclose(truth.poses.positions, found.positions, atol=1e-9)  # type: ignore[union-attr]


def test_what_is_there_is_never_overwritten(camera_entries: Any, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    for name in ("out", "dangling"):
        with pytest.raises(InputError, match=f"{name}: exists already; choose another folder or remove it"):
            export_dataset(camera_entries[1.0], STEREO, InputOptions(), EUROC, tmp_path / name)
    assert list((tmp_path / "out").iterdir()) == []


def test_what_fails_leaves_nothing(camera_entries: Any, tmp_path: Path, monkeypatch: Any) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(exporting, "settle", refuse)
    with pytest.raises(SystemFault, match="out: No space left on device"):
        export_dataset(camera_entries[1.0], STEREO, InputOptions(), EUROC, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("form", [EUROC, DataFormat.MCAP])
def test_an_interrupted_export_leaves_nothing(camera_entries: Any, tmp_path: Path, form: DataFormat) -> None:
    seen = []

    def interrupt(share: float) -> None:
        seen.extend(tmp_path.iterdir())
        if share > 0.3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_dataset(
            camera_entries[1.0],
            STEREO,
            InputOptions(resolution=0.5),
            form,
            tmp_path / "out",
            progress=interrupt,
        )
    assert {path.name[:5] for path in seen} == {".out."}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("form", "roles"),
    [
        (DataFormat.MCAP, {"left", "right", "color", "depth"}),
        (EUROC, {"left", "right"}),
        (TUM, {"color", "depth"}),
        (KITTI, {"left", "right"}),
    ],
)
def test_all_that_a_form_holds_is_exported(camera_entries: Any, form: DataFormat, roles: set[str]) -> None:
    assert set(all_roles(camera_entries[1.0], form)) == roles


def test_a_dataset_without_sensors_for_a_form(lidar_entry: Any) -> None:
    assert set(all_roles(lidar_entry, KITTI)) == {"lidar"}
    with pytest.raises(InputError, match="'lidar' has no sensors for Tum; it has: imu, lidar"):
        all_roles(lidar_entry, TUM)
