# SPDX-License-Identifier: Apache-2.0
"""Results made stale by a changed algorithm or dataset: kept beside the new ones, never mixed."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.model.errors import SlamHiveError

if TYPE_CHECKING:
    from slamhive.archive import Archive
    from slamhive.local.run import Point
    from slamhive.local.workbench import Program, Workbench

_WHY = "their algorithm, its environment or their dataset has changed; the earlier results stay as superseded"


class Changes:
    """Finds the finished runs of a sweep that today's algorithms and datasets would not repeat.

    Args:
        bench: what runs share.
    """

    def __init__(self, bench: Workbench) -> None:
        self._bench = bench
        self._programs: dict[str, Program] = {}
        self._uids: list[str] = []

    def since(self, uid: str, point: Point, content_hash: str | None) -> bool:
        """Tell whether a run's result is that of something else than would be run today.

        Args:
            uid: the run's identity.
            point: what the plan says of it.
            content_hash: what the result was made from; None when it never got so far.
        """
        # It failed before anything was made from its inputs: there is no result that could have changed.
        if content_hash is None:
            return False
        name = point.spec["algorithmRef"]["name"]
        try:
            if name not in self._programs:
                self._programs[name] = self._bench.program(name)
            now = self._bench.provenance(point.spec, point.spec_hash, self._programs[name])
        except (SlamHiveError, OSError):
            return False  # it can't be run today: what is there stays
        if now.content_hash == content_hash:
            return False
        self._uids.append(uid)
        return True

    def set_aside(self, sweep: str) -> None:
        """Set the runs found aside, and say so."""
        if not self._uids:
            return
        count = "1 finished run is" if len(self._uids) == 1 else f"{len(self._uids)} finished runs are"
        self._bench.tell(f"{sweep}: {count} done again: {_WHY}")
        for uid in self._uids:
            set_aside(self._bench.archive, uid)


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
