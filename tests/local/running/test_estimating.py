# SPDX-License-Identifier: Apache-2.0
"""Estimates of how long a sweep still takes: from what is known of such runs, then from itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.archive import Cost
from slamhive.local.running.costs import Knowledge
from slamhive.local.running.estimating import Estimate
from slamhive.monitor.measuring.machine import cpu_model
from slamhive.plan import Plan

from .sweeps import sweep_of

if TYPE_CHECKING:
    from slamhive.local.home.catalog import Workshop


@pytest.fixture
def points(workshop: Workshop) -> Plan:
    return Plan(sweep_of(["good", "crash"], repetitions=3), workshop)


def cost(points: Plan, index: int, wall: float, algorithm: str = "actor") -> Cost:
    spec = points.point(index).spec
    return Cost(
        uid=f"{algorithm}-{index}-{wall}",
        algorithm=algorithm,
        dataset="tiny",
        spec=spec,
        reason=None,
        cpu_seconds=wall,
        wall_seconds=wall,
        memory_bytes=1_000_000,
        cpu_model=cpu_model(),
        content_hash=None,
        folder=None,
        prepared=None,
        algorithm_hash=None,
        dataset_sha256=None,
        created=None,
        started=None,
        sweep_uid=None,
    )


def estimate(points: Plan, *costs: Cost) -> Estimate:
    return Estimate(points, Knowledge.of(costs))


def test_nobody_knows_at_first(points: Plan) -> None:
    assert estimate(points).left(range(6), {}, 2) is None
    assert estimate(points).seconds(0) is None
    assert estimate(points, cost(points, 0, 9.0, "other")).seconds(0) is None


def test_it_begins_with_the_runs_of_the_same_setting(points: Plan) -> None:
    known = [cost(points, index, wall) for index, wall in ((0, 9.0), (1, 10.0), (2, 11.0), (3, 30.0))]
    found = estimate(points, *known)
    assert found.seconds(0) == pytest.approx(10.0, rel=0.05)
    assert 10.0 < (found.seconds(5) or 0.0) < 31.0
    each = [found.seconds(index) or 0.0 for index in range(6)]
    assert found.left(range(6), {}, 2) == pytest.approx(sum(each) / 2)


def test_what_a_setting_took_in_this_sweep_counts_more(points: Plan) -> None:
    found = estimate(points, *(cost(points, index, 30.0) for index in range(3)))
    found.note(0, 2.0, 3.0)
    assert found.seconds(1) == pytest.approx(3.0)  # the same setting, with what is prepared and measured
    assert found.seconds(3) == pytest.approx(3.0, rel=0.1)  # another one: as the runs of this sweep do
    found.note(3, 40.0, 41.0)
    assert found.left([4, 5], {}, 1) == pytest.approx(82.0)


def test_what_runs_has_less_left_and_the_end_is_no_sooner_than_its_own(points: Plan) -> None:
    found = estimate(points, *(cost(points, index, 10.0) for index in range(6)))
    assert found.left([], {0: 4.0, 1: 8.0}, 2) == pytest.approx(6.0, rel=0.02)
    assert found.left([], {0: 400.0}, 2) == 0.0
    assert found.left([], {}, 2) == 0.0


def test_of_very_many_settings_some_stand_for_those_beside_them(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.local.running.estimating.MOST_TOLD_APART", 2)
    points = Plan(sweep_of(["good", "crash", "slow", "second", "hang"]), workshop)
    found = estimate(points, *(cost(points, index, 10.0) for index in range(5)))
    assert found.left(range(5), {}, 1) == pytest.approx(50.0, rel=0.1)
