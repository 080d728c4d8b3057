# SPDX-License-Identifier: Apache-2.0
"""Registry of images on a port of this machine: what is asked of it when an image is pulled."""

from __future__ import annotations

import http.server
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

_MANIFEST = "application/vnd.oci.image.manifest.v1+json"


class Registry(http.server.ThreadingHTTPServer):
    """Serves one image, of any name.

    Args:
        layout: Its folder in OCI's layout.
        manifest: Digest of its manifest.
    """

    def __init__(self, layout: Path, manifest: str) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.layout = layout
        self.manifest = manifest
        self.asked: list[str] = []
        threading.Thread(target=self.serve_forever, daemon=True).start()


class _Handler(http.server.BaseHTTPRequestHandler):
    server: Registry

    def do_GET(self) -> None:
        self.server.asked.append(self.path)
        kind, name = self.path.split("/")[-2:]
        if self.path == "/v2/":
            self._answer(b"{}", "application/json")
        elif kind == "manifests" and name in {"1", self.server.manifest}:
            self._answer(self._blob(self.server.manifest), _MANIFEST)
        elif kind == "blobs":
            self._answer(self._blob(name), "application/octet-stream")
        else:
            body = b'{"errors": [{"code": "MANIFEST_UNKNOWN", "message": "manifest unknown"}]}'
            self._answer(body, "application/json", 404)

    do_HEAD = do_GET  # noqa: N815 - its name there

    def _blob(self, digest: str) -> bytes:
        return (self.server.layout / "blobs" / digest.replace(":", "/")).read_bytes()

    def _answer(self, body: bytes, kind: str, code: int = 200) -> None:
        self.send_response(code)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        """Say nothing."""
