# SPDX-License-Identifier: Apache-2.0
"""A proxy between an operator and the API server, with real connections, that misbehaves as asked."""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import aiohttp
import yaml
from aiohttp import web
from faultlab.recorder import session_for

if TYPE_CHECKING:
    from collections.abc import AsyncIterator
    from pathlib import Path

    from slamhive.kube.api.client import Api

_REASONS = {
    403: "Forbidden",
    422: "Invalid",
    409: "Conflict",
    410: "Expired",
    429: "TooManyRequests",
    500: "InternalError",
}
_DROPPED = {"Host", "Content-Length", "Accept-Encoding"}


@dataclass(frozen=True)
class Trouble:
    """Faults that the proxy causes in an operator's calls and watches.

    Attributes:
        status: what is answered in the place of the truth.
        taken: whether creates are answered that the name is taken.
        refused_jobs: what creating a Job is answered, each time.
        reset: whether the connection breaks, in the middle of the answer if there is one.
        executed: whether the call is carried out all the same.
        one_page: whether lists come in pages of one object, and the first second page is gone.
        cut_after: number of events after which each watch breaks.
        expired_after: number of events after which each watch says that its version is gone.
        silent_after: number of events after which a watch says nothing more.
        late_seconds: by how much watches lag behind.
    """

    status: int | None = None
    taken: bool = False
    refused_jobs: int | None = None
    reset: bool = False
    executed: bool = False
    one_page: bool = False
    cut_after: int | None = None
    expired_after: int | None = None
    silent_after: int | None = None
    late_seconds: float = 0.0

    @property
    def hits_calls(self) -> bool:
        """True if single calls go wrong."""
        return self.status is not None or self.reset or self.taken


