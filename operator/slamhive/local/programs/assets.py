# SPDX-License-Identifier: Apache-2.0
"""Files that algorithms name with a checksum: copied or fetched, verified, and laid into run folders."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.data.files.fetching import fetch
from slamhive.data.recordings.entries import file_sha256
from slamhive.local.home.folder import lock
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.local.home.catalog import AlgorithmEntry
    from slamhive.model.algorithm import Asset


_HASHES = ".hashes"


def place_assets(entry: AlgorithmEntry, target: Path, cache: Path, *, fetched_alone: bool = False) -> None:
    """Lay an algorithm's assets into a run folder's ``assets``.

    Args:
        entry: the algorithm.
        target: the folder.
        cache: where fetched files are kept.
        fetched_alone: leave out those beside the Algorithm, which an image has.

    Raises:
        DataError: a file is missing or isn't the one that was named.
        SystemFault: it can't be fetched right now.
    """
    target.mkdir(exist_ok=True)
    for asset in entry.algorithm.spec.assets:
        if fetched_alone and asset.url is None:
            continue
        source = entry.folder / asset.path if asset.path else _fetched(asset, cache)
        if not source.is_file():
            raise DataError(f"assets: {asset.name}: {source} is not there")
        if asset.sha256 and (found := file_sha256(source, cache / _HASHES)) != asset.sha256:
            raise DataError(f"assets: {asset.name}: {source} has sha256 {found}, expected {asset.sha256}")
        place = target / asset.name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.symlink_to(source.resolve())


def remove_asset(place: Path) -> bool:
    """Remove a fetched file unless it is being fetched, and tell whether it was removed."""
    with lock(place.with_name(f"{place.name}.lock"), wait=False) as held:
        if held is None:
            return False
        place.unlink(missing_ok=True)
    return True


def _fetched(asset: Asset, cache: Path) -> Path:
    """Return a file of the cache, which all runs share: one that a program changed is fetched again."""
    checksum = asset.sha256 or ""
    place = cache / checksum
    with lock(cache / f"{checksum}.lock"):
        if not place.exists() or file_sha256(place, cache / _HASHES) != checksum:
            fetch(asset.url or "", place, checksum, f"assets: {asset.name}")
            place.chmod(0o444)
    return place
