# SPDX-License-Identifier: Apache-2.0
"""Faults of a pair of trajectories: each by itself, and none."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive_eval import Trajectory, rotation, write_tum
from slamhive_eval.command import main
from slamhive_eval.conventions import read_as
from slamhive_eval.measures.explaining import explain
from thinning import thinned

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SECONDS, RATE = 40.0, 50


def truth() -> Trajectory:
    """A hand-held walk about a room that turns about all axes."""
    random = np.random.default_rng(5)
    t = np.arange(0.0, SECONDS, 1.0 / RATE)

    def wave(size: float) -> Any:
        parts = random.uniform(0.03, 0.35, (5, 1)), random.uniform(0, 7, (5, 1)), random.normal(size=(5, 1))
        return size * np.sum(parts[2] * np.sin(2 * np.pi * parts[0] * t + parts[1]), axis=0) / 2.0

    positions = np.stack([wave(3.0), wave(3.0), wave(0.5)], axis=1)
    turns = np.stack([wave(0.3), wave(0.3), wave(1.2)], axis=1)
    return Trajectory(1.6e9 + t, positions, rotation.from_roll_pitch_yaw(turns))


def estimate(drift: float = 0.0) -> Trajectory:
    """A good system's estimate of it, in a world of its own: 1 cm and 0.3° of noise, and a drift in m."""
    random = np.random.default_rng(6)
    found = truth().select(slice(1, None, 3))
    noise = random.normal(0.0, 0.01, (len(found), 3))
    walk = np.cumsum(random.normal(0.0, drift / len(found) ** 0.5, (len(found), 3)), axis=0)
    turned = rotation.multiply(
        found.quaternions, rotation.from_roll_pitch_yaw(random.normal(0.0, 0.005, (len(found), 3)))
    )
    world = rotation.to_matrix(rotation.from_roll_pitch_yaw(np.array([[0.3, -0.2, 1.0]])))[0]
    drifted = Trajectory(found.stamps, found.positions + noise + walk, turned)
    return drifted.transformed(world, np.array([1.0, 2.0, 3.0]))


def frame(turn: tuple[float, float, float] = (0, 0, 0), arm: tuple[float, float, float] = (0, 0, 0)) -> Any:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.to_matrix(rotation.from_roll_pitch_yaw(np.array([turn], float)))[0]
    matrix[:3, 3] = arm
    return matrix


def scaled(factor: float) -> Callable[[Trajectory], Trajectory]:
    return lambda one: one.transformed(np.eye(3), np.zeros(3), factor)


FAULTS: dict[str, tuple[Callable[[Trajectory], Trajectory], str, float | None, str]] = {
    "late": (lambda one: one.shifted(0.1), "clock", -0.1, "are added to its stamps"),
    "early": (lambda one: one.shifted(-0.05), "clock", 0.05, ""),
    "far": (lambda one: one.shifted(1.5), "clock", -1.5, ""),
    "TAI": (lambda one: one.shifted(37.0), "clock", -37.0, "TAI instead of UTC"),
    "GPS": (lambda one: one.shifted(18.0), "clock", -18.0, "GPS time instead of UTC"),
    "GPS epoch": (lambda one: one.shifted(18.0 - 315_964_800.0), "clock", 315_964_782.0, "GPS time"),
    "zone": (lambda one: one.shifted(7200.0), "clock", -7200.0, "2 h, as between time zones"),
    "boot": (lambda one: one.shifted(-1.6e9 + 5.25), "clock", 1.6e9 - 5.25, ""),
    "inverse": (lambda one: read_as(one, "inverse"), "inverse", None, "of the world in the body"),
    "rotations": (lambda one: read_as(one, "inverse-rotation"), "inverse-rotation", None, "rotations"),
    "wxyz": (
        lambda one: Trajectory(one.stamps, one.positions, one.quaternions[:, [3, 0, 1, 2]]),
        "wxyz",
        None,
        "w x y z",
    ),
    "left-handed": (lambda one: read_as(one, "left-handed"), "left-handed", None, "left-handed"),
    "upside down": (lambda one: one.moved(frame((np.pi, 0, 0))), "turn", 180.0, "180° about x"),
    "camera": (lambda one: one.moved(frame((-np.pi / 2, 0, -np.pi / 2))), "turn", 120.0, "camera axes"),
    "tilted": (lambda one: one.moved(frame((0, np.deg2rad(3.0), 0))), "turn", 3.0, "by 3."),
    "arm": (
        lambda one: one.moved(frame(arm=(0.3, 0.05, -0.1))),
        "lever",
        0.32,
        "m in the body, not at its origin",
    ),
    "short arm": (lambda one: one.moved(frame(arm=(0, 0.1, 0))), "lever", 0.1, ""),
    "half": (scaled(0.5), "scale", 2.0, "multiplied by 2"),
    "a little": (scaled(1.05), "scale", 0.952, ""),
    "millimetres": (scaled(1000.0), "scale", 0.001, ""),
}


