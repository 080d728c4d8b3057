# SPDX-License-Identifier: Apache-2.0
"""Decision of any search: what its method says is run next."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.engine.searching import SearchDecider
from slamhive.engine.threshold import decide_threshold
from slamhive.model.search import SearchMethod

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.engine.searching import RunSeen, SearchDecision
    from slamhive.model.search import Search
    from slamhive.plan.searching import SearchPlan


class NextSteps:
    """Decisions on a search under way, whatever its method.

    Args:
        plan: its trials so far, which become more.
    """

    def __init__(self, plan: SearchPlan) -> None:
        self._plan = plan
        self._search: Search = plan.sweep.spec.search
        self._decider = SearchDecider(self._search, plan.space)
        self._last: tuple[tuple[int, int, int], SearchDecision] | None = None

    def forget(self) -> None:
        """Decide from the beginning next time: a run that had ended did not, or ended otherwise."""
        self._decider, self._last = SearchDecider(self._search, self._plan.space), None

    def after(self, seen: Mapping[int, RunSeen]) -> SearchDecision:
        """Decide what the search does next; at once where nothing is new.

        Args:
            seen: the runs that have ended, by index: those of the last time, and further ones.
        """
        plan = self._plan
        mark = (len(seen), len(plan.trials), plan.most_trials)
        if self._last is None or self._last[0] != mark:
            self._last = mark, self._decide(seen)
        return self._last[1]

    def _decide(self, seen: Mapping[int, RunSeen]) -> SearchDecision:
        plan = self._plan
        if self._search.method is SearchMethod.THRESHOLD:
            return decide_threshold(self._search, plan.space, plan.trials, seen)
        return self._decider.decide(plan.trials, seen, plan.most_trials)


def decide(plan: SearchPlan, seen: Mapping[int, RunSeen]) -> SearchDecision:
    """Decide what a search does next, of which nothing was decided before.

    Args:
        plan: its trials so far.
        seen: the runs that have ended, by index.
    """
    return NextSteps(plan).after(seen)
