# SPDX-License-Identifier: Apache-2.0
"""Sharing of the cluster among Sweeps: how many runs each may start now, and what it says of its share.

All Sweeps of the operator's namespaces share one pool. Each asks here before it starts runs; who is due and
doesn't look by itself is queued. What is held here is made again from the Sweeps' looks.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from slamhive.engine import (
    Contender,
    Division,
    NamespaceRule,
    PointState,
    SlotOutlook,
    SlotTurns,
    divide,
    foresee,
)
from slamhive.kube.builders.run import least_requests
from slamhive.kube.capacity import SeenRoom
from slamhive.kube.priorities import PriorityClasses
from slamhive.kube.reconciling.archiving import ArchiveAway, in_thread
from slamhive.kube.reconciling.sweep_accounts import PASSED_OVER_SECONDS, ShareAccounts
from slamhive.kube.reconciling.sweep_budgets import CpuBudgets
from slamhive.kube.reconciling.sweep_classes import learn, scouts
from slamhive.kube.reconciling.sweep_shares import ShareFacts, share_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from slamhive.archive import Archive
    from slamhive.kube.api.kinds import Object
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.sweep_accounts import ShareAccount, SweepLook
    from slamhive.model.status import SweepShare

_IN_LINE_SECONDS = 30.0
_NEWS_SLOTS, _NEWS_PART = 0.5, 0.15


@dataclass(frozen=True)
class SlotGrant:
    """Answer to a Sweep that asks for slots.

    Attributes:
        starts: runs that it may start now.
        blocked: reason and sentence, where it gets none until someone does something.
        share: what its status says.
        delay: after how many seconds it is to look again; None: it is called.
    """

    starts: int
    blocked: tuple[str, str] | None = None
    share: SweepShare | None = None
    delay: float | None = None


class SlotSharing:
    """Shares the pool of slots among all Sweeps.

    Args:
        archive: what earlier runs took, if there is one.
    """

    def __init__(self, archive: Archive | None = None) -> None:
        self._archive = archive
        self._accounts = ShareAccounts()
        self._turns = SlotTurns()
        self._division = Division()
        self._passed = 0.0
        self._roomy: float | None = None
        self._seen = SeenRoom()
        self._classes = PriorityClasses()
        self._budgets = CpuBudgets(archive)
        self._outlooks: tuple[float, dict[str, SlotOutlook]] = (0.0, {})

    async def turn(self, cluster: Cluster, look: SweepLook, now: float) -> SlotGrant:
        """Return the number of runs that a Sweep may start now; these count as held until its next look."""
        await self._classes.look(cluster)
        self._accounts.begin(cluster, now)
        uid = look.sweep.metadata.uid or ""
        account = self._accounts.note(look, now)
        learn(self._classes, look)
        account.class_name = look.sweep.spec.priority_class or cluster.settings.pods.priority_class_name
        if not look.asks and not account.contender.held and not account.waiting:
            self.leave(cluster, uid)
            return SlotGrant(0)
        if look.asks:
            await self._look_at_room(cluster, look, account)
        blocked = await self._hindrance(cluster, look, account, now) if look.asks else None
        if blocked is not None:
            account.contender = replace(account.contender, asks=0)
        starts = self._serve(cluster, uid, now)
        if blocked is None and look.asks and not account.contender.held and not starts:
            blocked = _impossible(account)
        wait = account.told_at + cluster.settings.sweep_write_seconds - now
        if account.share is None or wait <= 0:
            is_stopped = blocked is not None or look.sweep.spec.suspend
            left = replace(look, asks=look.asks - starts)
            await self._tell(cluster, left, account, is_stopped=is_stopped)
        delays = [wait] if wait > 0 else []
        delays += [_IN_LINE_SECONDS] if look.asks > starts else []
        return SlotGrant(starts, blocked, account.share, min(delays, default=None))

    async def _hindrance(
        self, cluster: Cluster, look: SweepLook, account: ShareAccount, now: float
    ) -> tuple[str, str] | None:
        """Return reason and sentence of what keeps a Sweep from starting anything, if anything does."""
        blocked = self._classes.lack(account.class_name)
        if blocked is None and self._classes.is_doubtful(look.sweep.spec.priority_class):
            account.contender = replace(account.contender, asks=min(account.contender.asks, scouts(look)))
        return blocked or await self._budgets.exhausted(cluster, look.key.namespace, now)

    def begun(self, uid: str, runs: Iterable[Object], now: float) -> None:
        """Note that runs of a Sweep were begun: they may have ended when it looks again."""
        if uid in self._accounts:  # it may have been deleted meanwhile
            self._accounts[uid].times.begin(runs, now)

    def rest(self, cluster: Cluster, uid: str, held: int | None = None) -> None:
        """Note that a Sweep can start nothing for the time being.

        Args:
            cluster: the cluster.
            uid: of the Sweep.
            held: runs of it in flight, where it may never have been looked at before; default: as it was.
        """
        self._accounts.begin(cluster, cluster.clock())
        if uid not in self._accounts:
            return
        account = self._accounts[uid]
        held = account.contender.held if held is None else max(0, held - len(account.waiting))
        account.contender = replace(account.contender, asks=0, held=held)
        if not held and not account.waiting:
            self.leave(cluster, uid)

    def leave(self, cluster: Cluster, *uids: str) -> None:
        """Take out Sweeps that hold nothing and ask for nothing; others are called in their place."""
        gone = [self._accounts.pop(uid, None) for uid in uids]
        if any(gone):
            self._serve(cluster, None, cluster.clock())

    @property
    def known(self) -> list[str]:
        """Return the UIDs of the Sweeps that share."""
        return [*self._accounts]

    async def _look_at_room(self, cluster: Cluster, look: SweepLook, account: ShareAccount) -> None:
        """Find out what quotas and nodes allow for runs of a Sweep."""
        index = next(iter(look.runs), 0)
        asked = least_requests(look.memory.plan.point(index).spec["resources"], cluster.settings)
        of_namespace = (one for one in self._accounts.values() if one.key.namespace == look.key.namespace)
        there = sum(len(one.placed) + len(one.waiting) for one in of_namespace)
        account.bounds = (
            await self._seen.of_quotas(cluster, look.key.namespace, asked, there),
            await self._seen.of_nodes(cluster, asked),
        )

    def _serve(self, cluster: Cluster, uid: str | None, now: float) -> int:
        """Divide the slots, call those that are due, and return how many runs a Sweep may start."""
        crowd = self._crowd(now)
        rules, capacity = self._rules(cluster), self._capacity(cluster)
        self._turns.pass_by(max(0.0, now - self._passed), crowd, self._division)
        self._passed = now
        has_room = self._accounts.line > 0 and self._accounts.held < self._accounts.felt.limit
        self._roomy = (self._roomy or now) if has_room else None
        self._division = divide(capacity, crowd, rules)
        given = Counter(self._turns.next(capacity, crowd, self._division, rules))
        for name, count in given.items():
            other = self._accounts[name]
            if name != uid and count and other.called is None and other.contender.asks:
                other.called = now
                cluster.queue.add(other.key)
        self._call_for_news(cluster, uid)
        account = self._accounts.get(uid or "")
        if account is None:
            return 0
        contender = account.contender
        starts = min(given.get(contender.name, 0), contender.asks)
        is_behind = contender.held < self._division.sweeps[contender.name]
        if not starts and not account.waiting and contender.asks:
            # The line may be of others' pods that can never have a node: one of its own finds that out.
            probes = is_behind and self._accounts.line > 0 and self._may_probe(cluster)
            starts = int(probes or self._finds_room(cluster, contender.name, crowd, now))
        account.contender = replace(contender, held=contender.held + starts, asks=contender.asks - starts)
        return starts

    def _finds_room(self, cluster: Cluster, name: str, crowd: Sequence[Contender], now: float) -> bool:
        """Tell whether there is room for a Sweep that, for a while, no pod in the line has taken."""
        if self._roomy is None or now - self._roomy <= PASSED_OVER_SECONDS:
            return False
        still = [replace(one, asks=0) if self._accounts[one.name].waiting else one for one in crowd]
        line = sum(len(one.waiting) for one in self._accounts.values() if not one.is_stuck)
        rules, capacity = self._rules(cluster), self._capacity(cluster, line)
        return name in self._turns.next(capacity, still, divide(capacity, still, rules), rules)

    def _may_probe(self, cluster: Cluster) -> bool:
        """Tell whether a run more may be in flight by the chart's values."""
        slots = cluster.settings.sharing.slots
        return slots is None or self._accounts.line + self._accounts.held < slots

    def _call_for_news(self, cluster: Cluster, uid: str | None) -> None:
        """Have other Sweeps look, soon, whose shares are clearly not those that they tell of."""
        for name, account in self._accounts.items():
            told = account.share.fair if account.share is not None else None
            fair = self._division.sweeps.get(name, 0.0)
            if name != uid and told is not None and abs(fair - told) > max(_NEWS_SLOTS, _NEWS_PART * told):
                cluster.queue.add(account.key, cluster.settings.sweep_write_seconds)

    def _crowd(self, now: float) -> list[Contender]:
        """Return all Sweeps as they stand: none asks for more than the cluster's nodes could hold."""
        crowd = []
        for account in self._accounts.values():
            one = replace(account.standing(now), priority=self._classes.value(account.class_name))
            bound = account.bounds[1]
            if bound is not None:
                one = replace(one, asks=max(0, min(one.asks, bound.runs - one.held)))
            crowd.append(one)
        return crowd

    def _rules(self, cluster: Cluster) -> dict[str, NamespaceRule]:
        given = cluster.settings.sharing.namespaces
        rules = {name: NamespaceRule(one.weight, one.slots) for name, one in given.items()}
        stuck = Counter[str]()
        for account in self._accounts.values():
            stuck[account.key.namespace] += len(account.waiting) if account.is_stuck else 0
            quota = account.bounds[0]
            if quota is not None:
                rule = rules.get(account.key.namespace, NamespaceRule())
                least = quota.runs if rule.slots is None else min(rule.slots, quota.runs)
                rules[account.key.namespace] = replace(rule, slots=least)
        return {
            name: rule if rule.slots is None else replace(rule, slots=max(0, rule.slots - stuck[name]))
            for name, rule in rules.items()
        }

    def _capacity(self, cluster: Cluster, line: int | None = None) -> int:
        """Return the slots that there are, without those of runs that can't be placed.

        Args:
            cluster: the cluster.
            line: pods that wait for a node and count, too; default: as many as may.
        """
        felt = self._accounts.felt
        room = felt.slots if line is None else felt.limit + line
        slots = cluster.settings.sharing.slots
        if slots is not None:
            slots -= sum(len(account.waiting) for account in self._accounts.values() if account.is_stuck)
            room = min(room, max(0, slots))
        return room

    async def _tell(
        self, cluster: Cluster, look: SweepLook, account: ShareAccount, *, is_stopped: bool
    ) -> None:
        """Find out what a Sweep's status says of its share."""
        now = account.told_at = cluster.clock()
        pending = _pending(look)
        await self._learn_from_archive(account)
        account.work = account.times.work(look.memory, 0 if is_stopped else pending, now)
        capacity, rules = self._capacity(cluster), self._rules(cluster)
        crowd = self._crowd(now)
        # While the archive was asked, others may have come.
        division = divide(capacity, crowd, rules)
        told, outlooks = self._outlooks
        if now - told >= cluster.settings.sweep_write_seconds or account.contender.name not in outlooks:
            works = {uid: one.work for uid, one in self._accounts.items()}
            # How long runs take was seen with as many in flight as there are.
            slots = max(self._capacity(cluster, 0), self._accounts.held)
            outlooks = foresee(slots, crowd, works, rules)
            self._outlooks = now, outlooks
        facts = ShareFacts(
            settings=cluster.settings,
            namespace=look.key.namespace,
            uid=account.contender.name,
            weight=account.contender.weight,
            priority=self._classes.value(account.class_name),
            class_words=self._classes.words(account.class_name),
            window=look.window,
            is_own_window=look.sweep.spec.parallelism is not None,
            in_flight=account.contender.held + len(account.waiting),
            waiting=len(account.waiting),
            pending=pending,
            fair=division.sweeps.get(account.contender.name, 0.0),
            crowd=crowd,
            names={uid: one.key for uid, one in self._accounts.items()},
            bounds=account.bounds,
            felt=self._accounts.felt.limit if self._accounts.felt.is_full else None,
            place=self._place(account, crowd, rules, division) if look.asks and not is_stopped else None,
            is_stopped=is_stopped,
            is_search=look.memory.search is not None,
            times=account.times,
            outlooks=outlooks,
            rate=self._rate(),
        )
        account.share = share_of(facts, account.share, account.begin, account.end)

    async def _learn_from_archive(self, account: ShareAccount) -> None:
        """Have earlier runs of the same kinds say how long they take, once."""
        times = account.times
        if self._archive is None or times.archived or not times.unknown or account.share is not None:
            return
        kinds = times.unknown
        try:
            costs = await in_thread(
                self._archive.costs, {one for one, _ in kinds}, {other for _, other in kinds}
            )
        except ArchiveAway:
            return  # there is no forecast then before the first of its own has ended
        times.take(costs)

    def _place(
        self,
        account: ShareAccount,
        crowd: list[Contender],
        rules: dict[str, NamespaceRule],
        division: Division,
    ) -> int | None:
        """Return the place of a Sweep in the line for the next free slot; None where it isn't in one."""
        name = account.contender.name
        if not account.contender.asks:
            return None
        # One slot each: how many the others ask for is nothing to their places.
        line = [replace(one, asks=min(one.asks, 1)) for one in crowd]
        without = {space: replace(rule, slots=None) for space, rule in rules.items()}
        order = self._turns.next(None, line, division, without)
        return order.index(name) + 1 if name in order else len(order) + 1

    def _rate(self) -> float:
        """Return the number of slots that become free in a second."""
        known = ((account.contender.held, account.work.a_run) for account in self._accounts.values())
        return sum(held / seconds for held, seconds in known if seconds)


def _impossible(account: ShareAccount) -> tuple[str, str] | None:
    """Return reason and sentence of what keeps a Sweep from having any run; None where waiting helps."""
    for bound, reason in zip(account.bounds, ("QuotaExceeded", "NoNodeFits"), strict=True):
        if bound is not None and bound.runs == 0:
            return reason, f"no run can start: {bound.why} has no room for one; it goes on when there is"
    return None


def _pending(look: SweepLook) -> int:
    if look.memory.search is not None:
        return look.asks
    return look.memory.states.count(PointState.PENDING)
