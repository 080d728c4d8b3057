# SPDX-License-Identifier: Apache-2.0
"""Patience with Jobs of ours that do not begin: refused pods, which only Events show, and pods that wait."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.kube.api.errors import ApiError
from slamhive.kube.observing import POD_SECONDS, explained, lacks_pod
from slamhive.kube.reports import clean

if TYPE_CHECKING:
    from slamhive.engine import AttemptEnd
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.pods import Waiting

_AGAIN_SECONDS = 15.0
_ROOM_SECONDS = 60.0
"""Time for which a cluster that is full lets pods wait as a matter of course."""


async def why_no_pod(cluster: Cluster, job: dict[str, Any]) -> str | None:
    """Return the API server's last word on the pod that a Job asked it for; None where it said nothing.

    Raises:
        ApiError: the server can't be asked just now.
    """
    metadata = job["metadata"]
    try:
        message = await cluster.refused_pods.message(metadata["namespace"], metadata["uid"])
    except ApiError as error:
        if error.retryable:
            raise
        return None  # without the right to read Events the reason stays unknown
    return clean((message or "").removeprefix("Error creating: ")) or None


class Patience(NamedTuple):
    """Patience with a Job of ours: what it waits for, and how long it still may.

    Attributes:
        why: a sentence to be said of it; None where nothing keeps it from running, or a moment may help.
        seconds: after how many seconds to look again; None: the events of its pod lead back.
        end: what it ends with, as it has waited too long; None while it may wait.
    """

    why: str | None = None
    seconds: float | None = None
    end: AttemptEnd | None = None


async def patience(cluster: Cluster, job: dict[str, Any], waiting: Waiting | None) -> Patience:
    """Return the time that a Job may still wait, and the reason.

    Args:
        cluster: the cluster.
        job: the Job.
        waiting: as it was seen.

    Raises:
        ApiError: the server can't be asked just now.
    """
    if waiting is None:
        return Patience()
    since = waiting.since or cluster.clock()
    waited = cluster.clock() - since
    if lacks_pod(waiting):
        # A new Job has no pod for a moment: to ask for Events then would cost a call for each Job.
        if waited < POD_SECONDS:
            return Patience(seconds=POD_SECONDS)
        waiting = explained(waiting, await why_no_pod(cluster, job))
        left = cluster.settings.refusal_grace_seconds - waited
        if waiting.end is None:
            # Where nothing is refused the cluster is busy: as with a pod, that is said when it lasts.
            busy = lacks_pod(waiting) and waited < _ROOM_SECONDS
            return Patience(None if busy else waiting.message, _AGAIN_SECONDS)
    elif waiting.end is None:
        left = 0.0 if waiting.since is None else _ROOM_SECONDS - waited
        return Patience(seconds=left) if left > 0 else Patience(waiting.message)
    else:
        left = 0.0 if waiting.hopeless else cluster.settings.image_pull_grace_seconds - waited
    if left > 0:
        return Patience(waiting.message, min(left, _AGAIN_SECONDS))
    return Patience(waiting.message, end=waiting.end)
