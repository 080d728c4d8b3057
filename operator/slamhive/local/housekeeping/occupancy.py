# SPDX-License-Identifier: Apache-2.0
"""Room that a home takes, by what is in it, with the command that gives it back."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from slamhive.data.store.datasets import MANIFEST
from slamhive.local.home.extent import DiskTally, Extent
from slamhive.local.home.removed import NOTE, leftovers_in
from slamhive.local.housekeeping.collecting import CHECKS, MADE
from slamhive.local.housekeeping.merging import ASIDE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_PRUNE, _COLLECT = "slamhive results prune", "slamhive gc --all"
_FOLDERS = {
    "variants": ("variants: prepared recordings", _COLLECT),
    "preparing": ("logs of programs that prepare recordings", ""),
    "environments": ("environments of algorithms", _COLLECT),
    "assets": ("assets: files fetched for algorithms", _COLLECT),
    "truths": ("ground truth read from topics", _COLLECT),
    "downloads": ("downloads: archives of datasets, whole or in part", _COLLECT),
    "findings": ("findings of recordings that were looked at", _COLLECT),
    "cache": ("tables kept for the next start", _COLLECT),
    "algorithms": ("algorithms", "slamhive algorithm remove"),
    "groundtruth": ("ground truth of imported runs", ""),
    CHECKS: ("leftovers", "slamhive gc"),
}
_OTHER = ("other files", "")


class Room(NamedTuple):
    """Disk space that one kind of thing takes in a home, and the command that frees it.

    Attributes:
        kind: what they are.
        items: their number.
        extent: what they take.
        remedy: the command that gives it back; empty where there is none.
    """

    kind: str
    items: int
    extent: Extent
    remedy: str


def occupancy(home: Path) -> list[Room]:
    """Return the rooms of a home, the largest first; what a link leads to counts as if it were here."""
    tally = DiskTally()
    found: dict[tuple[str, str], tuple[int, Extent]] = {}
    for what, path in _parts(home):
        # They lie among variants and datasets, and are none.
        if path.name.endswith(".lock") or path.name == ".hashes":
            what = _OTHER  # noqa: PLW2901
        items, extent = found.get(what, (0, Extent()))
        found[what] = items + 1, extent + tally.of(path)
    rooms = [Room(kind, items, extent, remedy) for (kind, remedy), (items, extent) in found.items()]
    return sorted(rooms, key=lambda room: (-room.extent.size, room.kind))


def _parts(home: Path) -> Iterator[tuple[tuple[str, str], Path]]:
    """Yield all that is in a home, with what it is and the command that removes it."""
    for path in sorted(home.iterdir()) if home.is_dir() else ():
        if not path.is_dir():
            yield _kind_of_file(path), path
        elif path.name == ASIDE:
            yield _leftover(), path
        elif path.name == "runs":
            for run in sorted(path.glob("*/*")):
                yield _kind_of_run(run), run
        elif path.name == "datasets":
            for dataset in sorted(path.iterdir()):
                yield _kind_of_dataset(dataset), dataset
        elif path.name in _FOLDERS:
            for item in sorted(path.iterdir()):
                yield (_leftover() if item.name.endswith(".making") else _FOLDERS[path.name]), item
        else:
            yield _OTHER, path


def _leftover() -> tuple[str, str]:
    return _FOLDERS[CHECKS]


def _kind_of_file(path: Path) -> tuple[str, str]:
    if path.name in {"archive.sqlite", "archive.sqlite-wal", "archive.sqlite-shm"}:
        return "the archive: records of all runs", f"{_PRUNE} --records"
    if path.name.endswith(".making"):
        return _leftover()
    return ("copies of the archive, set aside", "") if path.name.startswith("archive.sqlite") else _OTHER


def _kind_of_run(path: Path) -> tuple[str, str]:
    if (path / NOTE).exists() and not leftovers_in(path):
        return "notes in the place of removed files of runs", f"{_PRUNE} --records"
    # RUN@DIGITS, as a later version of the run was put in its place.
    if "@" in path.name:
        return "files of runs set aside: earlier versions", f"{_PRUNE} --superseded"
    return "files of runs", _PRUNE


def _kind_of_dataset(path: Path) -> tuple[str, str]:
    if path.name.endswith(".making"):
        return _leftover()
    if MADE.fullmatch(path.name) and not (path / MANIFEST).exists():
        return "recordings, generated or fetched", _COLLECT
    return "datasets", "slamhive dataset remove"
