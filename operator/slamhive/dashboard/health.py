# SPDX-License-Identifier: Apache-2.0
"""``/healthz`` and ``/readyz`` on a port of their own, which no crowd of visitors can fill."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.model.errors import SlamHiveError

if TYPE_CHECKING:
    import socket
    from collections.abc import Awaitable, Callable

_SECONDS = 5.0
_LONGEST_LINE = 4096
_MOST = 64
_WORDS = {200: "OK", 404: "Not Found", 503: "Service Unavailable"}


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
