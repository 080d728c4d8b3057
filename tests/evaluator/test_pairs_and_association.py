# SPDX-License-Identifier: Apache-2.0
"""Choices of poses against the plainest implementation of their definition."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive_eval import OptionError, Trajectory, associate, find_pairs, interpolate, rotation

if TYPE_CHECKING:
    from collections.abc import Callable

# Multiples of 1/8 add up exactly: ties are ties.
eighths = st.lists(st.integers(0, 40).map(lambda k: k / 8), min_size=1, max_size=30).map(sorted)
steps = st.lists(st.sampled_from((0.0, 0.0, 0.125, 0.25, 0.5, 1.0)), min_size=1, max_size=40)


def at(stamps: list[float]) -> Trajectory:
    n = len(stamps)
    return Trajectory(np.array(stamps), np.zeros((n, 3)), np.tile((0.0, 0, 0, 1), (n, 1)))


def along(lengths: list[float]) -> Trajectory:
    x = np.concatenate(([0.0], np.cumsum(lengths)))
    n = len(x)
    positions = np.column_stack((x, np.zeros((n, 2))))
    return Trajectory(np.arange(n) * 0.5, positions, np.tile((0.0, 0, 0, 1), (n, 1)))


@given(eighths, eighths, st.sampled_from((0.0, 0.125, 0.25)), st.sampled_from((0.0, 0.25, -1.0)))
def test_nearest_of_the_longer_for_each_of_the_shorter(
    reference: list[float], estimate: list[float], tolerance: float, offset: float
) -> None:
    """Evo's pairs; of those that share a pose of the longer one the closest, the first of equally close."""
    found = associate(at(reference), at(estimate), tolerance, offset)
    longer = np.array(estimate) + offset if len(estimate) > len(reference) else np.array(reference) - offset
    shorter = reference if len(estimate) > len(reference) else estimate
    index = (found.reference.tolist(), found.estimate.tolist())
    of_short, of_long = index if len(estimate) > len(reference) else index[::-1]
    gaps = [np.abs(longer - stamp).min() for stamp in shorter]
    for i, j in zip(of_short, of_long, strict=True):
        assert abs(longer[j] - shorter[i]) == gaps[i] <= tolerance
        assert longer[j] == longer[np.argmin(np.abs(longer - shorter[i]))]
    assert of_short == sorted(set(of_short))
    assert of_long == sorted(set(of_long))
    taken = {longer[j]: gaps[i] for i, j in zip(of_short, of_long, strict=True)}
    for i, gap in enumerate(gaps):
        if gap <= tolerance and i not in of_short:
            assert taken[longer[np.argmin(np.abs(longer - shorter[i]))]] <= gap


def test_many_poses_never_share_one() -> None:
    """A short estimate at 200 Hz beside a long ground truth at 10 Hz; an estimate of one stamp."""
    truth = at((np.arange(300) / 10).tolist())
    dense = associate(truth, at((2.0 + np.arange(200) / 200 + 0.001).tolist()), 0.05)
    assert dense.reference.tolist() == list(range(20, 31))
    assert dense.estimate.tolist() == [*range(0, 200, 20), 199]
    assert associate(truth, at([3.0] * 200)).reference.tolist() == [30]


def test_of_equally_long_ones_the_estimate_counts_as_the_shorter() -> None:
    found = associate(at([0.0, 1.0, 2.0]), at([0.0, 0.001, 2.0]))
    assert found.reference.tolist() == [0, 2]
    assert found.estimate.tolist() == [0, 2]


def test_of_equal_stamps_the_last_is_taken_as_in_evo() -> None:
    found = associate(at([1.0, 2.0, 2.0, 3.0]), at([2.0, 2.005]))
    assert found.reference.tolist() == [2]
    assert found.estimate.tolist() == [0]


@given(steps, st.sampled_from((0.25, 0.5, 1.0)), st.sampled_from((0.0, 0.25, 1.0)))
def test_all_pairs_by_path_and_time(lengths: list[float], delta: float, tolerance: float) -> None:
    trajectory = along(lengths)
    for unit, position in (("m", trajectory.distances), ("s", trajectory.stamps)):
        expected = []
        for i in range(len(trajectory) - 1):
            miss = np.abs(position[i + 1 :] - position[i] - delta)
            if miss.min() <= delta * tolerance:
                expected.append([i, i + 1 + int(np.argmin(miss))])
        found = find_pairs(trajectory, delta, unit, all_pairs=True, rel_tolerance=tolerance)
        assert found.tolist() == expected


