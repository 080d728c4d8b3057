# SPDX-License-Identifier: Apache-2.0
"""Accounts of the Sweeps that share the cluster: what each holds, asks for and waits for.

They are made from the Sweeps' looks; of those that have not looked yet their statuses tell.
"""

from __future__ import annotations

from collections import UserDict
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from slamhive.engine import Contender, PointState, SlotWork
from slamhive.kube.api.kinds import Key, Kind, Label, labels_of
from slamhive.kube.builders.common import label_value
from slamhive.kube.capacity import Bound, FeltRoom
from slamhive.kube.pods import condition as condition_of
from slamhive.kube.pods import live_pods
from slamhive.kube.reconciling.sweep_forecast import RunTimes, ToldTime
from slamhive.kube.reconciling.sweep_runs import lacks_class
from slamhive.kube.status import moment, phase_of
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.kube.api.kinds import Object
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.sweep_state import SweepMemory
    from slamhive.model.status import SweepShare
    from slamhive.model.sweep import Sweep

_UNHEARD_SECONDS = 30.0
"""Time after which a Sweep that was called and does not look leaves its slots to others."""
PASSED_OVER_SECONDS = 30.0
"""Time for which the scheduler may pass over a pod that found no node: it tries it again after up to 10 s,
and pods that are made meanwhile have what becomes free."""


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


