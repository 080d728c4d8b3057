# SPDX-License-Identifier: Apache-2.0
"""Sharing of the cluster among Sweeps: how many runs each may start now, and what it says of its share.

All Sweeps of the operator's namespaces share one pool. Each asks here before it starts runs; who is due and
doesn't look by itself is queued. What is held here is made again from the Sweeps' looks.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from slamhive.engine import (
    Contender,
    Division,
    NamespaceRule,
    PointState,
    SlotOutlook,
    SlotTurns,
    SlotWork,
    divide,
    foresee,
)
from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.builders.common import label_value
from slamhive.kube.builders.run import least_requests
from slamhive.kube.capacity import Bound, FeltRoom, SeenRoom
from slamhive.kube.pods import condition as condition_of
from slamhive.kube.reconciling.archiving import ArchiveAway, in_thread
from slamhive.kube.reconciling.sweep_budgets import CpuBudgets
from slamhive.kube.reconciling.sweep_forecast import RunTimes, ToldTime
from slamhive.kube.reconciling.sweep_shares import ShareFacts, share_of
from slamhive.kube.status import moment

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.archive import Archive
    from slamhive.kube.api.kinds import Object
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.sweep_state import SweepMemory
    from slamhive.model.status import SweepShare
    from slamhive.model.sweep import Sweep

_UNHEARD_SECONDS = 30.0
"""Time after which a Sweep that was called and does not look leaves its slots to others."""
_IN_LINE_SECONDS = 30.0
_NEWS_SLOTS, _NEWS_PART = 0.5, 0.15


@dataclass(frozen=True)
class SweepLook:
    """State of a Sweep that asks for slots.

    Attributes:
        key: its address.
        sweep: the Sweep.
        memory: its points.
        runs: its live runs, by point.
        pods: pods at work by the label of their run.
        leaving: how many of them have runs that are over.
        window: runs that it may have in flight by itself.
        asks: runs that it would start now.
    """

    key: Key
    sweep: Sweep
    memory: SweepMemory
    runs: Mapping[int, Object]
    pods: Mapping[str, Sequence[Mapping[str, Any]]]
    leaving: int
    window: int
    asks: int

    @property
    def active(self) -> list[Object]:
        """Return its runs in flight."""
        states = self.memory.states
        return [run for index, run in self.runs.items() if states[index] == PointState.ACTIVE]


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


@dataclass
class _ShareAccount:
    """State of one Sweep's share.

    Attributes:
        key: its address.
        contender: what it holds and asks for; those of its runs that wait for a node hold nothing.
        times: how long its runs take.
        waiting: names of its runs for which there is no room, each with the time since when.
        placed: names of its runs in flight whose pods have a node.
        overtaken: pods of others, made later than its waiting ones, that found a node.
        work: what it has still to do.
        bounds: what quotas and nodes allow.
        window: runs that it may have in flight by itself.
        called: since when it is called; None: it isn't.
        begin, end: the forecast as it was last told.
        share: what was last told of all.
        told_at: when.
    """

    key: Key
    contender: Contender
    times: RunTimes = field(default_factory=RunTimes)
    waiting: dict[str, float] = field(default_factory=dict)
    placed: set[str] = field(default_factory=set)
    overtaken: int = 0
    work: SlotWork = field(default_factory=SlotWork)
    bounds: tuple[Bound | None, Bound | None] = (None, None)
    window: int = 0
    called: float | None = None
    begin: ToldTime = field(default_factory=ToldTime)
    end: ToldTime = field(default_factory=ToldTime)
    share: SweepShare | None = None
    told_at: float = 0.0

    @property
    def is_stuck(self) -> bool:
        """Tell whether its pods that wait do so for reasons of their own."""
        return bool(self.waiting) and self.overtaken > 0

    def standing(self, now: float) -> Contender:
        """Return its part among the others: who doesn't answer, or can't be placed, asks for nothing."""
        unheard = self.called is not None and now - self.called > _UNHEARD_SECONDS
        asks = 0 if self.is_stuck or unheard else self.contender.asks + len(self.waiting)
        return replace(self.contender, asks=asks)


class SlotSharing:
    """Shares the pool of slots among all Sweeps.

    Args:
        archive: what earlier runs took, if there is one.
    """

    def __init__(self, archive: Archive | None = None) -> None:
        self._archive = archive
        self._accounts: dict[str, _ShareAccount] = {}
        self._turns = SlotTurns()
        self._division = Division()
        self._passed = 0.0
        self._has_begun = False
        self._felt: FeltRoom | None = None
        self._seen = SeenRoom()
        self._budgets = CpuBudgets(archive)
        self._outlooks: tuple[float, dict[str, SlotOutlook]] = (0.0, {})

    async def turn(self, cluster: Cluster, look: SweepLook, now: float) -> SlotGrant:
        """Return the number of runs that a Sweep may start now; these count as held until its next look."""
        self._begin(cluster, now)
        uid, namespace = look.sweep.metadata.uid or "", look.key.namespace
        account = self._take_note(look, now)
        if not look.asks and not account.contender.held and not account.waiting:
            self.leave(cluster, uid)
            return SlotGrant(0)
        if look.asks:
            await self._look_at_room(cluster, look, account)
        blocked = await self._budgets.exhausted(cluster, namespace, now) if look.asks else None
        if blocked is not None:
            account.contender = replace(account.contender, asks=0)
        starts = self._serve(cluster, uid, now)
        if blocked is None and look.asks and not account.contender.held and not starts:
            blocked = _impossible(account)
        wait = account.told_at + cluster.settings.sweep_write_seconds - now
        if account.share is None or wait <= 0:
            await self._tell(cluster, replace(look, asks=look.asks - starts), account, blocked)
        delays = [wait] if wait > 0 else []
        delays += [_IN_LINE_SECONDS] if look.asks > starts else []
        return SlotGrant(starts, blocked, account.share, min(delays, default=None))

    def begun(self, uid: str, runs: Iterable[Object], now: float) -> None:
        """Note that runs of a Sweep were begun: they may have ended when it looks again."""
        if uid in self._accounts:  # it may have been deleted meanwhile
            self._accounts[uid].times.begin(runs, now)

    def rest(self, uid: str) -> None:
        """Note that a Sweep can start nothing for the time being."""
        if uid in self._accounts:
            account = self._accounts[uid]
            account.contender = replace(account.contender, asks=0)

    def leave(self, cluster: Cluster, *uids: str) -> None:
        """Take out Sweeps that hold nothing and ask for nothing; others are called in their place."""
        gone = [self._accounts.pop(uid, None) for uid in uids]
        if any(gone):
            self._serve(cluster, None, cluster.clock())

    @property
    def known(self) -> list[str]:
        """Return the UIDs of the Sweeps that share."""
        return [*self._accounts]

    def _begin(self, cluster: Cluster, now: float) -> None:
        """Take what statuses say of Sweeps: an operator that starts has looked at none."""
        if self._has_begun:
            return
        self._has_begun, self._passed = True, now
        self._felt = FeltRoom(cluster.settings.default_parallelism, cluster.settings.sharing.waiting_pods)
        for namespace in cluster.settings.namespaces:
            for body in cluster.store.of(Kind.SWEEP, namespace):
                spec, status, meta = body["spec"], body["status"], body["metadata"]
                held = status.get("running") or 0
                window = spec.get("parallelism") or cluster.settings.default_parallelism
                asks = max(0, min(window - held, status.get("pending") or 0))
                if status.get("completionTime") or not (held or asks):
                    continue
                contender = Contender(
                    *(meta["uid"], namespace, held, 0 if spec.get("suspend") else asks),
                    weight=spec.get("weight") or 1,
                    since=moment(meta.get("creationTimestamp")) or now,
                )
                key = Key(Kind.SWEEP, namespace, meta["name"])
                self._accounts[meta["uid"]] = _ShareAccount(key, contender, window=window)
                self._felt.limit += held  # they found room before

    def _take_note(self, look: SweepLook, now: float) -> _ShareAccount:
        """Take note of a Sweep's runs: which hold slots, which wait for room, which have ended."""
        meta = look.sweep.metadata
        uid = meta.uid or ""
        known = uid in self._accounts
        if not known:
            self._accounts[uid] = _ShareAccount(look.key, Contender(uid, look.key.namespace, 0, 0, since=now))
        account = self._accounts[uid]
        if not account.times.kinds and not account.times.sums:
            account.times.sample(look.memory)
            account.times.learn(one.run for one in look.memory.finished.values())
        active = look.active
        waiting, placed = _standing(look, active, account.waiting, now)
        reused = {one.run["metadata"]["uid"] for one in look.memory.finished.values() if one.reused}
        flights = {label_value(one.name): one.began for one in account.times.flying.values()}
        ended = {label_value(one.name) for one in account.times.look(active, reused, now)}
        # Who has ended had a node too, if only for a moment, but for those that were cancelled meanwhile.
        found = (placed | (ended - account.waiting.keys())) - account.placed
        refused = waiting.keys() - account.waiting.keys()
        account.overtaken = account.overtaken if waiting else 0
        self._overtake(uid, [flights.get(name, now) for name in found])
        used, before = self._held(), account.waiting.keys()
        account.waiting, account.placed = waiting, placed
        account.window, account.called = look.window, None
        account.contender = replace(
            account.contender,
            held=len(active) - len(waiting) + look.leaving,
            asks=look.asks,
            weight=look.sweep.spec.weight,
        )
        if self._felt is not None:
            at_once = len(found - before)
            self._felt.note(at_once, len(refused), used, self._held())
        return account

    def _overtake(self, uid: str, made: list[float]) -> None:
        """Count for others' pods that wait how many, made later, have found a node now."""
        for other, account in self._accounts.items():
            if other != uid and account.waiting:
                latest = max(account.waiting.values())
                account.overtaken += sum(time > latest for time in made)

    def _held(self) -> int:
        return sum(account.contender.held for account in self._accounts.values())

    async def _look_at_room(self, cluster: Cluster, look: SweepLook, account: _ShareAccount) -> None:
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
        crowd = [self._bounded(account, account.standing(now)) for account in self._accounts.values()]
        rules, capacity = self._rules(cluster), self._capacity(cluster)
        self._turns.pass_by(
            max(0.0, now - self._passed),
            [one for one in crowd if one.name in self._division.sweeps],
            self._division,
        )
        self._passed = now
        self._division = divide(capacity, crowd, rules)
        given = Counter(self._turns.next(capacity, crowd, self._division, rules))
        for name, count in given.items():
            other = self._accounts[name]
            if name != uid and count > len(other.waiting) and other.called is None and other.contender.asks:
                other.called = now
                cluster.queue.add(other.key)
        self._call_for_news(cluster, uid)
        account = self._accounts.get(uid or "")
        if account is None:
            return 0
        contender, waiting = account.contender, len(account.waiting)
        # Its pods that wait have the next slots.
        starts = min(max(0, given.get(contender.name, 0) - waiting), contender.asks)
        is_behind = contender.held < self._division.sweeps[contender.name]
        if not starts and not waiting and contender.asks and is_behind:
            # Slots may be kept for pods of others that can never have them: one of its own finds that out.
            starts = int(any(self._accounts[name].waiting for name in given) and self._may_probe(cluster))
        account.contender = replace(contender, held=contender.held + starts, asks=contender.asks - starts)
        return starts

    def _may_probe(self, cluster: Cluster) -> bool:
        """Tell whether a run more may be in flight by the chart's values."""
        slots = cluster.settings.sharing.slots
        flying = sum(len(one.waiting) + one.contender.held for one in self._accounts.values())
        return slots is None or flying < slots

    def _call_for_news(self, cluster: Cluster, uid: str | None) -> None:
        """Have other Sweeps look, soon, whose shares are clearly not those that they tell of."""
        for name, account in self._accounts.items():
            told = account.share.fair if account.share is not None else None
            fair = self._division.sweeps.get(name, 0.0)
            if name != uid and told is not None and abs(fair - told) > max(_NEWS_SLOTS, _NEWS_PART * told):
                cluster.queue.add(account.key, cluster.settings.sweep_write_seconds)

    @staticmethod
    def _bounded(account: _ShareAccount, contender: Contender) -> Contender:
        """Return a contender that asks for no more than the cluster's nodes could hold."""
        bound = account.bounds[1]
        if bound is None:
            return contender
        return replace(contender, asks=max(0, min(contender.asks, bound.runs - contender.held)))

    def _rules(self, cluster: Cluster) -> dict[str, NamespaceRule]:
        given = cluster.settings.sharing.namespaces
        rules = {name: NamespaceRule(one.weight, one.slots) for name, one in given.items()}
        waiting = Counter[str]()
        for account in self._accounts.values():
            waiting[account.key.namespace] += len(account.waiting)
            quota = account.bounds[0]
            if quota is not None:
                rule = rules.get(account.key.namespace, NamespaceRule())
                least = quota.runs if rule.slots is None else min(rule.slots, quota.runs)
                rules[account.key.namespace] = replace(rule, slots=least)
        return {
            name: rule if rule.slots is None else replace(rule, slots=max(0, rule.slots - waiting[name]))
            for name, rule in rules.items()
        }

    def _capacity(self, cluster: Cluster) -> int | None:
        """Return the slots that there are, without those of runs that wait for a node."""
        waits = sum(len(account.waiting) for account in self._accounts.values())
        placed = sum(len(account.placed) for account in self._accounts.values())
        room = self._felt.slots(waits, max(0, self._held() - placed)) if self._felt is not None else None
        slots = cluster.settings.sharing.slots
        if slots is not None:
            slots = max(0, slots - waits)
        return min((one for one in (room, slots) if one is not None), default=None)

    async def _tell(
        self, cluster: Cluster, look: SweepLook, account: _ShareAccount, blocked: tuple[str, str] | None
    ) -> None:
        """Find out what a Sweep's status says of its share."""
        now = account.told_at = cluster.clock()
        pending = _pending(look)
        await self._learn_from_archive(account)
        account.work = account.times.work(look.memory, pending, now)
        capacity, rules = self._capacity(cluster), self._rules(cluster)
        crowd = [self._bounded(one, one.standing(now)) for one in self._accounts.values()]
        # While the archive was asked, others may have come.
        division = divide(capacity, crowd, rules)
        told, outlooks = self._outlooks
        if now - told >= cluster.settings.sweep_write_seconds or account.contender.name not in outlooks:
            works = {uid: one.work for uid, one in self._accounts.items()}
            outlooks = foresee(capacity, crowd, works, rules)
            self._outlooks = now, outlooks
        facts = ShareFacts(
            settings=cluster.settings,
            namespace=look.key.namespace,
            uid=account.contender.name,
            weight=account.contender.weight,
            window=look.window,
            is_own_window=look.sweep.spec.parallelism is not None,
            in_flight=account.contender.held + len(account.waiting),
            waiting=len(account.waiting),
            pending=pending,
            fair=division.sweeps.get(account.contender.name, 0.0),
            crowd=crowd,
            names={uid: one.key for uid, one in self._accounts.items()},
            bounds=account.bounds,
            felt=self._felt.limit if self._felt is not None and self._felt.is_full else None,
            place=self._place(account, crowd, rules, division) if look.asks and not blocked else None,
            blocked=blocked,
            is_search=look.memory.search is not None,
            times=account.times,
            outlooks=outlooks,
            rate=self._rate(),
        )
        account.share = share_of(facts, account.share, account.begin, account.end)

    async def _learn_from_archive(self, account: _ShareAccount) -> None:
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
        account: _ShareAccount,
        crowd: list[Contender],
        rules: dict[str, NamespaceRule],
        division: Division,
    ) -> int | None:
        """Return the place of a Sweep in the line for the next free slot; None where it isn't in one."""
        name = account.contender.name
        if not account.contender.asks:
            return None
        held = sum(one.held for one in crowd)
        without = {space: replace(rule, slots=None) for space, rule in rules.items()}
        order = self._turns.next(held + 4 * len(crowd), crowd, division, without)
        line = [*dict.fromkeys(order)]
        return line.index(name) + 1 if name in line else len(line) + 1

    def _rate(self) -> float:
        """Return the number of slots that become free in a second."""
        known = ((account.contender.held, account.work.a_run) for account in self._accounts.values())
        return sum(held / seconds for held, seconds in known if seconds)


