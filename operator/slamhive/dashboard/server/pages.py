# SPDX-License-Identifier: Apache-2.0
"""The pages: files of the package, index.html for their addresses, the API's description without scripts."""

from __future__ import annotations

import gzip
import hashlib
import mimetypes
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from fastapi import Request, Response

from slamhive.dashboard.problems import Missing

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

_TYPES = {
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".svg": "image/svg+xml",
    ".json": "application/json",
    ".txt": "text/plain; charset=utf-8",
    ".map": "application/json",
}
_PACKED = frozenset(_TYPES)
_NONE_YET = b"""<!doctype html><html lang="en"><meta charset="utf-8"><title>SLAM Hive</title>
<p>The pages are not part of this installation; the API is at <a href="/api/v1/docs">/api/v1/docs</a>.</p>
"""

_HEAD = """<!doctype html><html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width"><title>SLAM Hive: API</title></head><body>
<h1>SLAM Hive: API</h1>
<p>GET and HEAD only. <a href="/api/v1/openapi.json">openapi.json</a></p>
"""


@dataclass(frozen=True)
class Page:
    """A file as it is sent."""

    content: bytes
    packed: bytes | None
    media_type: str
    tag: str


class Pages:
    """The files of the package, read once."""

    def __init__(self) -> None:
        self._folder = files("slamhive.dashboard").joinpath("static")
        self._read: dict[str, Page] = {}

    def answer(self, request: Request) -> Response:
        """Return the file at an address, index.html where there is none.

        Raises:
            Missing: the address is that of a file, and there is no such file.
        """
        page = self._page(request.url.path.strip("/"))
        headers = {"ETag": page.tag, "Cache-Control": "no-cache", "Vary": "Accept-Encoding"}
        if page.tag in request.headers.get("if-none-match", ""):
            return Response(status_code=304, headers=headers)
        content = page.content
        if page.packed is not None and "gzip" in request.headers.get("accept-encoding", ""):
            content = page.packed
            headers["Content-Encoding"] = "gzip"
        return Response(content, media_type=page.media_type, headers=headers)

    def _page(self, path: str) -> Page:
        found = self._read.get(path)
        if found is None:
            suffix = _suffix(path)
            place = self._file(path)
            if place is not None:
                found = _load(path, place.read_bytes())
            elif suffix in _TYPES or path.startswith(("api/", "vendor/")):
                raise Missing(f"there is nothing at /{path[:200]}")
            else:
                index = self._file("index.html")
                return _load("index.html", index.read_bytes() if index else _NONE_YET)
            self._read[path] = found
        return found

    def _file(self, path: str) -> Traversable | None:
        place = self._folder
        for part in path.split("/"):
            if part in {"", ".", ".."} or "\\" in part or "\0" in part or part.startswith("."):
                return None
            place = place.joinpath(part)
        try:
            return place if place.is_file() else None
        except OSError:  # a name longer than the file system takes
            return None


def _load(path: str, content: bytes) -> Page:
    suffix = _suffix(path)
    media_type = _TYPES.get(suffix) or mimetypes.guess_type(path)[0] or "application/octet-stream"
    packed = gzip.compress(content, 9, mtime=0) if suffix in _PACKED else None
    return Page(content, packed, media_type, f'W/"{hashlib.sha256(content).hexdigest()[:20]}"')


def _suffix(path: str) -> str:
    name = path.rpartition("/")[2]
    return f".{name.rpartition('.')[2].lower()}" if "." in name else ""


def docs_page(document: dict[str, Any]) -> str:
    """Return an OpenAPI document as HTML."""
    parts = [_HEAD]
    for path, operations in document["paths"].items():
        operation = operations.get("get", {})
        parts.append(f"<h2><code>{escape(path)}</code></h2><p>{escape(operation.get('summary', ''))}. ")
        parts.append(f"{escape(operation.get('description', ''))}</p>")
        if operation.get("parameters"):
            parts.append("<dl>")
            parts += [_parameter(parameter) for parameter in operation["parameters"]]
            parts.append("</dl>")
    return "".join([*parts, "</body></html>\n"])


def _parameter(parameter: dict[str, Any]) -> str:
    schema = parameter.get("schema", {})
    told = [parameter.get("description") or ""]
    if parameter.get("required"):
        told.append("Needed.")
    if schema.get("default") is not None:
        told.append(f"Default: {schema['default']}.")
    return f"<dt><code>{escape(parameter['name'])}</code></dt><dd>{escape(' '.join(told).strip())}</dd>"
