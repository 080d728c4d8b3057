# SPDX-License-Identifier: Apache-2.0
"""Bringing an archive of an earlier slamhive to this version.

The operator does it, and ``slamhive archive upgrade``; a workstation's own file is brought along by whoever
writes to it. All others refuse an archive of another version.
"""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, NamedTuple

from sqlalchemy import select, update

from slamhive.archive import migrations, schema
from slamhive.archive.connection import (
    alone_with_tables,
    exclusively,
    file_of,
    open_engine,
    parse,
    publish,
    reading,
    remove_database,
    require_content,
    version_of,
    wrong_version,
)
from slamhive.model.errors import SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from sqlalchemy import Connection, Engine

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
    """Bring an archive's tables to this version, all of it or nothing.

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
        return None if found in {None, schema.VERSION} else _upgrade(engine, file, tell)
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
    aside = target.with_name(f".{target.name}.{os.urandom(6).hex()}.making")
    try:
        with closing(sqlite3.connect(aside)) as copy, _one_moment(origin):
            origin.backup(
                copy,
                pages=_PAGES,
                progress=lambda _, left, total: share(1 - left / total if total else 1.0),
            )
            # Its log comes into the file, which so is all of it wherever it is carried.
            copy.execute("PRAGMA journal_mode = DELETE").close()
        return publish(aside, target)
    except (OSError, sqlite3.Error) as error:
        raise SystemFault(f"{target}: a copy of the archive can't be made: {error}") from None
    finally:
        remove_database(aside)


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
        migrations.STEPS[version](connection)
    connection.execute(update(schema.schema_version).values(version=schema.VERSION))


def _keep(file: Path, version: int) -> Path:
    """Copy an archive's file beside it under a name that is free, and return the copy."""
    number = 0
    while True:
        copy = file.with_name(f"{file.name}.schema-{version}" + (f".{number}" if number else ""))
        with closing(sqlite3.connect(file)) as origin:
            if copy_database(origin, copy):
                return copy
        number += 1
