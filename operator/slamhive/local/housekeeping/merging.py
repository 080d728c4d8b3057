# SPDX-License-Identifier: Apache-2.0
"""Merging of another home into one's own: its runs with their results, sweeps, catalog and files.

A run is the same where its UID, its content and the times at which it was made are the same. One that stands
in both homes stays as it is here; what it was measured by there and not here is added, and so are tags and a
newer note. Where one evaluation
says something else there, that is kept beside as ``EVALUATION@LABEL``. Another run of a UID that is taken
here gets ``@`` and 8 digits of its content, as earlier versions have (`local.changes`).

The files of a run are copied into ``.merging`` and renamed to their place, with a note of where they came
from; then its record is written. Wherever a merge ends, the next one goes on: a record has its files, and
files without a record are known by their note. Holes in files stay holes. What makes a run larger than any
run's output may be is not copied, and nothing is where there is no room for all of it.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import sqlite3
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from slamhive.archive import Archive
from slamhive.archive.connection import file_of, open_engine, parse, reading, version_of, wrong_version
from slamhive.archive.remarks import Remarks
from slamhive.archive.schema import VERSION
from slamhive.archive.upgrading import copy_database, upgrade
from slamhive.contract.files import read_regular
from slamhive.data.files.once import settle
from slamhive.local.home.changes import current_uid
from slamhive.local.home.extent import BLOCK_BYTES, DiskTally, Extent, below, total
from slamhive.local.home.removed import remove, run_parts, write_whole
from slamhive.model.base import quantity
from slamhive.model.errors import SystemFault
from slamhive.model.results import IMPORTED
from slamhive.monitor.spec import OUTPUT_LIMIT

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from slamhive.archive import CatalogEntry
    from slamhive.local.home.folder import Home
    from slamhive.model.results import Result, RunRecord
    from slamhive.model.search import SearchRecord

ASIDE = ".merging"
"""Folder of a home in which what is merged is made."""
NOTE = "merged.json"
_MOST = 4096
_DIGITS = 8
_LIMIT_BYTES = int(quantity(OUTPUT_LIMIT))

Parts = tuple[str, str]
"""The way from ``runs`` to a run's folder: SWEEP and RUN."""


class RunIdentity(NamedTuple):
    """Identity, content and times of a run; where all are equal, two homes have the same run."""

    uid: str
    content: str | None
    created: float | None
    finished: float | None


@dataclass(frozen=True)
class Other:
    """Other home or archive that is merged into one's own.

    Attributes:
        label: what it is called.
        archive: its archive, open for reading.
        path: its folder; None for a database alone.
    """

    label: str
    archive: Archive
    path: Path | None


@dataclass(frozen=True)
class Coming:
    """A run that comes.

    Attributes:
        uid: its identity there.
        record: as it will stand here.
        source: its folder there; None where it has none.
        target: where that goes; None where nothing is to be copied.
        extent: what it takes.
        room: bytes that a copy of it takes.
        left_out: files that are not copied, as with them it is larger than an output may be.
        hollow: files with holes.
    """

    uid: str
    record: RunRecord
    source: Path | None
    target: Parts | None
    extent: Extent
    room: int = 0
    left_out: frozenset[str] = frozenset()
    hollow: frozenset[str] = frozenset()


@dataclass
class Merge:
    """Plan of a merge: the runs and results that come, what is kept beside, and what could not be copied.

    Attributes:
        coming: runs that come.
        known: number of runs that are here already.
        results: results that come for runs that are here, by UID here.
        remarks: notes and tags that come for them, likewise.
        aside: sentences on what is kept beside, as something else stands here.
        without: number of coming runs whose files are not there.
        unread: files that could not be read, and were not copied.
        left_out: sentences on files that are not copied, as they are beyond the limit of an output.
    """

    coming: list[Coming] = field(default_factory=list)
    known: int = 0
    results: list[tuple[str, Result]] = field(default_factory=list)
    remarks: dict[str, Remarks] = field(default_factory=dict)
    aside: list[str] = field(default_factory=list)
    without: int = 0
    unread: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    @property
    def extent(self) -> Extent:
        """Return the room of what is copied."""
        return total(one.extent for one in self.coming)


