# SPDX-License-Identifier: Apache-2.0
"""Keeping an archive: looking it through for damage, copying it, and bringing a copy back.

A backup is an archive of its own, in an SQLite file, whatever database it was taken from: it can be restored
to any other, and read as it is.
"""

from __future__ import annotations

import sqlite3
import uuid
from collections.abc import Callable
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any

from sqlalchemy import delete, func, insert, select, text, update

from slamhive.analysis.compact.shapes import Shape
from slamhive.archive import documents as documents_of_runs
from slamhive.archive import schema
from slamhive.archive.archive import BATCH
from slamhive.archive.connection import (
    connect,
    exclusively,
    file_of,
    nothing_of_ours,
    open_engine,
    parse,
    reading,
    require_content,
    shown,
    version_of,
    writing,
)
from slamhive.archive.records import CatalogEntry, SweepRecord, run_row, to_record, to_result
from slamhive.archive.rows import why
from slamhive.archive.upgrading import copy_database, copying, upgrade
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from sqlalchemy import Connection, Engine, Table

_TABLES = (schema.algorithms, schema.datasets, schema.sweeps, schema.shapes, schema.runs, schema.results)
Tell = Callable[[str, float], None]
"""Is told what is being done, and how much of it is, 0 to 1."""

_COMPARED = ("algorithm", "dataset", "sensors", "pace", "repetition", "seed", "content_hash", "reused_from")


@dataclass
class ArchiveFindings:
    """Row counts, damage and remarks from a check of an archive.

    Attributes:
        counts: rows by table.
        faults: what is damaged, a sentence each.
        notes: what is worth knowing and no damage.
    """

    counts: dict[str, int] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def _quiet(what: str, share: float) -> None:
    """Tell nobody."""


def check(url: str, tell: Tell = _quiet) -> ArchiveFindings:
    """Look an archive through: its file, then whether each row says what it should.

    Runs have records that can be read and agree with their columns, none is there twice, results belong to
    runs, and runs to sweeps.

    Args:
        url: the database's URL.
        tell: told how far it is.

    Raises:
        InputError: there is no archive, it can't be opened at all, or it is of another version.
        SystemFault: the database doesn't answer.
    """
    findings = ArchiveFindings()
    engine = connect(url, read_only=True)
    try:
        with reading(engine) as connection:
            if engine.dialect.name == "sqlite":
                rows = connection.exec_driver_sql("PRAGMA integrity_check(100)").scalars()
                findings.faults += [f"file: {row}" for row in rows if row != "ok"]
            # What stands on damaged pages would be reported over and over.
            if not findings.faults:
                _check_rows(connection, findings, tell)
    finally:
        engine.dispose()
    return findings


def backup(url: str, target: Path, tell: Tell = _quiet) -> dict[str, int]:
    """Copy an archive to a file, as it is at one moment, and look the copy through.

    Programs that work with the archive go on.

    Args:
        url: the database's URL.
        target: the copy; whole when it is there.
        tell: told how far it is.

    Returns:
        Rows of the copy by table.

    Raises:
        InputError: there is no archive, it is of another version, the file is there already, or what was
            copied is damaged: the copy stays, as nothing better may be left.
        SystemFault: the database doesn't answer, or the disk refuses.
    """
    if target.exists():
        raise InputError(f"{target}: exists already; a backup never replaces a file")
    if not target.parent.is_dir():
        raise InputError(f"{target.parent}: no such folder")
    engine = connect(url, read_only=True)
    try:
        made = _copied(engine, target, tell)
    finally:
        engine.dispose()
    if not made:
        raise InputError(f"{target}: exists already; a backup never replaces a file")
    found = check(f"sqlite:///{target.absolute()}", lambda _, share: tell("looking the copy through", share))
    if found.faults:
        raise InputError(
            f"{target}: is a copy of what there is, but damaged ({found.faults[0]}); "
            "`slamhive archive check` says whether the archive is"
        )
    return found.counts


