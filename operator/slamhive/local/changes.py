# SPDX-License-Identifier: Apache-2.0
"""Finished runs whose algorithm or dataset is another one today: set aside, never mixed or lost."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.model.errors import SlamHiveError

if TYPE_CHECKING:
    from slamhive.archive import Archive
    from slamhive.local.run import Point
    from slamhive.local.workbench import Program, Workbench

_WHY = "their algorithm, its environment or their dataset has changed; the earlier results are set aside"


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
    """Move a run, record and folder, to the sweep ``NAME@`` and 8 digits of its content."""
    record = archive.get(uid)
    if record is None:
        return
    mark = (record.provenance.content_hash or "unknown")[:8]
    folder, trajectory = record.folder, record.trajectory
    if folder is not None and Path(folder).is_dir() and record.provenance.reused_from is None:
        target = Path(folder).with_name(f"{Path(folder).name}@{mark}")
        if not target.exists():
            Path(folder).rename(target)
        if trajectory is not None:
            trajectory = trajectory.replace(path=trajectory.path.replace(folder, str(target), 1))
        folder = str(target)
    aside = {"uid": f"{uid}@{mark}", "sweep": f"{record.sweep}@{mark}"}
    archive.put_run(record.replace(**aside, folder=folder, trajectory=trajectory))
    archive.remove_run(uid)
