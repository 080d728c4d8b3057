# SPDX-License-Identifier: Apache-2.0
"""Server of the application: its sockets, uvicorn's settings, and health on a port of its own.

``/healthz`` and ``/readyz`` have a port that no crowd of visitors can fill.
"""

from __future__ import annotations

import asyncio
import socket
from contextlib import suppress
from typing import TYPE_CHECKING

import uvicorn

from slamhive.dashboard.server.app import create_app
from slamhive.dashboard.server.connections import connections
from slamhive.model.errors import InputError, SlamHiveError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Collection

    from slamhive.dashboard.sources.archived import Source

_SECONDS = 5.0
_LONGEST_LINE = 4096
_MOST = 64
_WORDS = {200: "OK", 404: "Not Found", 503: "Service Unavailable"}

CONNECTIONS = 512
CONNECTIONS_PER_ADDRESS = 128
_LOCAL = frozenset({"localhost", "127.0.0.1", "[::1]", "::1"})


class Health:
    """Answers the kubelet: one request a connection.

    Args:
        ready: raises what keeps the dashboard from being ready.
    """

    def __init__(self, ready: Callable[[], Awaitable[object]]) -> None:
        self._ready = ready
        self._connections = 0
        self._server: asyncio.Server | None = None

    async def start(self, listening: socket.socket) -> None:
        """Begin to answer."""
        self._server = await asyncio.start_server(self._answer, sock=listening, limit=_LONGEST_LINE)

    def stop(self) -> None:
        """Answer nobody any more."""
        if self._server is not None:
            self._server.close()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._connections += 1
        try:
            if self._connections <= _MOST:
                async with asyncio.timeout(_SECONDS):
                    line = await reader.readline()
                    while (await reader.readline()).strip():
                        pass
                    status, text = await self._state(line.split(b" ")[1:2])
                    writer.write(_message(status, f"{text}\n".encode()))
                    await writer.drain()
        except (TimeoutError, OSError, ValueError):
            pass
        finally:
            self._connections -= 1
            with suppress(OSError):
                writer.close()

    async def _state(self, path: list[bytes]) -> tuple[int, str]:
        if path == [b"/healthz"]:
            return 200, "ok"
        if path != [b"/readyz"]:
            return 404, "there are /healthz and /readyz here"
        try:
            await self._ready()
        except SlamHiveError as error:
            return 503, str(error)
        return 200, "ok"


def _message(status: int, content: bytes) -> bytes:
    lines = (
        f"HTTP/1.1 {status} {_WORDS[status]}",
        "Content-Type: text/plain; charset=utf-8",
        "Connection: close",
        f"Content-Length: {len(content)}",
    )
    return "\r\n".join([*lines, "", ""]).encode() + content


def listen(host: str, port: int, argument: str = "port") -> socket.socket:
    """Return a socket that listens.

    Args:
        host: address.
        port: port; 0 for a free one.
        argument: what the port was given by.

    Raises:
        InputError: the address is taken or not ours.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    taken = socket.socket(family, socket.SOCK_STREAM)
    try:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind((host, port))
        taken.listen(CONNECTIONS)
    except (OSError, OverflowError) as error:
        taken.close()
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot listen on {host} port {port}: {reason}", argument) from None
    return taken


def lets_others_in(host: str) -> bool:
    """Tell whether other machines reach what listens on an address."""
    return host not in _LOCAL and not host.startswith("127.")


def allowed_hosts(host: str, others: Collection[str] = ()) -> frozenset[str]:
    """Return the names that a workstation's dashboard may be called by, beside addresses in digits.

    Args:
        host: where it listens; where others reach it, the machine's own names lead to it too.
        others: names that were allowed besides.
    """
    own = {socket.gethostname(), socket.getfqdn()} if lets_others_in(host) else set()
    return _LOCAL | {name.lower() for name in (host, *own, *others)}


def serve(
    source: Source,
    listening: socket.socket,
    *,
    hosts: Collection[str] | None,
    health: socket.socket | None = None,
    connections_per_address: int = CONNECTIONS_PER_ADDRESS,
    announce: Callable[[], None] | None = None,
) -> None:
    """Answer requests until a signal comes.

    Args:
        source: where the data come from.
        listening: the socket.
        hosts: names that it may be called by; None for any.
        health: a socket that answers /healthz and /readyz alone; None for none.
        connections_per_address: how many one address may have; open pages hold half of them at most.
        announce: called when it answers.
    """
    app = create_app(source, hosts=hosts, listeners=connections_per_address // 2)
    config = uvicorn.Config(
        app,
        http=connections(connections_per_address),
        log_level="warning",
        access_log=False,
        limit_concurrency=CONNECTIONS,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=2,
        server_header=False,
        date_header=True,
        lifespan="on",
        ws="none",
        proxy_headers=False,
    )
    if announce is not None:
        announce()
    _Server(config, Health(app.state.service.fresh), health).run(sockets=[listening])


class _Server(uvicorn.Server):
    """Answers on two ports in one loop: while that turns, it is alive."""

    def __init__(self, config: uvicorn.Config, health: Health, listening: socket.socket | None) -> None:
        super().__init__(config)
        self._health = health
        self._listening = listening

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self._listening is not None:
            await self._health.start(self._listening)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._health.stop()
        await super().shutdown(sockets)
