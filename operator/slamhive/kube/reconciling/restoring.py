# SPDX-License-Identifier: Apache-2.0
"""Folders of runs that took over an archived run's result: on the results volume before they are measured.

The offloader moves folders of archived runs to object storage, whose keys no evaluator gets. So a Job of ours
brings such folders back first; one that is on the volume stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from slamhive.engine import AttemptState
from slamhive.kube.api.errors import AlreadyExists
from slamhive.kube.api.kinds import Key, Kind, Label, Role, key_of
from slamhive.kube.builders.restoring import FOLDERS, restore_job
from slamhive.kube.observing import observe_restore
from slamhive.kube.reconciling.refusals import patience

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.kube.api.kinds import Object
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.evaluation_groups import Group
    from slamhive.kube.settings import StoreReference

_BATCH = 100
_AGAIN_SECONDS = 60.0


@dataclass
class Brought:
    """Runs by whether their folders are on the volume.

    Attributes:
        ready: runs, as they stand in requests, that can be measured.
        refused: why folders can't be had, by the name of their run.
        delays: after how many seconds to look again.
    """

    ready: list[Object]
    refused: dict[str, str] = field(default_factory=dict)
    delays: list[float] = field(default_factory=list)


class Restoring:
    """Jobs that bring folders back, and what they brought: an operator that is started anew asks again."""

    def __init__(self) -> None:
        self._here: dict[Key, set[str]] = {}
        self._trouble: dict[Key, tuple[str, float]] = {}

    def forget(self, key: Key) -> None:
        """Forget what was brought for a group that needs nothing any more."""
        self._here.pop(key, None)
        self._trouble.pop(key, None)

    def trouble(self, key: Key) -> str | None:
        """Return the reason that a group's folders can't be had now; None where nothing is in the way."""
        found = self._trouble.get(key)
        return found and f"run folders can't be brought back from object storage: {found[0]}"

    async def bring(self, cluster: Cluster, group: Group, items: list[Object]) -> Brought:
        """Have the folders of runs on the volume before they are measured.

        Args:
            cluster: the cluster.
            group: the runs' group.
            items: the runs, as they stand in requests.
        """
        store = cluster.settings.store
        if store is None:
            return Brought(items)
        here = self._here.setdefault(group.key, set())
        found = Brought([])
        left: dict[str, str] = {}
        active = False
        for job in _jobs(cluster, group):
            told = await self._look(cluster, group, job, found)
            active |= told is None
            left |= told or {}
            if told is not None:
                here |= {folder for folder in _folders(job) if _uid(folder) not in told}
        away = []
        for item in items:
            folder = item["folder"]
            # A run's own folder is still on the volume: only archived runs are moved away.
            if _uid(folder) in {item["uid"], None} or folder in here:
                found.ready.append(item)
            elif why := left.get(str(_uid(folder))):
                found.refused[item["name"]] = why
            else:
                away.append(folder)
        if not away and not active:
            self._trouble.pop(group.key, None)
        # One at a time: runs that end meanwhile are in the next.
        left_seconds = self._trouble.get(group.key, ("", 0.0))[1] - cluster.clock()
        if away and not active and left_seconds > 0:
            found.delays.append(left_seconds)
        elif away and not active:
            await self._start(cluster, group, sorted(set(away))[:_BATCH], store)
        return found

    async def _look(
        self, cluster: Cluster, group: Group, job: Object, found: Brought
    ) -> dict[str, str] | None:
        """Return the folders that a Job left away, with reasons; None while it runs."""
        seen = observe_restore(job, cluster.store.pods_of(job))
        problem = seen.problem[1] if seen.problem else None
        if seen.state is not AttemptState.ENDED:
            waits = await patience(cluster, job, seen.waiting)
            if waits.end is None:
                found.delays += [] if waits.seconds is None else [waits.seconds]
                if waits.why is not None:
                    self._trouble[group.key] = f"its Job does not begin: {waits.why}", 0.0
                return None
            problem = waits.end.message
        # Read and then removed: its name follows from the folders, and the same ones may be asked for again.
        await cluster.delete(key_of(Kind.JOB, job))
        if problem is not None:
            self._trouble[group.key] = problem, cluster.clock() + _AGAIN_SECONDS
            return dict.fromkeys(map(str, map(_uid, _folders(job))), "")
        self._trouble.pop(group.key, None)
        return dict(seen.left)

    @staticmethod
    async def _start(cluster: Cluster, group: Group, folders: Sequence[str], store: StoreReference) -> None:
        body = restore_job(
            group.key.namespace,
            folders,
            owner=group.owner,
            store=store,
            labels=group.labels,
            settings=cluster.settings,
        )
        try:
            await cluster.create(Kind.JOB, body)
        # Made by an operator that ended before it heard so; the watch may be late.
        except AlreadyExists:
            await cluster.refresh(key_of(Kind.JOB, body))


def _jobs(cluster: Cluster, group: Group) -> list[Object]:
    return [
        job
        for kind, job in cluster.store.owned(group.owner["uid"])
        if kind is Kind.JOB
        and (job["metadata"].get("labels") or {}).get(Label.ROLE) == Role.RESTORE
        and not job["metadata"].get("deletionTimestamp")
    ]


def _folders(job: Object) -> list[str]:
    """Return the folders that a Job was asked for."""
    return str((job["metadata"].get("annotations") or {}).get(FOLDERS) or "").split(",")


def _uid(folder: str) -> str | None:
    """Return the UID of the run that a folder is of, None where it is none like runs/UID/POD."""
    parts = folder.split("/")
    return parts[1] if len(parts) == 3 else None
