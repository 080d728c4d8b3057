# SPDX-License-Identifier: Apache-2.0
"""Trash of a volume: what the collector takes away first lies here, and can be moved back.

::

    .trash/20260131T031700Z/runs/UID               what was taken away at that time, by its path on the volume
    .trash/20260131T031700Z-offloaded/runs/UID     what lies in object storage as well
"""

from __future__ import annotations

import os
from datetime import UTC, datetime
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

FOLDER = ".trash"
OFFLOADED = "-offloaded"
_STAMP = "%Y%m%dT%H%M%SZ"


def throw_away(path: Path, volume: Path, now: float, ending: str = "") -> Path:
    """Move something on a volume to its trash, and return where it is then.

    Args:
        path: what, below the volume.
        volume: the volume's folder.
        now: the time, s since 1970.
        ending: of the folder's name, by which it is known who may erase it.

    Raises:
        OSError: it can't be moved.
    """
    while True:
        stamp = datetime.fromtimestamp(now, UTC).strftime(_STAMP)
        target = volume / FOLDER / f"{stamp}{ending}" / path.relative_to(volume)
        if not os.path.lexists(target):
            break
        now += 1  # it came back, and goes again within a second
    target.parent.mkdir(parents=True, exist_ok=True)
    if path.is_dir() and not path.is_symlink() and not os.access(path, os.W_OK):
        path.chmod(0o700)  # a locked folder can't get another parent
    return path.rename(target)


def outdated(volume: Path, now: float, seconds: float, ending: str = "") -> Iterator[Path]:
    """Go through the folders of a volume's trash that are older than some seconds, by their ending."""
    trash = volume / FOLDER
    if trash.is_symlink() or not trash.is_dir():
        return
    for folder in sorted(trash.iterdir()):
        try:
            thrown = datetime.strptime(folder.name, f"{_STAMP}{ending}").replace(tzinfo=UTC)
        except ValueError:
            continue  # not of our making
        if now - thrown.timestamp() >= seconds:
            yield folder
