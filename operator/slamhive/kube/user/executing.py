# SPDX-License-Identifier: Apache-2.0
"""Execution of a program in a pod: its streams, by the protocol v4.channel.k8s.io.

Messages are binary, and their first byte says what they carry: 0 standard input, 1 standard output,
2 standard error, 3 how the program ended, as a Status object.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, NoReturn

import aiohttp

from slamhive.kube.errors import ServerFault

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator

PROTOCOL = "v4.channel.k8s.io"
_IN, _OUT, _ERROR, _STATUS = range(4)
_PIECE = 1 << 14
_SILENCE_SECONDS = 120.0
_SAID_BYTES = 2000
_LONGEST_LINE = 4 << 20


class Session:
    """A program that runs in a pod.

    Args:
        socket: the connection to it.
        target: which pod, as NAMESPACE/NAME.
        silence: how long it may say nothing while something is waited for, s.
    """

    def __init__(
        self, socket: aiohttp.ClientWebSocketResponse, target: str, silence: float = _SILENCE_SECONDS
    ) -> None:
        self._socket = socket
        self._target = target
        self._silence = silence
        self._rest = bytearray()
        self._said = b""
        self._status = ""

    async def send(self, data: bytes) -> None:
        """Write to the program's standard input.

        Raises:
            ServerFault: the connection broke.
        """
        try:
            for place in range(0, len(data), _PIECE):
                await self._socket.send_bytes(bytes([_IN]) + data[place : place + _PIECE])
        except (aiohttp.ClientError, OSError) as error:
            self._break(str(error) or type(error).__name__)

    async def line(self) -> bytes:
        """Return the next line of the program's standard output.

        Raises:
            ServerFault: it ended, or the connection broke.
        """
        while (end := self._rest.find(b"\n")) < 0:
            if len(self._rest) > _LONGEST_LINE:
                self._break(f"a line is longer than {_LONGEST_LINE} bytes")
            self._rest += await self._more()
        line = bytes(self._rest[:end])
        del self._rest[: end + 1]
        return line

    async def take(self, count: int) -> AsyncGenerator[bytes, None]:
        """Yield the next bytes of the program's standard output, as they come.

        Raises:
            ServerFault: it ended, or the connection broke.
        """
        while count:
            data = bytes(self._rest[:count]) if self._rest else b""
            if data:
                del self._rest[: len(data)]
            else:
                more = await self._more()
                data = more[:count]
                self._rest += more[count:]
            count -= len(data)
            yield data

    async def _more(self) -> bytes:
        while True:
            try:
                message = await self._socket.receive(self._silence)
            except TimeoutError:
                self._break(f"silent for {self._silence:.0f} s")
            except (aiohttp.ClientError, OSError) as error:
                self._break(str(error) or type(error).__name__)
            if message.type is not aiohttp.WSMsgType.BINARY or not message.data:
                if message.type in {aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY}:
                    continue
                self._break(self._end())
            channel, data = message.data[0], message.data[1:]
            if channel == _OUT and data:
                return bytes(data)
            if channel == _ERROR:
                self._said = (self._said + data)[-_SAID_BYTES:]
            elif channel == _STATUS:
                self._status = data.decode(errors="replace")

    def _end(self) -> str:
        """Return how the program ended, as far as that is known."""
        said = self._said.decode(errors="replace").strip()
        try:
            status = json.loads(self._status)
            ended = "it ended" if status.get("status") == "Success" else str(status.get("message"))
        except (ValueError, AttributeError):
            ended = "the connection was closed"
        return f"{ended}: {said.splitlines()[-1]}" if said else ended

    def _break(self, why: str) -> NoReturn:
        raise ServerFault(f"pod {self._target}: {why}", verb="get", resource="pods/exec") from None
