# SPDX-License-Identifier: Apache-2.0
"""A sweep: its window, its limits, its end."""

from __future__ import annotations

import pytest

from slamhive.engine import PointState, StartPoints, StopPoints, SweepObserved, Verdict, decide_sweep
from slamhive.model.sweep import SweepSpec

PENDING, ACTIVE, GOOD, BAD = PointState.PENDING, PointState.ACTIVE, PointState.SUCCEEDED, PointState.FAILED


def seen(states: list[PointState], parallelism: int = 2, **more: object) -> SweepObserved:
    order = list(range(len(states)))
    return SweepObserved(states=bytearray(states), order=order, parallelism=parallelism, **more)  # type: ignore[arg-type]


def spec(**fields: object) -> SweepSpec:
    return SweepSpec.model_validate(fields)


def test_the_window_is_filled_and_no_more() -> None:
    decision = decide_sweep(spec(), seen([GOOD, ACTIVE, PENDING, PENDING, PENDING], 3), 0)
    assert decision.actions == (StartPoints((2, 3)),)
    full = decide_sweep(spec(), seen([ACTIVE, ACTIVE, PENDING]), 0)
    assert full.actions == ()


def test_points_start_in_the_order_given_not_by_index() -> None:
    observed = SweepObserved(states=bytearray(4), order=[3, 1, 0, 2], parallelism=2)
    assert decide_sweep(spec(), observed, 0).actions == (StartPoints((3, 1)),)


def test_a_sweep_is_driven_to_its_end_and_starts_each_point_once() -> None:
    states, cursor, started = bytearray(100), 0, []
    order = [(7 * k) % 100 for k in range(100)]
    while True:
        observed = SweepObserved(states=states, order=order, parallelism=7, cursor=cursor)
        decision = decide_sweep(spec(), observed, 0)
        if decision.verdict is Verdict.COMPLETE:
            break
        cursor = decision.cursor
        for action in decision.actions:
            assert isinstance(action, StartPoints)
            for index in action.indices:
                states[index] = ACTIVE
                started.append(index)
        states[started[len(states) - states.count(PENDING) - states.count(ACTIVE)]] = GOOD
    assert sorted(started) == list(range(100))
    assert cursor > 50


def test_points_that_are_done_are_not_gone_through_again_while_the_first_one_runs() -> None:
    decision = decide_sweep(spec(), seen([ACTIVE, GOOD, BAD, GOOD, PENDING, PENDING], 2), 0)
    assert decision.actions == (StartPoints((4,)),)
    assert decision.cursor == 4


@pytest.mark.parametrize("end", [GOOD, BAD])
def test_a_point_that_comes_out_as_another_starts_after_its_end(end: PointState) -> None:
    twins = {0: 1, 3: 1}
    waiting = decide_sweep(spec(), seen([PENDING, PENDING, PENDING, PENDING], 4, twins=twins), 0)
    assert waiting.actions == (StartPoints((1, 2)),)
    still = decide_sweep(spec(), seen([PENDING, ACTIVE, GOOD, PENDING], 4, twins=twins, cursor=0), 0)
    assert (still.verdict, still.actions) == (Verdict.RUNNING, ())
    ended = decide_sweep(spec(), seen([PENDING, end, GOOD, PENDING], 4, twins=twins, cursor=still.cursor), 0)
    assert ended.actions == (StartPoints((0, 3)),)


@pytest.mark.parametrize(
    ("fields", "observed", "verdict"),
    [
        ({"maxFailures": 1}, seen([BAD, BAD, ACTIVE, PENDING]), Verdict.TOO_MANY_FAILURES),
        ({"maxFailures": 2}, seen([BAD, BAD, ACTIVE, PENDING]), Verdict.RUNNING),
        ({"budget": {"wallTime": "10s"}}, seen([ACTIVE, PENDING], started_at=0.0), Verdict.BUDGET_EXHAUSTED),
        ({"budget": {"wallTime": "11s"}}, seen([ACTIVE, PENDING], started_at=0.0), Verdict.RUNNING),
        ({"budget": {"cpuHours": 1}}, seen([ACTIVE, PENDING], cpu_seconds=3600), Verdict.BUDGET_EXHAUSTED),
        ({"suspend": True}, seen([ACTIVE, PENDING]), Verdict.SUSPENDED),
    ],
)
def test_limits_end_a_sweep_with_their_name(
    fields: dict[str, object], observed: SweepObserved, verdict: Verdict
) -> None:
    decision = decide_sweep(spec(**fields), observed, 10.0)
    assert decision.verdict is verdict
    started = any(isinstance(action, StartPoints) for action in decision.actions)
    assert started == (verdict is Verdict.RUNNING)


def test_a_limit_stops_what_is_in_flight_but_suspending_lets_it_end() -> None:
    limited = decide_sweep(spec(maxFailures=0), seen([BAD, ACTIVE, PENDING]), 0)
    assert limited.actions == (StopPoints((1,)),)
    assert decide_sweep(spec(suspend=True), seen([ACTIVE, PENDING]), 0).actions == ()


def test_all_points_done_is_complete_even_with_failures_at_the_limit() -> None:
    decision = decide_sweep(spec(maxFailures=0), seen([BAD, GOOD]), 0)
    assert decision.verdict is Verdict.COMPLETE
