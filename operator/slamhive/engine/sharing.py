# SPDX-License-Identifier: Apache-2.0
"""Sharing of slots: how many runs each of several Sweeps may have in flight, by weight. Pure.

Slots are divided as water fills vessels (weighted max-min fairness): nobody gets more than it asks for, and
what one leaves goes to the others by their weights. Namespaces come first, then the Sweeps in each. A fair
number is no whole one, and runs are never broken off for it: whoever is behind gets the next slot that is
free. Where that is not decided by whole slots, who was left short for the longest time comes first, so that
with fewer slots than Sweeps all have their turns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

_NEARLY = 1e-9


@dataclass(frozen=True)
class Contender:
    """Sweep that shares slots.

    Attributes:
        name: its identity.
        namespace: its namespace.
        held: runs of it that have slots.
        asks: further slots that it would take now.
        weight: its weight in its namespace.
        since: since when it is there, s: of equal ones the oldest comes first.
    """

    name: str
    namespace: str
    held: int
    asks: int
    weight: int = 1
    since: float = 0.0

    @property
    def demand(self) -> int:
        """Return the number of slots that it would have if it were alone."""
        return self.held + self.asks


@dataclass(frozen=True)
class NamespaceRule:
    """Rule for the Sweeps of a namespace together.

    Attributes:
        weight: its weight beside other namespaces; None: the largest of its Sweeps.
        slots: most slots of all of them; None: any number.
    """

    weight: int | None = None
    slots: int | None = None


_NO_RULE = NamespaceRule()


@dataclass(frozen=True)
class Division:
    """Fair numbers of slots, which need not be whole.

    Attributes:
        sweeps: by the name of the Sweep.
        namespaces: by the name of the namespace.
    """

    sweeps: Mapping[str, float] = field(default_factory=dict)
    namespaces: Mapping[str, float] = field(default_factory=dict)


def fill(amount: float, vessels: Sequence[tuple[float, float]]) -> list[float]:
    """Return the parts of an amount by weight, none larger than asked for; the others have what one leaves.

    Args:
        amount: what there is.
        vessels: weight and demand of each.
    """
    parts = [0.0] * len(vessels)
    left, weights = max(0.0, amount), float(sum(weight for weight, _ in vessels))
    for number in sorted(range(len(vessels)), key=lambda one: vessels[one][1] / vessels[one][0]):
        weight, demand = vessels[number]
        parts[number] = min(demand, left * weight / weights) if weights > 0 else 0.0
        left -= parts[number]
        weights -= weight
    return parts


def divide(
    capacity: float | None, contenders: Iterable[Contender], rules: Mapping[str, NamespaceRule] | None = None
) -> Division:
    """Return the fair numbers of slots.

    Args:
        capacity: slots that there are; None: as many as they ask for.
        contenders: Sweeps with runs in flight or to start.
        rules: of namespaces.
    """
    rules = rules or {}
    spaces: dict[str, list[Contender]] = {}
    for one in contenders:
        spaces.setdefault(one.namespace, []).append(one)
    vessels = []
    for space, inside in spaces.items():
        rule = rules.get(space, _NO_RULE)
        demand = sum(one.demand for one in inside)
        most = demand if rule.slots is None else min(rule.slots, demand)
        vessels.append((rule.weight or max(one.weight for one in inside), most))
    # An endless amount has no share: nobody gets more than all ask for.
    amount = sum(demand for _, demand in vessels)
    parts = fill(amount if capacity is None else min(capacity, amount), vessels)
    namespaces = dict(zip(spaces, parts, strict=True))
    sweeps: dict[str, float] = {}
    for space, inside in spaces.items():
        fairs = fill(namespaces[space], [(one.weight, one.demand) for one in inside])
        sweeps |= {one.name: fair for one, fair in zip(inside, fairs, strict=True)}
    return Division(sweeps, namespaces)


@dataclass
class SlotTurns:
    """Account of the slots that contenders were short of, so that those who share one take turns.

    Attributes:
        sweeps: slot-seconds that a Sweep, by its name, is behind its fair number, as far as whole slots are
            the reason.
        namespaces: the same of namespaces.
    """

    sweeps: dict[str, float] = field(default_factory=dict)
    namespaces: dict[str, float] = field(default_factory=dict)

    def pass_by(self, seconds: float, contenders: Sequence[Contender], division: Division) -> None:
        """Let time pass, in which contenders held what they hold.

        Args:
            seconds: the time.
            contenders: all of them; others are forgotten.
            division: their fair numbers.
        """
        held = {one.name: one.held for one in contenders}
        self.sweeps = _owed(self.sweeps, seconds, held, division.sweeps)
        self.namespaces = _owed(self.namespaces, seconds, _by_namespace(contenders), division.namespaces)

    def next(
        self,
        capacity: int | None,
        contenders: Sequence[Contender],
        division: Division,
        rules: Mapping[str, NamespaceRule] | None = None,
    ) -> list[str]:
        """Return the names of those that get the slots that are free now, one a slot, in this order.

        Args:
            capacity: slots that there are; None: as many as they ask for.
            contenders: all of them.
            division: their fair numbers.
            rules: of namespaces.
        """
        there = [one for one in contenders if one.asks > 0]
        free = sum(one.asks for one in there)
        if capacity is not None:
            free = min(free, max(0, capacity - sum(one.held for one in contenders)))
        held, spaces = {one.name: one.held for one in contenders}, _by_namespace(contenders)
        most = {space: rule.slots for space, rule in (rules or {}).items() if rule.slots is not None}
        order: list[str] = []
        while len(order) < free:
            there = [
                one
                for one in there
                if held[one.name] < one.demand
                and spaces[one.namespace] < most.get(one.namespace, spaces[one.namespace] + 1)
            ]
            if not there:
                break
            oldest: dict[str, float] = {}
            for one in there:
                oldest[one.namespace] = min(one.since, oldest.get(one.namespace, one.since))
            space = min(
                oldest,
                key=lambda one: (
                    *_rank(division.namespaces[one], spaces[one], self.namespaces.get(one, 0.0)),
                    *(oldest[one], one),
                ),
            )
            chosen = min(
                (one for one in there if one.namespace == space),
                key=lambda one: (
                    *_rank(division.sweeps[one.name], held[one.name], self.sweeps.get(one.name, 0.0)),
                    *(one.since, one.name),
                ),
            )
            order.append(chosen.name)
            held[chosen.name] += 1
            spaces[space] += 1
        return order


def _rank(fair: float, held: int, owed: float) -> tuple[int, float]:
    """Return the rank of one that asks for a slot: the smallest is served first."""
    if held + 1 <= fair + _NEARLY:
        return 0, held / fair
    return (1 if held + _NEARLY < fair else 2), -owed


def _by_namespace(contenders: Iterable[Contender]) -> dict[str, int]:
    """Return the slots that the Sweeps of each namespace hold."""
    held: dict[str, int] = {}
    for one in contenders:
        held[one.namespace] = held.get(one.namespace, 0) + one.held
    return held


def _owed(
    before: Mapping[str, float], seconds: float, held: Mapping[str, int], fairs: Mapping[str, float]
) -> dict[str, float]:
    """Return the slot-seconds that each is behind after some more seconds."""
    return {
        name: before.get(name, 0.0) + seconds * _short(fairs[name], count) for name, count in held.items()
    }


def _short(fair: float, held: int) -> float:
    """Return the number of slots by which one is short, or ahead where negative, for whole slots alone."""
    low, high = math.floor(fair + _NEARLY), math.ceil(fair - _NEARLY)
    return fair - min(max(held, low), high)


@dataclass(frozen=True)
class SlotWork:
    """Work that a Sweep has before it.

    Attributes:
        seconds: slot-seconds of all its runs that have not ended; None: not known.
        a_run: s that one of them takes; None: not known.
    """

    seconds: float | None = None
    a_run: float | None = None


@dataclass(frozen=True)
class SlotOutlook:
    """Times at which a Sweep is expected to begin and to be done, s from now; None: not known."""

    start: float | None = None
    end: float | None = None


def foresee(
    capacity: int | None,
    contenders: Sequence[Contender],
    works: Mapping[str, SlotWork],
    rules: Mapping[str, NamespaceRule] | None = None,
) -> dict[str, SlotOutlook]:
    """Return the times at which Sweeps will begin and end if nothing else comes, as if runs flowed.

    A Sweep of which nothing is known keeps its slots for ever, so that who waits for those has no forecast.

    Args:
        capacity: slots that there are; None: as many as they ask for.
        contenders: all of them.
        works: what they have before them.
        rules: of namespaces.
    """
    left = {one.name: _left(works.get(one.name)) for one in contenders}
    starts: dict[str, float] = {}
    ends: dict[str, float] = {}
    now, there = 0.0, [one for one in contenders if one.demand > 0]
    while there:
        fairs = divide(capacity, there, rules).sweeps
        for one in there:
            if fairs[one.name] > _NEARLY:
                starts.setdefault(one.name, now)
        times = {one.name: left[one.name] / fairs[one.name] for one in there if fairs[one.name] > _NEARLY}
        step = min(times.values(), default=math.inf)
        if not math.isfinite(step):
            break
        now += step
        for one in there:
            left[one.name] -= step * fairs[one.name]
        over = {name for name, time in times.items() if time <= step * (1 + _NEARLY)}
        ends |= dict.fromkeys(over, now)
        # What another one held is free for those who stay.
        there = [replace(one, held=0, asks=one.demand) for one in there if one.name not in over]
    return {one.name: SlotOutlook(starts.get(one.name), ends.get(one.name)) for one in contenders}


def _left(work: SlotWork | None) -> float:
    return math.inf if work is None or work.seconds is None else max(work.seconds, _NEARLY)
