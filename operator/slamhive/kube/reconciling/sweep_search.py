# SPDX-License-Identifier: Apache-2.0
"""Search of a Sweep: what is remembered of it, and the settings that it tries next.

A setting stands in the Sweep's status before its first run is made: an operator that is killed, and another
one beside it, go on with what stands there and ask for none of it anew.
"""

from __future__ import annotations

import asyncio
import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from slamhive.analysis.searches.seen import runs_seen
from slamhive.contract.settled import is_settled
from slamhive.engine import NextSteps, PointState, RunSeen, SearchDecision, TrialStanding, asked_next, best_of
from slamhive.kube.api.encoding import encode
from slamhive.kube.records import record_of
from slamhive.model.canonical import normalize
from slamhive.model.errors import InputError
from slamhive.model.search import Goal, Trial
from slamhive.model.status import (
    BEST_LENGTH,
    LIST_BYTES,
    MESSAGE_LENGTH,
    BestTrial,
    SearchStatus,
    trial_field,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from slamhive.kube.api.kinds import Object
    from slamhive.kube.reconciling.sweep_runs import Finished, SweepTally
    from slamhive.model.results import RunRecord
    from slamhive.model.search import Search
    from slamhive.plan import SearchPlan
    from slamhive.sampling import Proposer

_ASKED_AT_ONCE = 16
_LONGEST_FLOAT = -2.2250738585072014e-308
_LARGEST = Trial(values=[], told=9_999)


@dataclass
class SearchMemory:
    """A search under way.

    Attributes:
        plan: the runs of its trials so far.
        fields: its trials as the status holds them.
        seen: its runs that have ended, by index.
        copied: how many trials, and how many spared runs, the archive knows of.
        problem: why what became of its runs can't be read; None where it can.
    """

    plan: SearchPlan
    fields: list[Object] = field(default_factory=list)
    seen: dict[int, RunSeen] = field(default_factory=dict)
    copied: tuple[int, int] | None = None
    problem: str | None = None

    def __post_init__(self) -> None:
        """Begin with nothing decided."""
        self._next_steps = NextSteps(self.plan)
        self._written: list[Object] | None = None

    @property
    def search(self) -> Search:
        """Return its settings."""
        return self.plan.sweep.spec.search

    @property
    def decision(self) -> SearchDecision:
        """Return the decision on the next steps; it takes a moment where something has changed."""
        return self._next_steps.after(self.seen)

    def draw(self, trial: Trial, states: bytearray) -> None:
        """Take in a trial that is written down; its runs are pending."""
        self.plan.draw(trial)
        self.fields.append(trial_field(trial))
        states.extend(bytes(len(self.plan) - len(states)))

    def is_written(self, found: list[Object]) -> bool:
        """Tell whether the trials of a status are those here; at once for the list that was looked at last.

        Args:
            found: the list that the status holds.
        """
        if len(found) != len(self.fields):
            return False
        if found is not self._written and found == self.fields:
            self._written = found
        return found is self._written

    def catch_up(self, found: list[Object], states: bytearray) -> bool:
        """Take in the trials that another operator wrote; False where they are others than those here.

        Raises:
            InputError: one can't be read.
        """
        if self.is_written(found):
            return True
        count = min(len(found), len(self.fields))
        if found[:count] != self.fields[:count]:
            return False
        for trial in read_trials(found[count:], count):
            self.draw(trial, states)
        return True

    def note(self, records: Mapping[int, RunRecord]) -> None:
        """Take note of runs of which nothing more will be written."""
        if not records:
            return
        try:
            found = runs_seen(records, self.search)
        except InputError as error:  # an objective has a value that is no number
            self.problem = str(error)
            return
        if any(self.seen.get(index, one) != one for index, one in found.items()):
            self._next_steps.forget()
        self.seen |= found

    def note_gone(self, index: int, run: Object) -> None:
        """Take note of a run whose object is gone, as it was in the end."""
        if index not in self.seen and is_settled(run):
            self.note({index: record_of(run)})

    def look(self, finished: Mapping[int, Finished], runs: Mapping[int, Object], states: bytearray) -> None:
        """Take note of the runs that have ended since the last look.

        Args:
            finished: finished runs that have objects.
            runs: live runs.
            states: state of each point.
        """
        for index in self.seen.keys() & runs.keys():
            if states[index] == PointState.ACTIVE:  # it was thought to be gone
                del self.seen[index]
                self._next_steps.forget()
        self.note(
            {
                index: record_of(one.run)
                for index, one in finished.items()
                if one.is_settled and index not in self.seen
            }
        )
        while lost := [
            index
            for index in self.decision.wanted
            if states[index] >= PointState.SUCCEEDED and index not in runs
        ]:
            # Done, and neither object nor record is left.
            self.seen |= dict.fromkeys(lost, RunSeen())

    def wanted(self, states: bytearray) -> list[int]:
        """Return the points that are to be started, in their order."""
        return [index for index in self.decision.wanted if states[index] == PointState.PENDING]

    def standing(self, tally: SweepTally) -> SearchStatus:
        """Return the standing of the search, without its trials."""
        decision, trials = self.decision, self.plan.trials
        decided = sum(one.is_decided for one in decision.standings)
        best = [] if not self.search.objectives else best_of(decision.standings)[:BEST_LENGTH]
        return SearchStatus(
            asked=len(trials),
            decided=decided,
            most=self.plan.most_trials,
            spared=tally.reused,
            best=[self._best(one) for one in best],
            message=decision.message[:MESSAGE_LENGTH],
        )

    def _best(self, standing: TrialStanding) -> BestTrial:
        score = standing.score
        signs = [-1 if one.goal is Goal.MAXIMIZE else 1 for one in self.search.objectives]
        figures = score.values if score is not None else ()
        return BestTrial(
            number=standing.number,
            values=self.plan.trials[standing.number].values,
            figures=[sign * figure for sign, figure in zip(signs, figures, strict=False)],
            failed=score.failed if score is not None else None,
        )


class Asker:
    """Asker for the settings that are tried next, of one search at a time.

    Args:
        sampler: proposes settings.
    """

    def __init__(self, sampler: Proposer) -> None:
        self._sampler = sampler
        self._asking = asyncio.Lock()

    async def further(self, memory: SearchMemory) -> list[Trial]:
        """Return the settings that are to be tried beside those so far; nothing has been written of them.

        Raises:
            InputError: the sampler isn't installed, or results can't be read.
            SystemFault: it failed.
        """
        if memory.problem is not None:
            raise InputError(memory.problem)
        decision, plan = memory.decision, memory.plan
        found = [_plain(trial) for trial in decision.draws]
        trials, standings, told = [*plan.trials, *found], [*decision.standings], decision.told
        while told is not None and len(found) < _ASKED_AT_ONCE:
            # In a thread: it takes up to a second, and what answers is another process.
            async with self._asking:
                trial = await asyncio.to_thread(
                    self._sampler.propose, *(memory.search, plan.space, trials, standings, told)
                )
            if trial is None:
                plan.is_exhausted = True
                break
            found.append(_plain(trial))
            trials.append(found[-1])
            # Its number alone is new: who is told what does not wait for another look at all runs.
            standings.append(TrialStanding(len(standings)))
            told = asked_next(memory.search, len(standings), decision.first_open, plan.most_trials)
        return found


def _plain(trial: Trial) -> Trial:
    """Return a trial as the API server gives it back: whole numbers without a fraction."""
    return trial.replace(values=normalize(trial.values))


def written_trials(body: Mapping[str, Any]) -> list[Object]:
    """Return the trials of a Sweep as its status holds them."""
    found = ((body.get("status") or {}).get("search") or {}).get("trials")
    return found if isinstance(found, list) else []


def read_trials(fields: Iterable[Object], first: int = 0) -> list[Trial]:
    """Return the trials that a Sweep's status holds.

    Args:
        fields: its items.
        first: number of the first one.

    Raises:
        InputError: one can't be read: without it, all later ones would be others.
    """
    trials = []
    for number, item in enumerate(fields, first):
        try:
            trials.append(Trial.model_validate(item))
        except ValidationError:
            raise InputError(
                f"status.search.trials[{number}]: {str(item)[:100]!r} is no trial as this version writes "
                "them; runs are numbered by this list, so nothing goes on without it"
            ) from None
    return trials


def require_room(plan: SearchPlan, taken: int) -> None:
    """Check that the status of a Sweep can hold all trials that there may be.

    Args:
        plan: the plan.
        taken: bytes that other lists of it take.

    Raises:
        InputError: it can't.
    """
    longest = len(encode(trial_field(_LARGEST) | {"origin": "Known"})) + 1
    for axis in plan.space.axes:
        values = axis.dimension.values if axis.ends is None else (_LONGEST_FLOAT,)
        longest += 1 + max(len(json.dumps(value).encode()) for value in values)
    most, room = plan.most_trials, LIST_BYTES - taken
    if most * longest > room:
        raise InputError(
            f"spec.search.trials: {most} settings of up to {longest} bytes each are more than the {room} "
            f"bytes that a Sweep can note: at most {max(0, room // longest)} of these values are possible"
        )
