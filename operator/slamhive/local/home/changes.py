# SPDX-License-Identifier: Apache-2.0
"""Results made stale by a changed algorithm or dataset: kept beside the new ones, never mixed."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slamhive.archive import Archive


def current_uid(uid: str) -> str:
    """Return the UID that the current version of a run has: not that of one that was set aside or merged.

    >>> current_uid("run-1@0a1b2c3d.2"), current_uid("run-1")
    ('run-1', 'run-1')
    """
    return uid.partition("@")[0]


def set_aside(archive: Archive, uid: str) -> None:
    """Give a run, record and folder, another identity, so that it stays beside the one that follows it.

    Its UID gets ``@`` and 8 digits of its content. It stays a run of its sweep: that it is superseded follows
    from what it was made of. A reused result whose original is kept already only goes.
    """
    record = archive.get(uid)
    if record is None:
        return
    aside = f"{uid}@{(record.provenance.content_hash or 'unknown')[:8]}"
    if archive.get(aside) is not None:
        # The folder and the result are another run's: only this record of them goes.
        if record.provenance.reused_from is not None:
            archive.remove_run(uid)
            return
        aside = next(name for number in count(2) if archive.get(name := f"{aside}.{number}") is None)
    folder, trajectory = record.folder, record.trajectory
    if folder is not None and Path(folder).is_dir() and record.provenance.reused_from is None:
        target = Path(folder).with_name(f"{Path(folder).name}@{aside.rpartition('@')[2]}")
        if not target.exists():
            Path(folder).rename(target)
        if trajectory is not None:
            trajectory = trajectory.replace(path=trajectory.path.replace(folder, str(target), 1))
        folder = str(target)
    archive.rename_run(record.replace(uid=aside, folder=folder, trajectory=trajectory), uid)
