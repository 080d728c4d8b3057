# SPDX-License-Identifier: Apache-2.0
"""Thresholds: up to which value of an axis something still works, from how often it failed at each.

The values are split where fewest runs contradict: those that failed on the side that passes, and those that
passed on the side that fails. How sure that is follows from the shares of runs that failed, pooled over
values next to the split, and from nothing but that failing is monotone.
"""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from slamhive.engine import tallies
from slamhive.model.base import Choice
from slamhive_eval.statistics import wilson

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.engine import RunSeen, ValueTally
    from slamhive.model.search import Search, Trial
    from slamhive.plan import SearchPlan

_FEW = 6
_APART = 0.7
"""Shares that differ by more contradict each other where there are fewer runs than ``_FEW``."""
_NEARLY = 1e-9


class ThresholdStatus(Choice):
    """Kinds of thresholds: found, beyond either end, of what does nothing, contradicted, or not known."""

    FOUND = "found"
    NEVER = "never fails"
    NO_EFFECT = "no effect seen"
    ALWAYS = "always fails"
    NOT_MONOTONE = "not monotone"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Threshold:
    """Threshold on an axis.

    Attributes:
        axis: its label.
        series: what was run, by axis.
        tallies: the runs at each value, lowest first.
        status: what is known of it.
        falls: whether it fails at small values, and not at large ones; None where that isn't known.
        low, high: neighbouring values between which it lies; of a threshold that lies beyond the values one
            of them is None.
        sure: values between which it lies in 95 of 100 such cases, None for an end that isn't known.
        figure: the figure in which no effect was seen; None where there is one, or none was looked at.
    """

    axis: str
    series: Mapping[str, Any]
    tallies: tuple[ValueTally, ...]
    status: ThresholdStatus
    falls: bool | None = None
    low: float | None = None
    high: float | None = None
    sure: tuple[float | None, float | None] = (None, None)
    figure: str | None = None

    @property
    def passing(self) -> float | None:
        """Return the last value that passes before the first that fails; None where none does."""
        return self.high if self.falls else self.low

    @property
    def failing(self) -> float | None:
        """Return the first value that fails; None where none does."""
        return self.low if self.falls else self.high

    @property
    def direction(self) -> str | None:
        """Return on which side of it something fails: above or below; None where that isn't known."""
        return None if self.falls is None else "below" if self.falls else "above"

    @property
    def runs(self) -> int:
        """Return the number of runs of which it is known whether they failed."""
        return sum(one.known for one in self.tallies)

    def counted(self, value: float | None) -> str:
        """Return the number of failed runs at a value, and of all known there, as ``1/5``."""
        found = [one for one in self.tallies if one.value == value]
        return f"{found[0].failed}/{found[0].known}" if found else ""

    @property
    def counts(self) -> str:
        """Return the number of failed runs at each value, as ``0.1: 0/3, 0.2: 2/3``."""
        return ", ".join(f"{one.value:g}: {one.failed}/{one.known}" for one in self.tallies)

    @property
    def sentence(self) -> str:
        """Return all that is known of it as a sentence."""
        tried = f"{self.tallies[0].value:g} to {self.tallies[-1].value:g}" if self.tallies else ""
        match self.status:
            case ThresholdStatus.NEVER:
                return f"never fails from {tried}"
            case ThresholdStatus.NO_EFFECT:
                words = f"never fails, and {self.figure} changes no more than from repetition to repetition"
                return f"no effect seen from {tried}: {words}"
            case ThresholdStatus.ALWAYS:
                return f"always fails from {tried}"
            case ThresholdStatus.NOT_MONOTONE:
                return f"not monotone, runs that failed: {self.counts}"
            case ThresholdStatus.UNKNOWN:
                return "nothing is known of its runs" if not self.runs else "too few values are known"
        order = "from … down" if self.falls else "up to …"
        words = order.replace("…", f"{self.passing:g}")
        ends = " to ".join("unknown" if end is None else f"{end:g}" for end in self.sure)
        ends = "not known from so few runs" if self.sure == (None, None) else ends
        return (
            f"passes {words} ({self.counted(self.passing)} failed), fails at {self.failing:g} "
            f"({self.counted(self.failing)}); 95 %: {ends}"
        )


def thresholds(
    search: Search, plan: SearchPlan, trials: Sequence[Trial], seen: Mapping[int, RunSeen]
) -> list[Threshold]:
    """Return the thresholds that a search has found so far, one for each series.

    Args:
        search: what is asked.
        plan: its plan.
        trials: the values that were tried.
        seen: the runs that have ended, by index.
    """
    labels = [axis.label for axis in plan.space.axes if axis.label != search.axis]
    return [
        estimate(search.axis or "", dict(zip(labels, series, strict=True)), found, search.failing.quantile)
        for series, found in tallies(search, plan.space, trials, seen)
    ]


