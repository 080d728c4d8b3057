# SPDX-License-Identifier: Apache-2.0
"""Whatever is remembered and seen, there is a decision: statuses get lost, Jobs deleted, variants evicted."""

from __future__ import annotations

from itertools import product

import pytest

from slamhive.engine import (
    AttemptEnd,
    AttemptState,
    Prepare,
    RunObserved,
    RunState,
    Start,
    VariantState,
    decide_run,
)
from slamhive.engine.run import TRANSITIONS
from slamhive.model.results import Phase, Reason

ENDS = (AttemptEnd(exit_code=0), AttemptEnd(exit_code=1), AttemptEnd(reason=Reason.SYSTEM_FAULT))


@pytest.mark.parametrize("phase", Phase)
def test_every_observation_has_a_decision(phase: Phase) -> None:
    for variant, attempt, end, reusable, cancel in product(
        VariantState, AttemptState, ENDS, (False, True), (False, True)
    ):
        seen = RunObserved(variant=variant, attempt=attempt, end=end, reusable=reusable, cancel=cancel)
        found = decide_run(RunState(phase=phase), seen, 0.0).state.phase
        assert found is phase or found in TRANSITIONS[phase]


def test_a_fault_counts_once_however_often_its_attempt_is_seen() -> None:
    fault = AttemptEnd(reason=Reason.SYSTEM_FAULT)
    seen = RunObserved(variant=VariantState.READY, attempt=AttemptState.ENDED, end=fault, number=1)
    state = RunState(phase=Phase.RUNNING, attempts=1)
    for now in (0.0, 0.1, 0.2):
        state = decide_run(state, seen, now).state
    assert (state.phase, state.faults) == (Phase.PENDING, 1)
    decision = decide_run(state, seen, 100.0)
    assert decision.actions == (Start(2),)
    again = RunObserved(variant=VariantState.READY, attempt=AttemptState.ENDED, end=fault, number=2)
    assert decide_run(decision.state, again, 101.0).state.faults == 2


def test_a_preparation_that_the_machine_failed_is_asked_for_again() -> None:
    seen = RunObserved(variant=VariantState.FAILED, variant_problem=(Reason.SYSTEM_FAULT, "disk full"))
    state, asked = RunState(), 0
    for now in range(0, 1000, 100):
        decision = decide_run(state, seen, float(now))
        state, asked = decision.state, asked + decision.actions.count(Prepare())
    assert (asked, state.phase, state.message) == (seen.retries, Phase.FAILED, "disk full")
