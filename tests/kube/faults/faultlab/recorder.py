# SPDX-License-Identifier: Apache-2.0
"""Recorder of every object that is made on the API server, by a watch of the test's own."""

from __future__ import annotations

import asyncio
import json
import ssl
from collections import defaultdict
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING

import aiohttp

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from slamhive.kube.api.client import Api
    from slamhive.kube.api.kinds import Object


PATHS = {
    "mappingruns": "/apis/slamhive.io/v1alpha1/mappingruns",
    "sweeps": "/apis/slamhive.io/v1alpha1/sweeps",
    "jobs": "/apis/batch/v1/jobs",
    "pods": "/api/v1/pods",
    "volumes": "/api/v1/persistentvolumes",
}
_LINE_LIMIT = 1 << 22


class Recorder:
    """All objects that there ever were, by kind and namespace, then by uid, each as last seen.

    Attributes:
        ever: as said.
        gone: uids of those that were deleted.
    """

    def __init__(self) -> None:
        self.ever: dict[tuple[str, str], dict[str, Object]] = defaultdict(dict)
        self.gone: set[str] = set()

    def alive(self, plural: str, namespace: str) -> list[Object]:
        """Return the objects that there are."""
        # Operators live in threads of their own, and look while the watch goes on.
        known = list(self.ever[plural, namespace].items())
        return [obj for uid, obj in known if uid not in self.gone]

    def named(self, plural: str, namespace: str, name: str) -> Object | None:
        """Return the object of a name."""
        return next((obj for obj in self.alive(plural, namespace) if obj["metadata"]["name"] == name), None)

    def available(self) -> set[str]:
        """Return the names of the volumes that their controller knows."""
        volumes = self.alive("volumes", "")
        return {body["metadata"]["name"] for body in volumes if body["status"].get("phase") != "Pending"}

    def is_empty(self, namespace: str) -> bool:
        """Tell whether nothing is left in a namespace."""
        return not any(self.alive(plural, namespace) for plural in PATHS)

    def forget(self, namespace: str) -> None:
        """Forget what there was in a namespace."""
        for plural in PATHS:
            self.ever.pop((plural, namespace), None)

    def take(self, plural: str, event: Object) -> None:
        """Take in an event of a watch."""
        obj = event["object"]
        if event["type"] not in {"ADDED", "MODIFIED", "DELETED"}:
            raise ValueError(f"the watch of {plural} broke: {obj}")
        meta = obj["metadata"]
        self.ever[plural, meta.get("namespace", "")][meta["uid"]] = obj
        if event["type"] == "DELETED":
            self.gone.add(meta["uid"])


async def session_for(api: Api) -> tuple[str, aiohttp.ClientSession]:
    """Return the API server's address and a session that it lets in."""
    access = await api.access()
    context = ssl.create_default_context(cafile=access.ca_path)
    if access.certificate_path:
        context.load_cert_chain(access.certificate_path, access.private_key_path)
    headers = {"Authorization": f"Bearer {access.token}"} if access.token else {}
    connector = aiohttp.TCPConnector(ssl=context, limit=0)
    timeout = aiohttp.ClientTimeout(total=None)
    return access.server, aiohttp.ClientSession(
        connector=connector, headers=headers, timeout=timeout, read_bufsize=_LINE_LIMIT
    )


@asynccontextmanager
async def recording(api: Api) -> AsyncIterator[Recorder]:
    """Record all namespaces as long as the context lasts."""
    recorder = Recorder()
    server, session = await session_for(api)

    async def watch(plural: str, begun: asyncio.Event) -> None:
        address = f"{server}{PATHS[plural]}?watch=1&timeoutSeconds=3600"
        while True:
            async with session.get(address) as answer:
                # A CRD is served soon after it is accepted; its storage may still be making itself ready.
                if answer.status in {404, 429} and not begun.is_set():
                    await asyncio.sleep(0.2)
                    continue
                answer.raise_for_status()
                begun.set()
                async for line in answer.content:
                    event = json.loads(line)
                    if event["type"] == "ERROR" and event["object"].get("code") == 504:
                        # "Too large resource version": the server's cache is behind its own etcd, as happens
                        # on a busy machine, and only before the first object.
                        break
                    recorder.take(plural, event)

    flags = [asyncio.Event() for _ in PATHS]
    tasks = [asyncio.create_task(watch(plural, flag)) for plural, flag in zip(PATHS, flags, strict=True)]
    try:
        for flag in flags:
            await asyncio.wait_for(flag.wait(), 30)
        yield recorder
    finally:
        # Closed first: a watch that is cancelled leaves its connection half closed.
        await session.close()
        for task in tasks:
            task.cancel()
        for task in tasks:
            with suppress(asyncio.CancelledError, aiohttp.ClientError, RuntimeError):
                await task