def _impossible(account: _ShareAccount) -> tuple[str, str] | None:
    """Return reason and sentence of what keeps a Sweep from having any run; None where waiting helps."""
    for bound, reason in zip(account.bounds, ("QuotaExceeded", "NoNodeFits"), strict=True):
        if bound is not None and bound.runs == 0:
            return reason, f"no run can start: {bound.why} has no room for one; it goes on when there is"
    return None


def _pending(look: SweepLook) -> int:
    if look.memory.search is not None:
        return look.asks
    return look.memory.states.count(PointState.PENDING)


def _standing(
    look: SweepLook, active: Iterable[Object], waited: Mapping[str, float], now: float
) -> tuple[dict[str, float], set[str]]:
    """Return the names of runs that wait for room, with since when, and of those that have a node."""
    waiting, placed = {}, set()
    for run in active:
        name = label_value(run["metadata"]["name"])
        pod = next(reversed(look.pods.get(name, ())), None)
        if pod is not None and pod["spec"].get("nodeName"):
            placed.add(name)
        elif _lacks_room(run, pod):
            waiting[name] = waited.get(name, now)
    return waiting, placed


def _lacks_room(run: Object, pod: Mapping[str, Any] | None) -> bool:
    """Tell whether a run waits for a node, or for a quota."""
    if pod is not None:
        told = condition_of(pod, "PodScheduled") or {}
        return told.get("status") == "False" and told.get("reason") == "Unschedulable"
    scheduled = condition_of(run, "Scheduled") or {}
    return scheduled.get("status") == "False" and scheduled.get("reason") == "QuotaExceeded"
