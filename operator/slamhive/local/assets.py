# SPDX-License-Identifier: Apache-2.0
"""Files that algorithms name with a checksum: copied or fetched, verified, and laid into run folders."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import urllib.request
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.local.home import lock
from slamhive.model.errors import DataError, SystemFault

if TYPE_CHECKING:
    from slamhive.local.catalog import AlgorithmEntry
    from slamhive.model.algorithm import Asset

_CHUNK = 1 << 20
_TIMEOUT_SECONDS = 60


def place_assets(entry: AlgorithmEntry, target: Path, cache: Path) -> None:
    """Lay an algorithm's assets into a run folder's ``assets``.

    Raises:
        DataError: a file is missing or isn't the one that was named.
        SystemFault: it can't be fetched right now.
    """
    target.mkdir(exist_ok=True)
    for asset in entry.algorithm.spec.assets:
        source = entry.folder / asset.path if asset.path else _fetched(asset, cache)
        if not source.is_file():
            raise DataError(f"assets: {asset.name}: {source} is not there")
        if asset.sha256 and asset.path:
            _verify(source, asset.sha256, asset.name)
        place = target / asset.name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.symlink_to(source.resolve())


def _fetched(asset: Asset, cache: Path) -> Path:
    checksum = asset.sha256 or ""
    place = cache / checksum
    with lock(cache / f"{checksum}.lock"):
        if not place.exists():
            _download(asset.url or "", place, checksum, asset.name)
    return place


def _download(url: str, place: Path, checksum: str, name: str) -> None:
    descriptor, temporary = tempfile.mkstemp(dir=place.parent)
    try:
        # The model allows https alone.
        with (
            urllib.request.urlopen(url, timeout=_TIMEOUT_SECONDS) as answer,  # noqa: S310
            os.fdopen(descriptor, "wb") as out,
        ):
            shutil.copyfileobj(answer, out, _CHUNK)
        _verify(Path(temporary), checksum, name)
        Path(temporary).replace(place)
    except OSError as error:
        raise SystemFault(f"assets: {name}: {url}: {error}") from None
    finally:
        Path(temporary).unlink(missing_ok=True)


def _verify(path: Path, checksum: str, name: str) -> None:
    found = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            found.update(chunk)
    if found.hexdigest() != checksum:
        raise DataError(f"assets: {name}: has sha256 {found.hexdigest()}, expected {checksum}")
