# SPDX-License-Identifier: Apache-2.0
"""Files from the network: fetched over https alone, within limits, checked, never seen half there."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import IO, Any

from slamhive.model.errors import DataError, SystemFault

MOST_BYTES = 1 << 38
"""Bytes of the largest file that is fetched, 256 GiB."""
LEFT_BYTES = 1 << 30
"""Bytes that stay free on the disk."""
STALL_SECONDS = 60
"""Seconds in which at least `STALL_BYTES` must come: a server that sends a byte now and then is no use."""
STALL_BYTES = 1 << 20
_CHUNK = 1 << 20


def fetch(url: str, place: Path, sha256: str, what: str) -> None:
    """Fetch a file to a place.

    Args:
        url: where it is; the models allow https alone.
        place: the file to make.
        sha256: its checksum, 64 hexadecimal digits.
        what: what it is, for messages.

    Raises:
        DataError: what came is another file, more than `MOST_BYTES`, or comes by a way that isn't https.
        SystemFault: it can't be had right now, or there is no room for it.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(dir=place.parent, prefix=".fetching-")
    temporary = Path(name)
    try:
        with (
            os.fdopen(descriptor, "wb") as out,
            urllib.request.build_opener(_HttpsAlone).open(url, timeout=STALL_SECONDS) as answer,
        ):
            _copy(answer, out, place.parent, f"{what}: {url}")
        require_sha256(temporary, sha256, f"{what}: {url}")
        temporary.replace(place)
    except OSError as error:
        raise SystemFault(f"{what}: {url}: {error}") from None
    finally:
        temporary.unlink(missing_ok=True)


class _HttpsAlone(urllib.request.HTTPRedirectHandler):
    """Follows no redirect to where anyone on the way could read along or answer."""

    def redirect_request(  # noqa: PLR0917 - the signature is urllib's
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str, headers: Any, newurl: str
    ) -> urllib.request.Request | None:
        if not newurl.lower().startswith("https://"):
            raise DataError(f"{req.full_url} leads to {newurl[:200]}, expected an https:// address")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _copy(answer: Any, out: IO[bytes], folder: Path, what: str) -> None:
    """Copy an answer of unknown length within the limits of size, room and pace."""
    room = shutil.disk_usage(folder).free - LEFT_BYTES
    _require_room(int(answer.headers.get("Content-Length") or 0), room, what)
    total, counted, since = 0, 0, time.monotonic()
    while block := answer.read1(_CHUNK):
        total += len(block)
        counted += len(block)
        _require_room(total, room, what)
        out.write(block)
        if counted >= STALL_BYTES:
            counted, since = 0, time.monotonic()
        elif time.monotonic() - since > STALL_SECONDS:
            raise SystemFault(f"{what}: less than {STALL_BYTES >> 20} MiB came in {STALL_SECONDS} s")


def _require_room(size: int, room: int, what: str) -> None:
    if size > MOST_BYTES:
        raise DataError(f"{what}: has more than {MOST_BYTES >> 30} GiB, the most that is fetched")
    if size > room:
        raise SystemFault(f"{what}: has more than the disk has room for, {max(room, 0) >> 20} MiB")


def require_sha256(path: Path, sha256: str, what: str) -> None:
    """Check a file against its checksum.

    Raises:
        DataError: it is another file.
    """
    with path.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if found != sha256:
        raise DataError(f"{what}: has sha256 {found}, expected {sha256}")
