# SPDX-License-Identifier: Apache-2.0
"""Likely runs of a search that hasn't been done: the search played with settings and results at random.

What it costs is forecast from them. A search drops what is poor, so that it takes fewer runs than it may.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.engine import NextSteps, RunSeen
from slamhive.model.search import Trial

if TYPE_CHECKING:
    from slamhive.plan import SearchPlan
    from slamhive.plan.searching import SearchedAxis

_TRIES = 20


def likely_runs(plan: SearchPlan) -> tuple[SearchPlan, list[int]]:
    """Return a search as it is likely to be: its plan, and the indices of its runs as they are done."""
    played, search = plan.with_trials(plan.trials), plan.sweep.spec.search
    rng = np.random.default_rng(search.seed)
    seen: dict[int, RunSeen] = {}
    next_steps = NextSteps(played)
    while not (decision := next_steps.after(seen)).is_over:
        for trial in decision.draws:
            played.draw(trial)
        if decision.told is not None:
            played.draw(Trial(values=_any_setting(played, rng), told=decision.told))
        if decision.told is None and not decision.draws:
            for index in decision.wanted:
                seen[index] = _any_end(len(search.objectives), rng)
    return played, list(seen)


def _any_setting(plan: SearchPlan, rng: np.random.Generator) -> list[Any]:
    """Return a setting that was not tried, if some tries find one."""
    space = plan.space
    tried = {space.key(trial.values) for trial in plan.trials}
    for _ in range(_TRIES):
        values = [_any_value(axis, rng) for axis in space.axes]
        if space.key(values) not in tried:
            break
    return values


def _any_value(axis: SearchedAxis, rng: np.random.Generator) -> Any:
    if axis.ends is None:
        return axis.dimension.values[int(rng.integers(len(axis.dimension.values)))]
    low, high = axis.ends
    if axis.is_integer:
        return int(rng.integers(math.ceil(low), math.floor(high) + 1))
    if axis.is_log:
        return min(high, max(low, math.exp(rng.uniform(math.log(low), math.log(high)))))
    return float(rng.uniform(low, high))


def _any_end(objectives: int, rng: np.random.Generator) -> RunSeen:
    """Return the end of a run; one of a threshold, which has no objective, fails as often as not."""
    if not objectives:
        return RunSeen(has_failed=bool(rng.random() < 0.5), values=())
    return RunSeen(values=tuple(rng.random(objectives).tolist()))
