# SPDX-License-Identifier: Apache-2.0
"""Sharing of slots: how many runs each of several Sweeps may have in flight, by weight. Pure.

Slots are divided as water fills vessels (weighted max-min fairness): nobody gets more than it asks for, and
what one leaves goes to the others by their weights. Those of a higher priority come before all others; among
equal ones namespaces come first, then the Sweeps in each. A fair
number is no whole one, and runs are never broken off for it: whoever is behind gets the next slot that is
free. Where that is not decided by whole slots, who was left short for the longest time comes first, so that
with fewer slots than Sweeps all have their turns.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

_NEARLY = 1e-9

Group = tuple[int, str]
"""Sweeps of one priority in one namespace."""
_Name = TypeVar("_Name", str, Group)


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
        priority: it is served before all that have a lower one.
    """

    name: str
    namespace: str
    held: int
    asks: int
    weight: int = 1
    since: float = 0.0
    priority: int = 0

    @property
    def group(self) -> Group:
        """Return the group that it shares the slots of its priority in."""
        return self.priority, self.namespace

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
        groups: by priority and namespace.
    """

    sweeps: Mapping[str, float] = field(default_factory=dict)
    groups: Mapping[Group, float] = field(default_factory=dict)


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
    contenders, rules = [*contenders], rules or {}
    sweeps: dict[str, float] = {}
    groups: dict[Group, float] = {}
    used: dict[str, float] = {}
    for priority in sorted({one.priority for one in contenders}, reverse=True):
        left = None if capacity is None else capacity - sum(used.values())
        inside: dict[str, list[Contender]] = {}
        for one in contenders:
            if one.priority == priority:
                inside.setdefault(one.namespace, []).append(one)
        for space, part in _divide_equals(left, inside, rules, used).items():
            fairs = fill(part, [(one.weight, one.demand) for one in inside[space]])
            sweeps |= {one.name: fair for one, fair in zip(inside[space], fairs, strict=True)}
            groups[priority, space] = part
            used[space] = used.get(space, 0.0) + part
    return Division(sweeps, groups)


def _divide_equals(
    capacity: float | None,
    inside: Mapping[str, Sequence[Contender]],
    rules: Mapping[str, NamespaceRule],
    used: Mapping[str, float],
) -> dict[str, float]:
    """Return the fair numbers of slots of namespaces, for their Sweeps of one priority."""
    vessels = []
    for space, some in inside.items():
        rule = rules.get(space, _NO_RULE)
        demand: float = sum(one.demand for one in some)
        if rule.slots is not None:
            demand = min(max(0.0, rule.slots - used.get(space, 0.0)), demand)
        vessels.append((rule.weight or max(one.weight for one in some), demand))
    # An endless amount has no share: nobody gets more than all ask for.
    amount = sum(demand for _, demand in vessels)
    parts = fill(amount if capacity is None else min(capacity, amount), vessels)
    return dict(zip(inside, parts, strict=True))


@dataclass
class SlotTurns:
    """Account of the slots that contenders were short of, so that those who share one take turns.

    Attributes:
        sweeps: slot-seconds that a Sweep, by its name, is behind its fair number, as far as whole slots are
            the reason.
        groups: the same of namespaces, by priority.
    """

    sweeps: dict[str, float] = field(default_factory=dict)
    groups: dict[Group, float] = field(default_factory=dict)

    def pass_by(self, seconds: float, contenders: Sequence[Contender], division: Division) -> None:
        """Let time pass, in which contenders held what they hold.

        Args:
            seconds: the time.
            contenders: all of them; others are forgotten.
            division: their fair numbers.
        """
        held = {one.name: one.held for one in contenders}
        self.sweeps = _owed(self.sweeps, seconds, held, division.sweeps)
        self.groups = _owed(self.groups, seconds, _by_group(contenders), division.groups)

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
        held = {one.name: one.held for one in contenders}
        groups, spaces = _by_group(contenders), Counter[str]()
        for (_, space), count in groups.items():
            spaces[space] += count
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
            highest = max(one.priority for one in there)
            oldest: dict[Group, float] = {}
            for one in there:
                if one.priority == highest:
                    oldest[one.group] = min(one.since, oldest.get(one.group, one.since))
            group = min(
                oldest,
                key=lambda one: (
                    *_rank(division.groups[one], groups[one], self.groups.get(one, 0.0)),
                    *(oldest[one], one),
                ),
            )
            chosen = min(
                (one for one in there if one.group == group),
                key=lambda one: (
                    *_rank(division.sweeps[one.name], held[one.name], self.sweeps.get(one.name, 0.0)),
                    *(one.since, one.name),
                ),
            )
            order.append(chosen.name)
            held[chosen.name] += 1
            groups[group] += 1
            spaces[chosen.namespace] += 1
        return order


def _rank(fair: float, held: int, owed: float) -> tuple[int, float]:
    """Return the rank of one that asks for a slot: the smallest is served first."""
    if held + 1 <= fair + _NEARLY:
        return 0, held / fair
    return (1 if held + _NEARLY < fair else 2), -owed


def _by_group(contenders: Iterable[Contender]) -> dict[Group, int]:
    """Return the slots that the Sweeps of each group hold."""
    held: dict[Group, int] = {}
    for one in contenders:
        held[one.group] = held.get(one.group, 0) + one.held
    return held


def _owed(
    before: Mapping[_Name, float], seconds: float, held: Mapping[_Name, int], fairs: Mapping[_Name, float]
) -> dict[_Name, float]:
    """Return the slot-seconds that each is behind after some more seconds."""
    # One that came, or got another priority, since these numbers were told begins anew.
    return {
        name: before.get(name, 0.0) + seconds * _short(fairs[name], count)
        for name, count in held.items()
        if name in fairs
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