def restore(url: str, source: Path, *, force: bool = False, tell: Tell = _quiet) -> dict[str, int]:
    """Put what a backup holds in the place of what an archive holds, all of it or nothing.

    The archive gets a new identity: it may know less than it did, and whoever removes what it doesn't know
    is to ask first. A file that is empty or, with ``force``, damaged is set aside under another name.

    Args:
        url: the database's URL; made where there is none.
        source: a backup, of this version or an earlier one; it stays as it is.
        force: whether what is there may be replaced.
        tell: told how far it is.

    Returns:
        Rows by table.

    Raises:
        InputError: the backup can't be used, or the archive holds something.
        SystemFault: the database doesn't answer, or the disk refuses.
    """
    with _as_archive(source) as copy:
        faults = check(copy, lambda _, share: tell("looking the backup through", share)).faults
        if faults:
            raise InputError(f"{source}: is damaged, so nothing was restored: {faults[0]}")
        _set_aside_what_is_lost(url, force=force)
        origin, engine = connect(copy, read_only=True), connect(url)
        try:
            with reading(origin) as held, writing(engine) as connection:
                if not force and not _is_empty(connection):
                    raise InputError(
                        f"archive {shown(url)}: holds runs or sweeps already; --force puts the backup in the "
                        "place of all of it (`slamhive archive backup` keeps it first)"
                    )
                for table in reversed(_TABLES):
                    connection.execute(delete(table))
                counts = _copy_rows(held, connection, lambda share: tell("restoring the archive", share))
                connection.execute(update(schema.schema_version).values(identity=str(uuid.uuid4())))
        finally:
            origin.dispose()
            engine.dispose()
    return counts


def _set_aside_what_is_lost(url: str, *, force: bool) -> None:
    """Give the file of an archive that can't be written to any more another name."""
    file = file_of(url)
    if file is None or not file.exists():
        return
    if file.stat().st_size and (not force or _is_sound(url)):
        return
    number = 0
    while True:
        aside = file.with_name(f"{file.name}.damaged" + (f".{number}" if number else ""))
        if not aside.exists():
            break
        number += 1
    # What stands beside it goes along: to another file of the name it would be a log of foreign changes.
    for rest in ("-shm", "-wal", ""):
        with suppress(FileNotFoundError):
            file.with_name(f"{file.name}{rest}").rename(f"{aside}{rest}")


def _is_sound(url: str) -> bool:
    engine = open_engine(parse(url), read_only=True)
    try:
        with reading(engine) as connection:
            return connection.exec_driver_sql("PRAGMA quick_check(1)").scalar() == "ok"
    except InputError:
        return False
    finally:
        engine.dispose()


@contextmanager
def _as_archive(source: Path) -> Iterator[str]:
    """Yield the URL of a copy of a backup that is of this version and may be written to."""
    if not source.is_file():
        problem = "a folder; name the backup in it" if source.is_dir() else "no such file"
        raise InputError(f"{source}: {problem}")
    if "?" in str(source):  # what follows it in a database URL would be taken for options
        raise InputError(f"{source}: a path with a question mark is not allowed")
    require_content(source)
    url = f"sqlite:///{source}"
    with reading(open_engine(parse(url), read_only=True)) as connection:
        current = version_of(connection)
        if current is None:
            raise InputError(f"{source}: is no backup: it {nothing_of_ours(connection)}")
    if current == schema.VERSION:
        yield url
        return
    with copying(source) as aside:
        with closing(sqlite3.connect(source)) as origin:
            copy_database(origin, aside)
        url = f"sqlite:///{aside}"
        done = upgrade(url)
        if done is not None and done.copy is not None:
            done.copy.unlink()
        yield url


def _copied(engine: Engine, target: Path, tell: Tell) -> bool:
    """Copy an archive to a file; tells whether the name was free."""

    def share(done: float) -> None:
        tell("copying the archive", done)

    if engine.dialect.name == "sqlite":
        with reading(engine) as held:
            origin: Any = held.connection.driver_connection
            return copy_database(origin, target, share)
    with copying(target) as aside:
        copy = connect(f"sqlite:///{aside}")
        try:
            with reading(engine) as held, exclusively(copy) as connection:
                held.exec_driver_sql("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ")
                _copy_rows(held, connection, share)
                identity = held.execute(select(schema.schema_version.c.identity)).scalar()
                connection.execute(update(schema.schema_version).values(identity=identity))
        finally:
            copy.dispose()
        with closing(sqlite3.connect(aside)) as whole:
            return copy_database(whole, target)


def _copy_rows(held: Connection, target: Connection, share: Callable[[float], None]) -> dict[str, int]:
    total, done = sum(_counts(held).values()), 0
    counts = {}
    for table in _TABLES:
        rows = held.execution_options(yield_per=BATCH).execute(select(table)).mappings()
        counts[table.name] = 0
        while batch := [dict(row) for row in islice(rows, BATCH)]:
            target.execute(insert(table), batch)
            counts[table.name] += len(batch)
            done += len(batch)
            share(done / total)
    if target.dialect.name == "postgresql":
        target.execute(
            text(
                "SELECT setval(pg_get_serial_sequence('runs', 'id'), "
                "greatest((SELECT coalesce(max(id), 0) + 1 FROM runs), 1), false)"
            )
        )
    return counts