@given(steps, st.sampled_from((0.25, 0.5, 1.0)))
def test_consecutive_pairs_by_path_and_time(lengths: list[float], delta: float) -> None:
    trajectory = along(lengths)
    for unit, position in (("m", trajectory.distances), ("s", trajectory.stamps)):
        found = find_pairs(trajectory, delta, unit, all_pairs=False).tolist()
        assert [i for i, _ in found] == [0, *(j for _, j in found)][: len(found)]
        for i, j in found:
            assert position[j] - position[i] >= delta > position[j - 1] - position[i]
        last = found[-1][1] if found else 0
        assert position[-1] - position[last] < delta


def test_pairs_by_angle(wander: Callable[..., Trajectory]) -> None:
    trajectory = wander(120)
    q = trajectory.quaternions
    angles = np.rad2deg(rotation.angle(rotation.multiply(rotation.conjugate(q)[:, None], q[None])))
    expected = np.argwhere(np.triu((angles >= 9) & (angles <= 11), 1))
    np.testing.assert_array_equal(find_pairs(trajectory, 10, "deg", all_pairs=True), expected)
    wide = find_pairs(trajectory, 10, "deg", all_pairs=True, rel_tolerance=1.0)
    np.testing.assert_array_equal(wide, np.argwhere(np.triu(angles <= 20, 1)))
    consecutive = find_pairs(trajectory, 10, "deg", all_pairs=False)
    turned = np.diag(angles, 1)
    assert len(consecutive) > 3
    for i, j in consecutive:
        assert turned[i:j].sum() >= 10 > turned[i : j - 1].sum()
    radians = find_pairs(trajectory, np.deg2rad(10), "rad", all_pairs=False)
    np.testing.assert_array_equal(radians, consecutive)


@pytest.mark.parametrize("unit", ["frames", "m", "s", "deg", "rad"])
@pytest.mark.parametrize("every", [True, False])
def test_no_pairs_of_one_pose(wander: Callable[..., Trajectory], unit: str, every: bool) -> None:
    assert find_pairs(wander(1), 1, unit, all_pairs=every).shape == (0, 2)


def test_frames(wander: Callable[..., Trajectory]) -> None:
    assert find_pairs(wander(7), 3.0, "frames", all_pairs=False).tolist() == [[0, 3], [3, 6]]
    assert find_pairs(wander(6), 3, "frames", all_pairs=True).tolist() == [[0, 3], [1, 4], [2, 5]]
    assert find_pairs(wander(6), 9, "frames", all_pairs=True).shape == (0, 2)


def test_interpolation(wander: Callable[..., Trajectory]) -> None:
    whole = wander(101)
    sparse = whole.select(np.arange(0, 101, 4))
    signs = np.where(np.arange(len(sparse)) % 2, -1.0, 1.0)[:, np.newaxis]
    sparse = Trajectory(sparse.stamps, sparse.positions, signs * sparse.quaternions)
    found, positions, quaternions = interpolate(sparse, whole.stamps, 0.5)
    assert found.all()
    assert np.abs(positions - whole.positions).max() < 0.1
    turn = rotation.multiply(rotation.conjugate(quaternions), whole.quaternions)
    assert np.rad2deg(rotation.angle(turn)).max() < 5
    np.testing.assert_array_equal(positions[::4], sparse.positions)
    found, _, _ = interpolate(sparse, whole.stamps, 0.1)
    np.testing.assert_array_equal(np.flatnonzero(found), np.arange(0, 101, 4))
    outside = np.array((whole.stamps[0] - 1, whole.stamps[-1] + 1))
    assert not interpolate(sparse, outside, 100.0)[0].any()


def test_more_pairs_by_angle_than_can_be_compared_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamhive_eval.pairs.MAX_ANGLE_PAIRS", 4950)
    still = at([k / 8 for k in range(100)])
    assert len(find_pairs(still, 1e-9, "deg", all_pairs=True, rel_tolerance=1.0)) == 4950
    more = at([k / 8 for k in range(101)])
    with pytest.raises(OptionError, match=r"more than 4,950 pairs of poses are 1e-09° .* smaller tolerance"):
        find_pairs(more, 1e-9, "deg", all_pairs=True, rel_tolerance=1.0)
