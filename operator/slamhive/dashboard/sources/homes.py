# SPDX-License-Identifier: Apache-2.0
"""Source of several homes: a workstation's own, and others that are read beside it (``--also``)."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from slamhive.archive.digests import ArchiveDigests
from slamhive.dashboard.sources.archived import Snapshot, Workstation
from slamhive.dashboard.sources.looks import HomeLooks, HomesLooks
from slamhive.model.errors import SlamHiveError
from slamhive.runfiles.homefiles import HomeFiles
from slamhive.tables.homes import COLUMN, OWN, plain_name, together, told_name, uid_in

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from concurrent.futures import Executor
    from pathlib import Path

    from slamhive.analysis.frame import Frame
    from slamhive.archive.records import CatalogEntry, SweepRecord
    from slamhive.local.home.folder import Home
    from slamhive.model.results import RunRecord
    from slamhive.runfiles.artifacts import ArtifactFolder
    from slamhive.runfiles.ground_truth import DatasetTruth
    from slamhive.tables.homes import Beside

Item = TypeVar("Item")

_REFERENCES = {"algorithm": "algorithmRef", "dataset": "datasetRef"}


class Homes:
    """Several homes as one: names that mean something else in another home have its label.

    Args:
        own: one's own home.
        others: the other ones; nothing is written to them.
        ground_truth: folder of files named after datasets, for plots.
    """

    def __init__(self, own: Home, others: Sequence[Beside], ground_truth: Path | None = None) -> None:
        cache = own.path / "cache"
        self._stations = {OWN: Workstation(own.archive_url, own.path, ground_truth)}
        for one in others:
            self._stations[one.label] = Workstation(one.url, one.path, ground_truth, cache=cache)
        self._executor: Executor | None = None
        self._revision = ""
        self._snapshot = Snapshot()
        self._rows: dict[str, dict[str, Any]] = {}
        self._names: dict[str, set[str]] = {}

    async def start(self, executor: Executor) -> None:
        """Read the archives for the first time."""
        self._executor = executor
        for station in self._stations.values():
            await station.start(executor)

    async def stop(self) -> None:
        """Let go of the archives."""
        for station in self._stations.values():
            await station.stop()

    async def fresh(self) -> Snapshot:
        """Return the archives as they are now."""
        found = await asyncio.gather(*(station.fresh() for station in self._stations.values()))
        snapshots = dict(zip(self._stations, found, strict=True))
        revision = "+".join(snapshot.revision for snapshot in snapshots.values())
        if revision != self._revision:
            join = partial(self._join, snapshots, revision)
            await asyncio.get_running_loop().run_in_executor(self._executor, join)
        return self._snapshot

    def _join(self, snapshots: dict[str, Snapshot], revision: str) -> None:
        frame = together([(label, snapshot.frame) for label, snapshot in snapshots.items()])
        self._note(frame)
        problems = [
            problem if label == OWN else f"home {label}: {problem}"
            for label, snapshot in snapshots.items()
            for problem in snapshot.problems
        ]
        asked = {
            (namespace, self._told("sweep", name, label))
            for label, snapshot in snapshots.items()
            for namespace, name in snapshot.asked
        }
        own = snapshots[OWN]
        self._snapshot = Snapshot(frame, revision, tuple(problems), own.sweeps, frozenset(asked), own.at_work)
        self._revision = revision

    def _note(self, frame: Frame) -> None:
        """Note whose each run is, and by which names it goes."""
        names = ("uid", COLUMN, "algorithm", "dataset", "sweep")
        rows = {str(row["uid"]): row for row in frame.records(names) if row[COLUMN] != OWN}
        told = {name: {str(row[name]) for row in rows.values()} for name in ("algorithm", "dataset", "sweep")}
        self._rows, self._names = rows, told

    def _told(self, column: str, name: str, label: str) -> str:
        """Return the name here of something that a home has."""
        named = told_name(name, label)
        return named if label != OWN and named in self._names.get(column, ()) else name

    def _label(self, uid: str) -> str:
        row = self._rows.get(uid)
        return str(row[COLUMN]) if row is not None else OWN

    @property
    def ready(self) -> bool:
        """True if the archive of one's own home was read."""
        return self._stations[OWN].ready

    def describe(self) -> dict[str, Any]:
        """Say that this is a workstation, and whose homes are shown."""
        return self._stations[OWN].describe() | {"homes": list(self._stations)}

    def _whose(self, uid: str) -> tuple[str, str]:
        """Return the label of a run's home, and its UID there."""
        plain, _ = uid_in(uid, self._stations)
        label = self._label(uid)
        return label, plain if label != OWN else uid

    def looks(self) -> HomesLooks:
        """Return the looks that the runs of all homes have now; of one that does not answer none is known."""
        held = {label: self._looks_in(label) for label in self._stations}
        return HomesLooks(held, self._whose)

    def _looks_in(self, label: str) -> HomeLooks:
        station = self._stations[label]
        try:
            return station.looks()
        except SlamHiveError:
            if label == OWN:
                raise
            return HomeLooks(ArchiveDigests(), HomeFiles(None))

    def record(self, uid: str) -> RunRecord | None:
        """Return a run by its UID, with the names that it has here."""
        label, plain = self._whose(uid)
        record = self._stations[label].record(plain)
        row = self._rows.get(uid)
        if record is None or row is None:
            return record
        spec = dict(record.spec)
        for column, reference in _REFERENCES.items():
            if row[column] is not None and reference in spec:
                spec[reference] = {**spec[reference], "name": row[column]}
        return record.replace(uid=uid, sweep=row["sweep"], spec=spec)

    def sweeps(self) -> list[SweepRecord]:
        """Return the sweeps of all homes, one that several know once."""
        found: dict[tuple[str, str], SweepRecord] = {}
        for label, station in self._stations.items():
            for sweep in self._held(label, station.sweeps):
                name = self._told("sweep", sweep.name, label)
                found.setdefault((sweep.uid, name), sweep.replace(name=name))
        return list(found.values())

    def catalog(self, kind: str) -> list[CatalogEntry]:
        """Return the catalogs of all homes, by the names that they have here."""
        column = kind.lower()
        found: dict[tuple[str, str], CatalogEntry] = {}
        for label, station in self._stations.items():
            for entry in self._held(label, partial(station.catalog, kind)):
                name = self._told(column, entry.name, label)
                found.setdefault((name, entry.content_hash), entry.replace(name=name))
        return list(found.values())

    @staticmethod
    def _held(label: str, ask: Callable[[], list[Item]]) -> list[Item]:
        """Return the items of a home; none of another one that does not answer, as its problem says."""
        try:
            return ask()
        except SlamHiveError:
            if label == OWN:
                raise
            return []

    def place(self, record: RunRecord) -> ArtifactFolder | None:
        """Return the folder that holds a run's files, if it is there."""
        return self._stations[self._label(record.uid)].place(record)

    def absence(self, record: RunRecord) -> str | None:
        """Return the reason that a run's files aren't here, if somebody removed them."""
        return self._stations[self._label(record.uid)].absence(record)

    def truth(self, dataset: str, label: str | None) -> DatasetTruth | None:
        """Return the ground truth of a dataset: of the home in its name, else of the first that has it."""
        name, home = plain_name(dataset, self._stations)
        stations = [self._stations[home]] if home is not None else self._stations.values()
        return next((truth for one in stations if (truth := one.truth(name, label)) is not None), None)

    def variants(self) -> Path | None:
        """Return the folder of prepared recordings in one's own home."""
        return self._stations[OWN].variants()

    def home(self) -> Path | None:
        """Return one's own home."""
        return self._stations[OWN].home()

    def live_runs(self) -> int:
        """Return the number of runs that are at work in one's own home."""
        return self._stations[OWN].live_runs()
