# SPDX-License-Identifier: Apache-2.0
"""Security middleware of the dashboard.

Refuses methods that write, long addresses and unknown hosts, and adds the security headers to every answer.
"""

from __future__ import annotations

import asyncio
from ipaddress import ip_address
from typing import TYPE_CHECKING

from slamhive.dashboard.answering.encoding import encode_json
from slamhive.dashboard.problems import RETRY_SECONDS

if TYPE_CHECKING:
    from collections.abc import Collection

    from starlette.types import ASGIApp, Message, Receive, Scope, Send

MAX_QUERY = 16_384
MAX_PATH = 4096
HEAD = "slamhive.head"
"""In the scope of a GET that was asked as a HEAD: whose body nobody sees."""

CONTENT_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "font-src 'self'; connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; "
    "object-src 'none'; "
)

HEADERS: tuple[tuple[bytes, bytes], ...] = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"permissions-policy", b"camera=(), geolocation=(), microphone=(), payment=(), usb=()"),
)
_FRAMED = (b"content-security-policy", (CONTENT_POLICY + "frame-ancestors *").encode())
_ALONE = (
    (b"content-security-policy", (CONTENT_POLICY + "frame-ancestors 'none'").encode()),
    (b"x-frame-options", b"DENY"),
)
_METHODS = frozenset({"GET", "HEAD"})


class Shield:
    """Answers what must not pass, and adds the security headers to everything else.

    Args:
        app: what answers the others.
        hosts: names that the dashboard may be called by in the header Host, beside addresses in digits;
            None for any. It keeps web pages of others from reading a workstation's results by a name of
            theirs that leads here.
    """

    def __init__(self, app: ASGIApp, hosts: Collection[str] | None = None) -> None:
        self._app = app
        self._hosts = None if hosts is None else frozenset(hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        refused = self._refused(scope)
        head = scope["method"] == "HEAD"
        outer = _Outgoing(send, embedded=b"embed=1" in scope.get("query_string", b""), head=head)
        if refused is not None:
            await _refuse(outer, *refused)
            return
        try:
            await self._app({**scope, "method": "GET", HEAD: True} if head else scope, receive, outer)
        except asyncio.CancelledError:
            # The server is to end and waits no longer: no mistake, and another instance may answer.
            if outer.begun:
                raise
            await _refuse(outer, 503, "the dashboard is being stopped: ask again in a few seconds", None)

    def _refused(self, scope: Scope) -> tuple[int, str, str | None] | None:
        headers = dict(scope["headers"])
        if scope["method"] not in _METHODS:
            return 405, "the dashboard is read-only: it answers GET and HEAD only", None
        if headers.get(b"content-length", b"0") != b"0" or b"transfer-encoding" in headers:
            return 413, "the dashboard takes no request bodies", None
        if len(scope.get("query_string", b"")) > MAX_QUERY:
            return 414, f"the query string may have {MAX_QUERY:,} characters", None
        if len(scope.get("raw_path") or b"") > MAX_PATH:
            return 414, f"the path may have {MAX_PATH:,} characters", None
        host = headers.get(b"host", b"").decode("latin-1").lower()
        name = host.rpartition(":")[0] if not host.endswith("]") and ":" in host else host
        if self._hosts is not None and name not in self._hosts and not _is_address(name):
            return (
                421,
                "the dashboard doesn't answer to this host name; --allowed-host NAME allows it",
                "Host",
            )
        return None


def _is_address(name: str) -> bool:
    """Tell whether a name is an address in digits: no name server can lead one elsewhere."""
    try:
        ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return False
    return True


class _Outgoing:
    """Sends an answer on with the security headers, its body left out for HEAD.

    Attributes:
        begun: whether the answer has begun.
    """

    def __init__(self, send: Send, *, embedded: bool, head: bool) -> None:
        self._send = send
        self._headers = [*HEADERS, *((_FRAMED,) if embedded else _ALONE)]
        self._head = head
        self.begun = False

    async def __call__(self, message: Message) -> None:
        """Send one part of the answer."""
        if message["type"] == "http.response.start":
            self.begun = True
            message = {**message, "headers": [*message.get("headers", ()), *self._headers]}
        elif self._head and message["type"] == "http.response.body":
            message = {**message, "body": b""}
        await self._send(message)


async def _refuse(send: _Outgoing, status: int, sentence: str, field: str | None) -> None:
    content = encode_json({"error": sentence, "field": field})
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(content)).encode())]
    if status == 405:
        headers.append((b"allow", b"GET, HEAD"))
    if status == 503:
        headers.append((b"retry-after", str(RETRY_SECONDS).encode()))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": content})
