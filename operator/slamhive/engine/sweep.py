# SPDX-License-Identifier: Apache-2.0
"""State machine of a sweep: ``decide_sweep`` returns which points to start and which to stop.

Workstation and operator carry it out.

A sweep holds two bits a point and a window of runs in flight; it never lists what it will do.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from slamhive.model.base import Choice, plural, seconds

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from slamhive.model.sweep import SweepSpec


class PointState(enum.IntEnum):
    """State of a point, in two bits."""

    PENDING = 0
    ACTIVE = 1
    SUCCEEDED = 2
    FAILED = 3


class Verdict(Choice):
    """States of a sweep: running, suspended, complete, or stopped by a limit."""

    RUNNING = "Running"
    SUSPENDED = "Suspended"
    COMPLETE = "Complete"
    TOO_MANY_FAILURES = "TooManyFailures"
    BUDGET_EXHAUSTED = "BudgetExhausted"

    @property
    def is_final(self) -> bool:
        """Tell whether no further point will be started."""
        return self in {Verdict.COMPLETE, Verdict.TOO_MANY_FAILURES, Verdict.BUDGET_EXHAUSTED}


@dataclass(frozen=True)
class SweepObserved:
    """Observed facts about a sweep, from which ``decide_sweep`` decides what happens next.

    Attributes:
        states: state of each point, by index.
        order: indices in the order in which they are to be started.
        parallelism: runs that may be in flight.
        started_at: when its first run was started, on the caller's clock.
        cpu_seconds: CPU time of its finished runs.
        cursor: position in ``order`` before which no point is pending; speeds up the search. Who makes a
            point pending again begins at 0.
        twins: points that come out as another one does, with that one's index: they start after its end, to
            take its result.
        left_out: number of pending points that nobody asks for this time; ``order`` is without them.
        is_open: whether more points may be asked for later, as a search does: it isn't complete before.
    """

    states: Sequence[int]
    order: Sequence[int]
    parallelism: int
    started_at: float | None = None
    cpu_seconds: float = 0.0
    cursor: int = 0
    twins: Mapping[int, int] = field(default_factory=dict)
    left_out: int = 0
    is_open: bool = False

    def may_start(self, index: int) -> bool:
        """Tell whether a point is pending and waits for no other."""
        twin = self.twins.get(index)
        free = twin is None or self.states[twin] >= PointState.SUCCEEDED
        return free and self.states[index] == PointState.PENDING


@dataclass(frozen=True)
class StartPoints:
    """Start runs for these points."""

    indices: tuple[int, ...]


@dataclass(frozen=True)
class StopPoints:
    """End the runs of all points in flight."""

    indices: tuple[int, ...]


@dataclass(frozen=True)
class SweepDecision:
    """State of a sweep with its reason, the actions to take, and where to search for points next time."""

    verdict: Verdict
    message: str = ""
    actions: tuple[StartPoints | StopPoints, ...] = ()
    cursor: int = 0


def decide_sweep(spec: SweepSpec, seen: SweepObserved, now: float) -> SweepDecision:
    """Decide what happens next to a sweep.

    Args:
        spec: the sweep; parallelism, failure limit, budget and suspend may change while it runs.
        seen: what is observed.
        now: seconds on the caller's clock.
    """
    counts = {state: _count(seen.states, state) for state in PointState}
    active = counts[PointState.ACTIVE]
    if counts[PointState.PENDING] <= seen.left_out and not active and not seen.is_open:
        return SweepDecision(Verdict.COMPLETE, "all points are done", cursor=seen.cursor)
    limit = _limit(spec, seen, counts, now)
    if limit is not None:
        verdict, message = limit
        stop = (StopPoints(tuple(_indices(seen.states, PointState.ACTIVE))),) if active else ()
        return SweepDecision(verdict, message, stop, seen.cursor)
    if spec.suspend:
        return SweepDecision(Verdict.SUSPENDED, "spec.suspend is set", (), seen.cursor)
    cursor, chosen = _next_points(seen, max(0, seen.parallelism - active))
    actions = (StartPoints(chosen),) if chosen else ()
    return SweepDecision(Verdict.RUNNING, "", actions, cursor)


def _limit(
    spec: SweepSpec, seen: SweepObserved, counts: dict[PointState, int], now: float
) -> tuple[Verdict, str] | None:
    failed = counts[PointState.FAILED]
    if spec.max_failures is not None and failed > spec.max_failures:
        return (
            Verdict.TOO_MANY_FAILURES,
            f"{plural(failed, 'run')} failed, maxFailures is {spec.max_failures}",
        )
    budget = spec.budget
    if budget.wall_time is not None and seen.started_at is not None:
        spent = now - seen.started_at
        if spent >= seconds(budget.wall_time):
            return Verdict.BUDGET_EXHAUSTED, f"budget.wallTime: {budget.wall_time} is used up"
    if budget.cpu_hours is not None and seen.cpu_seconds >= 3600 * budget.cpu_hours:
        return Verdict.BUDGET_EXHAUSTED, f"budget.cpuHours: {budget.cpu_hours:g} h are used up"
    return None


def _next_points(seen: SweepObserved, room: int) -> tuple[int, tuple[int, ...]]:
    chosen: list[int] = []
    cursor = seen.cursor
    position = cursor
    while position < len(seen.order) and len(chosen) < room:
        index = seen.order[position]
        if seen.may_start(index):
            chosen.append(index)
        elif position == cursor and not chosen and seen.states[index] != PointState.PENDING:
            cursor = position + 1
        position += 1
    return cursor, tuple(chosen)


def _count(states: Sequence[int], value: int) -> int:
    count = getattr(states, "count", None)
    return count(value) if count is not None else sum(1 for state in states if state == value)


def _indices(states: Sequence[int], value: int) -> Iterator[int]:
    return (index for index, state in enumerate(states) if state == value)
