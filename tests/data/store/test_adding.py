# SPDX-License-Identifier: Apache-2.0
"""Tests of adding datasets: what is refused before it is known, what takes whose place, what is kept."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from slamhive.data.inspecting.inspection import inspect
from slamhive.data.inspecting.known import FINDINGS
from slamhive.data.inspecting.known import known as kept_findings
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.local.home.folder import Home
from slamhive.model.dataset import Dataset
from slamhive.model.loading import load_file

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

Command = "Callable[..., tuple[int, str, str]]"
CAMERA = {"width": 8, "height": 6, "fx": 8.0, "fy": 8.0, "cx": 4.0, "cy": 3.0}
POSES = "".join(f"{1 + k / 10} {k} 0 0 0 0 0 1\n" for k in range(20))


@pytest.fixture
def add(
    tmp_path: Path, bag_writer: Any, monkeypatch: pytest.MonkeyPatch, run_command: Any
) -> Callable[..., tuple[int, str, str]]:
    """Adds a dataset of a small bag with a camera, its manifest changed; returns code, output and errors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    with bag_writer(tmp_path / "walk.bag") as bag:
        for k in range(20):
            bag.image("/cam", 10**9 + k * 10**8, "cam", "mono8", np.zeros((6, 8), dtype=np.uint8))
    (tmp_path / "poses.txt").write_text(POSES)

    def call(*options: str, camera: dict[str, Any] | None = None, **spec: Any) -> tuple[int, str, str]:
        sensor = {"type": "Camera", "topic": "/cam", "camera": CAMERA | (camera or {})}
        content = {
            "recording": {"format": "Rosbag1", "files": [{"path": "walk.bag"}]},
            "sensors": {"camera": sensor},
            "groundTruth": {"file": "poses.txt"},
        } | spec
        manifest = {
            "apiVersion": "slamhive.io/v1alpha1",
            "kind": "Dataset",
            "metadata": {"name": "walk"},
            "spec": content,
        }
        (tmp_path / "walk.yaml").write_text(yaml.safe_dump(manifest))
        return run_command("dataset", "add", "walk.yaml", *options)

    return call


