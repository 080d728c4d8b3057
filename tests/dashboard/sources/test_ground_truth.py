# SPDX-License-Identifier: Apache-2.0
"""Ground truth for plots: found as soon as it is there, and what it is now."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from slamhive.data.store.datasets import made_folder
from slamhive.local.home.catalog import load_datasets
from slamhive.local.home.folder import Home
from slamhive.runfiles.ground_truth import DatasetTruths

if TYPE_CHECKING:
    from pathlib import Path


def write(path: Path, x: float) -> None:
    path.write_text("".join(f"{k} {x} {k} 0 0 0 0 1\n" for k in range(3)))


def test_what_comes_later_is_found_and_what_changes_is_read_again(tmp_path: Path) -> None:
    now = [0.0]
    truths = DatasetTruths(tmp_path, clock=lambda: now[0])
    assert truths.find("hall") is None
    write(tmp_path / "Hall.txt", 1.0)
    found = truths.find("hall")
    assert found is not None
    assert truths.find("hall") is found
    write(tmp_path / "Hall.txt", 2.0)
    now[0] = 120.0
    again = truths.find("hall")
    assert again is not None
    assert again.poses.positions[:, 0].tolist() == [2.0] * 3


def test_names_lead_nowhere_else(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    write(tmp_path / "secret.txt", 1.0)
    assert DatasetTruths(tmp_path / "folder").find("../secret") is None


def generated(home: Path, folder: str, x: float, when: float) -> None:
    place = home / "datasets" / folder
    place.mkdir(parents=True)
    write(place / "groundtruth.txt", x)
    os.utime(place / "groundtruth.txt", (when, when))


def test_a_dataset_beside_a_sweep_has_the_truth_that_was_generated_last(tmp_path: Path) -> None:
    generated(tmp_path, "hall-0123456789abcdef", 2.0, 200.0)
    generated(tmp_path, "hall-fedcba9876543210", 1.0, 100.0)
    generated(tmp_path, "hall-2-0123456789abcdef", 3.0, 300.0)  # of the dataset hall-2
    found = DatasetTruths(home=tmp_path).find("hall")
    assert found is not None
    assert found.poses.positions[:, 0].tolist() == [2.0] * 3
    assert DatasetTruths(home=tmp_path).find("hal") is None
    assert DatasetTruths(home=tmp_path).find("../datasets/hall") is None


def test_a_generated_dataset_that_is_known_has_the_truth_of_its_manifest(tmp_path: Path) -> None:
    (tmp_path / "datasets" / "hall").mkdir(parents=True)
    manifest = (
        "apiVersion: slamhive.io/v1alpha1\nkind: Dataset\nmetadata: {name: hall}\n"
        "spec: {recording: {synthetic: {sensors: [Imu], durationSeconds: 10, loops: 0.3}}}\n"
    )
    (tmp_path / "datasets" / "hall" / "dataset.yaml").write_text(manifest)
    current = made_folder(load_datasets(Home.at(tmp_path))["hall"].dataset, tmp_path / "datasets")
    generated(tmp_path, current.name, 1.0, 100.0)
    generated(tmp_path, "hall-0123456789abcdef", 2.0, 200.0)
    found = DatasetTruths(home=tmp_path).find("hall")
    assert found is not None
    assert found.poses.positions[:, 0].tolist() == [1.0] * 3
