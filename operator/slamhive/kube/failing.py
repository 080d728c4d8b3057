# SPDX-License-Identifier: Apache-2.0
"""The condition of an object that the operator can't bring on: what goes wrong each time it is looked at."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

from slamhive.kube.errors import ApiError, Conflict
from slamhive.kube.kinds import Key, Kind
from slamhive.kube.reports import clean
from slamhive.kube.routing import OWN_EVALUATIONS
from slamhive.kube.status import condition, holds, merged

if TYPE_CHECKING:
    from slamhive.kube.operator import Operator

RECONCILE_ERROR, EVALUATION_ERROR = "ReconcileError", "EvaluationError"
"""Conditions of an object: bringing it on fails; measuring it, as it asks itself, fails."""

_OWNERS = dict(zip(OWN_EVALUATIONS, (Kind.SWEEP, Kind.MAPPING_RUN), strict=True))
_log = logging.getLogger("slamhive.operator")


async def tell_failure(op: Operator, key: Key, error: Exception) -> None:
    """Write what went wrong into an object's conditions, and attach an Event; failing to is no failure."""
    place, kind = _place(key)
    word = type(error).__name__
    told = condition(kind, True, word, f"{word}: {clean(error) or 'no reason given'}")
    if await _write(op, place, told):
        body = op.store.get(place)
        if body is not None:
            await op.api.event(place.kind, body, "Warning", kind, told["message"])


async def tell_recovery(op: Operator, key: Key) -> bool:
    """Take back what was told of an object; returns whether nothing of it stands there now."""
    place, kind = _place(key)
    if not holds((op.store.get(place) or {}).get("status") or {}, kind):
        return True
    return await _write(op, place, condition(kind, False, "Recovered"))


def _place(key: Key) -> tuple[Key, str]:
    """Return the object that a key stands for, and the condition for it."""
    for prefix, kind in _OWNERS.items():
        if key.kind is Kind.EVALUATION and key.name.startswith(prefix):
            return Key(kind, key.namespace, key.name.removeprefix(prefix)), EVALUATION_ERROR
    return key, RECONCILE_ERROR


async def _write(op: Operator, key: Key, told: dict[str, Any]) -> bool:
    """Write a condition, after a Conflict once more; returns whether that was news and could be."""
    body = op.store.get(key)
    for _ in range(2):
        if body is None or body["metadata"].get("deletionTimestamp"):
            return False
        metadata, before = body["metadata"], body["status"].get("conditions") or []
        after = merged(before, [told], metadata.get("generation", 1), op.clock())
        if after == before:
            return False
        patch = {
            "metadata": {"resourceVersion": metadata["resourceVersion"]},
            "status": {"conditions": after},
        }
        try:
            await op.patch(key, patch, subresource="status")
        except Conflict:
            body = await _anew(op, key)
        except ApiError as error:
            _log.debug("%s: its condition %s can't be written: %s", key, told["type"], error)
            return False
        else:
            return True
    return False


async def _anew(op: Operator, key: Key) -> dict[str, Any] | None:
    try:
        return await op.refresh(key)
    except ApiError:
        return None
