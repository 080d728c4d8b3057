# SPDX-License-Identifier: Apache-2.0
"""What every request passes through first: nothing is written, nothing is too long, nothing foreign runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.dashboard.encoding import encode_json

if TYPE_CHECKING:
    from collections.abc import Collection

    from starlette.types import ASGIApp, Message, Receive, Scope, Send

MAX_QUERY = 16_384
MAX_PATH = 4096
_CONTENT = (
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
_FRAMED = (b"content-security-policy", (_CONTENT + "frame-ancestors *").encode())
_ALONE = (
    (b"content-security-policy", (_CONTENT + "frame-ancestors 'none'").encode()),
    (b"x-frame-options", b"DENY"),
)
_METHODS = frozenset({"GET", "HEAD"})


class Shield:
    """Answers what must not pass, and adds the security headers to everything else.

    Args:
        app: what answers the others.
        hosts: names that the dashboard may be called by in the header Host; None for any. It keeps web
            pages of others from reading a workstation's results by a name of theirs that leads here.
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
        await self._app({**scope, "method": "GET"} if head else scope, receive, outer)

    def _refused(self, scope: Scope) -> tuple[int, str, str | None] | None:
        headers = dict(scope["headers"])
        if scope["method"] not in _METHODS:
            return 405, "the dashboard only shows: GET and HEAD are all it answers", None
        if headers.get(b"content-length", b"0") != b"0" or b"transfer-encoding" in headers:
            return 413, "the dashboard takes no request bodies", None
        if len(scope.get("query_string", b"")) > MAX_QUERY:
            return 414, f"the query string may have {MAX_QUERY:,} characters", None
        if len(scope.get("raw_path") or b"") > MAX_PATH:
            return 414, f"the path may have {MAX_PATH:,} characters", None
        host = headers.get(b"host", b"").decode("latin-1").lower()
        name = host.rpartition(":")[0] if not host.endswith("]") and ":" in host else host
        if self._hosts is not None and name not in self._hosts:
            return 421, "the dashboard is not called by this name here", "Host"
        return None


class _Outgoing:
    """Sends an answer on with the security headers, its body left out for HEAD."""

    def __init__(self, send: Send, *, embedded: bool, head: bool) -> None:
        self._send = send
        self._headers = [*HEADERS, *((_FRAMED,) if embedded else _ALONE)]
        self._head = head

    async def __call__(self, message: Message) -> None:
        """Send one part of the answer."""
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *self._headers]}
        elif self._head and message["type"] == "http.response.body":
            message = {**message, "body": b""}
        await self._send(message)


async def _refuse(send: _Outgoing, status: int, sentence: str, field: str | None) -> None:
    content = encode_json({"error": sentence, "field": field})
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(content)).encode())]
    if status == 405:
        headers.append((b"allow", b"GET, HEAD"))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": content})
