# SPDX-License-Identifier: Apache-2.0
"""Kubernetes Events, as `kubectl describe` shows them below an object: pure."""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slamhive.kube.api.kinds import Kind, Object


_LONGEST_NOTE = 1024
_LONGEST_NAME = 230


def event_body(
    kind: Kind, regarding: Object, *, event_type: str, reason: str, message: str, now: float
) -> Object:
    """Return an Event; its name follows from what it says, so that the same one again finds the first.

    Args:
        kind: kind of the object that it is about.
        regarding: the object.
        event_type: Normal or Warning.
        reason: one word.
        message: a sentence.
        now: time in s since 1970.
    """
    metadata = regarding["metadata"]
    message = message[:_LONGEST_NOTE]
    # The same words again find the Event that is there: an object that fails for hours has one, not
    # thousands.
    identity = "\0".join([metadata.get("uid", ""), event_type, reason, message])
    digest = hashlib.sha256(identity.encode()).hexdigest()[:16]
    moment = datetime.fromtimestamp(now, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return {
        "apiVersion": "v1",
        "kind": "Event",
        "metadata": {
            "name": f"{metadata['name'][:_LONGEST_NAME]}.{digest}",
            "namespace": metadata["namespace"],
        },
        "involvedObject": {
            "apiVersion": kind.api_version,
            "kind": str(kind),
            "namespace": metadata["namespace"],
            "name": metadata["name"],
            "uid": metadata.get("uid", ""),
        },
        "type": event_type,
        "reason": reason,
        "message": message,
        "source": {"component": "slamhive"},
        "reportingComponent": "slamhive.io/operator",
        "firstTimestamp": moment,
        "lastTimestamp": moment,
        "count": 1,
    }