def estimate(axis: str, series: Mapping[str, Any], found: Sequence[ValueTally], quantile: float) -> Threshold:
    """Estimate a threshold from counts.

    Args:
        axis: label of the axis.
        series: what was run.
        found: runs at each value, lowest first.
        quantile: share of runs that must fail for a value to fail.
    """
    known = tuple(one for one in found if one.known)
    if len(known) < 2:
        return Threshold(axis, series, tuple(found), ThresholdStatus.UNKNOWN)
    rising, falling = _split(known, quantile), _split(known[::-1], quantile)
    falls = falling < rising
    # As if failing rose with the value, and turned back at the end.
    ordered = known[::-1] if falls else known
    place = (falling if falls else rising)[-1]
    status, direction = ThresholdStatus.FOUND, falls
    if place in {0, len(known)}:
        status = ThresholdStatus.ALWAYS if place == 0 else ThresholdStatus.NEVER
    if _is_contradicted(ordered, place, quantile):
        status = ThresholdStatus.NOT_MONOTONE
    before = ordered[place - 1].value if place else None
    after = ordered[place].value if place < len(known) else None
    ends = _surely(ordered, place, quantile)
    if falls:
        before, after, ends = after, before, (ends[1], ends[0])
    is_beyond = place in {0, len(known)}
    return Threshold(
        axis, series, tuple(found), status, None if is_beyond else direction, before, after, ends
    )


def noticed(threshold: Threshold, figure: str, blocks: Sequence[Sequence[Sequence[float]]]) -> Threshold:
    """Return a threshold, told of as one of what does nothing where no run failed and nothing else changed.

    A figure changes where the medians of values are further apart than the repetitions of any one value.

    Args:
        threshold: what is known of it.
        figure: name of a figure of the runs.
        blocks: for each dataset, and each value that was run on it, the figure of each run.
    """
    if threshold.status is not ThresholdStatus.NEVER or any(one.failed for one in threshold.tallies):
        return threshold
    for block in blocks:
        medians = [statistics.median(one) for one in block]
        among = max(max(one) - min(one) for one in block)
        if max(medians) - min(medians) > among + _NEARLY * abs(medians[0]):
            return threshold
    if not any(len(block) > 1 for block in blocks):
        return threshold
    return replace(threshold, status=ThresholdStatus.NO_EFFECT, figure=figure)


def _split(ordered: Sequence[ValueTally], quantile: float) -> tuple[float, int, int]:
    """Return the best split's cost, the count of values against it, and the place of the first that fails."""
    excess = [one.failed - quantile * one.known or _NEARLY for one in ordered]
    fails = [one.share >= quantile for one in ordered]
    best: tuple[float, int, int] | None = None
    for place in range(len(ordered) + 1):
        cost = round(math.fsum(excess[:place]) - math.fsum(excess[place:]), 6)
        wrong = sum(fails[:place]) + fails[place:].count(False)
        if best is None or (cost, wrong) < best[:2]:
            best = (cost, wrong, place)
    return best or (0.0, 0, 0)


def _is_contradicted(ordered: Sequence[ValueTally], place: int, quantile: float) -> bool:
    """Tell whether a value fails among those that pass, or passes among those that fail.

    Its share is compared with that of all values between it and the split, so that chance doesn't explain it;
    where these are of few runs, with the naked eye.
    """
    for number, one in enumerate(ordered):
        passes = number < place
        between = ordered[number + 1 : place] if passes else ordered[place:number]
        failed, known = sum(other.failed for other in between), sum(other.known for other in between)
        if (one.share < quantile) == passes or not known:
            continue
        (low, high), (floor, top) = wilson(one.failed, one.known), wilson(failed, known)
        apart = abs(one.share - failed / known) > _APART if known < _FEW else low > top or high < floor
        if apart:
            return True
    return False


def _surely(ordered: Sequence[ValueTally], place: int, quantile: float) -> tuple[float | None, float | None]:
    """Return the values between which the threshold surely lies.

    Failing being monotone, a share below the quantile among runs from a value on to the split says that this
    value passes; a share above it from the split on to a value says that this value fails.
    """
    passes = fails = None
    failed = known = 0
    for one in reversed(ordered[:place]):
        failed, known = failed + one.failed, known + one.known
        if wilson(failed, known)[1] < quantile:
            passes = one.value
            break
    failed = known = 0
    for one in ordered[place:]:
        failed, known = failed + one.failed, known + one.known
        if wilson(failed, known)[0] > quantile:
            fails = one.value
            break
    return passes, fails
