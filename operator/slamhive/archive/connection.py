# SPDX-License-Identifier: Apache-2.0
"""Connecting to the archive's database: its settings, its tables, and its errors as sentences."""

from __future__ import annotations

import json
import re
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sqlalchemy import Connection, Engine, create_engine, event, exc, insert, inspect, select, text, update
from sqlalchemy.engine import URL, make_url

from slamhive.archive import migrations, schema
from slamhive.model.errors import InputError, SlamHiveError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Iterator

BUSY_SECONDS = 30
"""How long a writer waits for another one's transaction."""

_SQLITE_SETTINGS = (
    f"busy_timeout = {BUSY_SECONDS * 1000}",
    "foreign_keys = ON",
    "journal_mode = WAL",
    "synchronous = FULL",
)
_LOCK_KEY = 0x51A_711E
_SECRET_OPTIONS = ("password", "sslpassword")
_SCHEME = re.compile(r"\s*([A-Za-z][A-Za-z0-9+:]{0,40})://")
_DRIVERS = {"sqlite": "sqlite+pysqlite", "postgresql": "postgresql+psycopg", "postgres": "postgresql+psycopg"}


def connect(url: str) -> Engine:
    """Return an engine for a database URL, its tables made or brought to this version.

    Raises:
        InputError: the URL cannot be used, or the tables are of a newer slamhive.
        SystemFault: the database doesn't answer.
    """
    parsed = _parse(url)
    try:
        engine = create_engine(
            parsed,
            json_serializer=lambda value: json.dumps(value, allow_nan=False, separators=(",", ":")),
            pool_pre_ping=parsed.get_backend_name() == "postgresql",
        )
    except ModuleNotFoundError:
        raise InputError(
            f"archive {shown(parsed)}: PostgreSQL needs the package psycopg; "
            "install slamhive with its extra: slamhive[postgresql]"
        ) from None
    if parsed.get_backend_name() == "sqlite":
        _tune_sqlite(engine)
    try:
        with failures(parsed):
            _prepare(engine, shown(parsed))
    except BaseException:
        engine.dispose()
        raise
    return engine


def shown(url: URL | str) -> str:
    """Return a database URL as it may be printed: without its password; a file as its path.

    Raises:
        InputError: it is none.
    """
    if isinstance(url, str):
        url = _parse(url)
    if url.get_backend_name() == "sqlite" and url.database:
        return url.database
    return url.difference_update_query(_SECRET_OPTIONS).render_as_string(hide_password=True)


@contextmanager
def failures(url: URL) -> Iterator[None]:
    """Turn the database's errors into sentences.

    Raises:
        InputError: the file is no database.
        SystemFault: everything else, worth another try.
    """
    try:
        yield
    except exc.DBAPIError as error:
        cause = " ".join(str(error.orig).split())
        if "not a database" in cause:
            raise InputError(f"archive {shown(url)}: the file is not an SQLite database") from None
        raise SystemFault(f"archive {shown(url)}: {cause}") from error
    except exc.SQLAlchemyError as error:
        raise SystemFault(f"archive {shown(url)}: {error}") from error


@contextmanager
def writing(engine: Engine) -> Iterator[Connection]:
    """Open a transaction that holds the writer's place from its beginning, committed at the end.

    Taking it at once is what lets a second writer wait its turn instead of failing halfway.
    """
    with (
        failures(engine.url),
        engine.connect().execution_options(slamhive_write=True) as connection,
        connection.begin(),
    ):
        yield connection


@contextmanager
def reading(engine: Engine) -> Iterator[Connection]:
    """Open a transaction that sees one state of the database."""
    with failures(engine.url), engine.connect() as connection:
        yield connection


def _parse(url: str) -> URL:
    try:
        parsed = make_url(url.strip())
        backend = parsed.drivername.split("+")[0]
    except (exc.ArgumentError, ValueError):
        backend, parsed = "", URL.create("none")
    is_server = any((parsed.username, parsed.password, parsed.host, parsed.port))
    if backend not in _DRIVERS or (backend == "sqlite" and is_server):
        raise InputError(
            f"archive: {_beginning(url)} is not a database URL; allowed are sqlite:///PATH and "
            "postgresql://USER:PASSWORD@HOST/DATABASE"
        )
    if is_server and "@" in f"{parsed.host}{parsed.database}":
        # What follows the first @ would be taken for the host, and be shown.
        raise InputError(
            f"archive: {_beginning(url)} holds more than one @; in a user's name or password it is written "
            "%40, and / is written %2F"
        )
    parsed = parsed.set(drivername=_DRIVERS[backend])
    if parsed.get_backend_name() == "sqlite" and parsed.database not in (None, "", ":memory:"):
        folder = Path(str(parsed.database)).parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"archive {parsed.database}: {folder}: {error.strerror}") from None
    return parsed


def _beginning(url: str) -> str:
    """Return as much of a text as holds no password, however wrongly it is written."""
    found = _SCHEME.match(url)
    return f"'{found[1]}://…'" if found else "what is given"


def _tune_sqlite(engine: Engine) -> None:
    def prepare(connection: Any, _record: Any) -> None:
        # The driver's own transactions begin too late; the event below begins them.
        connection.isolation_level = None
        try:
            for setting in _SQLITE_SETTINGS:
                connection.execute(f"PRAGMA {setting}").close()
        except Exception:
            connection.close()
            raise

    def begin(connection: Connection) -> None:
        write = connection.get_execution_options().get("slamhive_write")
        connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")

    event.listen(engine, "connect", prepare)
    event.listen(engine, "begin", begin)


def _prepare(engine: Engine, name: str) -> None:
    """Make the tables, or bring them to this version, once among all processes that open the archive."""
    with engine.connect() as connection:
        if _version(connection) == schema.VERSION:
            return
    with writing(engine) as connection:
        if engine.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK_KEY})
        found = _version(connection)
        if found is None:
            schema.metadata.create_all(connection)
            connection.execute(insert(schema.schema_version).values(version=schema.VERSION))
            return
        if found > schema.VERSION:
            raise InputError(
                f"archive {name}: written by a newer slamhive (schema {found}; this one knows up to "
                f"{schema.VERSION}); update slamhive or name another archive in SLAMHIVE_ARCHIVE"
            )
        _migrate(connection, found, name)


def _migrate(connection: Connection, found: int, name: str) -> None:
    for version in range(found, schema.VERSION):
        step = migrations.STEPS.get(version)
        if step is None:
            raise SlamHiveError(f"archive {name}: schema {version} can't be brought to {schema.VERSION}")
        step(connection)
    connection.execute(update(schema.schema_version).values(version=schema.VERSION))


def _version(connection: Connection) -> int | None:
    if not inspect(connection).has_table(schema.schema_version.name):
        return None
    return connection.execute(select(schema.schema_version.c.version)).scalar()
