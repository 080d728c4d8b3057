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
from slamhive.kube.api.kinds import Kind, Role, annotations_of, key_of
from slamhive.kube.builders.restoring import FOLDERS, restore_job
from slamhive.kube.observing import observe_job
from slamhive.kube.pods import is_deleted
from slamhive.kube.reconciling.waiting import patience
from slamhive.kube.reports import read_left

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.kube.api.kinds import Object
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.evaluation_groups import EvaluationGroup
    from slamhive.kube.settings import StoreReference

_BATCH = 100
_AGAIN_SECONDS = 60.0


@dataclass
class Restored:
    """Runs by whether their folders are on the volume.

    Attributes:
        ready: runs, as they stand in requests, that can be measured.
        refused: why folders can't be had, by the name of their run.
        delays: after how many seconds to look again.
    """

    ready: list[Object]
    refused: dict[str, str] = field(default_factory=dict)
    delays: list[float | None] = field(default_factory=list)


async def restore_folders(cluster: Cluster, group: EvaluationGroup, items: list[Object]) -> Restored:
    """Have the folders of runs on the volume before they are measured.

    Args:
        cluster: the cluster.
        group: the runs' group.
        items: the runs, as they stand in requests.
    """
    store, memory = cluster.settings.store, group.memory
    if store is None:
        return Restored(items)
    found = Restored([])
    left: dict[str, str] = {}
    active = False
    for job in cluster.store.jobs_of(group.owner["uid"], Role.RESTORE):
        if is_deleted(job):
            continue
        told = await _take_in(cluster, group, job, found)
        active |= told is None
        left |= told or {}
    away = set()
    for item in items:
        folder = item["folder"]
        # A run's own folder is still on the volume: only archived runs are moved away.
        if _uid(folder) in {item["uid"], None} or folder in memory.restored:
            found.ready.append(item)
        elif why := left.get(str(_uid(folder))):
            found.refused[item["name"]] = why
        else:
            away.add(folder)
    if active:
        return found  # one at a time: runs that end meanwhile are in the next
    if not away:
        memory.trouble, memory.restore_at = None, 0.0
    elif (seconds := memory.restore_at - cluster.clock()) > 0:
        found.delays.append(seconds)
    else:
        await _start(cluster, group, sorted(away)[:_BATCH], store)
    return found


async def _take_in(
    cluster: Cluster, group: EvaluationGroup, job: Object, found: Restored
) -> dict[str, str] | None:
    """Return the folders that a Job left away, with reasons; None while it runs."""
    memory, seen = group.memory, observe_job(job, await cluster.pods_of(job))
    problem = seen.problem[1] if seen.problem else None
    if seen.state is not AttemptState.ENDED:
        waits = await patience(cluster, job, seen.waiting)
        if waits.end is None:
            found.delays.append(waits.seconds)
            if waits.why is not None:
                memory.trouble = f"its Job does not begin: {waits.why}"
            return None
        problem = waits.end.message
    # Read and then removed: its name follows from the folders, and the same ones may be asked for again.
    await cluster.delete(key_of(Kind.JOB, job))
    if problem is not None:
        memory.trouble, memory.restore_at = problem, cluster.clock() + _AGAIN_SECONDS
        return dict.fromkeys(map(str, map(_uid, _folders(job))), "")
    memory.trouble, memory.restore_at = None, 0.0
    left = read_left(seen.words)
    memory.restored |= {folder for folder in _folders(job) if _uid(folder) not in left}
    return left


async def _start(
    cluster: Cluster, group: EvaluationGroup, folders: Sequence[str], store: StoreReference
) -> None:
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


def _folders(job: Object) -> list[str]:
    """Return the folders that a Job was asked for."""
    return str(annotations_of(job).get(FOLDERS) or "").split(",")


def _uid(folder: str) -> str | None:
    """Return the UID of the run that a folder is of, None where it is none like runs/UID/POD."""
    parts = folder.split("/")
    return parts[1] if len(parts) == 3 else None
