# SPDX-License-Identifier: Apache-2.0
"""State machine of one mapping run.

``decide_run`` takes what is remembered and what is seen, and returns the next actions. Workstation and
operator carry them out.

::

    Pending ──► Preparing ──► Running ──► Succeeded
       ▲  │         │            │  │
       │  │         ├──► Failed ◄┤  │      a fault of the machine leads back to Pending
       └──┼─────────┴────────────┘  │      while there are retries left
          └──► Succeeded (reused)   └──► Cancelled (from every phase)

What is remembered may be older than what is seen (a status that was lost), and what was seen may go (a
Job deleted, a variant evicted): then phases are skipped, or Running leads back to Preparing.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

from slamhive.model.results import Phase, Reason

TRANSITIONS: dict[Phase, frozenset[Phase]] = {
    Phase.PENDING: frozenset(
        {Phase.PREPARING, Phase.RUNNING, Phase.SUCCEEDED, Phase.FAILED, Phase.CANCELLED}
    ),
    Phase.PREPARING: frozenset(
        {Phase.PENDING, Phase.RUNNING, Phase.SUCCEEDED, Phase.FAILED, Phase.CANCELLED}
    ),
    Phase.RUNNING: frozenset(
        {Phase.PENDING, Phase.PREPARING, Phase.SUCCEEDED, Phase.FAILED, Phase.CANCELLED}
    ),
    Phase.SUCCEEDED: frozenset(),
    Phase.FAILED: frozenset(),
    Phase.CANCELLED: frozenset(),
}
"""The phases that each phase may lead to."""

FIRST_BACKOFF_SECONDS = 1.0
LAST_BACKOFF_SECONDS = 60.0


class VariantState(enum.Enum):
    """States of the prepared recording (variant) that a run reads."""

    ABSENT = enum.auto()
    MAKING = enum.auto()
    READY = enum.auto()
    FAILED = enum.auto()


class AttemptState(enum.Enum):
    """States of a run's current attempt: none, running or ended."""

    NONE = enum.auto()
    RUNNING = enum.auto()
    ENDED = enum.auto()


@dataclass(frozen=True)
class AttemptEnd:
    """End of an attempt as its executor saw it: exit code or signal, cause, and faults of the trajectory.

    Attributes:
        exit_code: the program's exit code, or None when a signal or the executor ended it.
        signal: the signal that ended it, if any.
        reason: what the executor or the monitor knows of the cause.
        message: a sentence about it.
        trajectory_problem: what is wrong with trajectory.txt; None when it can be used.
        trajectory_missing: whether there is none. A file without a pose is a lost run's.
        remark: a sentence about what was odd, but no failure.
    """

    exit_code: int | None = None
    signal: int | None = None
    reason: Reason | None = None
    message: str | None = None
    trajectory_problem: str | None = None
    trajectory_missing: bool = False
    remark: str | None = None


@dataclass(frozen=True)
class RunState:
    """State of a run that is kept between two decisions.

    Attributes:
        phase: where it stands.
        reason: why, for phases that have a reason.
        message: a sentence about it.
        attempts: attempts started.
        faults: faults of the machine met.
        judged: number of the last attempt whose fault is among them.
        not_before: when another try may begin, on the caller's clock.
    """

    phase: Phase = Phase.PENDING
    reason: Reason | None = None
    message: str | None = None
    attempts: int = 0
    faults: int = 0
    judged: int = 0
    not_before: float = 0.0


@dataclass(frozen=True)
class RunObserved:
    """Observed facts about a run, from which ``decide_run`` decides what happens next.

    Attributes:
        problem: why the run can never start (its spec against its catalog), if so.
        retries: attempts allowed after faults of the machine.
        cancel: whether its end was asked for.
        reusable: whether an equal run's result may be taken.
        variant: state of the prepared recording.
        variant_problem: why preparing failed; the reason tells whether it is worth another try.
        attempt: state of the current attempt.
        end: how it ended.
        number: which attempt it is, counted from 1; None when it is never shown again after its end.
        wants_evaluation: whether a result is asked for and not there yet.
        suspicion: what is known to be wrong with its recording, which may be why its program fails.
    """

    retries: int = 2
    cancel: bool = False
    problem: tuple[Reason, str] | None = None
    reusable: bool = False
    variant: VariantState = VariantState.ABSENT
    variant_problem: tuple[Reason, str] | None = None
    attempt: AttemptState = AttemptState.NONE
    end: AttemptEnd | None = None
    number: int | None = None
    wants_evaluation: bool = True
    suspicion: str | None = None


@dataclass(frozen=True)
class Prepare:
    """Make the variant of the dataset."""


@dataclass(frozen=True)
class Start:
    """Start an attempt."""

    attempt: int


@dataclass(frozen=True)
class Stop:
    """End the running attempt."""


@dataclass(frozen=True)
class Evaluate:
    """Measure the trajectory."""


@dataclass(frozen=True)
class Finish:
    """Record the run."""


RunAction = Prepare | Start | Stop | Evaluate | Finish


@dataclass(frozen=True)
class Decision:
    """A run's new state, what to do, and when to look again at the latest."""

    state: RunState
    actions: tuple[RunAction, ...] = ()
    look_again_at: float | None = None


