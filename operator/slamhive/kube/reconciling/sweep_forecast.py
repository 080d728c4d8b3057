# SPDX-License-Identifier: Apache-2.0
"""Forecast of a Sweep: how long its runs hold a slot by what has ended, and what that comes to, in words."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from slamhive.engine import PointState, SlotWork
from slamhive.kube.builders.common import label_value
from slamhive.kube.pods import PULLS, condition
from slamhive.kube.status import moment, phase_of
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping

    from slamhive.archive import Cost
    from slamhive.kube.api.kinds import Object
    from slamhive.kube.reconciling.sweep_state import SweepMemory

RunKind = tuple[str, str]
"""Algorithm and dataset of a run."""

_SAMPLED = 400
"""Points of a Sweep of which it is looked up what kind they are: a share of so many is known within 5 %."""
_RECENT = 100
"""Runs of a kind whose times count: a cluster has others to serve now than hours ago."""
_JUST_MADE_SECONDS = 5.0
_LEAST_LEFT = 0.1
_MINUTE, _HOUR, _DAY = 60.0, 3600.0, 86_400.0
_STEPS = tuple(
    (name, unit, float(number))
    for name, unit, numbers in (
        ("s", 1.0, "75 90 105"),
        ("min", _MINUTE, "1 2 2.5 3 3.5 4 5 6 7 8 10 12 15 18 22 26 30 35 40 50"),
        ("h", _HOUR, "1 1.25 1.5 1.75 2 2.5 3 3.5 4 5 6 7 8 10 12 15 18 21"),
        ("days", _DAY, "1 1.25 1.5 1.75 2 2.5 3 3.5 4 5 6 7 8 10 12 15 18 22 26 30 35 40 50 60"),
    )
    for number in numbers.split()
)
"""Times that are told, each at most 1.25 times the one before."""
_SAME = 1.15
"""Ratio within which a time that was told still holds: it isn't written anew each minute."""


def kind_of(run: Mapping[str, Object]) -> RunKind:
    """Return the kind of a MappingRun."""
    spec = run["spec"]
    return spec["algorithmRef"]["name"], spec["datasetRef"]["name"]


class Flight(NamedTuple):
    """Run in flight: its kind, its name, when it was made, and since when it takes time, s since 1970."""

    kind: RunKind
    name: str
    made: float
    began: float


