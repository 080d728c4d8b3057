# SPDX-License-Identifier: Apache-2.0
"""Limits of axes: a few numbers far away flatten nothing, and nothing else is cut."""

from __future__ import annotations

import numpy as np
import pytest

from slamhive.analysis.limits import Limits, robust_limits

FORTY = np.linspace(0.008, 0.016, 40)


def test_two_diverged_runs_stay_outside() -> None:
    assert robust_limits([*FORTY, 3.9, 4.2]) == Limits(0.008, 0.016, 0, 2)
    assert robust_limits([*FORTY, -4.2]) == Limits(0.008, 0.016, 1, 0)


@pytest.mark.parametrize(
    "numbers",
    [
        FORTY,
        [1.0, 1.1, 1.2, 50.0],  # of four, none is the exception
        [*FORTY, *np.linspace(4, 5, 15)],  # a second group
        [*FORTY, 0.02],  # not far
        [1.0] * 20,
        [1.0] * 20 + [9.0],  # nothing says what is far
    ],
)
def test_other_numbers_are_all_inside(numbers: list[float]) -> None:
    assert robust_limits(numbers) == Limits(min(numbers), max(numbers))


def test_half_of_them_equal() -> None:
    assert robust_limits([1.0] * 20 + [1.1] * 6 + [1.2] * 6 + [90.0]) == Limits(1.0, 1.2, 0, 1)


def test_logarithms_have_distances_of_their_own() -> None:
    spread = np.geomspace(0.01, 1, 30)
    found = robust_limits([*spread, 1e9], log=True)
    assert found is not None
    assert (found.low, found.high) == pytest.approx((0.01, 1))
    assert (found.above, found.outside) == (1, 1)
    assert robust_limits([*spread, 3.0], log=True) is not None
    assert robust_limits([*spread, 3.0], log=True).above == 0  # type: ignore[union-attr]


def test_what_is_no_number_does_not_count() -> None:
    assert robust_limits([]) is None
    assert robust_limits([np.nan, np.inf]) is None
    assert robust_limits([-1.0, 0.0], log=True) is None
    assert robust_limits([np.nan, 2.0, -1.0]) == Limits(-1.0, 2.0)
    assert robust_limits([0.0, 2.0, -1.0], log=True) == Limits(2.0, 2.0)
