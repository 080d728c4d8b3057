# SPDX-License-Identifier: Apache-2.0
"""Bisection for thresholds: which values of an axis are tried, and how often each is run.

``decide_threshold`` is pure, and follows from results alone and not from the order in which they came.
Each combination of the other axes is a series with a bisection of its own, whose turns are: both ends of the
axis; the value in the middle between the last that passes and the first that fails, until none is between
them; where repetitions at these two disagree, a few values next to them, until they agree; then one in the
middle of the widest gap on each side, which tells whether failing is monotone.

Trials are numbered by turn, and within a turn by series: one is drawn as soon as all before it are, which
needs of the other series their results of the turn before, or of this one. So numbers follow from results,
and a slow series holds others up by one turn, not by a whole bisection.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.engine.searching import UNKNOWN, Score, SearchDecision, TrialStanding
from slamhive.model.base import plural
from slamhive.model.search import VALUES_NEAR, VALUES_UNKNOWN, Trial

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Mapping, Sequence

    from slamhive.engine.searching import RunSeen
    from slamhive.model.search import Search
    from slamhive.plan.ladder import Ladder
    from slamhive.plan.searching import SearchSpace


@dataclass(frozen=True)
class ValueTally:
    """Runs at a value.

    Attributes:
        value: the value.
        failed: how many failed.
        known: of how many it is known.
    """

    value: Any
    failed: int
    known: int

    @property
    def share(self) -> float:
        """Return the share that failed; not a number where nothing is known."""
        return self.failed / self.known if self.known else math.nan

    @property
    def is_mixed(self) -> bool:
        """Tell whether some runs failed and others did not."""
        return 0 < self.failed < self.known

    def fails(self, quantile: float) -> bool | None:
        """Tell whether as large a share failed as makes the value fail; None where nothing is known."""
        return self.share >= quantile if self.known else None


if TYPE_CHECKING:
    _Steps = Generator[tuple[int, ...], list[ValueTally], None]


@dataclass(frozen=True)
class _JudgedValue:
    """Knowledge of a trial, and those of its runs that are missing for more."""

    tally: ValueTally
    missing: tuple[int, ...]
    runs: int


@dataclass(frozen=True)
class _RoundOfTrials:
    """A turn of a series: values that it asks for, or waits for; the last one asks for nothing."""

    number: int
    asked: tuple[int, ...] = ()
    is_pending: bool = False


def decide_threshold(
    search: Search, space: SearchSpace, trials: Sequence[Trial], runs: Mapping[int, RunSeen]
) -> SearchDecision:
    """Decide what the seeking of thresholds does next.

    Args:
        search: its settings.
        space: the axis, and the series.
        trials: the values that were tried so far, by number.
        runs: the runs that have ended, by index.
    """
    judged = [_judged(search, space, number, trial, runs) for number, trial in enumerate(trials)]
    wanted = tuple(index for one in judged for index in one.missing)
    seen = _by_series(space, trials, judged)
    turns = {
        place: _turn(search, space.ladder, seen.get(space.series_key(series), {}))
        for place, series in enumerate(space.series)
    }
    # What waits for results draws its next turn after them: no later one may be numbered before that.
    bound = min(((turn.number + 1, place) for place, turn in turns.items() if turn.is_pending), default=None)
    draws: list[Trial] = []
    for number, place in sorted((turn.number, place) for place, turn in turns.items() if turn.asked):
        if bound is not None and (number, place) > bound:
            break
        series = space.series[place]
        values = [space.ladder[rung] for rung in turns[place].asked]
        draws += [Trial(values=space.joined(series, value)) for value in values]
        bound = min(bound or (number + 1, place), (number + 1, place))
    standings = tuple(_standing(number, one) for number, one in enumerate(judged))
    is_over = not wanted and not draws
    message = (
        f"{plural(len(space.series), 'threshold')} sought by {plural(len(trials), 'value')}"
        if is_over
        else ""
    )
    return SearchDecision(wanted, tuple(draws), standings=standings, is_over=is_over, message=message)


def tallies(
    search: Search, space: SearchSpace, trials: Sequence[Trial], runs: Mapping[int, RunSeen]
) -> list[tuple[tuple[Any, ...], list[ValueTally]]]:
    """Return the runs at each value that was tried, lowest first, for each series."""
    judged = [_judged(search, space, number, trial, runs) for number, trial in enumerate(trials)]
    seen = _by_series(space, trials, judged)
    return [
        (series, [one.tally for _, one in sorted(seen.get(space.series_key(series), {}).items())])
        for series in space.series
    ]


def _by_series(
    space: SearchSpace, trials: Sequence[Trial], judged: Sequence[_JudgedValue]
) -> dict[str, dict[int, _JudgedValue]]:
    """Return the judged trials by series and rung; one that is of none is left out."""
    found: dict[str, dict[int, _JudgedValue]] = {}
    for trial, one in zip(trials, judged, strict=True):
        series, value = space.part(trial.values)
        rung = space.ladder.rung(value)
        if rung is not None:
            found.setdefault(space.series_key(series), {}).setdefault(rung, one)
    return found


def _judged(
    search: Search, space: SearchSpace, number: int, trial: Trial, runs: Mapping[int, RunSeen]
) -> _JudgedValue:
    """Count a value's runs: no more of them than it takes to know whether enough fail."""
    order = [
        number * space.block + context * space.repetitions + repetition
        for repetition in range(space.repetitions)
        for context in range(len(space.contexts))
    ]
    enough = math.ceil(search.failing.quantile * len(order) - 1e-9)
    value = space.part(trial.values)[1]
    done = 0
    while True:
        known = [run for index in order[:done] if (run := runs[index]).is_known]
        failed = sum(run.has_failed for run in known)
        more = min(enough - failed, len(order) + 1 - enough - (len(known) - failed), len(order) - done)
        size = done + more
        missing = tuple(index for index in order[done:size] if index not in runs)
        if missing or more <= 0:
            return _JudgedValue(ValueTally(value, failed, len(known)), missing, done)
        done = size