@contextmanager
def opened(label: str, url: str, path: Path | None, home: Home) -> Iterator[Other]:
    """Open what is to be merged, a file of an earlier version as an upgraded copy.

    Args:
        label: what it is called.
        url: of its archive.
        path: its folder; None for a database alone.
        home: one's own home, in which the copy is made.

    Raises:
        InputError: there is no archive, or a newer slamhive wrote it.
        SystemFault: the database doesn't answer, or the disk refuses.
    """
    file, engine = file_of(url), None
    if file is not None and file.exists():
        engine = open_engine(parse(url), read_only=True)
        try:
            with reading(engine) as connection:
                found = version_of(connection)
        finally:
            engine.dispose()
        if found is not None and found > VERSION:
            raise wrong_version(parse(url), found)
        # Nothing is written to another's home: what is upgraded is a copy in one's own.
        if found is not None and found < VERSION:
            copy = home.folder(ASIDE) / f"archive-{os.getpid()}.sqlite"
            with closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as origin:
                copy_database(origin, copy)
            url = f"sqlite:///{copy}"
            upgrade(url)
    with Archive.open(url, read_only=True) as archive:
        yield Other(label, archive, path)


def plan_merge(home: Home, archive: Archive, other: Other) -> Merge:
    """Return the plan of a merge.

    Args:
        home: one's own home.
        archive: its archive.
        other: what is merged.
    """
    return _Planner(home, archive, other).plan()


def merge(
    home: Home, archive: Archive, other: Other, plan: Merge, step: Callable[[int], None] = lambda _: None
) -> None:
    """Do what a plan says; one that is interrupted is gone on with by the next merge.

    Args:
        home: one's own home, in which the caller is alone.
        archive: its archive.
        other: what is merged.
        plan: what is done.
        step: called with the number of runs done so far.

    Raises:
        SystemFault: there is no room for it, the disk refuses, or a file is gone.
    """
    room, free = sum(one.room for one in plan.coming), shutil.disk_usage(home.path).free
    if room > free:
        raise SystemFault(
            f"{home.path}: has {free >> 20:,} MiB of room, and the files of the runs to merge take "
            f"{room >> 20:,} MiB: nothing was merged"
        )
    catalog = {kind: _by_hash(other.archive, kind) for kind in ("Algorithm", "Dataset")}
    used = other.archive.used(one.uid for one in plan.coming)
    origin = other.archive.identity
    # Sweeps before their runs: a merge that is killed must not leave runs whose sweep nobody knows.
    known = {sweep.uid for sweep in archive.sweeps()}
    for sweep in other.archive.sweeps():
        if sweep.uid not in known:
            archive.put_sweep(sweep)
        elif sweep.search is not None:
            archive.change_search(sweep.uid, partial(_further, there=sweep.search))
    for number, one in enumerate(plan.coming, 1):
        if one.source is not None and one.target is not None:
            # Files before the record: what a record says to be there is there.
            plan.unread += _bring(home.path, one, one.source, one.target, origin)
        algorithm, dataset = used.get(one.uid, (None, None))
        archive.put_run(
            one.record, catalog["Algorithm"].get(algorithm or ""), catalog["Dataset"].get(dataset or "")
        )
        step(number)
    for uid, result in plan.results:
        archive.put_result(uid, result)
    for uid, remarks in plan.remarks.items():
        archive.annotate([uid], _joining(remarks))
    clear(home)


def _further(here: SearchRecord, *, there: SearchRecord) -> SearchRecord:
    """Return the record of a search: the one here, unless it went on from there in the other home."""
    goes_on = there.trials[: len(here.trials)] == here.trials
    return there if goes_on else here


def _joining(theirs: Remarks) -> Callable[[Remarks], Remarks]:
    return lambda mine: mine.merged(theirs)


def clear(home: Home) -> None:
    """Remove what a merge that was killed left half made.

    Raises:
        SystemFault: the disk refuses.
    """
    folder = home.path / ASIDE
    try:
        if folder.exists():
            remove(folder)
    except OSError as error:
        raise SystemFault(f"{folder}: {error.strerror or error}") from error


