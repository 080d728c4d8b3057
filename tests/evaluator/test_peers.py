# SPDX-License-Identifier: Apache-2.0
"""Agreement with other evaluators, whose own programs measured the drive that is made here.

peers.json holds what they found, with their versions. ``SLAMHIVE_PEERS=folder`` keeps the drive's files.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive_eval import (
    Trajectory,
    align,
    ape_errors,
    associate_forward,
    find_pairs,
    kitti_errors,
    match,
    measure_consistency,
    read_kitti,
    read_trajectory,
    rotation,
    rpe_errors,
    sub_trajectory_errors,
)
from slamhive_eval.formats.writing import write_trajectory

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive_eval import Alignment

FOUND = json.loads(Path(__file__).with_name("peers.json").read_text())
SPEED, TRUTH_HZ = 4.0, 10.0


def noise(shape: tuple[int, ...], start: float) -> np.ndarray:
    """Numbers within ±1 that no version of a generator changes."""
    return np.modf(np.sin(start + np.arange(np.prod(shape)) * 12.9898) * 43758.5453)[0].reshape(shape)


def trajectory(t: np.ndarray) -> Trajectory:
    """Return the poses of a car that sways, at times in s."""
    heading = 0.02 * t + 0.8 * np.sin(0.05 * t)
    rpy = np.column_stack((0.05 * np.sin(0.7 * t), 0.04 * np.cos(0.5 * t), heading))
    step = SPEED * np.column_stack((np.cos(heading), np.sin(heading), 0.05 * np.sin(0.1 * t)))
    return Trajectory(t, np.cumsum(step / TRUTH_HZ, axis=0), rotation.from_roll_pitch_yaw(rpy))


def row(values: np.ndarray) -> str:
    return " ".join(f"{value:.9f}" for value in values)


@pytest.fixture(scope="module", name="drive")
def drive_fixture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 960 m at 10 Hz and an estimate at 5 Hz that drifts, with covariances as OpenVINS writes."""
    folder = Path(os.environ.get("SLAMHIVE_PEERS") or tmp_path_factory.mktemp("drive"))
    truth = trajectory(1000.0 + np.arange(2400) / TRUTH_HZ)
    seen = truth.select(np.flatnonzero((np.arange(2400) % 2 == 0) & (np.arange(2400) // 100 % 7 != 3)))
    n = len(seen)
    drift = np.column_stack((np.zeros((n, 2)), 0.0004 * (seen.stamps - 1000.0)))
    turned = rotation.multiply(
        rotation.from_roll_pitch_yaw(drift + 0.01 * noise((n, 3), 1.0)), seen.quaternions
    )
    start = rotation.to_matrix(rotation.from_roll_pitch_yaw(np.array([[0.02, -0.01, 0.7]])))[0]
    moved = 1.01 * seen.positions + 0.001 * np.cumsum(noise((n, 3), 2.0), axis=0) + 0.05 * noise((n, 3), 3.0)
    stamps = seen.stamps + 0.015 * noise((n,), 4.0)
    estimate = Trajectory(stamps, moved, turned).transformed(start, np.array((5.0, -3.0, 1.0)))
    write(folder / "truth.txt", truth, np.empty((len(truth), 0)))
    root = np.tile(np.eye(3), (n, 1, 1)) + 0.3 * noise((n, 3, 3), 5.0)
    spread = root @ root.transpose(0, 2, 1)
    upper = np.triu_indices(3)
    write(
        folder / "estimate.txt",
        estimate,
        np.hstack((0.003 * spread[:, *upper], 4.0 * spread[::-1, *upper])),
    )
    every = Trajectory(truth.stamps, 1.01 * truth.positions, truth.quaternions + 0.01 * noise((2400, 4), 6.0))
    write_trajectory(folder / "truth.kitti", truth, "kitti")
    write_trajectory(folder / "estimate.kitti", every, "kitti")
    return folder


def write(path: Path, poses: Trajectory, more: np.ndarray) -> None:
    names = "timestamp(s) tx ty tz qx qy qz qw"
    if more.shape[1]:
        names += " Pr11 Pr12 Pr13 Pr22 Pr23 Pr33 Pt11 Pt12 Pt13 Pt22 Pt23 Pt33"
    columns = np.column_stack((poses.stamps, poses.positions, poses.quaternions, more))
    path.write_text(f"# {names}\n" + "".join(row(values) + "\n" for values in columns))


def agree(errors: np.ndarray, theirs: Mapping[str, float], ddof: int) -> None:
    """Their angles of small rotations have lost half of their digits: hence the tolerance."""
    assert len(errors) == theirs["count"]
    ours = {name: float(getattr(np, name)(errors)) for name in ("mean", "median", "min", "max")}
    ours |= {"rmse": float(np.sqrt(np.mean(errors**2))), "std": float(np.std(errors, ddof=ddof))}
    assert ours == pytest.approx({name: theirs[name] for name in ours}, rel=1e-7, abs=2e-6)


def laid(drive: Path, method: Any, matching: Any) -> tuple[Trajectory, Trajectory, Trajectory, Alignment]:
    files = (read_trajectory(drive / f"{name}.txt") for name in ("truth", "estimate"))
    truth, estimate = match(*files, matching, max_difference_seconds=0.02)
    alignment = align(truth, estimate, method)
    return truth, estimate, alignment.apply(estimate), alignment


@pytest.mark.parametrize(
    ("method", "theirs"), [("se3", "se3"), ("sim3", "sim3"), ("yaw", "posyaw"), ("origin", "se3single")]
)
def test_absolute_errors_and_nees_of_openvins(drive: Path, method: str, theirs: str) -> None:
    expected = FOUND["openvins"][theirs]
    truth, estimate, aligned, found = laid(drive, method, "forward")
    agree(ape_errors(truth, aligned), expected["pos"], 1)
    agree(ape_errors(truth, aligned, "angle_deg"), expected["ori"], 1)
    if method == "sim3":  # theirs finds another scale for the way back and leaves covariances as they are
        return
    assert estimate.covariances is not None
    for part, name in (("position", "neesPos"), ("rotation", "neesOri")):
        nees = measure_consistency(truth, aligned, estimate.covariances, found.rotation, part=part).nees
        agree(nees, expected[name], 1)


@pytest.mark.parametrize("length", ["8", "16", "40"])
def test_relative_errors_of_openvins(drive: Path, length: str) -> None:
    expected = FOUND["openvins"]["se3"]["rpe"][length]
    truth, _, aligned, _ = laid(drive, "se3", "forward")
    metres = float(length)
    pairs = find_pairs(truth, metres, "m", all_pairs=True, rel_tolerance=0.5 / metres)
    agree(rpe_errors(truth, aligned, pairs), expected["pos"], 1)
    agree(rpe_errors(truth, aligned, pairs, "angle_deg"), expected["ori"], 1)


def stamps(count: int, seed: int, step: int) -> Trajectory:
    """Unevenly spaced multiples of 1/256 s: ties are ties."""
    found: list[int] = []
    for _ in range(count):
        seed = (1103515245 * seed + 12345) % 2**31
        found.append((found[-1] if found else 0) + 1 + (seed >> 16) % step)
    still = np.tile((0.0, 0.0, 0.0, 1.0), (count, 1))
    return Trajectory(np.array(found) / 256, np.zeros((count, 3)), still)


@pytest.mark.parametrize("how", FOUND["openvins"]["matches"])
def test_matches_of_openvins(how: str) -> None:
    tolerance, offset = (float(word) / 256 for word in how.split())
    found = associate_forward(stamps(150, 1, 6), stamps(150, 2, 8), tolerance, offset)
    pairs = np.column_stack((found.reference, found.estimate)).tolist()
    assert pairs == FOUND["openvins"]["matches"][how]


@pytest.mark.parametrize(("method", "theirs"), [("se3", "se3"), ("sim3", "sim3"), ("yaw", "posyaw")])
def test_absolute_errors_of_rpg(drive: Path, method: str, theirs: str) -> None:
    expected = FOUND["rpg"][theirs]
    truth, _, aligned, found = laid(drive, method, "unique")
    assert found.scale == pytest.approx(expected["scale"], rel=1e-10)
    agree(ape_errors(truth, aligned), expected["pos"], 0)
    agree(ape_errors(truth, aligned, "angle_deg"), expected["ori"], 0)


def test_relative_errors_of_rpg(drive: Path) -> None:
    truth, estimate, _, _ = laid(drive, "none", "unique")
    # Without a hole: behind one it pairs poses with the wrong start.
    whole = np.flatnonzero((estimate.stamps > 1040.05) & (estimate.stamps < 1099.9))
    truth, estimate = truth.select(whole), estimate.select(whole)
    expected = FOUND["rpg"]["relative"]
    for found in sub_trajectory_errors(truth, estimate, tuple(map(float, expected))):
        theirs = expected[f"{found.length:.1f}"]
        agree(found.translation, theirs["rel_trans"], 0)
        agree(found.translation_percent, theirs["rel_trans_perc"], 0)
        agree(found.yaw_deg, theirs["rel_yaw"], 0)
        agree(found.gravity_deg, theirs["rel_gravity"], 0)
        agree(found.rotation_deg, theirs["rel_rot"], 0)
        agree(found.rotation_deg_per_m, theirs["rel_rot_deg_per_m"], 0)


@pytest.mark.parametrize(("precision", "digits"), [("float64", 1e-8), ("float32", 2e-5)])
def test_segments_of_kitti(drive: Path, precision: str, digits: float) -> None:
    expected = FOUND["kitti"][precision]
    found = kitti_errors(*(read_kitti(drive / f"{name}.kitti") for name in ("truth", "estimate")))
    groups = [(f"{one.value:g}", one) for one in found.by_length]
    assert [name for name, _ in groups] == list(expected["byLength"])
    for name, group in groups:
        count, percent, degrees = expected["byLength"][name]
        assert group.count == count
        assert group.translation_percent == pytest.approx(percent, rel=digits)
        assert group.rotation_deg_per_m == pytest.approx(degrees, rel=digits)
    assert found.overall.count == expected["count"]
    assert found.overall.translation_percent == pytest.approx(expected["translationPercent"], rel=digits)
    assert found.overall.rotation_deg_per_m == pytest.approx(expected["rotationDegPerM"], rel=digits)
