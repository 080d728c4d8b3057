# SPDX-License-Identifier: Apache-2.0
"""Offsets and drifts of clocks, planted and found; and what has none to find."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import AssociationError, Trajectory, find_offset, read_trajectory, rotation

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def turning(n: int = 6000, rate: float = 100.0, seed: int = 0) -> Trajectory:
    """A body that turns smoothly at random, faster and slower."""
    t = np.arange(n) / rate
    rng = np.random.default_rng(seed)
    waves = rng.uniform(0.1, 0.8, (3, 6)), rng.uniform(0, 6, (3, 6)), rng.uniform(0.1, 0.4, (3, 6))
    rpy = sum(
        amplitude[None] * np.sin(2 * np.pi * frequency[None] * t[:, None] + phase[None])
        for frequency, phase, amplitude in zip(*(wave.T for wave in waves), strict=True)
    )
    positions = np.column_stack((t, np.sin(t), np.cos(t)))
    return Trajectory(1.6e9 + t, positions, rotation.from_roll_pitch_yaw(rpy))


@pytest.mark.parametrize("offset", [0.0, 0.0137, -0.73, 25.0, -1.6e9])
@pytest.mark.parametrize("every", [1, 5, 30])
def test_a_planted_offset(offset: float, every: int) -> None:
    extrinsic = np.eye(4)
    extrinsic[:3, :3] = rotation.to_matrix(np.array((0.5, -0.5, 0.5, 0.5)))
    kept = turning().select(np.arange(1000, 5000, every)).moved(extrinsic)
    found = find_offset(turning(), kept.transformed(np.eye(3), np.ones(3), 5.0).shifted(-offset))
    # At 30 frames, 0.3 s, keyframes; and stamps of 1.6e9 s resolve 0.24 µs.
    assert found.offset_seconds == pytest.approx(offset, abs=1e-4, rel=1e-12)
    assert found.correlation > 0.999
    assert found.drift == 0


@pytest.mark.parametrize("drift", [0.0, 1e-4, -2e-3])
def test_a_planted_drift(drift: float) -> None:
    truth = turning(30000)
    middle = truth.stamps.mean()
    late = truth.stamps - 0.4 - drift * (truth.stamps - middle)
    estimate = Trajectory(late, truth.positions, truth.quaternions).select(np.arange(0, 30000, 5))
    found = find_offset(truth, estimate, drift=True)
    true = truth.stamps[::5]
    np.testing.assert_allclose(found.apply(estimate).stamps, true, atol=2e-4, rtol=0)
    assert found.apply(estimate).oriented


def test_gaps_do_no_harm() -> None:
    truth = turning()
    kept = np.r_[0:1000, 2000:2600, 4000:6000]
    found = find_offset(truth.select(np.r_[0:2300, 2900:6000]), truth.select(kept).shifted(1.25))
    assert found.offset_seconds == pytest.approx(-1.25, abs=1e-4)


@pytest.mark.parametrize("name", ["fr2_desk_ORB.txt", "fr2_desk_ORB_kf_mono.txt"])
def test_real_runs(trajectories: Path, name: str) -> None:
    """Frames and keyframes of two runs on one recording lag its motion capture by the same 8 ms."""
    truth = read_trajectory(trajectories / "fr2_desk_groundtruth.txt")
    estimate = read_trajectory(trajectories / name)
    assert find_offset(truth, estimate.shifted(3.0)).offset_seconds == pytest.approx(-3.0083, abs=1.5e-3)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda _: turning(seed=7), "doesn't turn as the ground truth does at any time offset"),
        (
            lambda truth: Trajectory(truth.stamps, truth.positions, truth.quaternions, oriented=False),
            "the estimate has no orientations",
        ),
        (lambda truth: truth.select(slice(5)), "can't be found from 5 poses of the estimate"),
        (
            lambda truth: Trajectory(truth.stamps, truth.positions, truth.quaternions[:1].repeat(6000, 0)),
            "the estimate turns by 0.0 degrees in all",
        ),
    ],
)
def test_nothing_to_find(make: Callable[[Trajectory], Trajectory], says: str) -> None:
    with pytest.raises(AssociationError, match=says):
        find_offset(turning(), make(turning()))
