# SPDX-License-Identifier: Apache-2.0
"""Following objects of the Kubernetes API: list, then watch, and again from the list after any break.

The dashboard follows all that it shows by this, the operator the Jobs and pods of its runs: following.py.
"""

from __future__ import annotations

import asyncio
import random
import ssl
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

import aiohttp

from slamhive.kube.api.encoding import decode
from slamhive.kube.api.errors import ApiError, from_answer

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from slamhive.kube.api.client import Api
    from slamhive.kube.api.kinds import Kind, Object


WATCH_SECONDS = 240
"""Duration of one watch; the server would end it after 30 to 60 min."""

_SILENCE_SECONDS = 90.0  # longer than the minute between the server's bookmarks: such a watch is dead
_FIRST_PAUSE = 0.5
_LONGEST_PAUSE = 20.0
_MAX_LINE = 8 * 2**20
_GONE = 410


def open_session() -> aiohttp.ClientSession:
    """Return the session of all watches; it must be closed before what follows is cancelled.

    A watch that is cancelled says goodbye to the server first, and nothing waits for the answer; a session
    that is closed ends its connections at once.
    """
    timeout = aiohttp.ClientTimeout(total=None, connect=10, sock_read=_SILENCE_SECONDS)
    connector = aiohttp.TCPConnector(limit=0)
    # By proxies that the environment names, as all other calls go.
    return aiohttp.ClientSession(timeout=timeout, read_bufsize=_MAX_LINE, connector=connector, trust_env=True)


class Follower:
    """Follows the objects of one kind in one namespace.

    Args:
        api: the API.
        session: by which it watches; following ends when this is closed.
        kind: the kind.
        namespace: where.
        reset: called with all objects after each list, and the version of that.
        change: called with (ADDED, MODIFIED or DELETED, the object).
        trouble: called with a sentence when the API does not answer, with None when it does again.
        narrow: applied to each object of a list as it comes, so that it is never held whole.
        narrow_change: applied to each object that has changed; default: the same.
        labels: label selector, applied by the server: what it leaves out never comes here.
    """

    def __init__(
        self,
        api: Api,
        session: aiohttp.ClientSession,
        kind: Kind,
        namespace: str,
        *,
        reset: Callable[[list[Any], str], None],
        change: Callable[[str, Any], None],
        trouble: Callable[[str | None], None],
        narrow: Callable[[Object], Any],
        narrow_change: Callable[[Object], Any] | None = None,
        labels: str | None = None,
    ) -> None:
        self._api = api
        self._session = session
        self._kind = kind
        self._namespace = namespace
        self._reset = reset
        self._change = change
        self._trouble = trouble
        self._narrow = narrow
        self._narrow_change = narrow_change or narrow
        self._labels = labels

    async def run(self) -> None:
        """Follow until the session is closed."""
        pause = _FIRST_PAUSE
        while not self._session.closed:
            try:
                version = await self._list()
                self._trouble(None)
                pause = _FIRST_PAUSE
                await self._watch(version)
            except (ApiError, aiohttp.ClientError, OSError, TimeoutError, ValueError) as error:
                said = str(error) or type(error).__name__
                self._trouble(f"the Kubernetes API does not answer for {self._kind.resource}: {said}")
            await asyncio.sleep(pause * (0.5 + 0.5 * random.random()))  # noqa: S311 - no secret
            pause = min(2 * pause, _LONGEST_PAUSE)

    async def _list(self) -> str:
        items, version = await self._api.list(
            self._kind, self._namespace, labels=self._labels, narrow=self._narrow
        )
        self._reset(items, version)
        return version

    async def _watch(self, version: str) -> None:
        while version:
            newest = ""
            async for event in self._events(version):
                obj = event.get("object") or {}
                if event.get("type") == "ERROR":
                    if obj.get("code") == _GONE:
                        return
                    raise ValueError(str(obj.get("message") or "the watch broke off"))
                newest = str(obj.get("metadata", {}).get("resourceVersion") or newest)
                if event.get("type") in {"ADDED", "MODIFIED", "DELETED"}:
                    self._change(str(event["type"]), self._narrow_change(obj))
            version = newest or version

    async def _events(self, version: str) -> AsyncIterator[Object]:
        access = await self._api.access()
        query = {
            "watch": "true",
            "resourceVersion": version,
            "allowWatchBookmarks": "true",
            "timeoutSeconds": str(WATCH_SECONDS),
        } | ({"labelSelector": self._labels} if self._labels else {})
        address = f"{access.server}{self._kind.path(self._namespace)}?{urlencode(query)}"
        headers = {"Accept": "application/json", "User-Agent": "slamhive"}
        if access.token:
            headers["Authorization"] = f"Bearer {access.token}"
        context = ssl.create_default_context(cafile=access.ca_path)
        if access.insecure:
            context.check_hostname = False
            context.verify_mode = ssl.CERT_NONE
        if access.certificate_path:
            context.load_cert_chain(access.certificate_path, access.private_key_path)
        async with self._session.get(address, headers=headers, ssl=context, proxy=access.proxy_url) as answer:
            if answer.status == _GONE:
                return
            if answer.status >= 400:
                what = ("watch", self._kind.resource, self._namespace)
                raise from_answer(answer.status, await answer.read(), answer.headers, *what)
            async for line in answer.content:
                if line.strip():
                    yield decode(line)