def _counts(connection: Connection) -> dict[str, int]:
    return {
        table.name: connection.execute(select(func.count()).select_from(table)).scalar_one()
        for table in _TABLES
    }


def _is_empty(connection: Connection) -> bool:
    return not any(
        connection.execute(select(func.count()).select_from(table)).scalar()
        for table in (schema.runs, schema.sweeps)
    )


def _check_rows(connection: Connection, found: ArchiveFindings, tell: Tell) -> None:
    found.counts |= _counts(connection)
    total, done = sum(found.counts.values()), 0
    looks: tuple[tuple[Table, Callable[[dict[str, Any]], object]], ...] = (
        (schema.shapes, _check_shape),
        (schema.runs, _check_run),
        (schema.results, to_result),
        (schema.sweeps, SweepRecord.model_validate),
        (schema.algorithms, partial(_entry, "Algorithm")),
        (schema.datasets, partial(_entry, "Dataset")),
    )
    for table, look in looks:
        for name, row in _rows(connection, table, found):
            done += 1
            if not done % BATCH:
                tell("checking the archive", done / total)
            try:
                look(row)
            except documents_of_runs.UNREADABLE as error:
                found.faults.append(f"{table.name}: {name}: {why(error)}")
    _check_references(connection, found)


def _check_references(connection: Connection, found: ArchiveFindings) -> None:
    runs, results, sweeps = schema.runs.c, schema.results.c, schema.sweeps.c
    twice = select(runs.uid, func.count()).group_by(runs.uid).having(func.count() > 1)
    for uid, count in connection.execute(twice):
        found.faults.append(f"runs: {uid}: stands there {count} times")
    lost = select(results.run_id, results.evaluation).where(results.run_id.not_in(select(runs.id)))
    for run, evaluation in connection.execute(lost):
        found.faults.append(f"results: {run} {evaluation}: its run is missing")
    for column, table in (("algorithm", schema.algorithms), ("dataset", schema.datasets)):
        hashed = runs[f"{column}_hash"]
        alone = hashed.is_not(None) & hashed.not_in(select(table.c.content_hash))
        for uid in connection.execute(select(runs.uid).where(alone)).scalars():
            found.faults.append(f"runs: {uid}: the {column} that it used is missing")
    unknown = runs.sweep_uid.is_not(None) & runs.sweep_uid.not_in(select(sweeps.uid))
    query = select(runs.sweep, func.count()).where(unknown).group_by(runs.sweep, runs.sweep_uid)
    for name, count in connection.execute(query):
        found.notes.append(f"{count} of the runs belong to a sweep {name!r} that is missing")


def _rows(
    connection: Connection, table: Table, found: ArchiveFindings
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Go through a table's rows by their names; one that can't be read is noted and left out."""
    shapes = documents_of_runs.read_all(connection) if table.name in documents_of_runs.DOCUMENTS else {}
    columns = documents_of_runs.all_raw(connection, table)
    asked = connection.execution_options(yield_per=BATCH).execute(select(*columns))
    for held in asked.mappings():
        row = dict(held)
        name = str(row["uid"]) if "uid" in row else " ".join(str(row[key.name]) for key in table.primary_key)
        ((wrong,),) = documents_of_runs.opened(connection, (table, [row]), shapes=shapes)
        if wrong is not None:
            found.faults.append(f"{table.name}: {name}: {why(wrong)}")
        else:
            yield name, row


def _check_run(row: dict[str, Any]) -> None:
    """Check that a run has a record, and that what is asked for often says the same as its documents.

    Raises:
        ValueError: it does not.
    """
    again = run_row(to_record(row, ()))
    for name in _COMPARED:
        if again[name] != row[name]:
            raise ValueError(f"column {name} is {row[name]!r}, where its documents say {again[name]!r}")


def _check_shape(row: dict[str, Any]) -> None:
    """Check that a shape is what its number says.

    Raises:
        ValueError: it is not.
    """
    documents_of_runs.parsed(row["text"])
    if Shape.of(row["text"]).number != row["number"]:
        raise ValueError("its text does not match its number")


def _entry(kind: str, row: Mapping[str, Any]) -> None:
    fields = ("name", "labels", "attributes", "spec")
    entry = CatalogEntry.model_validate({"kind": kind} | {name: row[name] for name in fields})
    if entry.content_hash != row["content_hash"]:
        raise ValueError("its content does not match its hash")
