# SPDX-License-Identifier: Apache-2.0
"""Handlers for kopf: forward every event of what people write to the operator's store.

Only the entry point imports this module.

kopf keeps the watches alive; everything else that it could do (finalizers, annotations, peering, Events,
retries) is left off, because the reconcilers work from the store and the queue.
"""

from __future__ import annotations

import logging
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import TYPE_CHECKING, Any

import kopf

from slamhive.kube.api.client import PAGE
from slamhive.kube.api.kinds import Kind
from slamhive.kube.following import FOLLOWED, following

if TYPE_CHECKING:
    import asyncio

    from slamhive.kube.api.client import Api
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.operator import Operator

WATCHED = tuple(kind for kind in Kind if kind not in FOLLOWED)
"""Kinds that kopf watches."""

WATCH_SECONDS = 600
INACTIVE_SECONDS = 90.0
"""Longer than the minute between the server's bookmarks: a watch silent for longer is dead."""

_BACKOFF_SECONDS = (1, 1, 2, 3, 5, 8, 13, *(20,) * 4_000)
"""Waits between tries of a watch: a day of them."""
_LOGIN_SECONDS = 600.0
_IDLE_SECONDS = 0.1
_EXIT_SECONDS = 0.5


class NoDiffs(kopf.DiffBaseStorage):
    """Remembers no last-seen state: nothing here asks what has changed since."""

    def build(self, *, body: kopf.Body, extra_fields: Any = None) -> kopf.BodyEssence:  # noqa: ARG002
        """Return nothing of an object, which saves a copy of it for each event."""
        return {}

    def fetch(self, *, body: kopf.Body) -> kopf.BodyEssence | None:  # noqa: ARG002
        """Return None: nothing was remembered."""
        return None

    def store(self, *, body: kopf.Body, patch: kopf.Patch, essence: kopf.BodyEssence) -> None:
        """Store nothing."""


def registry_for(cluster: Cluster) -> kopf.OperatorRegistry:
    """Return the handlers: one a kind that kopf watches, which hands over what the watch reports."""
    registry = kopf.OperatorRegistry()
    for kind in WATCHED:

        async def hand_over(event: Any, watched: Kind, **_: Any) -> None:
            cluster.observe(watched, event["type"], event["object"])

        handler = partial(hand_over, watched=kind)
        kopf.on.event(kind.group, kind.version, kind.plural, id=kind.plural, registry=registry)(handler)
    kopf.on.login(id="login", registry=registry)(partial(_log_in, cluster.api))
    return registry


def settings_for_kopf() -> kopf.OperatorSettings:
    """Return kopf's settings: watch what is ours, touch nothing."""
    settings = kopf.OperatorSettings()
    settings.watching.server_timeout = WATCH_SECONDS
    settings.watching.inactivity_timeout = INACTIVE_SECONDS
    settings.watching.chunk_size = PAGE
    # By itself kopf ends, and the operator with it, after a minute without the server or a right.
    settings.networking.error_backoffs = _BACKOFF_SECONDS
    # kopf would otherwise look through the cluster, attach its own Events and annotate what it sees.
    settings.scanning.disabled = True
    settings.posting.enabled = False
    settings.peering.standalone = True
    settings.queueing.idle_timeout = _IDLE_SECONDS
    settings.queueing.exit_timeout = _EXIT_SECONDS
    settings.persistence.diffbase_storage = NoDiffs()
    # Ten minutes after its end kopf would kill the process by SIGKILL, whatever that does by then. A pod that
    # doesn't end is the kubelet's to kill.
    settings.process.ultimate_exiting_timeout = None
    logging.getLogger("kopf.objects").setLevel(logging.WARNING)
    return settings


async def watch(op: Operator, ready_flag: asyncio.Event | None = None) -> None:
    """Watch until cancelled, or until a signal comes before the flag is set.

    Args:
        op: its cluster gets what is seen.
        ready_flag: set when the watching has begun and kopf's own signal handlers are in place.
    """
    async with following(op):
        await kopf.operator(
            registry=registry_for(op.cluster),
            settings=settings_for_kopf(),
            namespaces=op.cluster.settings.namespaces,
            standalone=True,
            ready_flag=ready_flag,
        )


async def _log_in(api: Api, **_: Any) -> kopf.ConnectionInfo:
    """Let kopf in by the same way as our own client: same address, certificates and token."""
    access = await api.access()
    # Tokens of service accounts are replaced while the pod lives: kopf has to ask again.
    expiration = datetime.now(UTC) + timedelta(seconds=_LOGIN_SECONDS) if access.token else None
    return kopf.ConnectionInfo(
        server=access.server,
        ca_path=access.ca_path,
        insecure=access.insecure,
        token=access.token,
        scheme="Bearer" if access.token else None,
        certificate_path=access.certificate_path,
        private_key_path=access.private_key_path,
        proxy_url=access.proxy_url,
        trust_env=True,
        expiration=expiration,
    )