@dataclass
class ShareAccount:
    """State of one Sweep's share.

    Attributes:
        key: its address.
        contender: what it holds and asks for; those of its runs that wait for a node hold nothing.
        times: how long its runs take.
        waiting: names of its runs for which there is no room, each with the time since when.
        placed: names of its runs in flight whose pods have a node.
        overtaken: pods of others, made clearly later than its waiting ones, that found a node.
        work: what it has still to do.
        bounds: what quotas and nodes allow.
        window: runs that it may have in flight by itself.
        called: since when it is called; None: it isn't.
        class_name: the PriorityClass of its runs' pods, if they have one.
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
    class_name: str | None = None
    begin: ToldTime = field(default_factory=ToldTime)
    end: ToldTime = field(default_factory=ToldTime)
    share: SweepShare | None = None
    told_at: float = 0.0

    @property
    def is_stuck(self) -> bool:
        """Tell whether its pods that wait do so for reasons of their own."""
        return bool(self.waiting) and self.overtaken > 0

    def standing(self, now: float) -> Contender:
        """Return its part among the others: who doesn't answer, or can't be placed, asks for nothing.

        Pods in the line for a node hold slots, but for those that can't be placed.
        """
        if self.is_stuck:
            return replace(self.contender, asks=0)
        unheard = self.called is not None and now - self.called > _UNHEARD_SECONDS
        asks = 0 if unheard else self.contender.asks
        return replace(self.contender, held=self.contender.held + len(self.waiting), asks=asks)


class ShareAccounts(UserDict[str, ShareAccount]):
    """Accounts by the UIDs of the Sweeps, and the room for runs that these were felt to have.

    Attributes:
        felt: the room, from the beginning on.
    """

    felt: FeltRoom

    def begin(self, cluster: Cluster, now: float) -> None:
        """Take what statuses and pods say of Sweeps, once: an operator that starts has looked at none."""
        if hasattr(self, "felt"):
            return
        settings = cluster.settings
        self.felt = FeltRoom(settings.default_parallelism, settings.sharing.waiting_pods)
        for namespace in settings.namespaces:
            for body in cluster.store.of(Kind.SWEEP, namespace):
                spec, status, meta = body["spec"], body["status"], body["metadata"]
                held = status.get("running") or 0
                window = spec.get("parallelism") or settings.default_parallelism
                asks = max(0, min(window - held, status.get("pending") or 0))
                if status.get("completionTime") or not (held or asks):
                    continue
                contender = Contender(
                    *(meta["uid"], namespace, held, 0 if spec.get("suspend") else asks),
                    weight=spec.get("weight") or 1,
                    since=moment(meta.get("creationTimestamp")) or now,
                )
                key = Key(Kind.SWEEP, namespace, meta["name"])
                account = ShareAccount(key, contender, window=window)
                template = (spec.get("template") or {}).get("spec") or {}
                named = spec.get("priorityClassName") or template.get("priorityClassName")
                account.class_name = named or settings.pods.priority_class_name
                self[meta["uid"]] = account
        pods = [
            pod
            for space in settings.namespaces
            for pod in live_pods(cluster.store.of(Kind.POD, space))
            if Label.SWEEP in labels_of(pod)  # others hold no slots
        ]
        placed = sum(bool(pod["spec"].get("nodeName")) for pod in pods)
        self.felt.recall(placed, sum(map(_finds_no_node, pods)))

    def note(self, look: SweepLook, now: float) -> ShareAccount:
        """Take note of a Sweep's runs: which hold slots, which wait for room, which have ended."""
        uid = look.sweep.metadata.uid or ""
        if uid not in self:
            self[uid] = ShareAccount(look.key, Contender(uid, look.key.namespace, 0, 0, since=now))
        account = self[uid]
        if not account.times.kinds and not account.times.sums:
            account.times.sample(look.memory)
            account.times.learn(one.run for one in look.memory.finished.values())
        active = look.active
        waiting, placed = _standing(look, active, account.waiting, now)
        # Those without a pod for the lack of their class hold no slot either.
        idle = waiting.keys() | {label_value(run["metadata"]["name"]) for run in active if lacks_class(run)}
        done = {
            uid
            for one in look.memory.finished.values()
            if (uid := one.run["metadata"]["uid"]) in account.times.flying
            and not one.reused
            and phase_of(one.run["status"]) is not Phase.CANCELLED
        }
        flights = {label_value(one.name): one.made for one in account.times.flying.values()}
        ended = {label_value(one.name) for one in account.times.look(active, done, now, idle)}
        # Who has ended had a node too, if only for a moment, but for those that were cancelled meanwhile.
        found = (placed | (ended - account.waiting.keys())) - account.placed
        refused = waiting.keys() - account.waiting.keys()
        account.overtaken = account.overtaken if waiting else 0
        self._overtake(uid, [flights.get(name, now) for name in found])
        used, before = self.held, account.waiting.keys()
        account.waiting, account.placed = waiting, placed
        account.window, account.called = look.window, None
        account.contender = replace(
            account.contender,
            held=len(active) - len(idle) + look.leaving,
            asks=look.asks,
            weight=look.sweep.spec.weight,
        )
        self.felt.note(len(found), len(found - before), len(refused), used, self.held)
        return account

    def _overtake(self, uid: str, made: list[float]) -> None:
        """Count for others' pods that wait how many, made clearly later, have found a node now."""
        for other, account in self.items():
            if other != uid and account.waiting:
                latest = max(account.waiting.values()) + PASSED_OVER_SECONDS
                account.overtaken += sum(time > latest for time in made)

    @property
    def held(self) -> int:
        """Return the number of slots that are held, without those of pods in the line for a node."""
        return sum(account.contender.held for account in self.values())

    @property
    def line(self) -> int:
        """Return the number of pods in the line for a node."""
        return sum(len(account.waiting) for account in self.values())


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


def _finds_no_node(pod: Mapping[str, Any]) -> bool:
    told = condition_of(pod, "PodScheduled") or {}
    return told.get("status") == "False" and told.get("reason") == "Unschedulable"


def _lacks_room(run: Object, pod: Mapping[str, Any] | None) -> bool:
    """Tell whether a run waits for a node, or for a quota."""
    if pod is not None:
        return _finds_no_node(pod)
    scheduled = condition_of(run, "Scheduled") or {}
    return scheduled.get("status") == "False" and scheduled.get("reason") == "QuotaExceeded"
