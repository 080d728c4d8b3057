# SPDX-License-Identifier: Apache-2.0
import multiprocessing
import os
from pathlib import Path
from typing import Any

import pytest

from slamhive.data.store.datasets import (
    add_dataset,
    dataset_sha256,
    file_sha256,
    materialise,
    recording_sha256,
)
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError, InputError
from slamhive.model.loading import load_file

FORK = multiprocessing.get_context("fork")


def synthetic(**spec: Any) -> Dataset:
    fields = {"sensors": ["Imu"], "durationSeconds": 8, "loops": 0.2, **spec}
    return Dataset.model_validate({"metadata": {"name": "s"}, "spec": {"recording": {"synthetic": fields}}})


def test_a_synthetic_dataset_becomes_one_of_files(lidar_entry: Any) -> None:
    spec = lidar_entry.dataset.spec
    assert [file.path for file in spec.recording.files] == ["recording.bag"]
    assert set(spec.sensors) == {"lidar", "imu"}
    assert spec.ground_truth.file == "groundtruth.txt"
    assert spec.attributes["loops"] == 0.2
    assert spec.gravity_aligned
    assert (lidar_entry.root / "recording.bag").stat().st_mode & 0o222 == 0


def _materialise(folder: Path, start: Any) -> None:
    start.wait(50)
    materialise(synthetic(), folder, folder)


def test_it_is_made_once_by_many(tmp_path: Path) -> None:
    start = FORK.Barrier(4)
    processes = [FORK.Process(target=_materialise, args=(tmp_path, start)) for _ in range(4)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60)
    assert [process.exitcode for process in processes] == [0] * 4
    assert len([path for path in tmp_path.iterdir() if path.is_dir()]) == 1
    other = materialise(synthetic(seed=2), tmp_path, tmp_path)
    assert other.root != materialise(synthetic(), tmp_path, tmp_path).root


def test_hashes_follow_content(tmp_path: Path, frames_of: Any) -> None:
    entry = frames_of(tmp_path / "a.bag", rate=10, count=3)
    cache = tmp_path / "cache"
    first = recording_sha256(entry, cache)
    assert recording_sha256(entry, cache) == recording_sha256(entry) == first
    frames_of(tmp_path / "a.bag", rate=10, count=4)
    assert recording_sha256(entry, cache) == recording_sha256(entry) != first


def test_hashes_are_remembered_by_size_and_time(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"one")
    known = file_sha256(path, tmp_path / "cache")
    state = path.stat()
    with path.open("r+b") as file:
        file.write(b"two")
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert file_sha256(path, tmp_path / "cache") == known
    assert file_sha256(path) != known


def test_declared_checksums_stand_for_files(tmp_path: Path, frames_of: Any) -> None:
    entry = frames_of(tmp_path / "a.bag", rate=10, count=3)
    path = entry.root / "a.bag"
    file = entry.dataset.spec.recording.files[0].replace(sha256=file_sha256(path))
    recording = entry.dataset.spec.recording.replace(files=[file])
    declared = type(entry)(
        entry.dataset.replace(spec=entry.dataset.spec.replace(recording=recording)), entry.root
    )
    assert recording_sha256(declared) == recording_sha256(entry)
    path.unlink()
    assert recording_sha256(declared)
    with pytest.raises(DataError, match="No such file"):
        recording_sha256(entry)


def test_calibration_and_ground_truth_count(bag_with_truth: Any, tmp_path: Path) -> None:
    (tmp_path / "gt.txt").write_text("1 0 0 0 0 0 0 1\n")
    entry = bag_with_truth(tmp_path, groundTruth={"file": "gt.txt"})
    before = dataset_sha256(entry)
    (tmp_path / "gt.txt").write_text("1 0 0 1 0 0 0 1\n")
    after = dataset_sha256(entry)
    lidar = entry.dataset.spec.sensors["lidar"].replace(time_offset=0.1)
    spec = entry.dataset.spec.replace(sensors={"lidar": lidar})
    moved = dataset_sha256(type(entry)(entry.dataset.replace(spec=spec), entry.root))
    assert len({before, after, moved}) == 3


def test_adding_links_files_and_refuses_another_of_that_name(tmp_path: Path, frames_of: Any) -> None:
    entry = frames_of(tmp_path / "a.bag", rate=10, count=3)
    home = tmp_path / "home"
    manifest = add_dataset(entry.dataset, entry.root, home)
    again = load_file(manifest)[0]
    assert again.spec == entry.dataset.spec
    assert (manifest.parent / "a.bag").samefile(tmp_path / "a.bag")
    assert add_dataset(entry.dataset, entry.root, home) == manifest
    changed = entry.dataset.replace(spec=entry.dataset.spec.replace(description="other"))
    with pytest.raises(InputError, match="known already and differs"):
        add_dataset(changed, entry.root, home)
    (tmp_path / "a.bag").unlink()
    with pytest.raises(DataError, match="does not exist"):
        materialise(entry.dataset, entry.root, home)
