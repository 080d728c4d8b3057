# SPDX-License-Identifier: Apache-2.0
"""One-to-one and interpolated matching."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive_eval import (
    AssociationError,
    OptionError,
    Trajectory,
    associate_forward,
    associate_uniquely,
    match,
)

if TYPE_CHECKING:
    from collections.abc import Callable

# Multiples of 1/8 add up exactly: ties are ties.
eighths = st.lists(st.integers(0, 60).map(lambda k: k / 8), min_size=1, max_size=30, unique=True).map(sorted)


def at(stamps: list[float]) -> Trajectory:
    n = len(stamps)
    return Trajectory(np.array(stamps), np.zeros((n, 3)), np.tile((0.0, 0, 0, 1), (n, 1)))


def as_the_tum_tools(
    a: list[float], b: list[float], tolerance: float, offset: float
) -> list[tuple[int, int]]:
    close = sorted((abs(x - (y + offset)), x, y) for x in a for y in b if abs(x - (y + offset)) < tolerance)
    left, right, pairs = set(a), set(b), []
    for _, x, y in close:
        if x in left and y in right:
            left.remove(x)
            right.remove(y)
            pairs.append((a.index(x), b.index(y)))
    return sorted(pairs)


@given(eighths, eighths, st.sampled_from((0.125, 0.25, 0.5, 100.0)), st.sampled_from((0.0, 0.25, -1.0)))
def test_one_to_one(a: list[float], b: list[float], tolerance: float, offset: float) -> None:
    found = associate_uniquely(at(a), at(b), tolerance, offset)
    pairs = list(zip(found.reference.tolist(), found.estimate.tolist(), strict=True))
    assert pairs == as_the_tum_tools(a, b, tolerance, offset)


def test_equal_stamps_pair_once() -> None:
    found = associate_uniquely(at([1.0, 1.0, 2.0]), at([1.0, 1.0, 1.0]), 0.5)
    assert found.reference.tolist() == [0, 1]
    assert len(set(found.estimate.tolist())) == 2


def test_interpolated_ground_truth(wander: Callable[..., Trajectory]) -> None:
    truth = wander(100)
    between = truth.shifted(0.05)
    nearest = match(truth, between, max_difference_seconds=0.01, matching="interpolate", max_gap_seconds=0.2)
    assert len(nearest[0]) == len(nearest[1]) == 99
    middle = (truth.positions[:-1] + truth.positions[1:]) / 2
    np.testing.assert_allclose(nearest[0].positions, middle, atol=1e-6)
    holes = truth.select(np.r_[0:30, 40:100])
    assert len(match(holes, between, "interpolate", max_gap_seconds=0.5)[0]) == 88
    shifted = match(truth, between, "interpolate", offset_seconds=0.025)
    np.testing.assert_allclose(
        shifted[0].positions, 0.25 * truth.positions[:-1] + 0.75 * truth.positions[1:], atol=1e-6
    )
    np.testing.assert_array_equal(shifted[1].positions, truth.positions[:-1])


@pytest.mark.parametrize(
    ("truth", "estimate", "pairs"),
    [
        ([0.0, 0.125, 0.25], [0.0, 0.125, 0.25], [(0, 0), (1, 1), (2, 2)]),
        # The first takes what is nearest to it, though it would suit the second better.
        ([1.0], [0.875, 1.0], [(0, 0)]),
        # What was passed over on the way to a nearer one is gone.
        ([1.0, 1.125], [1.1, 1.11], [(1, 0)]),
        # The tolerance itself is too much.
        ([0.0], [0.25], []),
        # As there, a pose exactly that far before stands in the way of the one after it.
        ([0.75, 1.0], [1.0, 1.125], [(1, 1)]),
        ([0.0, 5.0], [4.875, 9.0], [(1, 0)]),
    ],
)
def test_in_one_pass(truth: list[float], estimate: list[float], pairs: list[tuple[int, int]]) -> None:
    found = associate_forward(at(truth), at(estimate), 0.25)
    assert list(zip(found.reference.tolist(), found.estimate.tolist(), strict=True)) == pairs


@given(eighths, eighths, st.sampled_from((0.125, 0.25, 0.5)), st.sampled_from((0.0, 0.25, -1.0)))
def test_one_pass_is_one_to_one(a: list[float], b: list[float], tolerance: float, offset: float) -> None:
    found = associate_forward(at(a), at(b), tolerance, offset)
    assert (np.diff(found.reference) > 0).all()
    assert (np.diff(found.estimate) > 0).all()
    assert (np.abs(np.array(a)[found.reference] - np.array(b)[found.estimate] - offset) < tolerance).all()


def test_one_pass_takes_the_stamps_of_the_reference(wander: Callable[..., Trajectory]) -> None:
    reference, estimate = match(wander(50), wander(50).shifted(0.004), "forward")
    np.testing.assert_array_equal(reference.stamps, estimate.stamps)


@pytest.mark.parametrize("how", ["nearest", "unique", "forward"])
def test_match(wander: Callable[..., Trajectory], how: str) -> None:
    reference, estimate = match(wander(100), wander(100).select(np.arange(0, 100, 3)).shifted(0.004), how)
    assert len(reference) == len(estimate) == 34
    np.testing.assert_array_equal(reference.positions, estimate.positions)


@pytest.mark.parametrize(
    ("arguments", "error", "says"),
    [
        (
            {"matching": "best"},
            OptionError,
            "unknown matching 'best'; known are nearest, unique, forward, interpolate",
        ),
        ({"offset_seconds": 1e6}, AssociationError, "no pose of the estimate"),
        ({"offset_seconds": 1e6, "matching": "unique"}, AssociationError, "no pose of the estimate"),
        ({"offset_seconds": 1e6, "matching": "interpolate"}, AssociationError, "no pose of the estimate"),
        ({"matching": "interpolate", "max_gap_seconds": -1}, OptionError, "largest gap of the ground truth"),
        ({"matching": "unique", "max_difference_seconds": -1}, OptionError, "must be ≥ 0 s, not -1"),
    ],
)
def test_wrong_options(
    wander: Callable[..., Trajectory], arguments: dict[str, object], error: type[Exception], says: str
) -> None:
    with pytest.raises(error, match=says):
        match(wander(), wander(), **arguments)
