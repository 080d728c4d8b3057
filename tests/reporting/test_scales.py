# SPDX-License-Identifier: Apache-2.0
"""Axes: everything is within, ticks are round and few."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive.reporting.scales import Scale

numbers = st.floats(-1e12, 1e12).filter(lambda one: one == 0 or abs(one) > 1e-12)


@given(st.lists(numbers, min_size=1, max_size=20))
def test_everything_is_on_the_axis(values: list[float]) -> None:
    scale = Scale.over(values, 10.0, 400.0)
    places = [scale.at(value) for value in values]
    assert all(9.9 <= place <= 400.1 for place in places)
    ordered = sorted(zip(values, places, strict=True))
    assert [place for _, place in ordered] == sorted(places)
    assert all(9.9 <= scale.at(tick) <= 400.1 for tick in scale.ticks)
    assert len(scale.ticks) <= 12


@pytest.mark.parametrize(
    ("values", "log", "ticks"),
    [
        ([0.3, 1.1], False, (0.0, 0.25, 0.5, 0.75, 1.0)),
        ([100, 104], False, (100, 101, 102, 103, 104)),
        ([0.01, 10], True, (0.01, 0.1, 1.0, 10.0)),
        ([1, 30], True, (1.0, 3.0, 10.0, 30.0)),
    ],
)
def test_ticks_are_round(values: list[float], log: bool, ticks: tuple[float, ...]) -> None:
    scale = Scale.over(values, 0.0, 300.0)
    assert scale.log == log
    assert scale.ticks == pytest.approx(ticks)


def test_a_logarithm_needs_positive_numbers() -> None:
    assert not Scale.over([0.0, 100.0], 0, 1, log=True).log
    assert Scale.over([1.0, 2.0], 0, 1, log=True).log


@pytest.mark.parametrize("values", [[], [math.inf, math.nan], [0.0], [5.0, 5.0], [-3.0]])
def test_little_to_draw(values: list[float]) -> None:
    scale = Scale.over(values, 0.0, 100.0)
    assert scale.high > scale.low
    assert len(scale.ticks) >= 2


@pytest.mark.parametrize(
    ("tick", "text"), [(0.0, "0"), (0.25, "0.25"), (1e-7, "1e-07"), (2e6, "2e+06"), (1500.0, "1500")]
)
def test_labels(tick: float, text: str) -> None:
    assert Scale.over([1.0], 0, 1).label(tick) == text