@pytest.mark.parametrize("name", thinned(FAULTS))
def test_a_fault_is_named_with_its_number(name: str) -> None:
    spoil, code, value, says = FAULTS[name]
    found = explain(truth(), spoil(estimate()))
    assert [fault.code for fault in found.faults] == [code]
    (fault,) = found.faults
    assert says in fault.message
    if value is not None:
        limit = {"clock": 3e-3, "turn": 0.3, "lever": 0.01, "scale": 3e-3}[code]
        assert fault.value == pytest.approx(value, abs=limit, rel=1e-9)
    assert found.after is not None
    assert found.after.position < 0.03


@pytest.mark.parametrize("drift", [0.0, 0.2])
def test_nothing_is_said_of_a_pair_as_it_should_be(drift: float) -> None:
    assert explain(truth(), estimate(drift)).faults == ()


def test_an_offset_is_that_of_the_turns_where_positions_drift() -> None:
    """Positions that drift and are ahead of the turns suit another offset than the clock's best."""
    found = estimate()
    t = found.stamps - found.stamps[0]
    ahead = np.stack([np.interp(t + 0.03, t, axis) for axis in found.positions.T], axis=1)
    ahead += np.stack([np.sin(np.pi * t / SECONDS), np.cos(np.pi * t / SECONDS), 0 * t], axis=1)
    yaw = np.stack([0 * t, 0 * t, 0.2 * np.sin(2 * np.pi * t / SECONDS)], axis=1)
    turned = rotation.multiply(rotation.from_roll_pitch_yaw(yaw), found.quaternions)
    (fault,) = explain(truth(), Trajectory(found.stamps, ahead, turned).shifted(0.15)).faults
    assert (fault.code, fault.value) == ("clock", pytest.approx(-0.15, abs=2e-3))


def test_two_faults_are_undone_one_after_the_other() -> None:
    found = explain(truth(), read_as(estimate().shifted(0.2), "inverse"))
    assert {fault.code for fault in found.faults} == {"clock", "inverse"}


def test_the_flags_do_what_they_say(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A turned frame with an arm: `ape` takes the flag that `explain` names, and hints at it by itself."""
    gt, est, file = (tmp_path / name for name in ("gt.txt", "est.txt", "T.txt"))
    write_tum(gt, truth())
    write_tum(est, estimate().moved(frame((np.pi, 0, 0), (0.3, 0.0, 0.2))))
    assert main(["explain", str(gt), str(est), "--write-extrinsic", str(file)]) == 0
    said = capsys.readouterr().out
    assert "1. fits over" in said or "1. fits 1" in said
    assert "--extrinsic FILE" in said
    match = ("--align", "se3", "--max-diff", "0.02", "--relation", "angle_deg", "--json")
    assert main(["ape", str(gt), str(est), *match]) == 0
    before = json.loads(capsys.readouterr().out)
    assert any("180° about x" in note for note in before["notes"])
    assert main(["ape", str(gt), str(est), *match, "--extrinsic", str(file)]) == 0
    after = json.loads(capsys.readouterr().out)
    assert after["rmse"] < before["rmse"] / 50
    assert after["notes"] == []


def test_what_is_not_compared_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gt, est = tmp_path / "gt.txt", tmp_path / "est.txt"
    whole = truth()
    write_tum(gt, whole)
    write_tum(est, whole.at(whole.stamps + np.where(np.arange(len(whole)) > 60, 0.01, 0.0)))
    assert main(["ape", str(gt), str(est), "--max-diff", "0.005"]) == 0
    assert "poses have a partner of their own within 0.005 s" in capsys.readouterr().out
    write_tum(est, whole.at(np.full(len(whole), whole.stamps[0])))
    assert main(["ape", str(gt), str(est)]) == 0
    assert f"1 of {len(whole)} poses have a partner of their own" in (said := capsys.readouterr().out)
    assert f"note: {len(whole) - 1} poses of the estimate have the stamp of the one before" in said
    assert main(["explain", str(gt), str(est)]) == 0
    said = capsys.readouterr().out
    assert "no poses belong together" in said
    assert f"note: {len(whole) - 1} poses of the estimate have the stamp" in said
    write_tum(est, whole.shifted(0.01))
    assert main(["ape", str(gt), str(est), "--max-diff", "0.001"]) == 2
    assert "--match interpolate" in capsys.readouterr().err