def known() -> list[str]:
    return sorted(path.name for path in Home.from_environment().folder("datasets").glob("[!.]*"))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera": {"width": 16}}, "states 16×6 pixels, but the images on /cam have 8×6"),
        ({"groundTruth": {"file": "late.txt"}}, "doesn't overlap with the recording"),
        (
            {"recording": {"files": [{"path": "walk.bag", "sha256": "0" * 64}]}},
            "recording.files: ",
        ),
        ({"groundTruth": {"file": "poses.txt", "sha256": "0" * 64}}, "groundTruth.file: "),
        ({"recording": {"files": [{"path": "cut.bag"}]}}, "can't be read as Rosbag1"),
    ],
)
def test_a_broken_dataset_stays_unknown(
    add: Any, tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    (tmp_path / "late.txt").write_text(POSES.replace("\n", "\n90000", 1).replace("1.0 ", "90000 ", 1))
    lines = [f"{9000 + k} 0 0 0 0 0 0 1" for k in range(3)]
    (tmp_path / "late.txt").write_text("\n".join(lines))
    (tmp_path / "cut.bag").write_bytes((tmp_path / "walk.bag").read_bytes()[:-300])
    code, _, err = add(**changes)
    assert (code, known()) == (2, [])
    assert words in err


@pytest.mark.parametrize(
    ("camera", "words"),
    [({"cx": 80.0}, "(80, 3) lies outside of the image of 8×6"), ({"encoding": "rgb8"}, "states rgb8")],
)
def test_suspicious_calibration_is_said_when_it_is_added(add: Any, camera: Any, words: str) -> None:
    code, out, _ = add(camera=camera)
    assert code == 0
    assert words in " ".join(out.split())


def test_findings_of_a_sample_are_said_when_it_is_added(add: Any, run_command: Any, tmp_path: Path) -> None:
    code, out, _ = add()
    told = " ".join(out.split())
    assert (code, "dataset 'walk': sensors.camera: 20 images show one grey" in told) == (0, True)
    assert "(images.constant)" in told
    manifest = yaml.safe_load((tmp_path / "walk.yaml").read_text())
    entry = DatasetEntry(Dataset.model_validate(manifest), tmp_path)
    kept = kept_findings(entry, tmp_path / "home" / FINDINGS)
    assert [one.code for one in kept or []] == ["images.constant"]
    code, out, _ = run_command("dataset", "check", "walk", "--quick", "--json")
    report = json.loads(out)
    assert (code, report["sampled"], report["sensors"][0]["messages"]) == (0, 20, 20)
    shown = " ".join(run_command("dataset", "check", "walk", "--quick")[2].split())
    assert "a sample of 20 of 20 messages" in shown


def test_a_known_dataset_is_replaced_when_that_is_said(add: Any) -> None:
    manifest = add() and Home.from_environment().path / "datasets" / "walk" / "dataset.yaml"
    code, _, err = add(camera={"fx": 9.0})
    assert code == 2
    assert "slamhive dataset add --replace" in " ".join(err.split())
    assert add("--replace", camera={"fx": 9.0})[0] == 0
    assert yaml.safe_load(manifest.read_text())["spec"]["sensors"]["camera"]["camera"]["fx"] == 9.0
    assert known() == ["walk"]


def test_what_is_known_stays_if_its_successor_is_broken(add: Any) -> None:
    add()
    manifest = Home.from_environment().path / "datasets" / "walk" / "dataset.yaml"
    before = manifest.read_text()
    assert add("--replace", camera={"width": 16})[0] == 2
    assert manifest.read_text() == before


def test_two_datasets_of_one_name_in_a_file(add: Any, tmp_path: Path, run_command: Any) -> None:
    add()
    text = (tmp_path / "walk.yaml").read_text().replace("name: walk", "name: two")
    (tmp_path / "two.yaml").write_text(f"{text}---\n{text}")
    code, _, err = run_command("dataset", "add", "two.yaml")
    assert code == 2
    assert "2 Datasets of the name 'two'" in err
    assert known() == ["walk"]


def test_what_no_suite_uses_is_kept_and_named(
    add: Any, tmp_path: Path, bag_writer: Any, run_command: Any
) -> None:
    with bag_writer(tmp_path / "boat.bag") as bag:
        for k in range(1, 30):
            bag.planar_odometry("/odom", k * 10**8, np.array([0.1 * k, 0, 0]), np.array([1.0, 0]))
            bag.imu("/sonar_as_imu", k * 10**8, "imu", np.zeros(3), np.array([0, 0, 9.81]))
    code, _, err = run_command("dataset", "add", "boat.bag")
    assert code == 0
    assert "modes that it serves: odometry, odometry-inertial, inertial" in " ".join(err.split())
    assert run_command("dataset", "add", "boat.yaml")[0] == 0
    assert run_command("dataset", "check", "boat")[0] == 0
    code, _, err = run_command("dataset", "check", "boat.bag")
    assert (code, "make it a dataset first: slamhive dataset add boat.bag" in err) == (2, True)


def test_a_sensor_that_lasts_for_little_of_the_ground_truth(
    tmp_path: Path, bag_writer: Any, bag_entry: Any
) -> None:
    with bag_writer(tmp_path / "a.bag") as bag:
        for k in range(101):
            bag.imu("/imu", 10**9 + k * 10**8, "imu", np.zeros(3), np.array([0.0, 0.0, 9.81]))
            if k <= 10:
                bag.image("/cam", 10**9 + k * 10**8, "cam", "mono8", np.zeros((6, 8), dtype=np.uint8))
    lines = [f"{1 + k / 10} {k} 0 0 0 0 0 1" for k in range(101)]
    (tmp_path / "truth.txt").write_text("\n".join(lines))
    entry = bag_entry(
        tmp_path / "a.bag",
        {"imu": ("Imu", "/imu"), "camera": ("Camera", "/cam")},
        groundTruth={"file": "truth.txt"},
    )
    said = [text for text in inspect(entry).warnings if "ground truth's" in text]
    assert said == [
        (
            "sensors.camera: /cam lasts for 1.0 s of the ground truth's 10.0 s (10%); runs with it (mono, "
            "mono-inertial) are measured on no more than that. Get the whole recording if there is more of "
            "it, or choose a mode without it"
        )
    ]


@pytest.mark.parametrize(
    ("name", "words"),
    [("My Walk", "found 'My Walk'; try my-walk"), ("walk/2", "found 'walk/2'")],
)
def test_a_name_that_is_none_of_a_dataset_is_refused(
    add: Any, run_command: Any, name: str, words: str
) -> None:
    add()
    for source in ("walk.bag", "euroc/MH_01_easy"):
        code, _, err = run_command("dataset", "add", source, "--name", name)
        assert (code, words in err, "--name: " in err) == (2, True, True), err


def test_a_name_is_made_of_any_file_s(add: Any, run_command: Any, tmp_path: Path) -> None:
    add()
    (tmp_path / "walk.bag").rename(tmp_path / "Second Walk (1).bag")
    assert run_command("dataset", "add", "Second Walk (1).bag")[0] == 0
    assert (tmp_path / "second-walk-1.yaml").is_file()


def test_pieces_of_a_recording_are_added_together_and_named_where_one_is_given(
    bag_writer: Any, run_command: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    (tmp_path / "disk").mkdir()
    for piece in range(3):
        with bag_writer(tmp_path / "disk" / f"run_{piece}.bag") as bag:
            for k in range(10):
                bag.imu("/imu", (100 + 10 * piece + k) * 10**8, "imu", np.zeros(3), np.array([0, 0, 9.81]))
    pieces = [f"disk/run_{piece}.bag" for piece in (2, 0, 1)]
    code, _, err = run_command("dataset", "add", pieces[0], "--name", "one")
    assert (code, "run_0.bag, run_1.bag beside run_2.bag may be pieces" in " ".join(err.split())) == (0, True)

    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    code, _, err = run_command("dataset", "add", *(f"../{piece}" for piece in pieces), "--name", "run")
    assert code == 0, err
    assert "may be pieces" not in err
    assert run_command("dataset", "add", "run.yaml")[0] == 0
    report = inspect(DatasetEntry(load_file(tmp_path / "here" / "run.yaml")[0], tmp_path / "here"))
    (imu,) = report.sensors
    assert (imu.messages, imu.first, imu.last) == (30, 10.0, pytest.approx(12.9))

    code, _, err = run_command("dataset", "add", f"../{pieces[0]}", f"../{pieces[0]}", "--name", "twice")
    assert (code, "run_2.bag: named twice" in " ".join(err.split())) == (2, True)
    code, _, err = run_command("dataset", "add", "run.yaml", f"../{pieces[0]}", "--name", "mixed")
    assert (code, "run.yaml: a manifest is added by itself" in " ".join(err.split())) == (2, True)
    code, _, err = run_command("dataset", "add", "run.yaml", "run.yaml")
    assert (code, "one at a time" in " ".join(err.split()), "not a recording" in err) == (2, True, False)
    code, _, err = run_command("dataset", "add", "euroc/MH_01_easy", "euroc/MH_02_easy")
    assert (code, "a sequence of the catalogue is added by itself" in " ".join(err.split())) == (2, True)
