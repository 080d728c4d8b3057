# SPDX-License-Identifier: Apache-2.0
"""Answers of https servers: a file from a byte on, pages in between followed, anything else refused.

Used by `fetching`, which writes what comes, and by `remotezip`, which looks into an archive elsewhere.
Proxies are those of the environment (`https_proxy`, `no_proxy`), as urllib reads them. Trusted are the
system's authorities, or those of ``$SSL_CERT_FILE``, and those of `CERTIFICATES` beside them.
"""

from __future__ import annotations

import errno
import os
import re
import socket
import ssl
import time
import urllib.error
import urllib.request
from contextlib import suppress
from dataclasses import dataclass
from html.parser import HTMLParser
from http.client import HTTPException
from typing import IO, Any, Self
from urllib.parse import urlencode, urljoin, urlsplit

from slamhive.contract.lines import printable
from slamhive.model.errors import DataError, InputError, SystemFault

TIMEOUT_SECONDS = 60
"""Seconds without a byte after which a connection is given up."""
STALL_SECONDS = TIMEOUT_SECONDS
"""Seconds in which at least `STALL_BYTES` must come: a server that sends a byte now and then is no use."""
STALL_BYTES = 1 << 20
CERTIFICATES = "SLAMHIVE_CERTIFICATES"
"""Variable with a file of further authorities' certificates, such as that of a lab's own mirror."""
PAGE_BYTES = 1 << 20
_RANGE = re.compile(r"bytes (\d+)-(\d+)/(\d+|\*)", re.ASCII)
_PAGE = re.compile(rb"(?:\xef\xbb\xbf)?\s*<(?:!doctype\s+html|html)\b", re.IGNORECASE)
_PACKINGS = {"gzip", "x-gzip", "deflate", "br", "zstd", "compress"}
_AGAIN = {408, 425, 429, 500, 502, 503, 504}
"""Statuses after which another try may succeed."""


class Interrupted(SystemFault):
    """A server that is away, overloaded, or ends in the middle: the same address is worth another try."""

    reason = "Interrupted"


class WrongPartError(Interrupted):
    """A server that sends other bytes of a file than those that it was asked for."""


class OfflineError(SystemFault):
    """A server that nothing leads to: there is no network, or no server of that name."""

    reason = "Offline"


@dataclass(frozen=True)
class Validators:
    """Marks by which a server knows a state of a file.

    Attributes:
        etag: Its tag; one that begins with ``W/`` is weak: it says nothing of single bytes.
        modified: Time of its last change, as the server writes it.
    """

    etag: str | None = None
    modified: str | None = None

    @property
    def condition(self) -> str | None:
        """Return the mark for If-Range, by which a server goes on with no other file (RFC 9110, 13.1.5)."""
        mark = self.modified if self.etag is None else self.etag
        return mark if mark and mark.isascii() and mark.isprintable() and not mark.startswith("W/") else None

    def differ(self, others: Validators) -> bool | None:
        """Tell whether two answers are of different files; None where they have no mark in common."""
        pairs = ((self.etag, others.etag), (self.modified, others.modified))
        known = [mine != theirs for mine, theirs in pairs if mine and theirs]
        return any(known) if known else None


class _AnswerPace:
    """The pace that is asked of an answer from its head to its end; content counts, and nothing else."""

    def __init__(self) -> None:
        self._came, self._since = 0, time.monotonic()

    def count(self, size: int) -> None:
        """Take in that so many bytes of content came."""
        self._came += size
        if self._came >= STALL_BYTES:
            self._came, self._since = 0, time.monotonic()

    def require(self) -> None:
        """Check that enough came.

        Raises:
            TimeoutError: It didn't.
        """
        if time.monotonic() - self._since > STALL_SECONDS:
            raise TimeoutError(f"less than {STALL_BYTES / (1 << 20):g} MiB came in {STALL_SECONDS} s")

    def socket(self) -> type[ssl.SSLSocket]:
        """Return sockets that look at it before each read.

        The library reads on by itself in heads, between chunks and behind them, for as long as bytes come.
        """
        require = self.require

        class PacedSocket(ssl.SSLSocket):
            def recv_into(self, *args: Any, **options: Any) -> int:
                require()
                return super().recv_into(*args, **options)

        return PacedSocket


