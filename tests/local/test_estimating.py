# SPDX-License-Identifier: Apache-2.0
"""Estimates of how long a sweep still takes: from what is known of its settings, then from itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.local.estimating import Estimate
from slamhive.plan import Plan

from .conftest import sweep_of

if TYPE_CHECKING:
    from slamhive.local.catalog import Workshop


@pytest.fixture
def points(workshop: Workshop) -> Plan:
    return Plan(sweep_of(["good", "crash"], repetitions=3), workshop)


def estimate(points: Plan, walls: dict[Any, Any] | None = None) -> Estimate:
    return Estimate(points, None, {("actor", "tiny"): [9.0, 10.0, 20.0]} if walls is None else walls)


def test_nobody_knows_at_first(points: Plan) -> None:
    assert estimate(points, {}).left(range(6), {}, 2) is None
    assert estimate(points, {}).seconds(0) is None


def test_it_begins_with_the_median_of_the_same_algorithm_and_dataset(points: Plan) -> None:
    assert estimate(points).left(range(6), {}, 2) == pytest.approx(30.0)
    assert estimate(points, {("other", "tiny"): [1.0]}).left(range(6), {}, 2) is None


def test_what_a_setting_took_in_this_sweep_counts_more(points: Plan) -> None:
    found = estimate(points)
    found.note(0, 2.0, 3.0)
    assert found.seconds(1) == pytest.approx(3.0)  # the same setting, with what is prepared and measured
    assert found.seconds(3) == pytest.approx(3.0)  # another one: as the runs of this sweep do
    found.note(3, 40.0, 41.0)
    assert found.left([4, 5], {}, 1) == pytest.approx(82.0)


def test_what_runs_has_less_left_and_the_end_is_no_sooner_than_its_own(points: Plan) -> None:
    found = estimate(points)
    assert found.left([], {0: 4.0, 1: 8.0}, 2) == pytest.approx(6.0)
    assert found.left([], {0: 400.0}, 2) == 0.0
    assert found.left([], {}, 2) == 0.0
