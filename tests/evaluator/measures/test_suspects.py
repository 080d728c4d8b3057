# SPDX-License-Identifier: Apache-2.0
"""Suspect stretches of ground truth, on paths whose faults are known."""

from __future__ import annotations

import json

import numpy as np
import pytest

from slamhive_eval import Trajectory
from slamhive_eval.errors import OptionError
from slamhive_eval.measures.suspects import SystemEstimate, find_suspects

T = np.linspace(0.0, 60.0, 1201)
PATH = np.stack([10 * np.sin(T / 7), 6 * np.cos(T / 5), 0.5 * np.sin(T / 9)], axis=1)


def trajectory(positions: np.ndarray) -> Trajectory:
    return Trajectory(T, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(T), 1)))


def systems(count: int, seed: int = 1) -> dict[str, list[SystemEstimate]]:
    """Return estimates that drift in ways of their own, two runs each."""
    rng = np.random.default_rng(seed)
    made = {}
    for number in range(count):
        drift = np.cumsum(rng.normal(0, 0.0015, (len(T), 3)), axis=0)
        made[f"s{number}"] = [
            SystemEstimate(trajectory(PATH + drift + rng.normal(0, 0.003, PATH.shape))) for _ in range(2)
        ]
    return made


def test_a_stretch_that_is_wrong_is_found_with_its_size() -> None:
    wrong = PATH.copy()
    inside = (T > 20) & (T < 26)
    wrong[inside] += np.array([0.0, 0.6, 0.0])
    found = find_suspects(trajectory(wrong), systems(4))
    assert len(found.stretches) == 1
    one = found.stretches[0]
    assert one.begin == pytest.approx(20, abs=0.2)
    assert one.end == pytest.approx(26, abs=0.2)
    assert one.metres == pytest.approx(0.6, rel=0.15)
    assert one.direction[1] < -0.95, "the systems lie on the other side"
    for name in found.systems:
        assert found.rmse_without[name] < 0.4 * found.rmse[name]


@pytest.mark.parametrize("seed", range(8))
def test_a_truth_that_is_right_is_left_alone(seed: int) -> None:
    assert find_suspects(trajectory(PATH), systems(4, seed)).stretches == ()


def test_one_system_that_fails_says_nothing_of_the_truth() -> None:
    given = systems(4)
    off = PATH.copy()
    off[T > 30] += 2.0
    given["s0"] = [SystemEstimate(trajectory(off))]
    assert find_suspects(trajectory(PATH), given).stretches == ()


def test_two_systems_are_too_few() -> None:
    with pytest.raises(OptionError, match="2 with a trajectory"):
        find_suspects(trajectory(PATH), systems(2))


def test_a_system_without_poses_has_no_error() -> None:
    given = systems(4)
    given["late"] = [SystemEstimate(trajectory(PATH).shifted(1000.0))]
    found = find_suspects(trajectory(PATH), given).as_dict()
    assert found["rmse"]["late"] is None
    json.dumps(found, allow_nan=False)
