# SPDX-License-Identifier: Apache-2.0
"""Words between the sampler and its process: axes, settings and results as plain numbers.

The process knows no names: of an axis it is told its kind and its ends, of a value its place or its number.
"""

from __future__ import annotations

import itertools
import json
import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.engine import TrialStanding
    from slamhive.model.search import Search, Trial
    from slamhive.plan.searching import SearchedAxis, SearchSpace

MOST_STEPS = 64
"""Steps of a search at most: each has at least twice the runs of the one before."""


def axis_told(axis: SearchedAxis) -> dict[str, Any]:
    """Return an axis as the process is told it."""
    if axis.ends is None:
        numbers = axis.numbers
        kind = "choice" if numbers is None else "integer"
        return {"kind": kind, "low": 0, "high": len(axis.dimension.values) - 1, "log": False}
    low, high = axis.ends
    if axis.is_integer:
        return {"kind": "integer", "low": math.ceil(low), "high": math.floor(high), "log": axis.is_log}
    return {"kind": "real", "low": low, "high": high, "log": axis.is_log}


def value_told(axis: SearchedAxis, value: Any) -> Any:
    """Return a value as the process is told it: its number, or its place among those of the axis."""
    if axis.ends is not None:
        return value
    place = axis.step(value)
    return place if axis.numbers is None else _sorted_places(axis).index(place)


def value_meant(axis: SearchedAxis, told: float) -> Any:
    """Return the value that the process proposes."""
    if axis.ends is not None:
        low, high = axis.ends
        return int(told) if axis.is_integer else min(max(float(told), low), high)
    place = int(told)
    return axis.dimension.values[place if axis.numbers is None else _sorted_places(axis)[place]]


def _sorted_places(axis: SearchedAxis) -> list[int]:
    """Return the places of numbers by size: a search may rely on neighbours being alike."""
    numbers = axis.numbers or []
    return sorted(range(len(numbers)), key=numbers.__getitem__)


class TrialsTold:
    """Trials of a search as the process is told them: values turned into numbers, results into text, once.

    Args:
        space: what can be tried.
    """

    def __init__(self, space: SearchSpace) -> None:
        self.space = space
        self._axes = [axis_told(axis) for axis in space.axes]
        self._trials: list[Trial] = []
        self._values: list[list[Any]] = []
        self._keys: list[str] = []
        self._results: list[tuple[TrialStanding, str]] = []

    def keys(self, trials: Sequence[Trial]) -> set[str]:
        """Return the keys of the settings that were tried, after taking in the trials so far."""
        same = len(self._trials)
        if self._trials != trials[:same]:
            pairs = zip(trials, self._trials, strict=False)
            same = sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], pairs))
        for kept in (self._trials, self._values, self._keys, self._results):
            del kept[same:]
        for trial in trials[same:]:
            in_effect = self.space.in_effect(trial.values)
            numbers = zip(self.space.axes, trial.values, in_effect, strict=True)
            self._values.append([value_told(axis, value) if has else None for axis, value, has in numbers])
            self._keys.append(self.space.key(trial.values))
            self._trials.append(trial)
        return set(self._keys)

    def question(self, search: Search) -> dict[str, Any]:
        """Return the question put to the process for the next trial, without those before."""
        return {
            "method": search.method.value,
            "seed": search.seed,
            "number": len(self._trials),
            "objectives": len(search.objectives),
            "conditional": self.space.is_conditional,
            "axes": self._axes,
        }

    def told(self, standings: Sequence[TrialStanding], told: int) -> str:
        """Return the trials so far as JSON.

        Args:
            standings: where each trial stands, by number.
            told: the results of all trials below are told; others are under way, however far they are.
        """
        kept = self._results
        for number in range(told):
            standing = standings[number]
            if number < len(kept) and kept[number][0] is standing:
                continue  # a decided one never changes
            kept[number:] = [(standing, self._text(number, result_told(standing)))]
        running = [self._text(number, {"state": "running"}) for number in range(told, len(self._trials))]
        return f"[{','.join([*(text for _, text in kept[:told]), *running])}]"

    def _text(self, number: int, result: dict[str, Any]) -> str:
        return json.dumps({"values": self._values[number], "told": self._trials[number].told} | result)


def result_told(standing: TrialStanding) -> dict[str, Any]:
    """Return a trial's result: its figures, and how much of a failure it is.

    A failed run is the worst there is, never missing. A setting that was dropped has figures of other runs
    than one with all, so it ranks behind these: by the steps that it lacks, then by how many were better.
    """
    if standing.score is None:
        return {"state": "unknown"}  # the machine failed: nothing is known of the setting
    steps = len(standing.scores)
    return {
        "state": "known",
        "figures": [value if math.isfinite(value) else None for value in standing.score.values],
        "failed": standing.score.failed,
        "lacking": 0.0 if standing.is_complete else MOST_STEPS - steps + standing.behind,
    }
