# SPDX-License-Identifier: Apache-2.0
"""Cancelling of runs and Sweeps, and deleting of objects, for ``slamhive cancel``."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from slamhive.kube.api.errors import NotFound
from slamhive.kube.api.kinds import Key, Kind, Object
from slamhive.kube.status import holds, phase_of
from slamhive.kube.user.queries import find, is_over, name_of, runs_of, status_of
from slamhive.kube.user.together import together
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.kube.user.connecting import ConnectedCluster


_AT_ONCE = 16
_PATIENCE_SECONDS = 10.0
_PAUSE_SECONDS = 0.5


async def cancel(cluster: ConnectedCluster, names: Sequence[str]) -> list[str]:
    """End Sweeps and runs; returns a sentence about each.

    A Sweep is suspended, so that it starts nothing more, and its runs in flight are cancelled.

    Raises:
        UnknownNameError: nothing has one of the names.
        InputError: it is an Evaluation, which can only be deleted.
    """
    sentences = []
    for kind, body in await find(cluster, names):
        if kind is Kind.SWEEP:
            sentences.append(await _cancel_sweep(cluster, body))
        elif kind is Kind.MAPPING_RUN:
            sentences.append(await _cancel_single(cluster, body))
        else:
            raise InputError(f"{kind} {name_of(body)} cannot be cancelled, only deleted: --delete")
    return sentences


async def delete(cluster: ConnectedCluster, names: Sequence[str]) -> list[str]:
    """Delete Sweeps, runs and Evaluations with all that belongs to them; returns a sentence about each.

    Raises:
        UnknownNameError: nothing has one of the names.
    """
    sentences = []
    for kind, body in await find(cluster, names):
        key = cluster.key(kind, name_of(body))
        await cluster.api.delete(key, uid=body["metadata"]["uid"])
        also = {
            Kind.SWEEP: ", and with it its runs, their Jobs and pods",
            Kind.MAPPING_RUN: ", and with it its Jobs and pods",
        }
        sentences.append(f"{kind} {key.name}: deleted{also.get(kind, '')}")
    return sentences


async def _cancel_single(cluster: ConnectedCluster, run: Object) -> str:
    name = name_of(run)
    phase = phase_of(status_of(run))
    if phase.is_finished:
        return f"MappingRun {name}: {phase} already"
    if run["spec"].get("cancel"):
        return f"MappingRun {name}: is being cancelled already"
    await cluster.api.patch(cluster.key(Kind.MAPPING_RUN, name), {"spec": {"cancel": True}})
    return f"MappingRun {name}: cancelled; its pod ends within its grace time"


async def _cancel_sweep(cluster: ConnectedCluster, sweep: Object) -> str:
    key = cluster.key(Kind.SWEEP, name_of(sweep))
    if is_over(Kind.SWEEP, sweep):
        return f"Sweep {key.name}: {status_of(sweep).get('phase')} already, nothing of it runs"
    # First of all, so that the operator starts nothing in the place of the runs that are cancelled next.
    await cluster.api.patch(key, {"spec": {"suspend": True}})
    cancelled: set[str] = set()
    loop = asyncio.get_running_loop()
    deadline = loop.time() + _PATIENCE_SECONDS
    # What the operator was creating when it was told to stop is seen only after it has taken notice.
    while True:
        noticed = await _has_noticed(cluster, key)
        cancelled |= await _cancel_runs(cluster, sweep)
        if noticed or loop.time() > deadline:
            break
        await asyncio.sleep(_PAUSE_SECONDS)
    status = status_of(await cluster.api.get(key))
    pending = status.get("pending")
    left = f", {pending} not started stay pending" if pending else ""
    text = f"Sweep {key.name}: suspended; {len(cancelled)} in flight cancelled{left}"
    if not noticed:
        text += "; no operator has taken notice yet, so a run that was just being made may still appear"
    return text


async def _has_noticed(cluster: ConnectedCluster, key: Key) -> bool:
    """Tell whether the operator knows that a Sweep is suspended."""
    body = await cluster.api.get(key)
    status = status_of(body)
    current = status.get("observedGeneration", 0) >= body["metadata"].get("generation", 1)
    return current and (holds(status, "Suspended") is True or is_over(Kind.SWEEP, body))


async def _cancel_runs(cluster: ConnectedCluster, sweep: Object) -> set[str]:
    """Cancel a Sweep's runs in flight, and return the names of those that were not cancelled before."""
    going = [
        name_of(run)
        for run in await runs_of(cluster, sweep)
        if not phase_of(status_of(run)).is_finished and not run["spec"].get("cancel")
    ]
    limit = asyncio.Semaphore(_AT_ONCE)

    async def one(name: str) -> str | None:
        async with limit:
            try:
                await cluster.api.patch(cluster.key(Kind.MAPPING_RUN, name), {"spec": {"cancel": True}})
            except NotFound:
                return None
        return name

    return {name for name in await together(map(one, going)) if name}
