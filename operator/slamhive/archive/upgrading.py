# SPDX-License-Identifier: Apache-2.0
"""Bringing an archive of an earlier slamhive to this version.

The operator does it, and ``slamhive archive upgrade``; a workstation's own file is brought along by whoever
writes to it. All others refuse an archive of another version.
"""

from __future__ import annotations

import filecmp
import sqlite3
from contextlib import closing, contextmanager, suppress
from typing import TYPE_CHECKING, Any, NamedTuple

from sqlalchemy import bindparam, func, select, update

from slamhive.archive import documents, migrations, schema
from slamhive.archive.connection import (
    alone_with_tables,
    exclusively,
    failures,
    file_of,
    made_aside,
    open_engine,
    parse,
    publish,
    reading,
    require_content,
    shown,
    version_of,
    writing,
    wrong_version,
)
from slamhive.archive.rows import why
from slamhive.model.errors import InputError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from sqlalchemy import Connection, Engine, Table

_RUNS = 1000
"""Runs whose documents are divided in a transaction."""

_PAGES = 250
"""Pages copied before it is said how far a copy is."""


class Upgrade(NamedTuple):
    """Result of upgrading an archive: versions of its tables before and after, and the copy of its old file.

    Attributes:
        before, after: versions of its tables.
        copy: the file as it was before; None for a server, which keeps its own.
    """

    before: int
    after: int
    copy: Path | None


def upgrade(url: str, tell: Callable[[str], None] = lambda _: None) -> Upgrade | None:
    """Bring an archive's tables to this version, all of it or nothing, and then its documents.

    Documents that are not divided yet are as good as those that are; an upgrade that ends in the middle of
    them goes on with the next one.

    Args:
        url: the database's URL.
        tell: told what is being done, as that may take minutes.

    Returns:
        What was done; None where nothing was to be done, or there is no archive yet.

    Raises:
        InputError: the URL cannot be used, the file is damaged, or the tables are of a newer slamhive.
        SystemFault: the database doesn't answer, or there is no room for a copy.
    """
    parsed = parse(url)
    file = file_of(parsed)
    if file is not None:
        if not file.exists():
            return None
        require_content(file)
    engine = open_engine(parsed)
    try:
        with reading(engine) as connection:
            found = version_of(connection)
        done = None if found in {None, schema.VERSION} else _upgrade(engine, file, tell)
        if found is not None and found <= schema.VERSION:
            divide_documents(engine, tell)
        return done
    finally:
        engine.dispose()


def copy_database(
    origin: sqlite3.Connection, target: Path, share: Callable[[float], None] = lambda _: None
) -> bool:
    """Copy an SQLite database as of its last commit, also while others write to it.

    Args:
        origin: the database.
        target: the copy, one file that is whole when it is there. One that is there already stays as it is.
        share: told how much is copied, 0 to 1.

    Returns:
        Whether the copy was made.

    Raises:
        SystemFault: the disk refuses.
    """
    with copying(target) as aside:
        _copy(origin, aside, share)
        return publish(aside, target)


@contextmanager
def copying(target: Path) -> Iterator[Path]:
    """Yield a name for a copy of a database while it is made; as ``made_aside``.

    Raises:
        SystemFault: the disk refuses.
    """
    try:
        with made_aside(target) as aside:
            yield aside
    except (OSError, sqlite3.Error) as error:
        raise SystemFault(f"{target}: a copy of the archive can't be made: {error}") from None


def _copy(origin: sqlite3.Connection, target: Path, share: Callable[[float], None] = lambda _: None) -> None:
    with closing(sqlite3.connect(target)) as copy, _one_moment(origin):
        origin.backup(
            copy, pages=_PAGES, progress=lambda _, left, total: share(1 - left / total if total else 1.0)
        )
        # Its log comes into the file, which so is all of it wherever it is carried.
        copy.execute("PRAGMA journal_mode = DELETE").close()


@contextmanager
def _one_moment(connection: sqlite3.Connection) -> Iterator[None]:
    """Let a connection see one state of its database: a copy in steps begins anew where others write."""
    begun = not connection.in_transaction
    if begun:
        connection.execute("BEGIN").close()
    try:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()  # it is seen from here on
        yield
    finally:
        if begun:
            connection.rollback()


def _upgrade(engine: Engine, file: Path | None, tell: Callable[[str], None]) -> Upgrade | None:
    with exclusively(engine) as connection:
        alone_with_tables(connection)
        column = schema.schema_version.c.version
        # Waits for those that write by the present version; they find the new one then.
        found = connection.execute(select(column).with_for_update()).scalar_one()
        if found == schema.VERSION:
            return None
        if found > schema.VERSION or found not in migrations.STEPS:
            raise wrong_version(engine.url, found)
        tell("copying the archive")
        copy = _keep(file, found) if file is not None else None
        migrate(connection, found, tell)
    return Upgrade(found, schema.VERSION, copy)


