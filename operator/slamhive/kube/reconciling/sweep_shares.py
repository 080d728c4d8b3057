# SPDX-License-Identifier: Apache-2.0
"""Words on a Sweep's share: what limits it, its place in the line, when it will be done. Pure.

Other namespaces are counted and not named: who may see one need not be allowed to see another.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.engine import SlotOutlook
from slamhive.model.status import SweepShare
from slamhive.model.sweep import MOST_WEIGHT

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.engine import Contender
    from slamhive.kube.api.kinds import Key
    from slamhive.kube.capacity import Bound
    from slamhive.kube.reconciling.sweep_forecast import RunTimes, ToldTime
    from slamhive.kube.settings import Settings

_NEARLY = 1e-6
_STEADY = 0.1
"""Part by which a number of slots that is only felt changes before it is written anew."""


@dataclass(frozen=True)
class ShareFacts:
    """Facts about a Sweep's share, from which its words are made.

    Attributes:
        settings: the operator's.
        namespace: its namespace.
        uid: its UID.
        weight: its weight.
        priority: its priority.
        class_words: what there is to say of that; None: nothing.
        window: runs that it may have in flight by itself.
        is_own_window: whether it says so itself.
        in_flight: its runs in flight.
        waiting: those of them for which there is no room.
        pending: its runs that have still to begin.
        fair: its fair number of slots.
        crowd: all Sweeps that share.
        names: their addresses.
        bounds: what quotas and nodes allow.
        felt: runs that the cluster was found to hold; None: it wasn't found full.
        place: its place in the line; None: it waits in none.
        is_stopped: whether it gets no slot at all, as it is suspended, or as its condition Blocked says.
        is_search: whether it is a search.
        times: how long its runs take.
        outlooks: when Sweeps are expected to begin and end.
        rate: slots that become free in a second.
    """

    settings: Settings
    namespace: str
    uid: str
    weight: int
    priority: int
    class_words: str | None
    window: int
    is_own_window: bool
    in_flight: int
    waiting: int
    pending: int
    fair: float
    crowd: Sequence[Contender]
    names: Mapping[str, Key]
    bounds: tuple[Bound | None, Bound | None]
    felt: int | None
    place: int | None
    is_stopped: bool
    is_search: bool
    times: RunTimes
    outlooks: Mapping[str, SlotOutlook]
    rate: float

    @property
    def others(self) -> list[Contender]:
        """Return the other Sweeps that share."""
        return [one for one in self.crowd if one.name != self.uid and one.demand > 0]

    @property
    def above(self) -> int:
        """Return the number of Sweeps that come first by their priority."""
        return sum(one.priority > self.priority for one in self.others)

    @property
    def inside(self) -> int:
        """Return the number of slots that the Sweeps of its namespace hold."""
        return sum(one.held for one in self.crowd if one.namespace == self.namespace)

    @property
    def slots(self) -> int | None:
        """Return the number of slots that are shared, None where it is not known."""
        return min((one for one in (self.settings.sharing.slots, self.felt) if one is not None), default=None)


def share_of(facts: ShareFacts, before: SweepShare | None, begin: ToldTime, end: ToldTime) -> SweepShare:
    """Return a Sweep's share as its status says it; numbers and times that are about the same stay.

    Args:
        facts: what is known.
        before: what it says so far.
        begin: when its first run begins, as it was last told.
        end: when its last run ends, as it was last told.
    """
    outlook = SlotOutlook() if facts.is_stopped else facts.outlooks.get(facts.uid, SlotOutlook())
    limit, sooner = _limit(facts)
    spaces = {one.namespace for one in facts.others} | {facts.namespace}
    share = SweepShare(
        fair=round(facts.fair, 1),
        of=facts.slots,
        sweeps=len(facts.others) + 1,
        namespaces=len(spaces),
        priority=facts.class_words,
        place=facts.place,
        begin=begin.words(_begin(facts, outlook)),
        end=end.words(outlook.end),
        forecast=_origin(facts, outlook),
        limit=limit or None,
        sooner=sooner or None,
    )
    if before is not None and facts.settings.sharing.slots is None and _is_about(share, before):
        share = share.replace(fair=before.fair, of=before.of)
    return share


def _is_about(share: SweepShare, before: SweepShare) -> bool:
    pairs = ((share.fair, before.fair), (share.of, before.of))
    return all(
        old == new or (old is not None and new is not None and abs(new - old) <= _STEADY * old)
        for new, old in pairs
    )


def _begin(facts: ShareFacts, outlook: SlotOutlook) -> float | None:
    """Return in how many s its first run begins; None where it has begun, or nobody knows."""
    if facts.in_flight or outlook.start is None or not facts.place:
        return None
    return outlook.start + (facts.place / facts.rate if facts.rate else 0.0)


def _origin(facts: ShareFacts, outlook: SlotOutlook) -> str:
    """Return the origin of a forecast, or the reason why there is none."""
    if facts.is_stopped:
        return "none: nothing starts now"
    if facts.is_search:
        return "none: a search decides by its results how many runs it does"
    unknown = facts.times.unknown
    if unknown:
        algorithm, dataset = unknown[0]
        more = f", nor {len(unknown) - 1} other kinds" if len(unknown) > 1 else ""
        return f"none: no run of {algorithm} on {dataset} has ended, nor is one in the archive{more}"
    if outlook.end is None:
        return "none: other Sweeps come first, and how long those take is not known"
    own = facts.times.ended
    archived = sum(count for count, _ in facts.times.archived.values())
    counts = [f"{_about(own)} runs of its own that ended"] if own else []
    if archived and facts.times.unknown_before:
        counts.append(f"{_about(archived)} runs of the same kinds in the archive")
    return f"from {' and '.join(counts)}, if no other Sweep comes" if counts else "nothing is left to start"


def _about(count: int) -> str:
    """Return a number that is not written anew with each run.

    >>> _about(7), _about(123), _about(4567)
    ('7', 'over 100', 'over 4,000')
    """
    if count < 10:
        return str(count)
    size = 10 ** (len(str(count)) - 1)
    return f"over {count // size * size:,}" if count % size else f"{count:,}"


def _limit(facts: ShareFacts) -> tuple[str, str]:
    """Return the limit of a Sweep, and the change that would make it sooner."""
    if facts.is_stopped:
        return "", ""  # phase or condition say it
    if not facts.pending:
        return "all its runs are in flight or done", ""
    found = _by_room(facts)
    if found is not None:
        return found
    if facts.fair >= facts.window - _NEARLY:
        given = "its spec.parallelism" if facts.is_own_window else "settings.defaultParallelism of the chart"
        return f"{given} ({facts.window})", "a larger spec.parallelism"
    return _by_rules(facts)


def _by_room(facts: ShareFacts) -> tuple[str, str] | None:
    """Return the same where quotas or nodes are what limits it."""
    quota, nodes = facts.bounds
    if quota is not None and facts.inside >= quota.runs:
        return f"{quota.why} of namespace {facts.namespace}", "a larger quota, or runs that ask for less"
    if nodes is not None and facts.in_flight >= nodes.runs:
        return nodes.why, "more nodes, or runs that ask for less"
    if not facts.waiting:
        return None
    told = f"the cluster has no room for more: {facts.waiting} of its runs in flight wait for it"
    return told, "more nodes or a larger quota, the end of what is there, or runs that ask for less"


def _by_rules(facts: ShareFacts) -> tuple[str, str]:
    """Return the same where it has a share of slots."""
    sharing = facts.settings.sharing
    rule = sharing.namespaces.get(facts.namespace)
    if rule is not None and rule.slots is not None and facts.inside >= rule.slots:
        told = f"sharing.namespaces.{facts.namespace}.slots of the chart ({rule.slots})"
        return told, _by_sharing(facts, "a larger number there")
    if facts.slots is None:
        return "it begins with few runs, and has more as these find nodes", ""
    if facts.slots == sharing.slots:
        told, larger = f"sharing.slots of the chart ({sharing.slots})", "a larger sharing.slots"
    else:
        told, larger = f"the room of the cluster, found to hold about {facts.slots} runs", "more nodes"
    if facts.others:
        told += f", shared with {_counted(facts)}"
    if facts.above:
        told += f"; {facts.above} of them come first by a PriorityClass of a higher value"
    return told, _by_sharing(facts, larger)


def _by_sharing(facts: ShareFacts, larger: str) -> str:
    """Return the changes that would make a Sweep sooner that shares slots with others."""
    if not facts.others:
        return larger
    ways = [larger]
    if facts.weight < MOST_WEIGHT and any(one.priority == facts.priority for one in facts.others):
        ways.insert(0, f"a larger spec.weight (now {facts.weight})")
    if facts.above:
        ways.insert(0, "a PriorityClass of a higher value")
    ends = [
        (outlook.end, one)
        for one in facts.others
        if (outlook := facts.outlooks.get(one.name, SlotOutlook())).end is not None
    ]
    if not ends:
        return ", or ".join(ways)
    first = min(ends, key=lambda pair: pair[0] or 0.0)[1]
    own = first.namespace == facts.namespace and first.name in facts.names
    whose = f"Sweep {facts.names[first.name].name}" if own else "a Sweep of another namespace"
    return f"{', '.join(ways)}, or the end of {whose}, which is the next to end"


def _counted(facts: ShareFacts) -> str:
    count = len(facts.others)
    spaces = {one.namespace for one in facts.others} - {facts.namespace}
    told = "one other Sweep" if count == 1 else f"{count} other Sweeps"
    if not spaces:
        return told
    return f"{told} ({len(spaces)} other namespace{'s' if len(spaces) > 1 else ''})"
