# SPDX-License-Identifier: Apache-2.0
"""State machine of a search: which runs of which settings are wanted, and whether another one is proposed.

``SearchDecider`` follows from results alone, never from the order in which they came, so that a
search that was killed goes on as if it had not been, on a workstation as on a cluster.

A setting's runs are done in steps: at first those that every setting gets, on the first dataset; then, of one
in ``keep`` settings, ``keep`` times as many, and so on to all. A setting is compared with those that were
proposed before it, at the same step and so on the same runs. A further setting is proposed when all but the
last ``atATime`` are decided, and by the results of just these.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from slamhive.model.base import plural
from slamhive.model.search import Goal, SettingAggregate

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from slamhive.model.search import Search, Trial


UNKNOWN = "nothing is known of its runs: the machine or the measuring failed, or no result has the figure"
"""Reason to drop a setting of which no run says anything."""


@dataclass(frozen=True)
class RunSeen:
    """End of a run of a search.

    Attributes:
        has_failed: whether its program failed, or it lost track: the worst there is, and never missing.
        values: its figure for each objective, or for the failing rule; None where the machine or the
            measuring failed, so that nothing is known.
    """

    has_failed: bool = False
    values: tuple[float, ...] | None = None

    @property
    def is_known(self) -> bool:
        """Tell whether the run says anything about its setting."""
        return self.has_failed or self.values is not None


class RunLayout(Protocol):
    """Numbers of the runs of each setting."""

    @property
    def contexts(self) -> Sequence[object]:
        """Return the contexts that each setting is run in."""

    @property
    def repetitions(self) -> int:
        """Return the number of runs in each context at most."""

    @property
    def block(self) -> int:
        """Return the number of runs that a setting can have."""


@dataclass(frozen=True, order=True)
class Score:
    """Figures of a setting, to be made small; fewer failures come before all else.

    Attributes:
        failed: share of its runs that failed.
        values: a figure for each objective, its sign turned where large is good; infinite where all failed.
    """

    failed: float
    values: tuple[float, ...]

    def dominates(self, other: Score) -> bool:
        """Tell whether this one is better in something and worse in nothing."""
        if self.failed != other.failed:
            return self.failed < other.failed
        pairs = list(zip(self.values, other.values, strict=True))
        return all(own <= theirs for own, theirs in pairs) and any(own < theirs for own, theirs in pairs)


@dataclass
class TrialStanding:
    """Standing of a trial.

    Attributes:
        number: its place.
        scores: its figures after each step.
        runs: how many of its runs they are of.
        behind: share of those that it was compared with last which were better.
        dropped: why it gets no further runs; None while it does, or when it has all.
        is_complete: whether all its runs are done.
    """

    number: int
    scores: list[Score] = field(default_factory=list)
    runs: int = 0
    behind: float = 0.0
    dropped: str | None = None
    is_complete: bool = False

    @property
    def is_decided(self) -> bool:
        """Tell whether it gets no further runs."""
        return self.is_complete or self.dropped is not None

    @property
    def score(self) -> Score | None:
        """Return its figures of as many of its runs as were compared."""
        return self.scores[-1] if self.scores else None


@dataclass(frozen=True)
class SearchDecision:
    """Decision on a search.

    Attributes:
        wanted: indices of runs that are to be done, in the order in which they start.
        draws: settings that are to be tried next and that follow from results alone.
        told: the next setting is to be asked of the sampler, which is told the results of all trials below
            this number; None: not now.
        standings: where each trial stands.
        first_open: number of the first trial that isn't decided, or of the next one where all are.
        is_over: whether nothing more is wanted or proposed.
        message: a sentence on how it ended.
    """

    wanted: tuple[int, ...]
    draws: tuple[Trial, ...] = ()
    told: int | None = None
    standings: tuple[TrialStanding, ...] = ()
    first_open: int = 0
    is_over: bool = False
    message: str = ""


class SearchDecider:
    """Decisions on a search under way, each by what is new and what is open: what was decided costs nothing.

    What it keeps follows from trials and runs: another one that is given these decides the same.

    Args:
        search: its settings.
        layout: which runs a setting has.
    """

    def __init__(self, search: Search, layout: RunLayout) -> None:
        self._search = search
        self._layout = layout
        self._steps = _steps(search, layout)
        self._order = _order(search, layout)
        self._standings: list[TrialStanding] = []
        self._open: list[int] = []
        # Of each step: the scores so far, and the first trial that is not compared yet, but may be.
        self._rankings = [_TrialRanking() for _ in self._steps]
        self._next = [0] * len(self._steps)

    def decide(self, trials: Sequence[Trial], runs: Mapping[int, RunSeen], most: int) -> SearchDecision:
        """Decide what the search does next.

        The standings of a decision go on with those of later ones.

        Args:
            trials: the settings so far, by number: those of the last time, and further ones.
            runs: the runs that have ended, by index: those of the last time as they were, and further ones.
            most: trials at most.
        """
        for number in range(len(self._standings), len(trials)):
            self._standings.append(TrialStanding(number))
            self._open.append(number)
        for step in range(len(self._steps)):
            self._go_on(step, runs)
        standings = self._standings
        self._open = [number for number in self._open if not standings[number].is_decided]
        # By number, and of each in the order in which its runs are done.
        wanted = [
            index
            for number in self._open
            for index in self._indices(number, len(standings[number].scores))
            if index not in runs
        ]
        first_open = self._open[0] if self._open else len(standings)
        told = asked_next(self._search, len(standings), first_open, most)
        is_over = not self._open and told is None
        message = _ended(standings) if is_over else ""
        return SearchDecision(tuple(wanted), (), told, tuple(standings), first_open, is_over, message)

    def _go_on(self, step: int, runs: Mapping[int, RunSeen]) -> None:
        """Compare what can be compared after a step.

        One after another, so that each is compared with those before it, whichever ended first.
        """
        while self._next[step] < len(self._standings):
            standing = self._standings[self._next[step]]
            if not standing.is_decided:
                indices = self._indices(standing.number, step)
                if len(standing.scores) < step or any(index not in runs for index in indices):
                    return
                score = _score(self._search, self._layout, self._order, [runs[index] for index in indices])
                block = self._layout.block
                sizes = {"size": self._steps[step], "block": block, "keep": self._search.keep}
                _compare(standing, score, self._rankings[step], **sizes)
                standing.is_complete = self._steps[step] == block and standing.dropped is None
            self._next[step] += 1

    def _indices(self, number: int, step: int) -> list[int]:
        """Return the indices of the runs that a trial has after a step, in the order of their starts."""
        return [number * self._layout.block + offset for offset in self._order[: self._steps[step]]]


def decide_search(
    search: Search, layout: RunLayout, trials: Sequence[Trial], runs: Mapping[int, RunSeen], most: int
) -> SearchDecision:
    """Decide what a search by a sampler does next; arguments as of a SearchDecider."""
    return SearchDecider(search, layout).decide(trials, runs, most)


def asked_next(search: Search, count: int, first_open: int, most: int) -> int | None:
    """Return the number of trials that the sampler is told of for the next one; None: none is asked for now.

    Args:
        search: its settings.
        count: number of trials so far.
        first_open: number of the first one that isn't decided; of a further one where all are.
        most: trials at most.
    """
    may_ask = count < most and count - first_open < search.at_a_time
    return max(0, count + 1 - search.at_a_time) if may_ask else None


class _TrialRanking:
    """Scores of settings at a step, of which is asked how many are better than another one."""

    def __init__(self) -> None:
        self._sorted: list[Score] = []
        self._all: list[tuple[float, ...]] = []

    def __len__(self) -> int:
        return max(len(self._sorted), len(self._all))

    def add(self, score: Score) -> None:
        """Add a score."""
        if len(score.values) == 1:
            bisect.insort(self._sorted, score)
        else:
            self._all.append((score.failed, *score.values))

    def better(self, score: Score) -> int:
        """Return the number of scores that dominate one."""
        if len(score.values) == 1:  # one objective has an order, in which they are found at once
            return bisect.bisect_left(self._sorted, score)
        if not self._all:
            return 0
        table = np.asarray(self._all)
        failed, values = table[:, 0], table[:, 1:]
        no_worse = (values <= score.values).all(axis=1) & (values < score.values).any(axis=1)
        return int(((failed < score.failed) | ((failed == score.failed) & no_worse)).sum())


def _compare(
    standing: TrialStanding, score: Score | None, compared: _TrialRanking, *, size: int, block: int, keep: int
) -> None:
    """Judge a setting after a step: it goes on, or is dropped with a word why."""
    standing.runs = size
    if score is None:
        standing.dropped = UNKNOWN
        return
    better, others = compared.better(score), len(compared)
    compared.add(score)
    standing.scores.append(score)
    standing.behind = better / max(1, others)
    if size == block:
        return
    if score.failed == 1:
        standing.dropped = "its one run failed" if size == 1 else f"all of its {size} runs failed"
    elif better >= math.ceil((others + 1) / keep):
        standing.dropped = f"after {size} of {block} runs {better} of {others} were better"


def _score(search: Search, layout: RunLayout, order: Sequence[int], seen: Sequence[RunSeen]) -> Score | None:
    """Return the figures of a setting: means over its repetitions, then over contexts their mean or worst.

    Runs of which nothing is known are left out; failed ones count in the share alone. None: nothing is known.
    """
    by_context: dict[int, list[tuple[float, ...]]] = {}
    failed = known = 0
    for offset, run in zip(order, seen, strict=False):
        if not run.is_known:
            continue
        known += 1
        failed += run.has_failed
        if not run.has_failed and run.values is not None:
            by_context.setdefault(offset // layout.repetitions, []).append(run.values)
    if not known:
        return None
    values = []
    for number, objective in enumerate(search.objectives):
        sign = -1 if objective.goal is Goal.MAXIMIZE else 1
        means = [sign * math.fsum(one[number] for one in found) / len(found) for found in by_context.values()]
        worst = search.aggregate is SettingAggregate.WORST
        values.append((max(means) if worst else math.fsum(means) / len(means)) if means else math.inf)
    return Score(failed / known, tuple(values))


def _order(search: Search, layout: RunLayout) -> list[int]:
    """Return the places of a setting's runs in the order in which they are done.

    The first repetitions come on each context in turn, then one repetition more on all of them, and so on.
    """
    first, contexts = search.repetitions.first, range(len(layout.contexts))
    begin = [context * layout.repetitions + repetition for context in contexts for repetition in range(first)]
    rest = [
        context * layout.repetitions + repetition
        for repetition in range(first, layout.repetitions)
        for context in contexts
    ]
    return begin + rest


def _steps(search: Search, layout: RunLayout) -> list[int]:
    """Return the numbers of runs that a setting has had after each step."""
    return list(_growing(search, layout))


def _growing(search: Search, layout: RunLayout) -> Iterator[int]:
    if search.keep == 1:  # nothing is dropped
        yield layout.block
        return
    size = min(search.repetitions.first, layout.block)
    while size < layout.block:
        yield size
        size = min(layout.block, size * search.keep)
    yield layout.block


def best_of(standings: Sequence[TrialStanding]) -> list[TrialStanding]:
    """Return the trials with all their runs that no other one dominates, the best of one objective first."""
    scored = [(one.score, one) for one in standings if one.is_complete and one.score is not None]
    front: list[tuple[Score, TrialStanding]] = []
    for score, one in sorted(scored, key=lambda pair: (pair[0], pair[1].number)):
        # Who dominates another one comes before it.
        if score.failed < 1 and not any(other.dominates(score) for other, _ in front):
            front.append((score, one))
    return [one for _, one in sorted(front, key=lambda pair: (pair[0].values, pair[1].number))]


def _ended(standings: Sequence[TrialStanding]) -> str:
    complete = sum(one.is_complete for one in standings)
    return f"{plural(len(standings), 'setting')} tried, {complete} of them with all runs"
