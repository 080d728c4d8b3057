# SPDX-License-Identifier: Apache-2.0
"""Refusals of the cluster that only Events show, such as a Job whose pod is not allowed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.kube.errors import ApiError
from slamhive.kube.observing import POD_SECONDS, explained, lacks_pod
from slamhive.kube.reports import clean

if TYPE_CHECKING:
    from slamhive.kube.operator import Operator
    from slamhive.kube.pods import Waiting

_AGAIN_SECONDS = 15.0


async def why_no_pod(op: Operator, job: dict[str, Any]) -> str | None:
    """Return the API server's last word on the pod that a Job asked it for; None where it said nothing.

    Raises:
        ApiError: the server can't be asked just now.
    """
    metadata = job["metadata"]
    try:
        message = await op.refused_pods.message(metadata["namespace"], metadata["uid"])
    except ApiError as error:
        if error.retryable:
            raise
        return None  # without the right to read Events the reason stays unknown
    return clean((message or "").removeprefix("Error creating: ")) or None


async def patience(
    op: Operator, job: dict[str, Any], waiting: Waiting | None
) -> tuple[Waiting | None, float | None]:
    """Return what a Job of ours waits for, and when to look at it again.

    Args:
        op: the operator.
        job: the Job.
        waiting: as it was seen.

    Returns:
        The waiting with the API server's reason, and seconds: 0 where its pod was refused for too long, None
        where it has its pod.

    Raises:
        ApiError: the server can't be asked just now.
    """
    if waiting is None or not lacks_pod(waiting):
        return waiting, None
    now = op.clock()
    since = waiting.since or now
    # A new Job has no pod for a moment: to ask for Events then would cost a call for each Job.
    if now - since < POD_SECONDS:
        return waiting, POD_SECONDS
    waiting = explained(waiting, await why_no_pod(op, job))
    left = since + op.settings.refusal_grace_seconds - now
    return waiting, _AGAIN_SECONDS if waiting.end is None or left > 0 else 0.0
