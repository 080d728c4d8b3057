# SPDX-License-Identifier: Apache-2.0
"""Capacity of the cluster for runs: what quotas and nodes allow, and what is learned of the rest.

Quotas and nodes are read now and then, as far as the account may. They say what is impossible; what fits now
only the scheduler knows. So a pool begins small, grows with every pod that finds a node, and shrinks to what
is in flight when one finds none or a quota refuses it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from slamhive.kube.api.errors import ApiError, Forbidden, NotFound
from slamhive.kube.builders.common import WHOLE_NODE
from slamhive.model.base import quantity

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Mapping

    from slamhive.kube.api.kinds import Object
    from slamhive.kube.cluster import Cluster

QUOTA_SECONDS = 5.0
NODES_SECONDS = 60.0
"""Shortest times between two readings."""
REFUSED_SECONDS = 600.0
"""Time until what an account may not see is asked for again."""
_OF_QUOTAS = {
    "pods": "pods",
    "count/pods": "pods",
    "cpu": "cpu",
    "memory": "memory",
    "requests.cpu": "cpu",
    "requests.memory": "memory",
    "limits.cpu": "cpu",
    "limits.memory": "memory",
}
"""Items of a quota, and the resource of a run's pod that each counts: its limits are its requests."""
_SCOPES_OF_RUNS = frozenset({"NotBestEffort", "Terminating"})
_KEEPS_AWAY = frozenset({"NoSchedule", "NoExecute"})


@dataclass(frozen=True)
class Bound:
    """Number of runs that are possible, and by what.

    Attributes:
        runs: the number.
        why: what bounds it, as the subject of a sentence.
    """

    runs: int
    why: str


def bound_by_quotas(quotas: Iterable[Object], asked: Mapping[str, float], there: int) -> Bound | None:
    """Return the number of runs that the quotas of a namespace allow; None where they bound nothing.

    A quota for some pods alone, such as those of a priority class, is left to the API server.

    Args:
        quotas: ResourceQuotas.
        asked: what a run's pod asks for, by resource.
        there: pods of runs that are counted in the quotas already.
    """
    bounds = []
    for quota in quotas:
        spec, status = quota.get("spec") or {}, quota.get("status") or {}
        if spec.get("scopeSelector") or not _SCOPES_OF_RUNS.issuperset(spec.get("scopes") or ()):
            continue
        used = status.get("used") or {}
        for item, most in (status.get("hard") or spec.get("hard") or {}).items():
            what = _OF_QUOTAS.get(item, item.removeprefix("requests."))
            each = 1.0 if what == "pods" else asked.get(what, 0.0)
            try:
                left = quantity(most) - quantity(used.get(item, "0"))
            except ValueError:
                continue
            if each > 0:
                name = quota["metadata"]["name"]
                told = f"quota {name} ({item}: {used.get(item, '0')} of {most} used)"
                bounds.append(Bound(max(0, math.floor(left / each + 1e-9)) + there, told))
    return min(bounds, key=lambda one: one.runs, default=None)


def bound_by_nodes(nodes: Iterable[Object], asked: Mapping[str, float], pods: Object) -> Bound:
    """Return the number of pods of a run that the cluster's nodes could hold if they held nothing else.

    Args:
        nodes: the nodes.
        asked: what a run's pod asks for, by resource.
        pods: parts of its spec: nodeSelector and tolerations.
    """
    fitting = [node for node in nodes if _takes(node, pods)]
    runs = 0
    for node in fitting:
        there = {name: _number(text) for name, text in (node["status"].get("allocatable") or {}).items()}
        there[WHOLE_NODE] = 1.0
        parts = [there.get(name, 0.0) / each for name, each in asked.items() if each > 0]
        runs += math.floor(min([*parts, there.get("pods", math.inf)], default=0.0) + 1e-9)
    words = "node that takes runs" if len(fitting) == 1 else "nodes that take runs"
    return Bound(runs, f"the cluster ({len(fitting)} {words}, which could hold {runs} of these)")


def _takes(node: Object, pods: Object) -> bool:
    """Tell whether a node is ready and takes pods with such a selector and tolerations."""
    spec, status = node.get("spec") or {}, node.get("status") or {}
    ready = next((one for one in status.get("conditions") or () if one["type"] == "Ready"), None)
    if spec.get("unschedulable") or (ready is not None and ready["status"] != "True"):
        return False
    labels = node["metadata"].get("labels") or {}
    if any(labels.get(name) != value for name, value in (pods.get("nodeSelector") or {}).items()):
        return False
    tolerations = pods.get("tolerations") or ()
    taints = [taint for taint in spec.get("taints") or () if taint.get("effect") in _KEEPS_AWAY]
    return all(any(_tolerates(one, taint) for one in tolerations) for taint in taints)


