# SPDX-License-Identifier: Apache-2.0
"""Clocks and mountings by how sensors and ground truth turn: which is off, by how much, what repairs it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from spoiling import found_in

from slamhive.data.doctor.matching import match
from slamhive.data.doctor.mountings import judge_mountings
from slamhive.data.doctor.turning import Turning, Turns
from slamhive.data.doctor.voting import TurningSensor
from slamhive.data.inspecting.inspection import inspect
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.store.datasets import materialise
from slamhive.model.dataset import Dataset
from slamhive.model.sensors import SensorType
from slamhive.model.variant import TRUTH

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.doctor.findings import Finding


def made(folder: Path, **synthetic: Any) -> DatasetEntry:
    """Make a recording of a body that turns about all axes."""
    spec = {"recording": {"synthetic": {"motion": 3, **synthetic}}}
    return materialise(Dataset.model_validate({"metadata": {"name": "walk"}, "spec": spec}), folder, folder)


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> DatasetEntry:
    lidar = {"rings": 16, "columns": 120}
    return made(
        tmp_path_factory.mktemp("lidar"), sensors=["Lidar", "Imu"], durationSeconds=10, loops=0.2, lidar=lidar
    )


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> DatasetEntry:
    folder, camera = tmp_path_factory.mktemp("camera"), {"width": 160, "height": 120, "rate": 10}
    clean = made(folder, sensors=["Stereo", "Imu"], durationSeconds=8, loops=0.1, camera=camera)
    return changed(clean, without=("right",))


def changed(
    clean: DatasetEntry, shifts: dict[str, float] | None = None, without: tuple[str, ...] = (), **spec: Any
) -> DatasetEntry:
    """Return a dataset with shifted stamps, without some sensors, with other fields of its spec."""
    values = clean.dataset.as_json()
    values["spec"] |= spec
    for name in without:
        del values["spec"]["sensors"][name]
    if shifts:
        moves: dict[str, Any] = {name: {"shift": shift} for name, shift in shifts.items()}
        truth = moves.pop("groundTruth", None)
        values["spec"]["repair"] = {"sensors": moves, "groundTruth": truth}
    return DatasetEntry(Dataset.model_validate(values), clean.root)


def warned(entry: DatasetEntry) -> dict[str, Finding]:
    return {finding.code: finding for finding in inspect(entry).findings if finding.severity != "note"}


def shift_of(finding: Finding) -> Any:
    repair = finding.repair["repair"]
    return (repair.get("groundTruth") or repair["sensors"][finding.sensor])["shift"]


@pytest.mark.parametrize(
    ("name", "shift", "within"),
    [("groundTruth", 0.1, 0.003), ("imu", 0.05, 0.003), ("lidar", -0.2, 0.01), ("left", 0.03, 0.01)],
)
def test_what_is_late_is_named_with_the_shift_that_repairs_it(
    scanned: DatasetEntry, filmed: DatasetEntry, name: str, shift: float, within: float
) -> None:
    clean = filmed if name == "left" else scanned
    found = warned(changed(clean, {name: shift}))
    assert [*found] == ["clock.offset"]
    assert found["clock.offset"].sensor == name
    assert shift_of(found["clock.offset"]) == pytest.approx(-shift, abs=within)


def test_clocks_and_mountings_that_are_right_are_no_finding(
    scanned: DatasetEntry, filmed: DatasetEntry
) -> None:
    assert warned(scanned) == warned(filmed) == {}


def test_it_is_said_how_far_each_step_is(scanned: DatasetEntry) -> None:
    told: dict[str, list[float | None]] = {}
    inspect(scanned, progress=lambda what, share: told.setdefault(what, []).append(share))
    assert told.pop("step 2 of 3, judging") == [None]
    assert [*told] == ["step 1 of 3, reading", "step 3 of 3, how lidar turned"]
    for shares in told.values():
        known = [share for share in shares if share is not None]
        assert known == sorted(known)
        assert 0.9 < known[-1] <= 1.0


def test_ground_truth_of_another_epoch_is_found_by_turning(scanned: DatasetEntry) -> None:
    finding = found_in(changed(scanned, {"groundTruth": 37.0}))["clock.epoch"]
    assert (finding.sensor, finding.severity) == ("groundTruth", "error")
    assert "which is TAI − UTC" in finding.message
    assert shift_of(finding) == pytest.approx(-37.0, abs=0.003)


@pytest.mark.parametrize(
    ("ahead", "said"), [(37.0, "TAI − UTC"), (3.0 - 1.6e9, "count from a sensor's start")]
)
def test_a_lone_lidar_of_another_epoch_than_the_truth_is_found(
    scanned: DatasetEntry, ahead: float, said: str
) -> None:
    finding = found_in(changed(scanned, {"lidar": ahead}, ("imu",)))["clock.epoch"]
    assert said in finding.message
    assert shift_of(finding) == pytest.approx(ahead, abs=0.01)


def test_without_a_gyro_cameras_are_held_against_the_ground_truth(filmed: DatasetEntry) -> None:
    found = warned(changed(filmed, {"groundTruth": -0.15}, ("imu",)))
    assert found["clock.offset"].sensor == "groundTruth"
    assert shift_of(found["clock.offset"]) == pytest.approx(0.15, abs=0.01)


def test_without_anything_that_tells_all_the_time_it_is_a_note(scanned: DatasetEntry) -> None:
    twice = changed(scanned).dataset.as_json()["spec"]["sensors"]
    found = found_in(changed(scanned, sensors=dict.fromkeys("ab", twice["lidar"]), groundTruth=None))
    assert found["clock.offset"].severity == "note"
    assert "that takes a gyro, or ground truth" in found["clock.offset"].message


@pytest.mark.parametrize("name", ["lidar", "groundTruth"])
def test_a_mounting_that_is_stated_wrong_is_corrected(scanned: DatasetEntry, name: str) -> None:
    turn = cv2.Rodrigues(np.radians([3.0, -4.0, 0.0]))[0]
    sensors = scanned.dataset.as_json()["spec"]["sensors"]
    truth, right = scanned.dataset.as_json()["spec"]["groundTruth"], np.eye(4)
    if name != "groundTruth":
        right = np.array(sensors[name]["T_body_sensor"])
    wrong = right.copy()
    wrong[:3, :3] = turn @ wrong[:3, :3]
    if name == "groundTruth":
        truth["T_body_frame"] = wrong.tolist()
    else:
        sensors[name]["T_body_sensor"] = wrong.tolist()
    finding = warned(changed(scanned, sensors=sensors, groundTruth=truth))["frames.rotation"]
    assert finding.sensor == name
    assert finding.value == pytest.approx(5.0, abs=0.5)
    repair = finding.repair.get("groundTruth") or finding.repair["sensors"][name]
    corrected = np.array(repair["T_body_frame" if name == "groundTruth" else "T_body_sensor"])
    left = np.linalg.norm(cv2.Rodrigues(corrected[:3, :3].T @ right[:3, :3])[0])
    assert np.degrees(left) < 0.5


@pytest.mark.parametrize(("scale", "code"), [(-1.0, "imu.sign"), (180.0 / np.pi, "imu.units")])
def test_clocks_are_told_by_rates_of_the_right_sign_and_unit(
    scanned: DatasetEntry, scale: float, code: str
) -> None:
    spoiled = {"sensors": {"imu": {"rateScale": scale}}, "groundTruth": {"shift": 0.1}}
    found = warned(changed(scanned, repair=spoiled))
    assert sorted(found) == ["clock.offset", code]
    assert shift_of(found["clock.offset"]) == pytest.approx(-0.1, abs=0.003)
    assert found[code].repair["repair"]["sensors"]["imu"]["rateScale"] == pytest.approx(1 / scale, rel=1e-5)


def swaying(
    seconds: float, drift: float = 0.0, noise: float = 0.0, axes: tuple[float, ...] = (1, 1, 1)
) -> tuple[Turning, Turns]:
    """Return the turning of a body by a gyro of 200 Hz, and the turns of a sensor with its own clock."""
    rng = np.random.default_rng(3)

    def angles(t: Any) -> Any:
        phases = np.outer(t, (0.7, 1.1, 1.6)) + 0.6 * np.sin(np.outer(t, (0.13, 0.21, 0.33)))
        return 0.2 * np.sin(phases) * np.array(axes)

    t = np.arange(0.0, seconds, 0.005)
    reference = Turning(t, angles(t) + np.cumsum(noise * rng.standard_normal((len(t), 3)), axis=0))
    begin = np.arange(1.0, seconds - 1.0, 0.1)
    own = Turns(
        begin * (1.0 - drift),
        (begin + 0.1) * (1.0 - drift),
        (angles(begin + 0.1) - angles(begin)) / 0.1 + 0.001 * rng.standard_normal((len(begin), 3)),
    )
    return reference, own


def test_half_a_turn_that_gravity_contradicts_is_one_of_signs(scanned: DatasetEntry) -> None:
    reference, own = swaying(30.0, axes=(0, 0, 1))
    fit = match(reference, replace(own, rates=-own.rates), np.eye(3))
    upright = TurningSensor("imu", SensorType.IMU, 0.0, np.eye(3), is_upright=True)
    others = [TurningSensor(name, name, 0.0, np.eye(3), fit) for name in (TRUTH, "Lidar")]
    for imu, code in ((upright, "imu.sign"), (replace(upright, is_upright=False), "frames.rotation")):
        found = judge_mountings([imu, *others], scanned.dataset.spec)
        (finding,) = [one for one in found if one.severity != "note"]
        assert (finding.code, finding.sensor) == (code, "imu")
        assert finding.value == pytest.approx(180.0, abs=2.0)


@pytest.mark.parametrize("drift", [0.0, -5e-4])
def test_a_clock_that_runs_away_is_told_from_one_that_is_late(drift: float) -> None:
    found = match(*swaying(60.0, drift), np.eye(3))
    assert found is not None
    assert found.drift == pytest.approx(drift, abs=5e-5)
    assert found.at(30.0) == pytest.approx(30.0 * drift, abs=0.003)


def test_a_turn_about_one_axis_leaves_the_mounting_about_it_open() -> None:
    found = match(*swaying(40.0, axes=(0, 0, 1)), np.eye(3))
    assert found is not None
    known = np.degrees(np.sqrt(np.diag(found.covariance)))
    assert known[:2].max() < 0.5
    assert known[2] > 5.0


def test_nothing_is_told_by_what_is_noise_alone_or_not_of_one_body() -> None:
    assert match(*swaying(40.0, noise=0.02), np.eye(3)) is None
    (reference, _), (_, turns) = swaying(40.0), swaying(60.0, axes=(-1, 1, 1))
    assert match(reference, Turns(turns.begin + 20.0, turns.end + 20.0, turns.rates[::-1]), np.eye(3)) is None


@pytest.mark.parametrize(("apart", "told"), [(0.016, True), (0.1, False)])
def test_halves_that_are_a_little_apart_tell_as_well_as_they_agree(apart: float, told: bool) -> None:
    reference, own = swaying(20.0)
    moved = np.where(own.middle < 10.0, apart, 0.0)
    found = match(reference, Turns(own.begin - moved, own.end - moved, own.rates), np.eye(3))
    assert (found is not None) is told
    if found is not None:
        assert found.error >= 0.9 * apart > found.offset > 0.0
