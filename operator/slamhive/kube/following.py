# SPDX-License-Identifier: Apache-2.0
"""Following of what comes in great numbers: runs, and the Jobs and pods that belong to our objects.

kopf watches the rest, what people write. Made to handle each event of each object by itself, it spends ten
times on an event what it takes to read it and to note it in the store.
"""

from __future__ import annotations

import asyncio
import logging
from contextlib import asynccontextmanager
from functools import partial
from typing import TYPE_CHECKING

from slamhive.kube.api.kinds import Kind
from slamhive.kube.api.watching import Follower, open_session
from slamhive.kube.cluster import MANAGED
from slamhive.kube.ending import end_tasks

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from aiohttp import ClientSession

    from slamhive.kube.cluster import Cluster
    from slamhive.kube.operator import Operator

FOLLOWED = (Kind.MAPPING_RUN, Kind.JOB, Kind.POD)
"""Kinds that are followed here and not by kopf."""

_log = logging.getLogger("slamhive.operator")


@asynccontextmanager
async def following(op: Operator) -> AsyncIterator[None]:
    """Follow these kinds in all namespaces as long as the context lasts."""
    session = open_session()
    tasks = [
        asyncio.create_task(
            _follower(op.cluster, session, kind, namespace).run(), name=f"{kind.plural} of {namespace}"
        )
        for kind in FOLLOWED
        for namespace in op.cluster.settings.namespaces
    ]
    for task in tasks:
        task.add_done_callback(op.note_end)
    try:
        yield
    finally:
        for task in tasks:
            task.remove_done_callback(op.note_end)
        try:
            await session.close()  # before the tasks: open_session says why
        finally:  # whoever ends this may have to say so twice
            await end_tasks(tasks)


def _follower(cluster: Cluster, session: ClientSession, kind: Kind, namespace: str) -> Follower:
    told: list[str | None] = [None]

    def trouble(sentence: str | None) -> None:
        if sentence is not None and sentence != told[0]:
            _log.warning("%s", sentence)
        told[0] = sentence

    return Follower(
        cluster.api,
        session,
        kind,
        namespace,
        reset=partial(cluster.take_list, kind, namespace),
        change=partial(cluster.observe, kind),
        trouble=trouble,
        narrow=partial(cluster.store.narrowed, kind),
        narrow_change=lambda obj: obj,  # the store does it, if the object is news at all
        # On the server's side: other people's Jobs and pods never reach this process.
        labels=None if kind.is_ours else MANAGED,
    )
