# SPDX-License-Identifier: Apache-2.0
"""Pairwise relations as ground truth."""

from __future__ import annotations

import bz2
import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import (
    OptionError,
    Relations,
    Trajectory,
    evaluate_relations,
    read_relations,
    rotation,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from typing import Any


def relations_of(trajectory: Trajectory, i: np.ndarray, j: np.ndarray) -> Relations:
    back = rotation.conjugate(trajectory.quaternions[i])
    step = rotation.rotate(back, trajectory.positions[j] - trajectory.positions[i])
    turn = rotation.multiply(back, trajectory.quaternions[j])
    return Relations(trajectory.stamps[i], trajectory.stamps[j], step, turn)


@pytest.fixture(name="truth")
def truth_fixture(wander: Callable[..., Trajectory]) -> Relations:
    rng = np.random.default_rng(4)
    return relations_of(wander(), rng.integers(0, 200, 50), rng.integers(0, 200, 50))


def test_any_world_frame_gives_zero(wander: Callable[..., Trajectory], truth: Relations) -> None:
    turn = rotation.to_matrix(np.array((0.5, 0.5, -0.5, 0.5)))
    found = evaluate_relations(truth, wander().transformed(turn, np.array((3.0, 4.0, 5.0))))
    assert (found.relations, found.count, found.missing) == (50, 50, 0)
    assert found.translation_errors.max() < 1e-9
    assert found.rotation_errors_deg.max() < 1e-5


def test_estimate_of_a_sensor(wander: Callable[..., Trajectory], truth: Relations) -> None:
    extrinsic = np.eye(4)
    extrinsic[:3, :3] = rotation.to_matrix(np.array((0.6, 0.0, 0.0, 0.8)))
    extrinsic[:3, 3] = (0.5, 0.1, -0.4)
    sensor = wander().moved(extrinsic)
    assert evaluate_relations(truth, sensor, extrinsic=extrinsic).translation_errors.max() < 1e-9
    assert evaluate_relations(truth, sensor, extrinsic=extrinsic).rotation_errors_deg.max() < 1e-5
    assert evaluate_relations(truth, sensor).translation_errors.max() > 0.1


def test_known_errors_missing_poses_and_groups() -> None:
    n = 21
    estimate = Trajectory(
        np.arange(n) * 1.0,
        np.column_stack((np.arange(n) * 1.1, np.zeros((n, 2)))),
        rotation.from_roll_pitch_yaw(np.outer(np.arange(n) * 0.01, (0, 0, 1))),
    )
    still = np.tile((0.0, 0, 0, 1), (4, 1))
    truth = Relations(
        np.array((0.0, 0.0, 20.0, 5.0)), np.array((1.0, 20.0, 0.0, 30.0)), np.array(((1.0, 0, 0),) * 4), still
    )
    found = evaluate_relations(truth, estimate)
    np.testing.assert_array_equal(found.used, (True, True, True, False))
    np.testing.assert_allclose(found.translation_errors[:2], (0.1, 21.0))
    np.testing.assert_allclose(np.deg2rad(found.rotation_errors_deg), (0.01, 0.2, 0.2))
    assert [group.count for group in found.by_time] == [0, 1, 2, 0, 0]
    assert found.by_time[0].translation is None
    assert found.by_time[1].rotation_deg.mean == pytest.approx(np.rad2deg(0.01))
    result = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert (result["count"], result["missing"], len(result["byTime"])) == (3, 1, 5)


def test_interpolated_poses(wander: Callable[..., Trajectory]) -> None:
    whole = wander(201)
    truth = relations_of(whole, np.arange(1, 100, 2), np.arange(101, 200, 2))
    every_second = whole.select(np.arange(0, 201, 2))
    assert evaluate_relations(truth, every_second).count == 0
    found = evaluate_relations(truth, every_second, interpolate_gap_seconds=0.3)
    assert found.count == 50
    assert found.overall.translation.rmse < 0.5  # 1.5° over 10 m


def test_roll_pitch_yaw_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "one.relations"
    file.write_text("# t1 t2 x y z roll pitch yaw\n1 2 1 2 3 0.1 0.2 0.3\n")
    c, s = np.cos((0.1, 0.2, 0.3)), np.sin((0.1, 0.2, 0.3))
    rx = np.array(((1, 0, 0), (0, c[0], -s[0]), (0, s[0], c[0])))
    ry = np.array(((c[1], 0, s[1]), (0, 1, 0), (-s[1], 0, c[1])))
    rz = np.array(((c[2], -s[2], 0), (s[2], c[2], 0), (0, 0, 1)))
    np.testing.assert_allclose(rotation.to_matrix(read_relations(file).quaternions)[0], rz @ ry @ rx)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"bins_seconds": (1.0, 0.5)}, "must ascend"),
        ({"bins_seconds": ()}, "must ascend"),
        ({"max_difference_seconds": -1.0}, "≥ 0 s"),
        ({"extrinsic": np.zeros((4, 4))}, "last row"),
    ],
)
def test_wrong_options(
    wander: Callable[..., Trajectory], truth: Relations, arguments: Any, says: str
) -> None:
    with pytest.raises(OptionError, match=says):
        evaluate_relations(truth, wander(), **arguments)


def test_raw_odometry_of_the_intel_lab(lidar2d: Path) -> None:
    rows = []
    with bz2.open(lidar2d / "intel.clf.bz2", "rt") as log:
        for words in map(str.split, log):
            if words[:1] == ["FLASER"]:
                x, y, theta = words[-6:-3]
                rows.append((float(words[-3]), float(x), float(y), float(theta)))
    stamps, x, y, theta = np.array(sorted(rows)).T
    flat = np.zeros_like(x)
    odometry = Trajectory(
        stamps,
        np.column_stack((x, y, flat)),
        rotation.from_roll_pitch_yaw(np.column_stack((flat, flat, theta))),
    )
    found = evaluate_relations(read_relations(lidar2d / "intel.relations"), odometry)
    assert (found.relations, found.missing) == (2984, 0)
    assert [group.count for group in found.by_time] == [365, 1405, 18, 662, 534]
    means = [group.translation.mean for group in found.by_time]
    assert max(means[:2]) < 0.03
    assert min(means[3:]) > 10
    assert found.by_time[1].rotation_deg.mean < 2
