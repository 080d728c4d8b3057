# SPDX-License-Identifier: Apache-2.0
"""Sources of the dashboard's data, kept fresh: an archive's runs, and a workstation with its run folders.

``dashboard.cluster`` has the third, which lays live objects over an archive.
"""

from __future__ import annotations

import asyncio
import math
import secrets
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from slamhive.analysis.frame import Frame
from slamhive.archive import Archive
from slamhive.archive.connection import connect, file_of, reading, require_version
from slamhive.archive.digests import ArchiveDigests
from slamhive.dashboard.problems import SourceUnavailable
from slamhive.dashboard.sources.looks import HomeLooks
from slamhive.dashboard.sources.underway import UnderWay
from slamhive.model.errors import SlamHiveError
from slamhive.model.leftout import sentences
from slamhive.runfiles.homefiles import HomeFiles
from slamhive.tables import snapshots
from slamhive.tables.loading import change_mark, load
from slamhive.tables.snapshots import Loaded

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from concurrent.futures import Executor
    from pathlib import Path

    from sqlalchemy import Connection, Engine

    from slamhive.analysis.derived import SweepVersion
    from slamhive.archive.records import CatalogEntry, SweepRecord
    from slamhive.model.results import RunRecord
    from slamhive.runfiles.artifacts import ArtifactFolder
    from slamhive.runfiles.ground_truth import DatasetTruth

LOOK_SECONDS = 0.5
"""Least time between questions to the database whether anything was written."""

PATIENCE_SECONDS = 5.0
"""Longest wait of answers for a look at the database before they show its last state."""

KEEP_SECONDS = (3.0, 600.0)
"""Times after which the table is kept for the next start: once the first answers are out, and again, s."""

_REST = 4.0
"""After a look that found changes, the next one waits so many times its duration."""

_LONG_SECONDS, _REST_OF_ALL = 1.0, 20.0
"""After a look through all runs that took so long, others find new runs alone for so many times that, s."""

_BEHIND = "the archive is large: removed and edited runs are shown as they were for up to {} min"
_CLOSE_SECONDS = 2.0
_LATE = "the archive does not answer at present: its last state is shown"


@dataclass(frozen=True)
class Snapshot:
    """The data at one moment; an answer is made of one snapshot alone.

    Attributes:
        frame: one row a run and evaluation.
        revision: differs whenever anything differs.
        problems: sentences on what does not answer at present.
        sweeps: live sweeps: their status by (namespace, name), of a workstation as far as it is known.
        asked: (namespace, name) of the sweeps that the archive knows, whether they have runs or not.
        at_work: what is known of each run of a workstation that goes on; the frame has those that ended.
    """

    frame: Frame = field(default_factory=lambda: Frame({}, 0))
    revision: str = "0"
    problems: tuple[str, ...] = ()
    sweeps: Mapping[tuple[str, str], Mapping[str, Any]] = field(default_factory=dict)
    asked: frozenset[tuple[str, str]] = frozenset()
    at_work: tuple[Mapping[str, Any], ...] = ()


class Source(Protocol):
    """Source of the API's data; all methods but ``fresh`` may block and are called from threads."""

    async def start(self, executor: Executor) -> None:
        """Begin to look after the data."""

    async def stop(self) -> None:
        """Let go of everything."""

    async def fresh(self) -> Snapshot:
        """Return the data as they are now, or as they were when they last could be read."""

    @property
    def ready(self) -> bool:
        """True if there are data."""

    def describe(self) -> dict[str, Any]:
        """Say what the data come from."""

    def record(self, uid: str) -> RunRecord | None:
        """Return a run by its UID."""

    def sweeps(self) -> list[SweepRecord]:
        """Return the sweeps that were asked for."""

    def catalog(self, kind: str) -> list[CatalogEntry]:
        """Return Algorithms or Datasets, versions of a name in the order of storing."""

    def place(self, record: RunRecord) -> ArtifactFolder | None:
        """Return the folder that holds a run's files, if it is there."""

    def absence(self, record: RunRecord) -> str | None:
        """Return the reason that a run's files aren't here, if somebody removed them: part of a sentence."""

    def truth(self, dataset: str, label: str | None) -> DatasetTruth | None:
        """Return the ground truth of a dataset, if it is at hand."""

    def variants(self) -> Path | None:
        """Return the folder of prepared recordings, if it is at hand."""

    def home(self) -> Path | None:
        """Return the home that datasets and published numbers were added to, if it is at hand."""

    def live_runs(self) -> int:
        """Return the number of runs that have not finished."""


