# SPDX-License-Identifier: Apache-2.0
"""Search of a sweep on this machine: what it has tried, what came of it, and which runs are wanted now.

A setting is in the archive before its first run starts. Whoever goes on with the search after any end, and
whoever runs it at the same time, reads it there and asks for none of it anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.analysis.searches.seen import runs_seen
from slamhive.archive.known import known_trials
from slamhive.engine import NextSteps, PointState, RunSeen, SearchDecision, best_of
from slamhive.model.canonical import normalize
from slamhive.model.errors import InputError
from slamhive.model.search import SearchRecord, Trial

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slamhive.archive import Archive
    from slamhive.engine import TrialStanding
    from slamhive.local.running.execution import PlannedPoint
    from slamhive.model.search import Search
    from slamhive.plan import SearchPlan
    from slamhive.sampling import Proposer


class SearchUnderWay:
    """A search under way.

    Args:
        plan: its runs, which become more here.
        uid: its sweep's identity.
        run_uid: returns the identity of each of its runs.

    Attributes:
        plan: the runs of its trials so far.
        seen: its runs that have ended, by index.
        spared: those of them that took over a result.
    """

    def __init__(self, plan: SearchPlan, uid: str, run_uid: Callable[[int], str]) -> None:
        self.plan = plan
        self.seen: dict[int, RunSeen] = {}
        self.spared: set[int] = set()
        self._uid = uid
        self._run_uid = run_uid
        self._best: tuple[SearchDecision, list[TrialStanding]] | None = None
        self._next_steps = NextSteps(plan)

    @property
    def search(self) -> Search:
        """Return its settings."""
        return self.plan.sweep.spec.search

    @property
    def decision(self) -> SearchDecision:
        """Return the decision on the next steps; it takes a moment where something has changed."""
        return self._next_steps.after(self.seen)

    @property
    def best(self) -> list[TrialStanding]:
        """Return the best trials with all their runs, else the best one of those under way; none at first."""
        decision = self.decision
        if self._best is None or self._best[0] is not decision:
            self._best = decision, self._found(decision.standings) if self.search.objectives else []
        return self._best[1]

    def _found(self, standings: Sequence[TrialStanding]) -> list[TrialStanding]:
        scored = [(one.score, one) for one in standings if one.score is not None and one.score.failed < 1]
        complete = [pair for pair in scored if pair[1].is_complete]
        if complete and len(self.search.objectives) > 1:
            return best_of(standings)
        best = min((score for score, _ in complete or scored), default=None)
        found = [one for score, one in complete or scored if score == best]
        return found if complete else found[:1]

    @property
    def further_runs(self) -> float:
        """Return the number of runs that are likely to come beside those that are wanted now.

        As many for each setting that is still to be tried as those that are decided had; nothing before.
        """
        standings = self.decision.standings
        decided = [one.runs for one in standings if one.is_decided]
        left = self.plan.most_trials - len(self.plan.trials)
        if not decided or self.plan.is_exhausted or not self.search.method.is_sampled:
            return 0.0
        return left * sum(decided) / len(decided)

    def recall(self, archive: Archive) -> None:
        """Take in what was tried before.

        Raises:
            InputError: it doesn't fit the sweep as the catalog makes it now.
        """
        found = next((one.search for one in archive.sweeps() if one.uid == self._uid), None)
        self._draw(found.trials if found is not None else [])

    def begin(self, archive: Archive, content: Callable[[PlannedPoint], str | None] | None) -> None:
        """Take in what was tried before; if nothing was, what the archive knows.

        Args:
            archive: has the sweep.
            content: returns the content hash that a run would have today; None to take nothing over.

        Raises:
            InputError: it doesn't fit the sweep as the catalog makes it now.
        """
        self.recall(archive)
        if not self.plan.trials and content is not None and self.search.method.is_sampled:
            self._write(archive, known_trials(self.plan, archive, content))

    def advance(
        self, archive: Archive, states: bytearray, sampler: Proposer, goes_on: Callable[[], bool]
    ) -> None:
        """Take note of the runs that have ended, and draw what is to be tried by their results.

        Args:
            archive: has the runs.
            states: state of each point, which become more.
            sampler: is asked for settings.
            goes_on: tells whether further ones are wanted.

        Raises:
            InputError: the sampler isn't installed, or an objective is no number.
            SystemFault: the sampler failed, or the database doesn't answer.
        """
        self._note(archive, states)
        while goes_on():
            decision, plan = self.decision, self.plan
            news = list(decision.draws)
            if decision.told is not None:
                asked = (plan.trials, decision.standings, decision.told)
                trial = sampler.propose(self.search, plan.space, *asked)
                if trial is None:
                    plan.is_exhausted = True
                    continue
                news = [trial]
            if not news:
                break
            self._write(archive, news)
        states.extend(bytes(len(self.plan) - len(states)))

    def _note(self, archive: Archive, states: bytearray) -> None:
        """Take note of runs that have ended; of one without a record nothing is known."""
        if sum(states.count(state) for state in (PointState.SUCCEEDED, PointState.FAILED)) == len(self.seen):
            return
        ended = [
            index
            for index, state in enumerate(states)
            if state >= PointState.SUCCEEDED and index not in self.seen
        ]
        uids = {self._run_uid(index): index for index in ended}
        records = {uids[record.uid]: record for record in archive.by_uids(uids)}
        self.seen |= dict.fromkeys(ended, RunSeen()) | runs_seen(records, self.search)
        self.spared |= {index for index, one in records.items() if one.provenance.reused_from}

    def _write(self, archive: Archive, news: Sequence[Trial]) -> None:
        """Write settings down that are tried next, unless another runner did so for these numbers."""
        trials = self.plan.trials
        plain = [one.replace(values=normalize(one.values)) for one in news]

        def longer(had: SearchRecord) -> SearchRecord:
            tried = had.trials if len(had.trials) > len(trials) else [*trials, *plain]
            return SearchRecord(trials=tried, spared=len(self.spared))

        if plain:
            self._draw(archive.change_search(self._uid, longer).trials)

    def end(self, archive: Archive) -> None:
        """Write down how many runs it was spared."""
        archive.change_search(self._uid, lambda had: had.replace(spared=len(self.spared)))

    def _draw(self, trials: Sequence[Trial]) -> None:
        """Take in the trials beyond those that are here."""
        for number in range(len(self.plan.trials), len(trials)):
            try:
                self.plan.draw(trials[number])
            except InputError as error:
                raise InputError(
                    f"sweep {self.plan.sweep.name}: setting {number} of its search, tried before, is none of "
                    f"it any more: {error}; give what is searched now another name"
                ) from None