def classify(end: AttemptEnd) -> tuple[Reason | None, str | None]:
    """Return the true reason of an attempt's end; None when it succeeded."""
    if end.reason is not None:
        return end.reason, end.message
    if end.signal is not None:
        return Reason.ALGORITHM_FAILED, end.message or f"ended by signal {end.signal}"
    if end.exit_code != 0:
        return Reason.ALGORITHM_FAILED, end.message or f"exit code {end.exit_code}"
    if end.trajectory_missing:
        return Reason.NO_TRAJECTORY, end.trajectory_problem or "output/trajectory.txt is missing"
    if end.trajectory_problem:
        return Reason.INVALID_TRAJECTORY, end.trajectory_problem
    return None, None


def decide_run(state: RunState, seen: RunObserved, now: float) -> Decision:
    """Decide what happens next to a run.

    Args:
        state: what was remembered.
        seen: what is observed.
        now: seconds on the caller's clock.
    """
    if state.phase.is_finished:
        return Decision(state)
    if seen.cancel:
        return _cancel(state, seen)
    if seen.problem is not None:
        return _fail(state, *seen.problem)
    judged = seen.number is not None and seen.number <= state.judged
    if seen.attempt is AttemptState.ENDED and seen.end is not None and not judged:
        return _ended(state, seen, seen.end, now)
    if seen.attempt is AttemptState.RUNNING:
        return Decision(_move(state, Phase.RUNNING))
    return _lead_on(state, seen, now)


def _lead_on(state: RunState, seen: RunObserved, now: float) -> Decision:
    if seen.reusable:
        return Decision(_move(state, Phase.SUCCEEDED), (Finish(),))
    if state.not_before > now:
        return Decision(state, look_again_at=state.not_before)
    return _start(state, seen, now)


def _start(state: RunState, seen: RunObserved, now: float) -> Decision:
    match seen.variant:
        case VariantState.ABSENT:
            return Decision(_move(state, Phase.PREPARING), (Prepare(),))
        case VariantState.MAKING:
            return Decision(_move(state, Phase.PREPARING))
        case VariantState.FAILED:
            reason, message = seen.variant_problem or (Reason.PREPARATION_FAILED, "preparation failed")
            if reason is Reason.SYSTEM_FAULT and state.phase is Phase.PENDING and state.not_before > 0:
                return Decision(_move(state, Phase.PREPARING), (Prepare(),))  # the wait is over: once more
            if reason is Reason.SYSTEM_FAULT:
                return _fault(state, seen, reason, message, now)
            return _fail(state, reason, message)
        case VariantState.READY:
            attempt = state.attempts + 1
            running = replace(_move(state, Phase.RUNNING), attempts=attempt, reason=None, message=None)
            return Decision(running, (Start(attempt),))


def _ended(state: RunState, seen: RunObserved, end: AttemptEnd, now: float) -> Decision:
    reason, message = classify(end)
    if reason is None:
        done = replace(_move(state, Phase.SUCCEEDED), reason=None, message=end.remark)
        actions: tuple[RunAction, ...] = (Evaluate(),) if seen.wants_evaluation else ()
        return Decision(done, (*actions, Finish()))
    if reason is Reason.CANCELLED:
        return Decision(replace(_move(state, Phase.CANCELLED), reason=reason, message=message), (Finish(),))
    # Disruptions are borne within an attempt, by a bound of their own.
    if reason.is_infrastructure and reason is not Reason.DISRUPTED:
        counted = replace(state, judged=seen.number or state.judged)
        return _fault(counted, seen, reason, message or "the machine failed", now)
    suspicion = seen.suspicion if reason.may_come_of_input else None
    return _fail(state, reason, "; ".join(filter(None, (message, suspicion))))


def _fault(state: RunState, seen: RunObserved, reason: Reason, message: str, now: float) -> Decision:
    faults = state.faults + 1
    if faults > seen.retries:
        return _fail(replace(state, faults=faults), reason, message)
    wait = min(FIRST_BACKOFF_SECONDS * 2.0 ** (faults - 1), LAST_BACKOFF_SECONDS)
    waiting = replace(
        _move(state, Phase.PENDING), reason=reason, message=message, faults=faults, not_before=now + wait
    )
    return Decision(waiting, look_again_at=waiting.not_before)


def _cancel(state: RunState, seen: RunObserved) -> Decision:
    if seen.attempt is AttemptState.RUNNING:
        return Decision(state, (Stop(),))
    cancelled = replace(_move(state, Phase.CANCELLED), reason=Reason.CANCELLED, message="cancelled")
    return Decision(cancelled, (Finish(),))


def _fail(state: RunState, reason: Reason, message: str) -> Decision:
    return Decision(replace(_move(state, Phase.FAILED), reason=reason, message=message), (Finish(),))


def _move(state: RunState, phase: Phase) -> RunState:
    if phase is state.phase:
        return state
    if phase not in TRANSITIONS[state.phase]:
        raise ValueError(f"a run cannot go from {state.phase} to {phase}")
    return replace(state, phase=phase)