class _Planner:
    """Finds out what a merge does."""

    def __init__(self, home: Home, archive: Archive, other: Other) -> None:
        self._runs = home.path / "runs"
        self._other = other
        self._mine: dict[RunIdentity, RunRecord] = {}
        self._uids: set[str] = set()
        for record in archive.runs():
            self._mine[_key(record)] = record
            self._uids.add(record.uid)
        self._uids |= {one.uid for one in archive.left_out.values() if one.uid is not None}
        self._origin = other.archive.identity
        self._places: dict[Parts, Parts] = {}
        self._taken: set[Parts] = set()
        self._tally = DiskTally()
        self._found = Merge()

    def plan(self) -> Merge:
        """Return the plan of the merge."""
        for record in self._other.archive.runs():
            mine = self._mine.get(_key(record))
            if mine is None:
                self._come(record)
            else:
                self._found.known += 1
                self._compare(mine, record)
                theirs, ours = run_parts(record.folder), run_parts(mine.folder)
                if theirs and ours:
                    self._places.setdefault(theirs, ours)
        return self._found

    def _come(self, record: RunRecord) -> None:
        digits = (record.provenance.content_hash or "unknown")[:_DIGITS]
        uid = _free(record.uid, digits, lambda name: name in self._uids)
        if uid != record.uid:
            self._found.aside.append(
                f"run {record.name} ({record.uid}) is another one here: it comes as {uid}"
            )
        self._uids.add(uid)
        placed, source, target = self._place(record, digits)
        # As if it were here already: the other archive may hold one run under two UIDs.
        self._mine[_key(record)] = placed.replace(uid=uid)
        coming = Coming(record.uid, placed.replace(uid=uid), source, target, Extent())
        if source is not None and target is not None:
            coming = self._measured(coming, source)
        self._found.coming.append(coming)

    def _measured(self, coming: Coming, source: Path) -> Coming:
        """Return a run that comes with what its files take, and which of them are too much."""
        files, left_out = list(below(source)), set()
        length = sum(status.st_size for _, status in files)
        for path, status in sorted(files, key=lambda file: file[1].st_size, reverse=True):
            if length > _LIMIT_BYTES:
                length -= status.st_size
                left_out.add(path)
                self._found.left_out.append(
                    f"{path}: is not copied, as with its {status.st_size >> 20:,} MiB the run's files are "
                    f"beyond the {_LIMIT_BYTES >> 20:,} MiB that an output may have"
                )
        taken = {
            path: (status, min(status.st_size, status.st_blocks * BLOCK_BYTES))
            for path, status in files
            if path not in left_out
        }
        return replace(
            coming,
            extent=self._tally.count(status for _, status in files),
            # Files of one content may be one file of several names there, and are copied name by name.
            room=sum(size for _, size in taken.values()),
            left_out=frozenset(left_out),
            hollow=frozenset(path for path, (status, size) in taken.items() if size < status.st_size),
        )

    def _place(self, record: RunRecord, digits: str) -> tuple[RunRecord, Path | None, Parts | None]:
        """Return a run as it has its files here, their folder there, and where that is copied to."""
        parts = run_parts(record.folder)
        # An imported run's files lie where they were imported from, for both homes.
        if parts is None or record.labels.get("source") == IMPORTED:
            return record, None, None
        source = self._other.path.joinpath("runs", *parts) if self._other.path is not None else None
        if source is None or not source.is_dir():
            self._found.without += 1
            return record, None, None
        if parts in self._places:  # another run has the same files
            return _moved(record, self._runs, self._places[parts]), None, None
        sweep, name = parts
        name = _free(name, digits, lambda free: self._is_taken((sweep, free), parts))
        self._places[parts] = sweep, name
        self._taken.add((sweep, name))
        return _moved(record, self._runs, (sweep, name)), source, (sweep, name)

    def _is_taken(self, place: Parts, parts: Parts) -> bool:
        folder = self._runs.joinpath(*place)
        if place in self._taken:
            return True
        return os.path.lexists(folder) and origin_of(folder) != _origin(self._origin, parts)

    def _compare(self, mine: RunRecord, record: RunRecord) -> None:
        said, theirs = Remarks.of(mine), Remarks.of(record)
        both = said.merged(theirs)
        if not both.says_same(said):
            self._found.remarks[mine.uid] = theirs
            if said.note and both.note != said.note:
                self._found.aside.append(
                    f"run {mine.name}: a newer note there takes the place of “{said.note}”"
                )
        have = {result.evaluation: result for result in mine.results}
        for result in record.results:
            known = have.get(result.evaluation)
            if known is None:
                self._found.results.append((mine.uid, result))
            elif known != result:
                beside = result.replace(evaluation=f"{result.evaluation}@{self._other.label}")
                # An earlier merge has kept it already.
                if have.get(beside.evaluation) == beside:
                    continue
                self._found.results.append((mine.uid, beside))
                self._found.aside.append(
                    f"run {mine.name}: evaluation {result.evaluation} says something else there: it is kept "
                    f"as {beside.evaluation}"
                )


