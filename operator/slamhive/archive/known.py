# SPDX-License-Identifier: Apache-2.0
"""Settings of a search that the archive knows already: its first trials, whose results are taken over.

A setting is known where the runs of its first step are there, with equal content. Which settings these may
be is read off the specs of runs of the same algorithms and datasets; the content hash decides.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.searches.seen import runs_seen
from slamhive.engine import decide_search
from slamhive.model.canonical import normalize
from slamhive.model.search import Trial, TrialOrigin

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from slamhive.archive import Archive
    from slamhive.archive.records import ReusableRun
    from slamhive.model.results import RunRecord
    from slamhive.plan import Point, SearchPlan, SearchSpace
    from slamhive.plan.searching import SearchedAxis

_SHARE = 3 / 4
"""Share of the trials that may be known ones: the others are for what the method makes of them."""

_ABSENT = object()


def known_trials(plan: SearchPlan, archive: Archive, content: Callable[[Point], str | None]) -> list[Trial]:
    """Return the settings of a search that the archive knows, in an order that follows from them alone.

    Of more than three quarters of the trials the best ones make up half, the rest is chosen by the seed.

    Args:
        plan: the search, of which nothing was tried yet.
        archive: what is known.
        content: returns the content hash that a run would have today; None where that can't be known.
    """
    found = archive.reusable_runs(plan.algorithm_names(), plan.dataset_names())
    tried = plan.with_trials(_candidates(plan.space, found.values()))
    if not tried.trials:
        return []
    search, block = plan.sweep.spec.search, plan.space.block
    first = decide_search(search, plan.space, tried.trials[:1], {}, 1).wanted
    # By content of each run of the first step of each setting: what stands for it in the archive.
    runs: dict[int, ReusableRun] = {}
    known: list[int] = []
    for number in range(len(tried.trials)):
        indices = [number * block + offset for offset in first]
        stand_in = [found.get(content(tried.point(index)) or "") for index in indices]
        if all(one is not None for one in stand_in):
            known.append(number)
            runs |= {index: one for index, one in zip(indices, stand_in, strict=True) if one is not None}
    most = math.floor(_SHARE * plan.most_trials)
    if len(known) > most:
        known = _some_of(tried, known, _results(archive, runs), most)
    return [tried.trials[number] for number in known]


def _candidates(space: SearchSpace, runs: Iterable[ReusableRun]) -> list[Trial]:
    """Return the settings that runs may have had, each once, sorted."""
    values = (_values(space, run.spec) for run in runs)
    found = {space.key(one): space.canonical(one) for one in values if one is not None}
    return [Trial(values=normalize(found[key]), origin=TrialOrigin.KNOWN) for key in sorted(found)]


def _values(space: SearchSpace, spec: Mapping[str, Any]) -> list[Any] | None:
    """Return a run's value on each axis; None where it has none on one of them."""
    values = [_value(axis, spec) for axis in space.axes]
    if space.is_conditional:  # one without effect is not set, whatever its axis has
        firsts = [axis.dimension.values[0] for axis in space.axes]
        values = [first if one is _ABSENT else one for one, first in zip(values, firsts, strict=True)]
    return None if any(value is _ABSENT for value in values) else values


def _value(axis: SearchedAxis, spec: Mapping[str, Any]) -> Any:
    if axis.ends is None:
        steps = zip(axis.dimension.values, axis.dimension.settings, strict=True)
        return next(
            (
                value
                for value, settings in steps
                if all(_field(spec, path) == normalize(wanted) for path, wanted in settings.items())
            ),
            _ABSENT,
        )
    value = _field(spec, axis.dimension.path or ())
    if isinstance(value, bool) or not isinstance(value, int | float):
        return _ABSENT
    fits = axis.ends[0] <= value <= axis.ends[1] and not (axis.is_integer and value % 1)
    return value if fits else _ABSENT


def _field(spec: Mapping[str, Any], path: Sequence[str]) -> Any:
    found: Any = spec
    for name in path:
        found = found.get(name) if isinstance(found, dict) else None
    return normalize(found)


def _results(archive: Archive, runs: Mapping[int, ReusableRun]) -> dict[int, RunRecord]:
    records = {record.uid: record for record in archive.by_uids(run.uid for run in runs.values())}
    return {index: records[run.uid] for index, run in runs.items() if run.uid in records}


def _some_of(
    tried: SearchPlan, known: Sequence[int], records: Mapping[int, RunRecord], most: int
) -> list[int]:
    """Return so many of the known settings: half of them the best ones, the rest by the seed."""
    search = tried.sweep.spec.search
    seen = runs_seen(records, search)
    decision = decide_search(search, tried.space, tried.trials, seen, len(tried.trials))
    scores = {number: decision.standings[number].scores[:1] for number in known}
    ranked = sorted((one[0], number) for number, one in scores.items() if one)
    best = [number for _, number in ranked[: math.ceil(most / 2)]]
    rest = [number for number in known if number not in set(best)]
    chosen = np.random.default_rng(search.seed).permutation(len(rest))[: most - len(best)]
    return sorted([*best, *(rest[place] for place in chosen.tolist())])