def migrate(connection: Connection, found: int, tell: Callable[[str], None] = lambda _: None) -> None:
    """Bring tables of a version to this one in the transaction of a connection."""
    for version in range(found, schema.VERSION):
        tell(f"bringing the archive from schema {version} to {version + 1}")
        try:
            migrations.STEPS[version](connection)
        except documents.UNREADABLE as error:
            raise InputError(
                f"archive {shown(connection.engine.url)}: a row of it can't be read, so it stays as it is: "
                f"{why(error)}"
            ) from error
    connection.execute(update(schema.schema_version).values(version=schema.VERSION))


def divide_documents(engine: Engine, tell: Callable[[str], None] = lambda _: None) -> None:
    """Write once what documents of an earlier version have in common, from where the last one ended.

    Args:
        engine: a database of this version.
        tell: told how far it is.
    """
    marked = schema.schema_version.c.divided_to
    with reading(engine) as connection:
        begun = connection.execute(select(marked)).scalar()
        if begun is None:
            return
        number, runs = func.count(), schema.runs
        count = connection.execute(select(number).select_from(runs)).scalar_one()
        done = connection.execute(select(number).select_from(runs).where(runs.c.id <= begun)).scalar_one()
    while True:
        with writing(engine) as connection:
            begun = connection.execute(select(marked).with_for_update()).scalar()
            if begun is None:
                break
            last, some = _divide_some(connection, begun)
            connection.execute(update(schema.schema_version).values(divided_to=last))
        if last is None:
            break
        done += some
        tell(f"writing once what runs have in common: {done:,} of {count:,} runs")
    _give_back(engine, tell)


def _divide_some(connection: Connection, begun: int) -> tuple[int | None, int]:
    """Divide the documents of the next runs; return the last one's id, None at the end, and their number."""
    runs, results = schema.runs.c, schema.results.c
    asked = select(runs.id, *(documents.raw(connection, runs[name]) for name in documents.DOCUMENTS["runs"]))
    held = connection.execute(asked.where(runs.id > begun).order_by(runs.id).limit(_RUNS).with_for_update())
    found = [dict(row) for row in held.mappings()]
    if not found:
        return None, 0
    last = found[-1]["id"]
    rows = _sound(connection, schema.runs, found)
    wanted = select(results.run_id, results.evaluation, documents.raw(connection, results["values"]))
    there = connection.execute(wanted.where(results.run_id.between(begun + 1, last)).with_for_update())
    measured = _sound(connection, schema.results, [dict(row) for row in there.mappings()])
    documents.store(connection, ("runs", rows), ("results", measured))
    _replace(connection, schema.runs, ("id",), rows)
    _replace(connection, schema.results, ("run_id", "evaluation"), measured)
    return last, len(found)


def _sound(connection: Connection, table: Table, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return opened rows without those that can't be read, which stay as they are."""
    (wrong,) = documents.opened(connection, (table, rows))
    return [row for row, problem in zip(rows, wrong, strict=True) if problem is None]


def _replace(
    connection: Connection, table: Table, key: tuple[str, ...], rows: Sequence[dict[str, Any]]
) -> None:
    """Write some columns of rows by their keys."""
    if not rows:
        return
    changed = [name for name in rows[0] if name not in key]
    change = (
        update(table)
        .where(*(table.c[name] == bindparam(f"of_{name}") for name in key))
        .values({name: bindparam(f"to_{name}") for name in changed})
    )
    connection.execute(
        change, [{f"{'of' if name in key else 'to'}_{name}": row[name] for name in row} for row in rows]
    )


def _give_back(engine: Engine, tell: Callable[[str], None]) -> None:
    """Make an SQLite file smaller; a disk without room for a copy of it leaves it as it is."""
    if engine.dialect.name != "sqlite":
        return  # a server uses the room again by itself
    tell("making the archive's file smaller")
    with suppress(SystemFault), failures(engine.url), engine.connect() as connection:
        held: Any = connection.connection.driver_connection
        held.execute("VACUUM").close()


def _keep(file: Path, version: int) -> Path:
    """Copy an archive's file beside it under a name that is free, and return the copy.

    An upgrade that was ended has left one: where that is equal, it is the copy.
    """
    kept = copy = file.with_name(f"{file.name}.schema-{version}")
    with copying(kept) as aside, closing(sqlite3.connect(file)) as origin:
        _copy(origin, aside)
        number = 0
        while not publish(aside, copy) and not filecmp.cmp(aside, copy, shallow=False):
            number += 1
            copy = kept.with_name(f"{kept.name}.{number}")
    return copy
