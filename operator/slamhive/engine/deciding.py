# SPDX-License-Identifier: Apache-2.0
"""Decision of any search: what its method says is run next."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.engine.searching import decide_search
from slamhive.engine.threshold import decide_threshold
from slamhive.model.search import SearchMethod

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.engine.searching import RunSeen, SearchDecision
    from slamhive.model.search import Search
    from slamhive.plan.searching import SearchPlan


def decide(search: Search, plan: SearchPlan, seen: Mapping[int, RunSeen]) -> SearchDecision:
    """Decide what a search does next.

    Args:
        search: its settings.
        plan: its trials so far.
        seen: the runs that have ended, by index.
    """
    if search.method is SearchMethod.THRESHOLD:
        return decide_threshold(search, plan.space, plan.trials, seen)
    return decide_search(search, plan.space, plan.trials, seen, plan.most_trials)