@dataclass
class Proxy:
    """Hands over calls; of reads of the same address the first goes wrong, of writes each second one.

    Attributes:
        hits: what went wrong, by method.
    """

    server: str
    session: aiohttp.ClientSession
    trouble: Trouble
    hits: Counter[str] = field(default_factory=Counter)
    _calls: Counter[tuple[str, str]] = field(default_factory=Counter)
    _watches: dict[int, web.Request] = field(default_factory=dict)

    def cut(self) -> int:
        """Break all watches there are now; returns their number."""
        watches = [*self._watches.values()]
        for request in watches:
            _abort(request)
        return len(watches)

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Answer a request; where the server is away, by a broken connection."""
        try:
            return await self._answer(request)
        except (aiohttp.ClientConnectionError, aiohttp.ClientPayloadError):  # before or within its answer
            _abort(request)
            return _status(500)

    async def _answer(self, request: web.Request) -> web.StreamResponse:
        if request.query.get("watch") == "true":
            self._watches[id(request)] = request
            try:
                return await self._watch(request)
            finally:
                del self._watches[id(request)]
        is_list = request.method == "GET" and request.query.keys() & {"limit", "labelSelector"}
        discovery = request.path.count("/") < 5
        ours = request.headers.get("User-Agent") == "slamhive"  # kopf ends when a page is gone
        if self.trouble.one_page and request.query.get("limit") and ours:
            return await self._page(request)
        if self.trouble.refused_jobs and request.method == "POST" and request.path.endswith("/jobs"):
            self.hits["POST"] += 1
            return _status(self.trouble.refused_jobs)
        place = (request.method, request.path)
        self._calls[place] += 1
        is_due = self._calls[place] == 1 if request.method == "GET" else self._calls[place] % 2 == 1
        if not (self.trouble.hits_calls and is_due) or is_list or discovery:
            return await self._hand_over(request)
        self.hits[request.method] += 1
        return await self._go_wrong(request)

    async def _go_wrong(self, request: web.Request) -> web.StreamResponse:
        trouble = self.trouble
        if trouble.taken and request.method == "POST":
            return _status(409, "AlreadyExists")
        if trouble.executed:
            answer = await self._hand_over(request)
            if trouble.reset:
                half = web.StreamResponse(headers={"Content-Length": "100000"})
                await half.prepare(request)
                await half.write((answer.body or b"")[:50] if isinstance(answer.body, bytes) else b"{")
                _abort(request)
                return half
        if trouble.reset:
            _abort(request)
        return _status(trouble.status or 409)

    async def _page(self, request: web.Request) -> web.StreamResponse:
        following = request.query.get("continue", "")
        if following:
            self._calls[request.path, "pages"] += 1
            if self._calls[request.path, "pages"] == 1:
                self.hits["GET"] += 1
                return _status(410)
        return await self._hand_over(request, limit="1")

    async def _hand_over(self, request: web.Request, **query: str) -> web.Response:
        async with self.session.request(
            request.method,
            self.server + request.path,
            params={**request.query, **query},
            data=await request.read() or None,
            headers=_passed(request),
        ) as answer:
            headers = {"Content-Type": answer.headers.get("Content-Type", "application/json")}
            return web.Response(status=answer.status, body=await answer.read(), headers=headers)

    async def _watch(self, request: web.Request) -> web.StreamResponse:
        trouble, events = self.trouble, 0
        async with self.session.get(
            self.server + request.path, params=request.query, headers=_passed(request)
        ) as answer:
            stream = web.StreamResponse(status=answer.status, headers={"Content-Type": "application/json"})
            await stream.prepare(request)
            async for line in answer.content:
                if trouble.silent_after is not None and events >= trouble.silent_after:
                    self.hits["WATCH"] += 1
                    continue
                if trouble.late_seconds:
                    self.hits["WATCH"] += 1
                    await asyncio.sleep(trouble.late_seconds)
                await stream.write(line)
                events += 1
                if events == trouble.cut_after:
                    self.hits["WATCH"] += 1
                    await stream.write(b'{"type": "MODIFIED", "object": {"meta')
                    _abort(request)
                    return stream
                if events == trouble.expired_after:
                    self.hits["WATCH"] += 1
                    error = {"type": "ERROR", "object": _body(410, "Expired")}
                    await stream.write(json.dumps(error).encode() + b"\n")
                    return stream
        return stream


@asynccontextmanager
async def proxied(api: Api, trouble: Trouble, kubeconfig: Path) -> AsyncIterator[Proxy]:
    """Run a proxy, and write the kubeconfig that leads to it."""
    server, session = await session_for(api)
    proxy = Proxy(server, session, trouble)
    application = web.Application(client_max_size=1 << 24)
    application.router.add_route("*", "/{path:.*}", proxy.handle)
    runner = web.AppRunner(application, shutdown_timeout=0.1, handler_cancellation=True)
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", 0)
    await site.start()
    port = runner.addresses[0][1]
    _write(kubeconfig, f"http://127.0.0.1:{port}")
    try:
        yield proxy
    finally:
        await runner.cleanup()
        await session.close()


def _write(kubeconfig: Path, server: str) -> None:
    content = {
        "apiVersion": "v1",
        "kind": "Config",
        "clusters": [{"name": "proxy", "cluster": {"server": server}}],
        "users": [{"name": "nobody", "user": {"token": "none"}}],
        "contexts": [{"name": "proxy", "context": {"cluster": "proxy", "user": "nobody"}}],
        "current-context": "proxy",
    }
    kubeconfig.write_text(yaml.safe_dump(content))


def _passed(request: web.Request) -> dict[str, str]:
    dropped = {*_DROPPED, "Authorization"}
    return {name: value for name, value in request.headers.items() if name not in dropped}


def _body(status: int, reason: str) -> dict[str, object]:
    details = {"retryAfterSeconds": 1} if status == 429 else {}
    message = f"played: {reason}"
    base = {"kind": "Status", "apiVersion": "v1", "status": "Failure", "code": status}
    return base | {"reason": reason, "message": message, "details": details}


def _status(status: int, reason: str | None = None) -> web.Response:
    headers = {"Retry-After": "1"} if status == 429 else {}
    return web.json_response(_body(status, reason or _REASONS[status]), status=status, headers=headers)


def _abort(request: web.Request) -> None:
    if request.transport is not None:
        request.transport.abort()