def origin_of(folder: Path) -> Mapping[str, str] | None:
    """Return the origin of a run's folder that was merged; None where it was made here."""
    try:
        found = json.loads(read_regular(str(folder / NOTE), _MOST))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _origin(identity: str, parts: Parts) -> dict[str, str]:
    return {"archive": identity, "folder": "/".join(parts)}


def _key(record: RunRecord) -> RunIdentity:
    moments = (moment.timestamp() if moment else None for moment in (record.created, record.finished))
    # Without the digits that an earlier merge gave it, or a second merge would bring the run once more.
    return RunIdentity(current_uid(record.uid), record.provenance.content_hash, *moments)


def _free(name: str, digits: str, is_taken: Callable[[str], bool]) -> str:
    """Return a name that nothing has: itself, or with digits of the content behind it."""
    if not is_taken(name):
        return name
    name = f"{name.partition('@')[0]}@{digits}"
    if not is_taken(name):
        return name
    return next(one for number in count(2) if not is_taken(one := f"{name}.{number}"))


def _moved(record: RunRecord, runs: Path, place: Parts) -> RunRecord:
    """Return a run whose files are in another place."""
    folder = str(runs.joinpath(*place))
    trajectory = record.trajectory
    if trajectory is not None and record.folder and trajectory.path:
        trajectory = trajectory.replace(path=trajectory.path.replace(record.folder, folder, 1))
    return record.replace(folder=folder, trajectory=trajectory)


def _by_hash(archive: Archive, kind: str) -> dict[str, CatalogEntry]:
    return {entry.content_hash: entry for entry in archive.catalog(kind)}


def _bring(home: Path, coming: Coming, source: Path, target: Parts, identity: str) -> list[str]:
    """Copy a run's folder to its place, whole or not at all; returns files that can't be read."""
    place, aside = home.joinpath("runs", *target), home / ASIDE / "run"
    unread: list[str] = []
    parts = (source.parts[-2], source.parts[-1])
    if origin_of(place) == _origin(identity, parts):
        return unread  # a merge that was killed had come so far

    def copy(one: str, other: str) -> None:
        try:
            (_copy_hollow if one in coming.hollow else shutil.copy2)(one, other, follow_symlinks=False)
        except PermissionError:
            unread.append(one)

    def passed_over(folder: str, names: list[str]) -> set[str]:
        return _special(folder, names) | {
            name
            for name in names
            if os.path.join(folder, name) in coming.left_out  # noqa: PTH118 - many
        }

    try:
        if aside.exists():
            remove(aside)
        aside.parent.mkdir(parents=True, exist_ok=True)
        # Links stay links: behind one there may be a recording of 100 GB that is not the run's.
        shutil.copytree(source, aside, symlinks=True, copy_function=copy, ignore=passed_over)
        write_whole(aside / NOTE, json.dumps(_origin(identity, parts)))
        # On the disk before it gets its name: what has a name is whole, also after a power cut.
        settle(aside, read_only=False)
        place.parent.mkdir(parents=True, exist_ok=True)
        aside.rename(place)
    except shutil.Error as error:
        first = error.args[0][0]
        raise SystemFault(f"{first[0]}: {first[2]}") from None
    except OSError as error:
        raise SystemFault(f"{error.filename or source}: {error.strerror or error}") from error
    return unread


def _copy_hollow(source: str, target: str, *, follow_symlinks: bool) -> None:
    """Copy a file with its times and rights as ``shutil.copy2``, its holes as holes."""
    with open(source, "rb") as origin, open(target, "xb") as copy:  # noqa: PTH123 - as shutil does
        end, there, size = 0, copy.fileno(), os.fstat(origin.fileno()).st_size
        os.ftruncate(there, size)
        while end < size:
            try:
                start = os.lseek(origin.fileno(), end, os.SEEK_DATA)
            except OSError as error:
                if error.errno != errno.ENXIO:
                    raise
                break  # nothing but a hole is left
            end = min(os.lseek(origin.fileno(), start, os.SEEK_HOLE), size)
            os.lseek(there, start, os.SEEK_SET)
            while start < end and (done := os.sendfile(there, origin.fileno(), start, end - start)):
                start += done
    shutil.copystat(source, target, follow_symlinks=follow_symlinks)


def _special(folder: str, names: list[str]) -> set[str]:
    """Return the names of neither files, folders nor links: pipes and sockets that a program left."""
    found = set()
    for name in names:
        path = Path(folder, name)
        with suppress(OSError):
            if not (path.is_symlink() or path.is_file() or path.is_dir()):
                found.add(name)
    return found
