# SPDX-License-Identifier: Apache-2.0
"""Findings of ground truth by itself: fillings, leaps, its rate, and a second one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml
from spoiling import found_in

from slamhive.data.inspecting.inspection import inspect
from slamhive.data.inspecting.remedies import repaired_manifest
from slamhive.data.inspecting.suggestion import suggest_dataset
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.synthetic.messages import MessageMaker, typestore
from slamhive.data.synthetic.trajectory import SyntheticMotion, quaternion_from_rotation
from slamhive.model.dataset import Dataset
from slamhive.model.synthetic import SyntheticRecording

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.doctor.findings import Finding

START = 1_600_000_000
TIMES = np.arange(0.0, 20.0, 0.01)
GAP = slice(800, 860)


def poses(**spec: Any) -> tuple[Any, Any]:
    asked = SyntheticRecording.model_validate({"durationSeconds": 20, "loops": 0.3} | spec)
    motion = SyntheticMotion(asked).at(TIMES)
    return motion.position, quaternion_from_rotation(motion.rotation)


@pytest.fixture
def entry_of(tmp_path: Path, bag_with_truth: Any) -> Any:
    """Give a dataset of 3 s another ground truth."""
    entry: DatasetEntry = bag_with_truth(tmp_path, groundTruth={"file": "groundtruth.txt"})

    def make(positions: Any, quaternions: Any, digits: int = 6, kept: Any = slice(None)) -> DatasetEntry:
        stamps = [f"{START + at:.4f}" for at in TIMES[kept]]
        rows = np.hstack((positions.round(digits), quaternions.round(7)))[kept].tolist()
        lines = [f"{at} {' '.join(map(str, row))}\n" for at, row in zip(stamps, rows, strict=True)]
        (tmp_path / "groundtruth.txt").write_text("".join(lines))
        return entry

    return make


def of_truth(entry: DatasetEntry) -> dict[str, Finding]:
    return {code: one for code, one in found_in(entry).items() if code.startswith("truth.")}


def hold(at: Any, turned: Any) -> None:
    at[GAP], turned[GAP] = at[GAP.start], turned[GAP.start]


def join(at: Any, _: Any) -> None:
    share = (TIMES[GAP] - TIMES[GAP.start]) / (TIMES[GAP.stop] - TIMES[GAP.start])
    at[GAP] = at[GAP.start] + share[:, None] * (at[GAP.stop] - at[GAP.start])


@pytest.mark.parametrize(
    ("change", "noise", "words"),
    [
        (hold, 0.0, "1 with the same pose"),
        (join, 0.0, "constant velocity"),
        (join, 1e-3, "constant velocity"),
    ],
)
def test_what_was_filled_in_is_found_and_left_out_by_its_repair(
    entry_of: Any, change: Any, noise: float, words: str
) -> None:
    at, turned = poses()
    at = at + noise * np.random.default_rng(1).standard_normal(at.shape)
    assert of_truth(entry_of(at, turned)) == {}
    change(at, turned)
    entry = entry_of(at, turned)
    found = of_truth(entry)
    assert set(found) == {"truth.filled"}
    assert words in found["truth.filled"].message
    assert found["truth.filled"].first == pytest.approx(START + TIMES[GAP.start], abs=0.02)
    assert found["truth.filled"].value == pytest.approx(0.6, abs=0.03)
    (hole,) = found["truth.filled"].repair["groundTruth"]["holes"]
    assert hole["end"] - hole["start"] == pytest.approx(0.59, abs=0.02)
    values = entry.dataset.as_json()
    values["spec"]["groundTruth"] |= found["truth.filled"].repair["groundTruth"]
    assert of_truth(DatasetEntry(Dataset.model_validate(values), entry.root)) == {}


def corridor(at: Any, turned: Any) -> None:
    """A simulated robot that goes straight at one speed between two turns."""
    turned[:] = [0.0, 0.0, 0.0, 1.0]
    speed = np.clip(np.minimum(TIMES, 20.0 - TIMES) - 2.0, 0.0, 1.0)
    heading = np.cumsum(np.where((TIMES > 5) & (TIMES < 15), 0.3, 0.0)) * 0.01
    at[:, 0], at[:, 1], at[:, 2] = *(np.cumsum(speed * f(heading)) * 0.01 for f in (np.cos, np.sin)), 0.0


@pytest.mark.parametrize("digits", [4, 9])
@pytest.mark.parametrize(
    ("spec", "change"),
    [({}, None), ({"motion": 0}, None), ({"motion": 3}, None), ({"vibration": {}}, None), ({}, corridor)],
    ids=["plain", "even", "wild", "shaken", "corridor"],
)
def test_motion_and_standstill_are_no_finding(entry_of: Any, spec: Any, change: Any, digits: int) -> None:
    at, turned = poses(**spec)
    if change:
        change(at, turned)
    assert of_truth(entry_of(at, turned, digits)) == {}


@pytest.mark.parametrize(("times", "seconds", "seed"), [("torn", 8, 10), ("uneven", 15, 5)])
def test_gaps_and_uneven_times_are_no_finding(entry_of: Any, times: str, seconds: int, seed: int) -> None:
    """A pose at rest before a gap, steps between two gaps while getting faster, and stamps of two streams."""
    chance = np.random.default_rng(seed)
    at, turned = poses(durationSeconds=seconds, motion=0)
    kept = np.ones(len(TIMES), dtype=np.bool_)
    if times == "torn":
        for begin in chance.integers(0, len(TIMES), 12):
            kept[begin : begin + chance.integers(5, 120)] = False
        assert of_truth(entry_of(at, turned, 4, kept)) == {}
    else:
        kept[:] = False
        kept[::10] = kept[2::50] = True
        assert of_truth(entry_of(at + 3e-3 * chance.standard_normal(at.shape), turned, 9, kept)) == {}


@pytest.mark.parametrize(("metres", "degrees"), [(0.06, 0.0), (0.0, 90.0)])
def test_a_leap_is_named_with_place_and_size(entry_of: Any, metres: float, degrees: float) -> None:
    at, turned = poses()
    at[1000:, 1] += metres
    half = np.radians(degrees / 2)
    turned[1000:] = np.column_stack(
        (
            np.cos(half) * turned[1000:, :2] + np.sin(half) * turned[1000:, 1::-1] * [1, -1],
            np.cos(half) * turned[1000:, 2] + np.sin(half) * turned[1000:, 3],
            np.cos(half) * turned[1000:, 3] - np.sin(half) * turned[1000:, 2],
        )
    )
    found = of_truth(entry_of(at, turned))
    assert set(found) == {"truth.jump"}
    assert found["truth.jump"].value == pytest.approx(metres or degrees, rel=0.2)
    assert found["truth.jump"].first == pytest.approx(START + 9.99)
    assert found["truth.jump"].count == 1


def test_fillings_and_leaps_away_and_back_are_left_out_together(entry_of: Any) -> None:
    at, turned = poses()
    hold(at, turned)
    at[1000:1020, 2] += 0.5
    entry = entry_of(at, turned)
    findings = inspect(entry).findings
    assert {one.code for one in findings} == {"truth.filled", "truth.jump"}
    made = repaired_manifest(entry.dataset, findings)
    assert made.notes == []
    repaired = DatasetEntry(Dataset.model_validate(yaml.safe_load(made.text)), entry.root)
    assert len(repaired.dataset.spec.ground_truth.holes) == 2
    assert of_truth(repaired) == {}


def test_a_second_truth_is_noted(entry_of: Any, bag_writer: Any, tmp_path: Path) -> None:
    entry = entry_of(*poses())
    assert of_truth(entry) == {}
    maker = MessageMaker(typestore())
    (tmp_path / "walk.bag").unlink()
    with bag_writer(tmp_path / "walk.bag") as bag:
        for k in range(30):
            at = START * 10**9 + k * 10**8
            bag.points("/points", at, "lidar", np.ones(5, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))
            odometry = maker.odometry(at, "base", np.array([0, 0, 0, 0.1 * k, 0, 0]))
            bag._write("/gt/pose", "nav_msgs/msg/Odometry", at, odometry)
            bag._write("/vicon/body", "nav_msgs/msg/Odometry", at, odometry)
    for name in ("gt.csv", "groundtruth_of_another.csv"):
        (tmp_path / name).write_text("")
    finding = of_truth(entry)["truth.two"]
    assert "groundtruth.txt is taken; /gt/pose, /vicon/body, gt.csv may" in finding.message
    assert str(finding.severity) == "note"
    said = suggest_dataset([tmp_path / "walk.bag"], "walk", tmp_path).missing
    assert any("/gt/pose taken by its name; there is /vicon/body, too" in one for one in said)
