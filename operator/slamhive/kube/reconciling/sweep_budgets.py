# SPDX-License-Identifier: Apache-2.0
"""Budgets of CPU hours: what the runs of a namespace have used, by the archive and those not yet in it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.kube.api.kinds import Kind
from slamhive.kube.reconciling.archiving import in_thread
from slamhive.kube.status import phase_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.archive import Archive
    from slamhive.kube.cluster import Cluster

BETWEEN_SECONDS = 10.0
"""Shortest time between two looks into the archive."""
SHARE = 50
"""Times as long as a look took until the next one."""
MOST_LIVE = 20_000
"""Live runs that the archive is asked to leave out: databases take so many values of a query."""
_HOUR = 3600.0


@dataclass
class _Used:
    """CPU seconds that a namespace has used, and when to look again, s since 1970."""

    seconds: float = 0.0
    due: float = 0.0


class CpuBudgets:
    """Tells whether namespaces have used up their budgets.

    Args:
        archive: where runs are whose objects are gone, if anywhere.
        stopwatch: returns seconds, to measure how long a look into the archive takes.
    """

    def __init__(
        self, archive: Archive | None = None, stopwatch: Callable[[], float] = time.monotonic
    ) -> None:
        self._archive = archive
        self._stopwatch = stopwatch
        self._used: dict[str, _Used] = {}

    async def exhausted(self, cluster: Cluster, namespace: str, now: float) -> tuple[str, str] | None:
        """Return reason and sentence where a namespace has used up its budget; None where it may go on.

        Raises:
            ArchiveAway: the archive does not answer: what was used isn't known.
        """
        rule = cluster.settings.sharing.namespaces.get(namespace)
        if rule is None or rule.cpu_hours is None:
            return None
        used = self._used.setdefault(namespace, _Used())
        if now >= used.due:
            began = self._stopwatch()
            used.seconds = await self._seconds(cluster, namespace)
            used.due = now + max(BETWEEN_SECONDS, SHARE * (self._stopwatch() - began))
        if used.seconds < _HOUR * rule.cpu_hours:
            return None
        return "CpuBudgetUsedUp", (
            f"the budget of namespace {namespace} is used up: its runs took {used.seconds / _HOUR:,.4g} of "
            f"{rule.cpu_hours:,.4g} CPU hours (sharing.namespaces.{namespace}.cpuHours of the chart); "
            "runs in flight end, and it goes on by itself when there is more"
        )

    async def _seconds(self, cluster: Cluster, namespace: str) -> float:
        live: dict[str, float] = {}
        for run in cluster.store.of(Kind.MAPPING_RUN, namespace):
            status = run["status"]
            if phase_of(status).is_finished and not (status.get("provenance") or {}).get("reusedFrom"):
                used = ((status.get("usage") or {}).get("cpu") or {}).get("seconds") or 0.0
                live[run["metadata"]["uid"]] = used
        if self._archive is None:
            return sum(live.values())
        # Those that the archive has may still have objects: they count once.
        known = list(live)[:MOST_LIVE]
        archived = await in_thread(self._archive.namespace_cpu_seconds, namespace, cluster.identity, known)
        return archived + sum(live[uid] for uid in known)