@dataclass
class HttpsResponse:
    """Response of an https server to a request for a file; a context manager that closes it.

    Attributes:
        start: Number of the first byte that comes; 0 where the server sends everything anew.
        total: Size of the whole file, bytes; None where the server doesn't say.
        validators: What the server knows this state of the file by.
        by_ranges: Whether the server sends parts of the file.
        tells_end: Whether the answer says where it ends, by a length or in chunks: else a cut looks like it.
    """

    start: int
    total: int | None
    validators: Validators
    by_ranges: bool
    tells_end: bool
    _response: Any
    _pace: _AnswerPace

    @property
    def packing(self) -> str | None:
        """Return the packing of the file that the server names, though it was asked for none."""
        packing = self._response.headers.get("Content-Encoding", "").strip().lower()
        # Servers name so what is in a tar.gz as well.
        is_own = urlsplit(self._response.url).path.lower().endswith(("gz", "zst", ".br"))
        return packing if packing in _PACKINGS and not is_own else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._response.close()

    def read(self, size: int) -> bytes:
        """Return the next bytes, at most so many; none at the end.

        Raises:
            Interrupted: The connection is lost, or hardly anything comes.
        """
        try:
            data: bytes = self._response.read1(size)
        except (OSError, HTTPException) as error:
            raise Interrupted(_shown(str(error))) from None
        self._pace.count(len(data))
        return data

    def read_page(self) -> str:
        """Return the text of a page, at most 1 MiB of it, in however many records it comes.

        Raises:
            Interrupted: The connection is lost.
        """
        page = b""
        while len(page) < PAGE_BYTES and (block := self.read(PAGE_BYTES - len(page))):
            page += block
        return page.decode("utf-8", "replace")


def _shown(text: str) -> str:
    """Return words of a server as sentences show them, at most 200 letters."""
    return printable(text[:200])


def open_url(url: str, start: int = 0, end: int | None = None, condition: str | None = None) -> HttpsResponse:
    """Ask for a file.

    Args:
        url: Its https address. A page of Google Drive that asks for a confirmation is confirmed.
        start: The first byte wanted.
        end: The byte after the last one wanted; None for the rest.
        condition: A mark of an earlier answer: if the file is another one now, it comes from 0 on.

    Raises:
        DataError: The address leads away from https, or to a page instead of a file.
        InputError: The file of `CERTIFICATES` can't be read.
        Interrupted: Another try may succeed.
        OfflineError: No server is reached: there is no network, or no such server.
        SystemFault: The server has no such file, or refuses it.
    """
    answer = _open(url, start, end, condition)
    if not _is_page(answer, url):
        return answer
    with answer:
        page = _HtmlPage(answer.read_page())
    target = page.confirmation(url)
    if target is None:
        raise _leads_to_page(url, page)
    answer = _open(target, start, end, condition)
    if _is_page(answer, url):
        with answer:
            raise SystemFault(f"{url}: answers a page again after its confirmation; try again later")
    return answer


def require_no_page(url: str, beginning: bytes) -> None:
    """Check that what came isn't a page that the server gave out for a file.

    Args:
        url: The address that it came from.
        beginning: Its first bytes.

    Raises:
        DataError: It is one.
    """
    if _PAGE.match(beginning) and not _is_address_of_page(url):
        raise _leads_to_page(url, _HtmlPage(beginning.decode(errors="replace")))


def _leads_to_page(url: str, page: _HtmlPage) -> DataError:
    title = f" {page.title!r}," if page.title else ""
    return DataError(
        f"{url} leads to a page,{title} not to a file: it may want a login or a click; open it in a browser"
    )


class _HttpsAlone(urllib.request.HTTPRedirectHandler):
    """Follows no redirect to where anyone on the way could read along or answer."""

    def redirect_request(  # noqa: PLR0917 - the signature is urllib's
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str, headers: Any, newurl: str
    ) -> urllib.request.Request | None:
        _require_https(newurl, req.full_url)
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _require_https(target: str, source: str) -> None:
    if not target.lower().startswith("https://"):
        raise DataError(f"{source} leads to {_shown(target)}, expected an https:// address")


def trusted() -> ssl.SSLContext:
    """Return the certificates to trust.

    Raises:
        InputError: The file of `CERTIFICATES` can't be read.
    """
    context = ssl.create_default_context()
    path = os.environ.get(CERTIFICATES)
    if path:
        try:
            context.load_verify_locations(cafile=path)
        except OSError as error:
            raise InputError(
                f"{CERTIFICATES}: {path}: expected a file of certificates (PEM): {error.strerror or error}"
            ) from None
    return context


