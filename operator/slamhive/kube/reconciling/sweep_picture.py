# SPDX-License-Identifier: Apache-2.0
"""A Sweep as it is seen at one moment: its runs, what other operators wrote, and what is decided on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from slamhive.engine import PointState, SweepDecision, SweepObserved, Verdict, decide_sweep
from slamhive.kube.api.kinds import Key, Kind, Label, Object, labels_of, owner_uids
from slamhive.kube.builders.common import label_value
from slamhive.kube.pods import live_pods
from slamhive.kube.reconciling.sweep_runs import SweepTally, decode_points, state_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.sweep_state import SweepMemory
    from slamhive.model.sweep import Sweep


@dataclass(frozen=True)
class SweepPicture:
    """A Sweep as it is seen now.

    Attributes:
        key: its address.
        body: the object.
        sweep: the same as a record.
        memory: what is remembered of it.
        runs: its live runs by point.
        tally: figures over all its finished runs.
    """

    key: Key
    body: Object
    sweep: Sweep
    memory: SweepMemory
    runs: dict[int, Object]
    tally: SweepTally

    @property
    def active(self) -> list[Object]:
        """Return its runs in flight, in the order of its points."""
        states = self.memory.states
        return [run for index, run in sorted(self.runs.items()) if states[index] == PointState.ACTIVE]

    @property
    def settled(self) -> list[Object]:
        """Return its live runs of which nothing more will be written."""
        finished = self.memory.finished
        return [run for index, run in self.runs.items() if index in finished and finished[index].is_settled]


def owned_runs(cluster: Cluster, key: Key, uid: str) -> list[Object]:
    """Return the runs of a Sweep, those that are being deleted too."""
    runs = cluster.store.select(Kind.MAPPING_RUN, key.namespace, Label.SWEEP, key.name)
    return [run for run in runs if uid in owner_uids(run)]


def own_runs(cluster: Cluster, key: Key, uid: str) -> list[Object]:
    """Return the runs of a Sweep that stay."""
    return [run for run in owned_runs(cluster, key, uid) if belongs_to(run, uid)]


def belongs_to(run: Object, uid: str) -> bool:
    """Tell whether a run is a Sweep's, and stays."""
    return uid in owner_uids(run) and not run["metadata"].get("deletionTimestamp")


def is_outdated(seen: SweepPicture) -> bool:
    """Tell whether another operator wrote of ends that were never seen here, of runs that are archived."""
    memory, text = seen.memory, seen.body["status"].get("points")
    if text is None or text == memory.points:
        return False
    memory.points = text
    pairs = enumerate(zip(decode_points(text, len(memory.states)), memory.states, strict=True))
    return any(
        theirs >= PointState.SUCCEEDED and theirs != ours and index not in seen.runs
        for index, (theirs, ours) in pairs
    )


def pods_at_work(cluster: Cluster, seen: SweepPicture) -> dict[str, list[Mapping[str, Any]]]:
    """Return the pods of its runs that are at work, by the run's label."""
    pods = cluster.store.select(Kind.POD, seen.key.namespace, Label.SWEEP, label_value(seen.key.name))
    found: dict[str, list[Mapping[str, Any]]] = {}
    for pod in live_pods(pods):
        found.setdefault(labels_of(pod).get(Label.RUN, ""), []).append(pod)
    return found


def leaving_pods(seen: SweepPicture, pods: Mapping[str, list[Mapping[str, Any]]]) -> list[Mapping[str, Any]]:
    """Return the pods at work whose runs were deleted or are over: a slot is free when its pod has ended."""
    going = (run for run in seen.runs.values() if state_of(run) is PointState.ACTIVE)
    active = {label_value(run["metadata"]["name"]) for run in going}
    return [pod for name, some in pods.items() if name not in active for pod in some]


def decide_now(seen: SweepPicture, room: int, now: float) -> SweepDecision:
    """Decide what is started and stopped now, with room for so many runs in flight."""
    memory, search = seen.memory, seen.memory.search
    observed = SweepObserved(
        states=memory.states,
        order=memory.order,
        parallelism=room,
        started_at=memory.started_at,
        cpu_seconds=seen.tally.cpu_seconds,
        cursor=memory.cursor,
        twins=memory.plan.twins,
    )
    if search is None:
        return decide_sweep(seen.sweep.spec, observed, now)
    wanted = search.wanted(memory.states)
    observed = replace(
        observed,
        order=wanted,
        cursor=0,
        left_out=memory.states.count(PointState.PENDING) - len(wanted),
        is_open=not search.decision.is_over,
    )
    decision = decide_sweep(seen.sweep.spec, observed, now)
    is_over = decision.verdict is Verdict.COMPLETE
    return replace(decision, message=search.decision.message) if is_over else decision
