# SPDX-License-Identifier: Apache-2.0
"""The condition *ReconcileError*: set on an object that fails each time the operator handles it."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

from slamhive.kube.api.errors import ApiError
from slamhive.kube.api.kinds import Key, Kind, Label, labels_of
from slamhive.kube.reports import clean
from slamhive.kube.routing import OWN_EVALUATIONS
from slamhive.kube.status import condition, holds, status_patch

if TYPE_CHECKING:
    from slamhive.kube.cluster import Cluster

RECONCILE_ERROR, EVALUATION_ERROR = "ReconcileError", "EvaluationError"
"""Conditions of an object: bringing it on fails; measuring it, as it asks itself, fails."""

_OWNERS = dict(zip(OWN_EVALUATIONS, (Kind.SWEEP, Kind.MAPPING_RUN), strict=True))
_log = logging.getLogger("slamhive.operator")


async def tell_failure(cluster: Cluster, key: Key, error: Exception) -> None:
    """Write what went wrong into an object's conditions, and attach an Event; failing to is no failure."""
    place, kind = _place(key)
    word = type(error).__name__
    told = condition(kind, True, word, f"{word}: {clean(error) or 'no reason given'}")
    body = cluster.store.get(place)
    if body is None:
        return
    if kind == RECONCILE_ERROR and cluster.failing.get(place) != told["message"]:
        cluster.failing[place] = told["message"]
        _wake_sweep(cluster, place)
    try:
        is_news = await _write(cluster, place, told)
    except ApiError as refused:
        _log.debug("%s: its condition %s can't be written: %s", place, kind, refused)
        is_news = True  # the Event is all that can be said
    if is_news:
        await cluster.api.event(place.kind, body, "Warning", kind, told["message"])


async def tell_recovery(cluster: Cluster, key: Key, *, told: bool) -> bool:
    """Take back what was told of an object; returns whether nothing of it stands there now.

    Args:
        cluster: the cluster.
        key: the key that goes on.
        told: whether `tell_failure` was called for it. What it wrote may stand there though its answer was
            lost and the watch is late, so the object is read anew.
    """
    place, kind = _place(key)
    if kind == RECONCILE_ERROR and cluster.failing.pop(place, ""):
        _wake_sweep(cluster, place)
    try:
        if told:
            await cluster.refresh(place)
        if not holds((cluster.store.get(place) or {}).get("status") or {}, kind):
            return True
        return await _write(cluster, place, condition(kind, False, "Recovered"))
    except ApiError as error:
        _log.debug("%s: its condition %s can't be taken back: %s", place, kind, error)
        return False


def _place(key: Key) -> tuple[Key, str]:
    """Return the object that a key stands for, and the condition for it."""
    for prefix, kind in _OWNERS.items():
        if key.kind is Kind.EVALUATION and key.name.startswith(prefix):
            return Key(kind, key.namespace, key.name.removeprefix(prefix)), EVALUATION_ERROR
    return key, RECONCILE_ERROR


def _wake_sweep(cluster: Cluster, key: Key) -> None:
    """Have a run's Sweep looked at, which counts those that fail: the run's status may be refused."""
    run = cluster.store.get(key) if key.kind is Kind.MAPPING_RUN else None
    if run is not None and (sweep := labels_of(run).get(Label.SWEEP)):
        cluster.queue.add(Key(Kind.SWEEP, key.namespace, sweep))


async def _write(cluster: Cluster, key: Key, told: dict[str, Any]) -> bool:
    """Write a condition; returns whether that was news. Errors as ``Cluster.amend``."""
    body = cluster.store.get(key)
    if body is None:
        return False

    def change(seen: dict[str, Any]) -> dict[str, Any]:
        # Nobody reads the conditions of what is being deleted.
        if seen["metadata"].get("deletionTimestamp"):
            return {}
        patch = status_patch(seen, {}, [told], cluster.clock())
        return {"status": patch} if patch else {}

    return await cluster.amend(key, body["metadata"]["uid"], change, subresource="status") is not None
