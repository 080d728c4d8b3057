# SPDX-License-Identifier: Apache-2.0
"""PriorityClasses of Sweeps' runs: one finds out whether there is its class, where nobody knows.

A run keeps the class that it was made with. One that waits for a class which its Sweep no longer names is
made anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.engine import PointState
from slamhive.kube.api.kinds import Kind, key_of
from slamhive.kube.builders.common import label_value
from slamhive.kube.reconciling.sweep_runs import encode_points, lacks_class
from slamhive.model.base import plural
from slamhive.model.status import SweepStatus

if TYPE_CHECKING:
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.priorities import PriorityClasses
    from slamhive.kube.reconciling.sweep_accounts import SweepLook
    from slamhive.kube.reconciling.sweep_picture import SweepPicture


def learn(classes: PriorityClasses, look: SweepLook) -> None:
    """Learn from a Sweep's runs whether there is its class: without it none has a pod."""
    name = look.sweep.spec.priority_class
    if name is None:
        return
    if _is_refused(look):
        classes.miss(name)
    elif any(
        run["spec"].get("priorityClassName") == name and look.pods.get(label_value(run["metadata"]["name"]))
        for run in look.active
    ):
        classes.meet(name)


def scouts(look: SweepLook) -> int:
    """Return the number of runs that may find out whether there is their class: one, at first."""
    if _is_refused(look):
        return 0
    states = look.memory.states
    # Those that take an equal run's result end without a pod, which must not have all go one by one.
    has_ended = states.count(PointState.PENDING) + states.count(PointState.ACTIVE) < len(states)
    return look.asks if has_ended else int(all(map(lacks_class, look.active)))


async def make_anew(cluster: Cluster, seen: SweepPicture) -> bool:
    """Remove the runs that wait for a class which their Sweep names no more; tells whether there were any."""
    memory, name = seen.memory, seen.sweep.spec.priority_class
    stale = {
        index: run
        for index, run in seen.runs.items()
        if memory.states[index] == PointState.ACTIVE
        and run["spec"].get("priorityClassName") != name
        and lacks_class(run)
    }
    if not stale:
        return False
    for index in stale:
        memory.states[index] = PointState.PENDING
    memory.cursor, memory.points = 0, encode_points(memory.states)
    # Written before: the next operator would otherwise take them for runs that were deleted by hand.
    await cluster.write_status(Kind.SWEEP, seen.body, SweepStatus(points=memory.points))
    for run in stale.values():
        await cluster.delete(key_of(Kind.MAPPING_RUN, run))
    former = sorted({str(run["spec"].get("priorityClassName")) for run in stale.values()})
    named = f"PriorityClass {name}" if name else "the chart's class"
    lost = f"{plural(len(stale), 'run')} that had no pod for want of {', '.join(former)}"
    text = f"made anew with {named}: {lost}"
    await cluster.api.event(Kind.SWEEP, seen.body, "Normal", "RunsMadeAnew", text)
    return True


def _is_refused(look: SweepLook) -> bool:
    """Tell whether runs have no pod for the lack of the class that the Sweep names now, not one before."""
    name = look.sweep.spec.priority_class
    return any(run["spec"].get("priorityClassName") == name and lacks_class(run) for run in look.active)
