# SPDX-License-Identifier: Apache-2.0
"""Connections that say nothing, or take nothing, are closed; one address has not all of them."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, ClassVar

from uvicorn.protocols.http.h11_impl import H11Protocol

if TYPE_CHECKING:
    import asyncio

    from uvicorn.config import Config

REQUEST_SECONDS = 10.0
"""Longest time of a connection without a whole request, from its beginning or from its first byte on."""

SENDING_SECONDS = 60.0
"""Longest time in which a client takes nothing of an answer."""

_FULL = (
    b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 5\r\nContent-Type: application/json\r\n"
    b"Connection: close\r\nContent-Length: %d\r\n\r\n%s"
)
_SENTENCE = b'{"error":"this address has too many connections: close some, or ask again later","field":null}'


class Connection(H11Protocol):
    """One connection of a client: HTTP as uvicorn speaks it, with an end to waiting.

    Attributes:
        most: connections that one address may have.
        seconds: how long one may go without a whole request.
        sending_seconds: how long nothing of an answer may be taken.
    """

    most: ClassVar[int] = 128
    seconds: ClassVar[float] = REQUEST_SECONDS
    sending_seconds: ClassVar[float] = SENDING_SECONDS
    _open: ClassVar[Counter[str]]

    def __init__(self, config: Config, *arguments: Any, **more: Any) -> None:
        super().__init__(config, *arguments, **more)
        self._address = ""
        self._asking: asyncio.TimerHandle | None = None
        self._sending: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request; an address that has too many connections is told so."""
        super().connection_made(transport)
        self._address = self.client[0] if self.client else ""
        self._open[self._address] += 1
        if self._open[self._address] > self.most:
            transport.write(_FULL % (len(_SENTENCE), _SENTENCE))
            transport.close()
            return
        self._wait_for_request()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._open[self._address] -= 1
        if self._open[self._address] <= 0:
            del self._open[self._address]
        self._stop_asking()
        if self._sending is not None:
            self._sending.cancel()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take some bytes; what is no whole request by now has not for ever to become one."""
        super().data_received(data)
        if self.cycle is not None and not self.cycle.response_complete:
            self._stop_asking()
        elif self._asking is None and not self.transport.is_closing():
            self._wait_for_request()

    def on_response_complete(self) -> None:
        """Wait for the next request, whose first bytes may be here already."""
        super().on_response_complete()
        rest, _ = self.conn.trailing_data
        if rest and self._asking is None and (self.cycle is None or self.cycle.response_complete):
            self._wait_for_request()

    def pause_writing(self) -> None:
        """Begin to wait for a client that takes nothing."""
        super().pause_writing()
        if self._sending is None:
            self._sending = self.loop.call_later(self.sending_seconds, self.transport.abort)

    def resume_writing(self) -> None:
        """Go on with an answer."""
        super().resume_writing()
        if self._sending is not None:
            self._sending.cancel()
            self._sending = None

    def _wait_for_request(self) -> None:
        self._asking = self.loop.call_later(self.seconds, self.transport.abort)

    def _stop_asking(self) -> None:
        if self._asking is not None:
            self._asking.cancel()
            self._asking = None


def connections(most: int, seconds: float = REQUEST_SECONDS) -> type[Connection]:
    """Return the connections of one server, with a count of their own.

    Args:
        most: that one address may have.
        seconds: how long one may go without a whole request.
    """
    return type("Connection", (Connection,), {"most": most, "seconds": seconds, "_open": Counter()})