def _turn(search: Search, ladder: Ladder, seen: Mapping[int, _JudgedValue]) -> _RoundOfTrials:
    """Return the turn at which a series is."""
    number = 0
    steps = _steps(ladder, search.failing.quantile)
    rungs = next(steps)
    while True:
        new = tuple(rung for rung in rungs if rung not in seen)
        if new:
            return _RoundOfTrials(number, new)
        found = [seen[rung] for rung in rungs]
        if any(one.missing for one in found):
            return _RoundOfTrials(number, is_pending=True)
        try:
            rungs = steps.send([one.tally for one in found])
        except StopIteration:
            return _RoundOfTrials(number)
        number += 1


def _steps(ladder: Ladder, quantile: float) -> _Steps:
    """Yield the rungs of each turn, and receive what became of them."""
    last = len(ladder) - 1
    found = dict(zip((0, last), (yield (0, last)), strict=True))
    ends = [one.fails(quantile) for one in found.values()]
    if None in ends:
        return
    if ends[0] == ends[1]:
        if last > 1:
            yield (ladder.between(0, last),)
        return
    low, high = 0, last
    while high - low > 1:
        free = [rung for rung in _around(ladder.between(low, high), low, high) if rung not in found]
        if not free or sum(not one.known for one in found.values()) >= VALUES_UNKNOWN:
            break
        rung = free[0]
        (found[rung],) = yield (rung,)
        fails = found[rung].fails(quantile)
        low, high = (rung, high) if fails == ends[0] else (low, rung) if fails == ends[1] else (low, high)
    yield from _beside(ladder, found, low, high)


def _beside(ladder: Ladder, found: dict[int, ValueTally], low: int, high: int) -> _Steps:
    """Yield values next to a threshold while repetitions disagree, then two far from it."""
    known = sorted(rung for rung, one in found.items() if one.known)
    sides = [[rung for rung in known if rung <= low], [rung for rung in known if rung >= high]]
    edges, spent, inner = [low, high], 0, (low, high)
    while spent < VALUES_NEAR and any(found[edge].is_mixed for edge in edges):
        moved = False
        for side, step in enumerate((-1, 1)):
            rung = edges[side] + step
            wanted = edges[side] == inner[side] or found[edges[side]].is_mixed
            if not wanted or not 0 <= rung < len(ladder) or spent == VALUES_NEAR:
                continue
            if rung not in found:
                (found[rung],) = yield (rung,)
                spent += 1
            edges[side], moved = rung, True
        if not moved:
            break
    checks = tuple(rung for side in sides for rung in _widest(ladder, side) if rung not in found)
    if checks:
        yield checks


def _around(middle: int, low: int, high: int) -> Iterator[int]:
    """Yield the few rungs next to one, nearest first, that lie between two others."""
    for away in range(VALUES_UNKNOWN + 1):
        for rung in dict.fromkeys((middle - away, middle + away)):
            if low < rung < high:
                yield rung


def _widest(ladder: Ladder, rungs: Sequence[int]) -> tuple[int, ...]:
    """Return the rung in the middle of the widest gap; nothing where there is no gap."""
    gaps = [(later - rung, -rung) for rung, later in itertools.pairwise(rungs)]
    width, start = max(gaps, default=(0, 0))
    return (ladder.between(-start, width - start),) if width > 1 else ()


def _standing(number: int, one: _JudgedValue) -> TrialStanding:
    is_done = not one.missing
    is_known = one.tally.known > 0
    return TrialStanding(
        number,
        scores=[Score(one.tally.share, ())] if is_known else [],
        runs=one.runs,
        dropped=UNKNOWN if is_done and not is_known else None,
        is_complete=is_done and is_known,
    )
