# SPDX-License-Identifier: Apache-2.0
"""An https server on this machine that does what servers of data sets do, and fails as they do."""

from __future__ import annotations

import contextlib
import hashlib
import http.server
import re
import socket
import ssl
import subprocess
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

BLOCK = 1 << 18
_OK = b"HTTP/1.1 200 OK\r\n"
ENDLESS = {
    "/endless.bag": (_OK + b"\r\n", b"a recording\n" * 1000),
    "/heads.bag": (b"", b"HTTP/1.1 100 Continue\r\n\r\n"),
    "/page.bag": (_OK + b"Content-Type: text/html\r\n\r\n", b" "),
    "/trailer.bag": (_OK + b"Transfer-Encoding: chunked\r\n\r\n1\r\na\r\n0\r\n", b"more: of it\r\n"),
}
"""Bytes that are sent first, and those that are sent for ever after, by path."""


@dataclass
class Site:
    """Content and faults of a test's https server, with a record of what it was asked.

    Attributes:
        folder: Files by their paths.
        url: Its address.
        by_ranges: Whether parts are sent.
        beside: Bytes by which parts begin beside where they should.
        known_by: Marks of a file: ``tag``, ``weak`` tag, ``folded`` tag of two lines, ``time`` of its last
            change, or ``nothing``.
        heeds: Whether If-Range is looked at.
        measured: Whether answers have a length; else they end with the connection.
        drops: Bytes after which an answer ends, one for each answer to come; None for whole ones.
        wrong: Bytes of a file that are sent wrong once: path to position.
        pages: Pages sent in the place of files: path to HTML.
        odd: Status and headers that are sent in the place of files, without content.
        asked: Path and Range of each request.
        sent: Bytes of content that left.
        held: Bytes after which an answer waits until it is let go.
        go: Lets it go.
    """

    folder: Path
    url: str = ""
    by_ranges: bool = True
    beside: int = 0
    known_by: str = "tag"
    heeds: bool = True
    measured: bool = True
    drops: list[int | None] = field(default_factory=list)
    wrong: dict[str, int] = field(default_factory=dict)
    pages: dict[str, str] = field(default_factory=dict)
    odd: tuple[int, dict[str, str]] | None = None
    asked: list[tuple[str, str | None]] = field(default_factory=list)
    sent: int = 0
    held: int | None = None
    go: threading.Event = field(default_factory=threading.Event)


class Handler(http.server.BaseHTTPRequestHandler):
    """Answers for a `Site`."""

    site: Site
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        site, self.close_connection = self.site, True
        asked = self.headers.get("Range")
        site.asked.append((self.path, asked))
        if site.odd:
            self._head(*site.odd)
        elif self.path in ENDLESS:
            self._endless(*ENDLESS[self.path])
        elif self.path.startswith("/to/"):
            self._head(302, {"Location": self.path.removeprefix("/to/"), "Content-Length": "0"})
        elif self.path.split("?")[0] in site.pages and "confirm=" not in self.path:
            page = site.pages[self.path.split("?")[0]].encode()
            self._head(200, {"Content-Type": "text/html; charset=utf-8", "Content-Length": str(len(page))})
            self.wfile.write(page[:60])  # in two records of TLS
            self.wfile.write(page[60:])
        elif (path := site.folder / self._name()).is_file():
            self._file(path, asked)
        else:
            self.send_error(404)

    def _name(self) -> str:
        """Return the path of the file that is asked for; Google Drive names files by ``id`` alone."""
        path, _, query = self.path.partition("?")
        number = re.search(r"(?:^|&)id=([\w-]+)", query)
        return number[1] if number and path == "/download" else path.lstrip("/")

    def _head(self, status: int, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()

    def _endless(self, first: bytes, block: bytes) -> None:
        with contextlib.suppress(OSError):  # until nobody listens any more
            self.wfile.write(first)
            while True:
                self.wfile.write(block)

    def _file(self, path: Path, asked: str | None) -> None:
        site, size = self.site, path.stat().st_size
        mark = hashlib.sha256(f"{size} {path.stat().st_mtime_ns}".encode()).hexdigest()[:16]
        marks = {"tag": f'"{mark}"', "weak": f'W/"{mark}"', "folded": f'"{mark}\r\n "', "time": mark}
        known = marks.get(site.known_by)
        start, end = 0, size
        match = re.fullmatch(r"bytes=(\d+)-(\d*)", asked or "") if site.by_ranges else None
        if site.heeds and self.headers.get("If-Range", known) != known:
            match = None
        if match:
            start, end = int(match[1]), min(int(match[2] or size - 1) + 1, size)
            if start >= size:
                self._head(416, {"Content-Length": "0"})
                return
        headers = {"Content-Type": "application/octet-stream"}
        if site.measured:
            headers["Content-Length"] = str(end - start)
        if site.by_ranges:
            headers["Accept-Ranges"] = "bytes"
        if known is not None:
            headers["Last-Modified" if site.known_by == "time" else "ETag"] = known
        if match:
            headers["Content-Range"] = f"bytes {start + site.beside}-{end - 1}/{size}"
        self._head(206 if "Content-Range" in headers else 200, headers)
        drop = site.drops.pop(0) if site.drops else None
        with path.open("rb") as file, contextlib.suppress(OSError):
            file.seek(start)
            last = end if drop is None else min(end, start + drop)
            while start < last and (block := file.read(min(BLOCK, last - start))):
                self.wfile.write(self._spoiled(block, start))
                start += len(block)
                site.sent += len(block)
                if site.held is not None and start >= site.held:
                    site.go.wait()

    def _spoiled(self, block: bytes, start: int) -> bytes:
        at = self.site.wrong.get(self.path)
        if at is None or not start <= at < start + len(block):
            return block
        del self.site.wrong[self.path]
        return block[: at - start] + bytes([block[at - start] ^ 255]) + block[at - start + 1 :]

    def log_message(self, *_: object) -> None:
        pass


def make_certificate(folder: Path, name: str = "DNS:localhost") -> tuple[Path, Path]:
    """Make a certificate for this machine by a name, or ``IP:`` and an address, and return it and its key."""
    key, certificate = folder / "key.pem", folder / "certificate.pem"
    names = ["-subj", "/CN=localhost", "-addext", f"subjectAltName={name}", "-days", "1"]
    kind = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    files = ["-keyout", str(key), "-out", str(certificate)]
    subprocess.run(["openssl", "req", "-x509", *kind, *names, *files], check=True, capture_output=True)
    return certificate, key


@contextlib.contextmanager
def serving(
    site: Site, certificate: Path, key: Path, address: str | None = None, handler: type = Handler
) -> Iterator[Site]:
    """Serve a site until the end of the block, on this machine alone or at one of its addresses."""
    handler = type("SiteHandler", (handler,), {"site": site})
    httpd = http.server.ThreadingHTTPServer((address or "127.0.0.1", 0), handler)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    # What waits in the kernel counts as sent: little of it.
    httpd.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 18)
    httpd.socket = context.wrap_socket(httpd.socket, server_side=True, do_handshake_on_connect=False)
    thread = threading.Thread(target=httpd.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    site.url = f"https://{address or 'localhost'}:{httpd.server_port}"
    try:
        yield site
    finally:
        site.go.set()
        httpd.shutdown()
        thread.join()
        httpd.server_close()