@dataclass
class RunTimes:
    """Times for which runs of a Sweep held their slots.

    Attributes:
        flying: runs in flight by UID.
        sums: number and s of those that ended, by kind; of equal results the first alone. Earlier ones count
            the less, the more have ended since.
        ended: number of its own runs that the times are of.
        archived: the same of runs of other Sweeps, as the archive has them.
        kinds: kinds of some of its points by index, all of them if it has few.
    """

    flying: dict[str, Flight] = field(default_factory=dict)
    sums: dict[RunKind, tuple[float, float]] = field(default_factory=dict)
    ended: int = 0
    archived: dict[RunKind, tuple[int, float]] = field(default_factory=dict)
    kinds: dict[int, RunKind] = field(default_factory=dict)

    def begin(self, runs: Iterable[Object], now: float) -> None:
        """Take note of runs that are in flight."""
        for run in runs:
            meta = run["metadata"]
            if meta["uid"] not in self.flying:
                made = moment(meta.get("creationTimestamp")) or now
                # Times of the API are whole seconds.
                began = now if now - made < _JUST_MADE_SECONDS else made
                self.flying[meta["uid"]] = Flight(kind_of(run), meta["name"], began, began)

    def look(
        self, active: Iterable[Object], done: Container[str], now: float, waiting: Container[str] = ()
    ) -> list[Flight]:
        """Take note of all runs that are in flight; returns those that have ended since the last time.

        Args:
            active: runs in flight.
            done: UIDs of runs that were done to their ends: others, which took over an equal result, were
                cancelled or deleted, say nothing of the time that one takes.
            now: s since 1970.
            waiting: labels of those for which there is no room: that is no time of theirs.
        """
        active = list(active)
        self.begin(active, now)
        for run in active:
            uid = run["metadata"]["uid"]
            if _waits_once(run) or label_value(self.flying[uid].name) in waiting:
                self.flying[uid] = self.flying[uid]._replace(began=now)
        there = {run["metadata"]["uid"] for run in active}
        ended = {uid: flight for uid, flight in self.flying.items() if uid not in there}
        for uid, flight in ended.items():
            del self.flying[uid]
            if uid in done:
                self._add(flight.kind, now - flight.began)
        return [*ended.values()]

    def learn(self, ended: Iterable[Object]) -> None:
        """Take note of runs that had ended before anybody looked."""
        for run in ended:
            status = run.get("status") or {}
            # What it waited before, for room, images or its preparation, is no time of the next ones.
            began = moment(status.get("startTime")) or moment(run["metadata"].get("creationTimestamp"))
            end = moment(status.get("completionTime"))
            reused = (status.get("provenance") or {}).get("reusedFrom")
            whole = not reused and phase_of(status) is not Phase.CANCELLED
            if began is not None and end is not None and whole:
                self._add(kind_of(run), max(0.0, end - began))

    def _add(self, kind: RunKind, seconds: float) -> None:
        count, total = self.sums.get(kind, (0.0, 0.0))
        kept = min(1.0, (_RECENT - 1) / count) if count else 1.0
        self.sums[kind] = kept * count + 1, kept * total + seconds
        self.ended += 1

    def sample(self, memory: SweepMemory) -> None:
        """Look up the kinds of some points, evenly over all of them; once."""
        if not self.kinds and memory.search is None:
            count = len(memory.states)
            for number in range(min(count, _SAMPLED)):
                index = number * count // min(count, _SAMPLED)
                names = memory.plan.point(index).short_spec
                self.kinds[index] = (names["algorithm"] or "", names["dataset"] or "")

    @property
    def unknown(self) -> list[RunKind]:
        """Return the kinds of which no run's time is known."""
        kinds = dict.fromkeys(self.kinds.values())
        return [kind for kind in kinds if kind not in self.sums and kind not in self.archived]

    def take(self, costs: Iterable[Cost]) -> None:
        """Take note of runs of the archive."""
        for cost in costs:
            kind = (cost.algorithm, cost.dataset)
            if cost.wall_seconds and cost.reason is None and kind in self.unknown_before:
                count, total = self.archived.get(kind, (0, 0.0))
                self.archived[kind] = count + 1, total + cost.wall_seconds

    @property
    def unknown_before(self) -> set[RunKind]:
        """Return the kinds of which none of its own runs has ended."""
        return set(self.kinds.values()) - self.sums.keys()

    def mean(self, kind: RunKind) -> float | None:
        """Return the time for which a run of a kind holds its slot, s; None where nothing is known."""
        count, total = self.sums.get(kind) or self.archived.get(kind) or (0, 0.0)
        return total / count if count else None

    def work(self, memory: SweepMemory, pending: int, now: float) -> SlotWork:
        """Return the work that it has still to do; unknown where a kind of its runs is.

        Args:
            memory: its points.
            pending: how many of them have still to begin.
            now: s since 1970.
        """
        flying = [(self.mean(one.kind), now - one.began) for one in self.flying.values()]
        twins = memory.plan.twins
        left = {
            index: kind for index, kind in self.kinds.items() if memory.states[index] == PointState.PENDING
        }
        # Of few that are left none may be among those looked up.
        left = left or self.kinds
        # What equals another run of the Sweep takes its result, which costs no time.
        waiting = [self.mean(kind) for index, kind in left.items() if index not in twins] if pending else []
        known = [*waiting, *(mean for mean, _ in flying)]
        if not known or None in known or memory.search is not None:
            return SlotWork()
        means = [mean or 0.0 for mean in waiting]
        total = pending * sum(means) / len(left) if means else 0.0
        total += sum(max((mean or 0.0) - age, _LEAST_LEFT * (mean or 0.0)) for mean, age in flying)
        a_run = sum(mean or 0.0 for mean in known) / len(known)
        return SlotWork(total, max(a_run, 1e-3))


def _waits_once(run: Object) -> bool:
    """Tell whether a run waits for what comes once, for all: its preparation, or an image."""
    told = condition(run, "Scheduled") or {}
    has_no_image = told.get("status") == "False" and told.get("reason") in PULLS
    return phase_of(run.get("status") or {}) is Phase.PREPARING or has_no_image


@dataclass
class ToldTime:
    """Time from now as it was last told, in words: it changes when it is clearly another one.

    Attributes:
        seconds: the time that the words stand for; None: nothing was told.
    """

    seconds: float | None = None

    def words(self, seconds: float | None) -> str | None:
        """Return a time from now in words; None where it is not known."""
        if seconds is None:
            self.seconds = None
            return None
        seconds = max(seconds, 1.0)
        before = self.seconds
        if before is None or not before / _SAME <= seconds <= before * _SAME:
            # The nearest one by ratio.
            self.seconds = min(
                (unit * number for _, unit, number in _STEPS), key=lambda one: abs(math.log(one / seconds))
            )
        return in_words(self.seconds or 0.0, seconds)


def in_words(told: float, seconds: float) -> str:
    """Return the words for a time from now: dates ahead print as invalid in kubectl's columns.

    >>> in_words(3 * 3600, 3 * 3600), in_words(60, 20)
    ('in about 3 h', 'within a minute')
    """
    if told <= _MINUTE and seconds <= _MINUTE:
        return "within a minute"
    name, unit, number = max(_STEPS, key=lambda one: (one[1] * one[2] <= told, one[1] * one[2]))
    if seconds > _SAME * _STEPS[-1][1] * _STEPS[-1][2]:
        return f"in more than {number:g} {name}"
    return f"in about {number:g} {'day' if unit == _DAY and number == 1 else name}"
