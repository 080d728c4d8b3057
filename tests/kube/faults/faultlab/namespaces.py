# SPDX-License-Identifier: Apache-2.0
"""Namespaces with volumes, made when they are needed and used again once they are empty."""

from __future__ import annotations

import asyncio
import itertools
import os
from contextlib import suppress
from typing import TYPE_CHECKING

from testcluster.lab import bound_volumes, until, volumes

from slamhive.kube.api.errors import ApiError
from slamhive.kube.api.kinds import OUR_KINDS, Kind, Object
from slamhive.kube.api.transport import Request

if TYPE_CHECKING:
    from faultlab.recorder import Recorder

    from slamhive.kube.api.client import Api


SECONDS = 120.0
_NUMBERS = itertools.count()


class Namespaces:
    """The namespaces of one test.

    Args:
        admin: the administrator's API.
        seen: what there is.
    """

    def __init__(self, admin: Api, seen: Recorder) -> None:
        self._admin = admin
        self._seen = seen
        self._all: list[str] = []
        self._free: list[str] = []
        self._emptying: set[asyncio.Task[None]] = set()

    async def take(self) -> str:
        """Return an empty namespace."""
        if self._free:
            return self._free.pop()
        name = f"faults-{os.getpid()}-{next(_NUMBERS)}"
        self._all.append(name)
        await self._create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}})
        await self._provide_volumes(name)
        return name

    def give_back(self, name: str) -> None:
        """Have a namespace emptied and used again."""
        task = asyncio.create_task(self._empty(name))
        self._emptying.add(task)
        task.add_done_callback(self._emptying.discard)

    async def clear(self) -> None:
        """Have all namespaces and volumes deleted; nothing waits for that."""
        for task in [*self._emptying]:
            task.cancel()
        gone = [f"namespaces/{name}" for name in self._all]
        gone += [
            f"persistentvolumes/{body['metadata']['name']}"
            for name in self._all
            for body in volumes(name)
            if "namespace" not in body["metadata"]
        ]
        for path in gone:
            await self._admin.call(Request("delete", "namespaces", path, "DELETE", f"/api/v1/{path}"))

    async def _empty(self, name: str) -> None:
        with suppress(ApiError, TimeoutError):
            for kind in (*OUR_KINDS, Kind.JOB):
                options = {"kind": "DeleteOptions", "apiVersion": "v1", "propagationPolicy": "Background"}
                await self._admin.call(
                    Request("delete", kind.resource, name, "DELETE", kind.path(name), body=options)
                )
            async with asyncio.timeout(SECONDS):
                await until(lambda: self._seen.is_empty(name), f"{name} to be empty", 2 * SECONDS)
            self._seen.forget(name)
            self._free.append(name)

    async def _provide_volumes(self, namespace: str) -> None:
        """Make volumes and claims on them."""
        disks, claims = bound_volumes(namespace)
        await asyncio.gather(*map(self._create, disks))
        names = {body["metadata"]["name"] for body in disks}
        await until(lambda: names <= self._seen.available(), "volumes", SECONDS)
        await asyncio.gather(*map(self._create, claims))

    async def _create(self, body: Object) -> None:
        """Create an object of the core group."""
        plural, meta = f"{body['kind'].lower()}s", body["metadata"]
        where = f"/namespaces/{meta['namespace']}" if "namespace" in meta else ""
        await self._admin.json(
            Request("create", plural, meta["name"], "POST", f"/api/v1{where}/{plural}", body=body)
        )
