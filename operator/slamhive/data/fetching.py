# SPDX-License-Identifier: Apache-2.0
"""Files from the network: fetched over https, checked against their checksum, never seen half there."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import urllib.request
from pathlib import Path

from slamhive.model.errors import DataError, SystemFault

_CHUNK = 1 << 20
_TIMEOUT_SECONDS = 60


def fetch(url: str, place: Path, sha256: str, what: str) -> None:
    """Fetch a file to a place.

    Args:
        url: where it is; the models allow https alone.
        place: the file to make.
        sha256: its checksum, 64 hexadecimal digits.
        what: what it is, for messages.

    Raises:
        DataError: what came is another file.
        SystemFault: it can't be had right now.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(dir=place.parent, prefix=".fetching-")
    temporary = Path(name)
    try:
        with (
            os.fdopen(descriptor, "wb") as out,
            urllib.request.urlopen(url, timeout=_TIMEOUT_SECONDS) as answer,  # noqa: S310
        ):
            shutil.copyfileobj(answer, out, _CHUNK)
        require_sha256(temporary, sha256, f"{what}: {url}")
        temporary.replace(place)
    except OSError as error:
        raise SystemFault(f"{what}: {url}: {error}") from None
    finally:
        temporary.unlink(missing_ok=True)


def require_sha256(path: Path, sha256: str, what: str) -> None:
    """Check a file against its checksum.

    Raises:
        DataError: it is another file.
    """
    with path.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if found != sha256:
        raise DataError(f"{what}: has sha256 {found}, expected {sha256}")