def _open(url: str, start: int, end: int | None, condition: str | None) -> HttpsResponse:
    _require_https(url, "the address")
    # A compressed answer would have other bytes than the file.
    request = urllib.request.Request(url, headers={"Accept-Encoding": "identity", "User-Agent": "slamhive"})  # noqa: S310
    if start or end is not None:
        request.add_header("Range", f"bytes={start}-{'' if end is None else end - 1}")
        if condition is not None:
            request.add_header("If-Range", condition)
    pace, context = _AnswerPace(), trusted()
    context.sslsocket_class = pace.socket()
    opener = urllib.request.build_opener(_HttpsAlone, urllib.request.HTTPSHandler(context=context))
    try:
        response = opener.open(request, timeout=TIMEOUT_SECONDS)
    except urllib.error.HTTPError as error:
        error.close()
        if error.code == 416 and start:
            return _open(url, 0, None, None)
        kind = Interrupted if error.code in _AGAIN else SystemFault
        raise kind(_shown(f"HTTP Error {error.code}: {error.reason}")) from None
    except (OSError, HTTPException) as error:
        reason = getattr(error, "reason", error)
        problem = _shown(str(reason))
        if isinstance(reason, socket.gaierror):
            raise OfflineError(
                f"no server {urlsplit(url).hostname} is known here, or no network ({problem})"
            ) from None
        if isinstance(reason, OSError) and reason.errno in {errno.ENETUNREACH, errno.ENETDOWN}:
            raise OfflineError(f"no network ({problem})") from None
        raise Interrupted(problem) from None
    except ValueError as error:  # of a redirect
        raise SystemFault(_shown(f"leads to an address that can't be: {error}")) from None
    return _answer(response, start, pace)


def _answer(response: Any, start: int, pace: _AnswerPace) -> HttpsResponse:
    headers = response.headers
    validators = Validators(headers.get("ETag"), headers.get("Last-Modified"))
    length = headers.get("Content-Length")
    if response.status == 206:
        match = _RANGE.fullmatch(headers.get("Content-Range", ""))
        if match is None or _number(match[1]) != start:
            response.close()
            found = headers.get("Content-Range")
            said = f"others ({_shown(found)})" if found else "some without saying which"
            raise WrongPartError(f"the server was asked for the bytes from {start:,} on, and sent {said}")
        total = None if match[3] == "*" else _number(match[3])
        tells_end = total is not None
        return HttpsResponse(
            start, total, validators, by_ranges=True, tells_end=tells_end, _response=response, _pace=pace
        )
    if response.status not in {200, 203}:
        response.close()
        raise Interrupted(_shown(f"HTTP status {response.status}, no file: {response.reason}"))
    total = _number(length) if length and length.isdecimal() else None
    by_ranges = headers.get("Accept-Ranges", "").strip().lower() == "bytes"
    tells_end = total is not None or response.chunked
    return HttpsResponse(0, total, validators, by_ranges, tells_end, response, pace)


def _number(digits: str) -> int:
    return int(digits[:20])  # more than any file has, also where it is cut


def _is_page(answer: HttpsResponse, url: str) -> bool:
    kind = answer._response.headers.get_content_type()  # noqa: SLF001 - of this module
    return kind == "text/html" and not _is_address_of_page(url)


def _is_address_of_page(url: str) -> bool:
    return urlsplit(url).path.endswith((".html", ".htm"))


class _HtmlPage(HTMLParser):
    """A page in the place of a file: its title, and the form by which Google Drive has one confirm."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.title = ""
        self._in_title = False
        self._action: str | None = None
        self._fields: list[tuple[str, str]] = []
        with suppress(AssertionError):  # of what is no HTML
            self.feed(text)
        self.title = _shown(" ".join(self.title.split()))[:100]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = {name: value or "" for name, value in attrs}
        self._in_title = tag == "title"
        if tag == "form" and known.get("id") == "download-form":
            self._action = known.get("action")
        if tag == "input" and self._action is not None and known.get("type") == "hidden":
            self._fields.append((known.get("name", ""), known.get("value", "")))

    def handle_endtag(self, tag: str) -> None:
        self._in_title = self._in_title and tag != "title"

    def handle_data(self, data: str) -> None:
        if self._in_title:
            self.title += data

    def confirmation(self, url: str) -> str | None:
        """Return the address that the form leads to; None where there is no such form."""
        if self._action is None:
            return None
        with suppress(ValueError):
            target = urljoin(url, self._action)
            return f"{target}{'&' if '?' in target else '?'}{urlencode(self._fields)}"
        return None
