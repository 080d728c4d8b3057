# SPDX-License-Identifier: Apache-2.0
"""One run: every way from Pending to its end."""

from __future__ import annotations

from dataclasses import replace

import pytest

from slamhive.engine import (
    AttemptEnd,
    AttemptState,
    Evaluate,
    Finish,
    Prepare,
    RunObserved,
    RunState,
    Start,
    Stop,
    VariantState,
    classify,
    decide_run,
)
from slamhive.engine.run import TRANSITIONS
from slamhive.model.results import Phase, Reason

READY = RunObserved(variant=VariantState.READY)
RUNNING = replace(READY, attempt=AttemptState.RUNNING)


def ended(**how: object) -> RunObserved:
    return replace(READY, attempt=AttemptState.ENDED, end=AttemptEnd(**how))  # type: ignore[arg-type]


def test_a_run_prepares_starts_evaluates_and_finishes() -> None:
    first = decide_run(RunState(), RunObserved(), 0)
    assert (first.state.phase, first.actions) == (Phase.PREPARING, (Prepare(),))
    second = decide_run(first.state, READY, 1)
    assert (second.state.phase, second.actions) == (Phase.RUNNING, (Start(1),))
    third = decide_run(second.state, RUNNING, 2)
    assert (third.state, third.actions) == (second.state, ())
    last = decide_run(third.state, ended(exit_code=0), 3)
    assert last.state.phase is Phase.SUCCEEDED
    assert last.actions == (Evaluate(), Finish())


def test_what_was_odd_is_said_of_a_run_that_succeeds() -> None:
    state = RunState(phase=Phase.RUNNING, attempts=1)
    done = decide_run(state, ended(exit_code=0, remark="metrics.json was ignored"), 0).state
    assert (done.phase, done.reason, done.message) == (Phase.SUCCEEDED, None, "metrics.json was ignored")


def test_nothing_happens_to_a_finished_run() -> None:
    for phase in (Phase.SUCCEEDED, Phase.FAILED, Phase.CANCELLED):
        state = RunState(phase=phase)
        assert decide_run(state, replace(READY, cancel=True), 0).actions == ()
        assert TRANSITIONS[phase] == frozenset()


@pytest.mark.parametrize(
    ("end", "reason"),
    [
        (AttemptEnd(exit_code=0), None),
        (AttemptEnd(exit_code=3), Reason.ALGORITHM_FAILED),
        (AttemptEnd(signal=11), Reason.ALGORITHM_FAILED),
        (AttemptEnd(exit_code=0, trajectory_missing=True), Reason.NO_TRAJECTORY),
        (AttemptEnd(exit_code=0, trajectory_problem="line 3: nan"), Reason.INVALID_TRAJECTORY),
        (AttemptEnd(signal=9, reason=Reason.OUT_OF_MEMORY), Reason.OUT_OF_MEMORY),
        (AttemptEnd(signal=9, reason=Reason.DEADLINE_EXCEEDED), Reason.DEADLINE_EXCEEDED),
        (AttemptEnd(exit_code=1, trajectory_missing=True), Reason.ALGORITHM_FAILED),
    ],
)
def test_an_attempt_gets_its_true_reason(end: AttemptEnd, reason: Reason | None) -> None:
    assert classify(end)[0] is reason
    decision = decide_run(RunState(phase=Phase.RUNNING, attempts=1), replace(ended(), end=end), 0)
    assert decision.state.phase is (Phase.SUCCEEDED if reason is None else Phase.FAILED)
    assert decision.state.reason is reason
    assert decision.actions[-1] == Finish()


def test_an_algorithm_that_fails_is_not_tried_again_but_a_fault_of_the_machine_is() -> None:
    state = RunState(phase=Phase.RUNNING, attempts=1)
    crash = decide_run(state, ended(exit_code=1), 10)
    assert crash.state.phase is Phase.FAILED
    fault = decide_run(state, ended(reason=Reason.SYSTEM_FAULT, message="disk full"), 10)
    assert fault.state.phase is Phase.PENDING
    assert fault.look_again_at == fault.state.not_before > 10
    early = decide_run(fault.state, READY, 10)
    assert early.actions == ()
    again = decide_run(fault.state, READY, fault.state.not_before)
    assert again.actions == (Start(2),)


def test_retries_are_counted_and_end_in_the_fault_itself() -> None:
    state, now = RunState(), 0.0
    for attempt in (1, 2, 3):
        decision = decide_run(state, READY, now)
        assert decision.actions == (Start(attempt),)
        decision = decide_run(decision.state, ended(reason=Reason.NODE_LOST, message="gone"), now)
        state, now = decision.state, decision.state.not_before
    assert (state.phase, state.reason, state.message) == (Phase.FAILED, Reason.NODE_LOST, "gone")


def test_a_variant_that_cannot_be_made_fails_the_run_but_a_full_disk_is_tried_again() -> None:
    failed = replace(READY, variant=VariantState.FAILED)
    wrong = replace(failed, variant_problem=(Reason.PREPARATION_FAILED, "no topic /x"))
    assert decide_run(RunState(phase=Phase.PREPARING), wrong, 0).state.phase is Phase.FAILED
    full = replace(failed, variant_problem=(Reason.SYSTEM_FAULT, "disk full"))
    assert decide_run(RunState(phase=Phase.PREPARING), full, 0).state.phase is Phase.PENDING


def test_cancelling_stops_the_attempt_first() -> None:
    state = RunState(phase=Phase.RUNNING, attempts=1)
    stopping = decide_run(state, replace(RUNNING, cancel=True), 0)
    assert (stopping.state.phase, stopping.actions) == (Phase.RUNNING, (Stop(),))
    over = decide_run(state, replace(ended(exit_code=0), cancel=True), 0)
    assert (over.state.phase, over.actions) == (Phase.CANCELLED, (Finish(),))


def test_an_equal_run_is_reused_before_anything_is_prepared() -> None:
    decision = decide_run(RunState(), RunObserved(reusable=True), 0)
    assert decision.state.phase is Phase.SUCCEEDED
    assert decision.actions == (Finish(),)


def test_a_spec_that_can_never_run_fails_with_its_reason() -> None:
    seen = RunObserved(problem=(Reason.INVALID_PARAMETERS, "nFeatures: -1"))
    decision = decide_run(RunState(), seen, 0)
    assert (decision.state.phase, decision.state.reason) == (Phase.FAILED, Reason.INVALID_PARAMETERS)


def test_no_evaluation_when_none_is_wanted() -> None:
    seen = replace(ended(exit_code=0), wants_evaluation=False)
    assert decide_run(RunState(phase=Phase.RUNNING), seen, 0).actions == (Finish(),)