class ArchiveData:
    """An archive's runs as a snapshot that follows the database; never writes to it.

    Args:
        url: the database's URL.
        cache: folder in which the table is kept for the next start; None to keep none.
        clock: monotonic time, s.
    """

    def __init__(
        self, url: str, cache: Path | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._url = url
        self._cache = snapshots.file_for(cache, url) if cache is not None else None
        self._saved: Loaded | None = None
        self._clock = clock
        self._engine: Engine | None = None
        self._held: Connection | None = None
        self._mark: object = None
        self._nonce = secrets.token_hex(4)
        self._count = 0
        self._next_look = self._next_of_all = 0.0
        self._owes_all = False
        self._rest_of_all = 0.0
        self._late = False
        self._again = False
        self._loaded = Loaded()
        self._frame = self._loaded.frame
        self._lock = threading.Lock()
        self._looking: asyncio.Future[None] | None = None
        self._keeping: asyncio.Task[None] | None = None
        self.problem: str | None = None
        self.loaded_once = False

    @property
    def revision(self) -> str:
        """Revision of the data: a text that differs after each change."""
        return f"{self._nonce}-{self._count}{'-late' if self._late else ''}"

    @property
    def frame(self) -> Frame:
        """The rows as they were last read, without the folders of runs: pages need not know them."""
        return self._frame

    @property
    def sweeps(self) -> tuple[SweepVersion, ...]:
        """The versions of sweeps as they were last read."""
        return self._loaded.sweeps or ()

    @property
    def asked(self) -> frozenset[tuple[str, str]]:
        """The (namespace, name) of the sweeps in it, whether they have runs or not."""
        return frozenset((one.namespace or "", one.name) for one in self.sweeps)

    @property
    def is_open(self) -> bool:
        """True if the database answered last time."""
        return self._engine is not None

    @property
    def is_absent(self) -> bool:
        """True if there is no archive yet, which is no fault."""
        return self._engine is None and self.problem is None

    @property
    def said(self) -> tuple[str, ...]:
        """Return sentences on the database's present trouble, and on what of it can't be read."""
        behind = _BEHIND.format(math.ceil(self._rest_of_all / 60)) if self._owes_all else None
        trouble = self.problem or (_LATE if self._late else behind)
        return (*((trouble,) if trouble else ()), *sentences(self._loaded.left_out))

    async def follow(self, executor: Executor | None, *, again: bool = False) -> None:
        """Look in a thread, and don't wait for one that takes long where there is something to show.

        Args:
            executor: has the thread.
            again: as for ``look``.
        """
        self._again |= again
        if self._looking is None or self._looking.done():
            loop = asyncio.get_running_loop()
            self._looking = loop.run_in_executor(executor, partial(self.look, again=self._again))
            self._again = False
        looking = self._looking
        await asyncio.wait({looking}, timeout=PATIENCE_SECONDS if self.loaded_once else None)
        self._late = not looking.done()
        if looking.done():
            looking.result()
        if self._keeping is None and self._cache is not None:
            self._keeping = asyncio.create_task(self._keep_on(executor), name="keep the table")

    def look(self, *, again: bool = False) -> None:
        """Read again what changed, if it is time for that; a database that is away is remembered.

        Args:
            again: look even if it is not time yet.
        """
        with self._lock:
            begun = self._clock()
            if begun < self._next_look and not again:
                return
            try:
                changed = self._refresh()
                self.problem = None
            except SlamHiveError as error:
                changed = self.problem is None
                self.problem = str(error)
                self._close()
            if changed:
                self._count += 1
            took = self._clock() - begun
            busy = changed or self.problem is not None
            self._next_look = begun + took + max(LOOK_SECONDS, _REST * took if busy else 0.0)

    def archive(self) -> Archive:
        """Return the archive's own reading methods.

        Raises:
            SourceUnavailable: the database does not answer.
        """
        engine = self._engine
        if engine is None:
            raise SourceUnavailable(self.problem or "the archive is not there yet")
        return Archive(engine)

    def keep(self) -> None:
        """Write the table for the next start, if it is large and much of it is news."""
        loaded = self._loaded
        if self._cache is not None and snapshots.keep(self._cache, loaded, self._saved):
            self._saved = Loaded(marks=loaded.marks)

    async def _keep_on(self, executor: Executor | None) -> None:
        pause, later = KEEP_SECONDS
        while True:
            await asyncio.sleep(pause)
            await asyncio.get_running_loop().run_in_executor(executor, self.keep)
            pause = later

    async def stop(self) -> None:
        """Let go of the database, from the loop that ``follow`` was called in."""
        if self._keeping is not None:
            self._keeping.cancel()
        self.close()

    def close(self) -> None:
        """Let go of the database; one that hangs is left to the end of the process."""
        if self._lock.acquire(timeout=_CLOSE_SECONDS):
            try:
                self._close()
            finally:
                self._lock.release()

    def _refresh(self) -> bool:
        if self._engine is None:
            if _is_missing(self._url):
                changed = not self.loaded_once
                self.loaded_once = True
                return changed
            self._engine = connect(self._url, read_only=True, held=True)
            self._held = self._engine.connect()
            self._mark, self._next_of_all = None, 0.0  # after an absence it may be another archive
        if self._held is None:
            raise SourceUnavailable("the archive was closed")
        with reading(self._engine) as connection:
            require_version(connection)
            mark = change_mark(self._engine, self._held)
        begun = self._clock()
        newer = self.loaded_once and begun < self._next_of_all
        if mark == self._mark and self.loaded_once and (newer or not self._owes_all):
            return self.problem is not None
        stamp = None
        if not self.loaded_once and self._cache is not None:
            self._saved = snapshots.restore(self._cache)
            self._loaded = self._saved or self._loaded
            # Taken after the mark: what is written from here on is met at the next look.
            stamp = snapshots.stamp_of(self._url)
        self._loaded = load(self._engine, self._loaded, stamp, newer=newer)
        self._owes_all = newer
        if not newer and (took := self._clock() - begun) > _LONG_SECONDS:
            self._rest_of_all = _REST_OF_ALL * took
            self._next_of_all = begun + took + self._rest_of_all
        self._frame = self._loaded.frame.without(["folder"])
        self._mark = mark
        self.loaded_once = True
        return True

    def _close(self) -> None:
        with suppress(Exception):
            if self._held is not None:
                self._held.close()
        self._held = None
        if self._engine is not None:
            self._engine.dispose()
        self._engine = None


class Workstation:
    """The archive and the run folders of one home.

    Args:
        url: the archive's database URL.
        home: folder that holds the runs' folders; None for none.
        ground_truth: folder of files named after datasets, for plots.
        cache: folder in which the table is kept for the next start; None for one in the home.
    """

    def __init__(
        self,
        url: str,
        home: Path | None = None,
        ground_truth: Path | None = None,
        *,
        cache: Path | None = None,
    ) -> None:
        self._url = url
        self._data = ArchiveData(url, cache or (home / "cache" if home is not None else None))
        self._under_way = UnderWay(home)
        self._home = home
        self._files = HomeFiles(home, ground_truth)
        self._executor: Executor | None = None

    async def start(self, executor: Executor) -> None:
        """Read the archive for the first time."""
        self._executor = executor

    async def stop(self) -> None:
        """Let go of the archive."""
        await self._data.stop()

    async def fresh(self) -> Snapshot:
        """Return the archive as it is now."""
        await self._data.follow(self._executor)
        found = Snapshot(self._data.frame, self._data.revision, self._data.said, asked=self._data.asked)
        return await self._with_what_goes_on(found)

    async def _with_what_goes_on(self, archived: Snapshot) -> Snapshot:
        now = self._under_way
        await now.follow(self._executor)
        return replace(archived, revision=archived.revision + now.mark, sweeps=now.sweeps, at_work=now.runs)

    @property
    def ready(self) -> bool:
        """True if the archive was read."""
        return self._data.loaded_once

    def describe(self) -> dict[str, Any]:
        """Say that this is a workstation."""
        return {"kind": "workstation"}

    def record(self, uid: str) -> RunRecord | None:
        """Return a run by its UID."""
        return None if self._data.is_absent else self._data.archive().get(uid)

    def records(self, uids: Iterable[str]) -> list[RunRecord]:
        """Return some runs by their UIDs, at a tenth of what one by one takes."""
        return [] if self._data.is_absent else list(self._data.archive().by_uids(uids))

    def looks(self) -> HomeLooks:
        """Return the looks that runs have now, read by a connection of its own."""
        if _is_missing(self._url):
            return HomeLooks(ArchiveDigests(), self._files)
        with Archive.open(self._url, read_only=True) as archive:
            return HomeLooks(archive.digests(), self._files)

    def sweeps(self) -> list[SweepRecord]:
        """Return the sweeps in the archive."""
        return [] if self._data.is_absent else self._data.archive().sweeps()

    def catalog(self, kind: str) -> list[CatalogEntry]:
        """Return the catalog as runs used it."""
        return [] if self._data.is_absent else self._data.archive().catalog(kind)

    def place(self, record: RunRecord) -> ArtifactFolder | None:
        """Return the folder of a run in the home, or the one that it was imported from."""
        return self._files.place(record)

    def absence(self, record: RunRecord) -> str | None:
        """Return the reason that a run's files aren't here, if somebody removed them."""
        return self._files.absence(record)

    def truth(self, dataset: str, label: str | None) -> DatasetTruth | None:
        """Return the ground truth of a dataset, if it is at hand."""
        return self._files.truth(dataset, label)

    def variants(self) -> Path | None:
        """Return the folder of prepared recordings in the home."""
        return self._home / "variants" if self._home is not None else None

    def home(self) -> Path | None:
        """Return the home."""
        return self._home

    def live_runs(self) -> int:
        """Return the number of runs that are at work in the home."""
        return len(self._under_way.runs)


def _is_missing(url: str) -> bool:
    file = file_of(url)
    return file is not None and not file.exists()