def _tolerates(toleration: Object, taint: Object) -> bool:
    if toleration.get("effect") not in {None, "", taint["effect"]}:
        return False
    exists = toleration.get("operator") == "Exists"
    if not toleration.get("key"):
        return exists
    same = toleration["key"] == taint["key"]
    return same and (exists or (toleration.get("value") or "") == (taint.get("value") or ""))


def _number(text: object) -> float:
    try:
        return quantity(str(text))
    except ValueError:
        return 0.0


@dataclass
class ClusterReading:
    """Objects of the cluster as they were last read, or why they could not be.

    Attributes:
        due: when to read again, s since 1970.
        objects: what was read; None: nothing ever was, or it may not be seen.
        there: pods of runs at that time.
    """

    due: float = 0.0
    objects: list[Object] | None = None
    there: int = 0

    async def renew(self, now: float, seconds: float, read: Callable[[], Awaitable[list[Object]]]) -> bool:
        """Read the objects again if that is due, as it is each so many seconds; tells whether they were read.

        What may not be seen isn't known any more; other failures leave what was read before.
        """
        if now < self.due:
            return False
        self.due = now + seconds
        try:
            self.objects = await read()
        except ApiError as error:
            if isinstance(error, Forbidden | NotFound):
                self.objects, self.due = None, now + REFUSED_SECONDS
            return False
        return True


class SeenRoom:
    """Bounds by quotas and nodes, as far as the account may see these."""

    def __init__(self) -> None:
        self._quotas: dict[str, ClusterReading] = {}
        self._nodes = ClusterReading()

    async def of_quotas(
        self, cluster: Cluster, namespace: str, asked: Mapping[str, float], there: int
    ) -> Bound | None:
        """Return the number of runs of a namespace that its quotas allow.

        Args:
            cluster: the cluster.
            namespace: the namespace.
            asked: what a run's pod asks for, by resource.
            there: pods of runs that are there now.
        """
        reading = self._quotas.setdefault(namespace, ClusterReading())
        if await reading.renew(cluster.clock(), QUOTA_SECONDS, lambda: cluster.api.quotas(namespace)):
            reading.there = there
        return bound_by_quotas(reading.objects or (), asked, reading.there)

    async def of_nodes(self, cluster: Cluster, asked: Mapping[str, float]) -> Bound | None:
        """Return the number of runs that the nodes could hold; None where they can't be seen."""
        if not cluster.settings.sharing.read_nodes:
            return None
        reading = self._nodes
        await reading.renew(cluster.clock(), NODES_SECONDS, cluster.api.nodes)
        if reading.objects is None:
            return None
        pods = cluster.settings.pods
        chosen = {"nodeSelector": pods.node_selector, "tolerations": pods.tolerations}
        return bound_by_nodes(reading.objects, asked, chosen)


@dataclass
class FeltRoom:
    """Room for runs as it is felt: how many may be in flight at a time.

    Attributes:
        first: the number that it begins with.
        waiting: pods that may wait for a node where there is no room.
        limit: runs in flight at most, those not counted that wait for a node.
        ceiling: runs in flight when the cluster was last found full; endless before that.
    """

    first: int
    waiting: int = 1
    limit: int = field(init=False)
    ceiling: float = math.inf

    def __post_init__(self) -> None:
        self.limit = self.first

    @property
    def is_full(self) -> bool:
        """Tell whether there was no room for more when it was last felt for."""
        return math.isfinite(self.ceiling) and self.limit <= self.ceiling + 1

    @property
    def slots(self) -> int:
        """Return the number of runs that may be in flight, with those that wait for a node."""
        # Where none waits one is tried, so that room which others leave is found while runs come and go.
        return self.limit + (self.waiting if math.isfinite(self.ceiling) else 0)

    def recall(self, placed: int, refused: int) -> None:
        """Take over what an operator before this one had found.

        Args:
            placed: pods of runs that have a node.
            refused: pods of runs that were found to have none.
        """
        self.limit = max(1, placed) if refused else self.first + placed
        self.ceiling = self.limit if refused else math.inf

    def note(self, placed: int, at_once: int, refused: int, used: int, held: int) -> None:
        """Note what has become of runs.

        Args:
            placed: pods that found a node, and runs that ended before they were seen to have one.
            at_once: those of them that were never found to have none.
            refused: pods that were found to have none.
            used: slots that were held since the last time.
            held: slots that are held now: runs in flight, without those that wait for a node.
        """
        if refused:
            self.ceiling = held
            self.limit = max(1, held)
        elif self.limit < self.ceiling:
            grown = min(self.limit + 2 * at_once, self.ceiling, max(self.first, 2 * used))
            self.limit = max(self.limit, int(grown))
        elif placed:
            # Some of those that may wait have found a node. Runs whose pods nobody has looked at prove
            # nothing: a busy cluster makes them late, and then refuses a crowd at once.
            self.limit = max(self.limit, held)
