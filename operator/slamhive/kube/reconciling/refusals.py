# SPDX-License-Identifier: Apache-2.0
"""Refusals of the cluster that only Events tell of: why a Job's pod is not made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.kube.errors import ApiError
from slamhive.kube.reports import clean

if TYPE_CHECKING:
    from slamhive.kube.operator import Operator


async def why_no_pod(op: Operator, job: dict[str, Any]) -> str | None:
    """Return the API server's last word on the pod that a Job asked it for; None where it said nothing.

    Raises:
        ApiError: the server can't be asked just now.
    """
    metadata = job["metadata"]
    try:
        told = await op.api.events_of(metadata["namespace"], metadata["uid"], "FailedCreate")
    except ApiError as error:
        if error.retryable:
            raise
        return None  # without the right to read Events the reason stays unknown
    message = str(told[-1].get("message") or "") if told else ""
    return clean(message.removeprefix("Error creating: ")) or None
