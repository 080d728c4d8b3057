# SPDX-License-Identifier: Apache-2.0
"""Connecting to the archive's database: its settings, its tables, and its errors as sentences."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import shutil
import sqlite3
import stat
import uuid
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from sqlalchemy import Connection, Engine, create_engine, event, exc, insert, inspect, select, text
from sqlalchemy.dialects import sqlite
from sqlalchemy.engine import URL, make_url

from slamhive.analysis.compact.shapes import MissingShapeError
from slamhive.archive import schema
from slamhive.data.files.once import flush
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.extras import without

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sqlalchemy import Dialect, Table

_AWAY = re.compile(r"08...|57P0[1-5]")
"""SQLSTATEs of a server that ends, begins, or is not reached."""


class DatabaseAway(SystemFault):
    """A database server is not reached, or ended while it was asked: it may be restarting."""


BUSY_SECONDS = 30
"""Longest wait of a writer for another one's transaction."""

_BUSY = f"busy_timeout = {BUSY_SECONDS * 1000}"
_PAGE_BYTES = 16384
"""Of a new file: rows of some 2 kB leave less of a large page empty, a tenth of the file."""
_SQLITE_SETTINGS = (
    *(_BUSY, f"page_size = {_PAGE_BYTES}"),  # before the log: its first page has the size for good
    *("foreign_keys = ON", "journal_mode = WAL", "synchronous = FULL"),
)
_SQLITE_READING = (_BUSY, "query_only = ON")
_POSTGRESQL_READING = "SET SESSION CHARACTERISTICS AS TRANSACTION READ ONLY"
_GIVING_UP = {
    "connect_timeout": 10,
    "tcp_user_timeout": 15_000,
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
}
"""Settings of libpq, in s and ms: without them a server that vanishes is waited for by the quarter hour."""
_LOCK_KEY = 0x51A_711E
_SECRET_OPTIONS = ("password", "sslpassword")
_SCHEME = re.compile(r"\s*([A-Za-z][A-Za-z0-9+:]{0,40})://")
_DRIVERS = {"sqlite": "sqlite+pysqlite", "postgresql": "postgresql+psycopg", "postgres": "postgresql+psycopg"}
_READ_ONLY = (
    "; it takes no writes: a replica, a server with default_transaction_read_only, a file or folder that "
    "this user can't write, or a file system mounted read-only"
)
_FULL = "; what it holds stays: make room{}, and the same command goes on"
_ADVICE: dict[str | int, str] = {
    "25006": _READ_ONLY,  # PostgreSQL's SQLSTATE, the same in every language of a server
    "53100": _FULL.format(" on the server's disk"),
    sqlite3.SQLITE_READONLY: _READ_ONLY,
}
_OF_FULL_DISKS = (sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN)
"""Further errors of SQLite where a disk is full: it can't make the files beside its own."""

_NO_ARCHIVE = "holds no archive yet; the first command that writes to it makes the tables"
_SHOWN_TABLES = 3
_LEAST_BYTES = 1 << 16
"""Room that SQLite needs to open an archive at all: its index of the log has 32 KiB."""
_DAMAGED = ("malformed", "Could not decode to UTF-8", "no such table", "no such column")


def connect(url: str, *, read_only: bool = False, held: bool = False) -> Engine:
    """Return an engine for a database URL whose tables are of this version.

    Args:
        url: the database's URL.
        read_only: let no connection write. A file in a folder that can't be written, or on a full disk, is
            read all the same. Otherwise tables are made where there are none; those of another version are
            never changed.
        held: the engine is kept while others write: a disk that is full will not always be.

    Raises:
        InputError: the URL cannot be used, the file is damaged or emptied, the tables are of another version
            or, to be read alone, not there.
        SystemFault: the database doesn't answer.
    """
    parsed = parse(url)
    file = file_of(parsed)
    if file is not None:
        if read_only and not file.exists():
            raise InputError(f"no archive at {file}; slamhive demo, run and import make one")
        if not read_only and not file.exists():
            _make_file(file, parsed)
        require_content(file)
    engine = open_engine(parsed, read_only=read_only, held=held)
    try:
        with failures(parsed):
            _prepare(engine, read_only=read_only)
    except BaseException:
        engine.dispose()
        raise
    return engine


def open_engine(parsed: URL, *, read_only: bool = False, held: bool = False) -> Engine:
    """Return an engine with the settings of all archives, whatever tables it may find.

    Raises:
        InputError: a package for the database is missing, or the file can't be read where it is.
    """
    options: dict[str, Any] = {}
    file = file_of(parsed)
    if read_only and file is not None and not _takes_files(file.parent, held=held):
        place = _read_only_name(file)
        options["creator"] = lambda: sqlite3.connect(place, uri=True, check_same_thread=False)
    try:
        engine = create_engine(
            parsed,
            json_serializer=lambda value: json.dumps(value, allow_nan=False, separators=(",", ":")),
            pool_pre_ping=parsed.get_backend_name() == "postgresql",
            **options,
        )
    except ModuleNotFoundError:
        raise without(f"archive {shown(parsed)}: PostgreSQL", "psycopg", "postgresql") from None
    if parsed.get_backend_name() == "sqlite":
        _tune_sqlite(engine, _SQLITE_READING if read_only else _SQLITE_SETTINGS)
    else:
        _tune_postgresql(engine, read_only=read_only)
    return engine


def shown(url: URL | str) -> str:
    """Return a database URL as it may be printed: without its password; a file as its path.

    Raises:
        InputError: it is none.
    """
    if isinstance(url, str):
        url = parse(url)
    if url.get_backend_name() == "sqlite" and url.database:
        return url.database
    return url.difference_update_query(_SECRET_OPTIONS).render_as_string(hide_password=True)


def file_of(url: URL | str) -> Path | None:
    """Return the file of an SQLite database; None for one in memory or behind a server.

    Raises:
        InputError: it is no database URL.
    """
    if isinstance(url, str):
        url = parse(url)
    if url.get_backend_name() != "sqlite" or url.database in {None, "", ":memory:"}:
        return None
    return Path(str(url.database))


@contextmanager
def failures(url: URL) -> Iterator[None]:
    """Turn the database's errors into sentences.

    Raises:
        InputError: the file is no database, or is damaged.
        SystemFault: everything else, worth another try.
    """
    try:
        yield
    except exc.DBAPIError as error:
        cause = " ".join(str(error.orig).split())
        if "not a database" in cause:
            raise InputError(f"archive {shown(url)}: the file is not an SQLite database") from None
        if any(words in cause for words in _DAMAGED):
            raise _damaged(url, cause) from error
        file = file_of(url)
        if file is not None and _is_full(error.orig, file.parent):
            raise _full(file) from error
        kind = DatabaseAway if file is None and _is_away(error) else SystemFault
        raise kind(f"archive {shown(url)}: {cause}{_advice(error.orig)}") from error
    except exc.SQLAlchemyError as error:
        raise SystemFault(f"archive {shown(url)}: {error}") from error
    except json.JSONDecodeError as error:
        raise _damaged(url, f"a document in it is no JSON: {error}") from error
    except MissingShapeError as error:
        raise _damaged(url, str(error)) from error


def insert_into(dialect: Dialect, table: Table) -> Any:
    """Return the database's own INSERT: both know ON CONFLICT, and SQLAlchemy names it by dialect."""
    if dialect.name == "postgresql":
        from sqlalchemy.dialects import postgresql  # noqa: PLC0415 - takes 0.1 s, SQLite needs it not

        return postgresql.insert(table)
    return sqlite.insert(table)


@contextmanager
def writing(engine: Engine) -> Iterator[Connection]:
    """Open a transaction that holds the writer's place from its beginning, committed at the end.

    Taking it at once is what lets a second writer wait its turn instead of failing halfway.

    Raises:
        InputError: another slamhive has brought the tables to another version since they were opened.
    """
    with exclusively(engine) as connection:
        # Shared: who changes the version waits for those who write by it, and they for the change.
        require_version(connection, shared=True)
        yield connection


@contextmanager
def exclusively(engine: Engine) -> Iterator[Connection]:
    """Open a transaction as ``writing`` does, whatever tables there are."""
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


def require_version(connection: Connection, *, shared: bool = False) -> None:
    """Check that the tables are those that this program knows.

    Args:
        connection: the database.
        shared: keep the version from being changed until the transaction ends.

    Raises:
        InputError: they are of another version.
    """
    column = schema.schema_version.c.version
    query = select(column).with_for_update(read=True) if shared else select(column)
    found = connection.execute(query).scalar()
    if found != schema.VERSION:
        raise wrong_version(connection.engine.url, found)


def version_of(connection: Connection) -> int | None:
    """Return the version of the tables; None where there are none."""
    if not inspect(connection).has_table(schema.schema_version.name):
        return None
    found = connection.execute(select(schema.schema_version.c.version)).scalar()
    if found is not None and not isinstance(found, int):
        raise _damaged(connection.engine.url, f"the version of its tables is {found!r}")
    return found


def wrong_version(url: URL, found: int | None) -> InputError:
    """Return the error that says what to do about tables of another version."""
    name = shown(url)
    if found is None:
        return InputError(f"archive {name}: {_NO_ARCHIVE}")
    if found > schema.VERSION:
        return InputError(
            f"archive {name}: written by a newer slamhive (schema {found}; this one knows up to "
            f"{schema.VERSION}); update slamhive or name another archive in SLAMHIVE_ARCHIVE"
        )
    return InputError(
        f"archive {name}: written by an earlier slamhive (schema {found}; this one needs {schema.VERSION}); "
        "`slamhive archive upgrade` brings it up to date"
        + (", as the operator of a newer chart does" if url.get_backend_name() == "postgresql" else "")
    )


def nothing_of_ours(connection: Connection) -> str:
    """Return the end of a sentence on a database without an archive: the tables that it holds."""
    tables = sorted(inspect(connection).get_table_names())
    if not tables:
        return _NO_ARCHIVE
    named = ", ".join(map(repr, tables[:_SHOWN_TABLES])) + (", …" if len(tables) > _SHOWN_TABLES else "")
    return f"holds no archive, but tables of another program: {named}"


def alone_with_tables(connection: Connection) -> None:
    """Keep others from making or changing tables until the transaction ends; waits for those that do."""
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK_KEY})


def parse(url: str) -> URL:
    """Return a database URL with the driver that is used.

    Raises:
        InputError: it is none, or its folder can't be made.
    """
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
    return parsed.set(drivername=_DRIVERS[backend])


def require_content(file: Path) -> None:
    """Check that an SQLite file was not emptied: SQLite would take it for a new database in silence.

    Raises:
        InputError: it has no content, or is no file. A new archive is never seen that way.
    """
    try:
        known = file.stat()
    except OSError:
        return  # told when it is opened
    if not stat.S_ISREG(known.st_mode):
        raise InputError(f"archive {file}: is no file; name another archive in SLAMHIVE_ARCHIVE")
    if known.st_size == 0:
        raise InputError(
            f"archive {file}: the file is empty, so what it held is lost: `slamhive archive restore` puts a "
            "backup in its place; to begin anew, remove it"
        )


def _advice(error: BaseException | None) -> str:
    """Return the advice beside a database's own words, as the end of a sentence."""
    state = getattr(error, "sqlstate", None)
    if state is not None:
        return _ADVICE.get(state, "")
    code = getattr(error, "sqlite_errorcode", None)
    return "" if code is None else _ADVICE.get(code & 0xFF, "")  # above it is the kind of the kind


def _is_away(error: exc.DBAPIError) -> bool:
    state = getattr(error.orig, "sqlstate", None)
    if state is None:  # none that a server gave: it is not there
        return error.connection_invalidated or isinstance(error, exc.OperationalError)
    return _AWAY.fullmatch(state) is not None


def _takes_files(folder: Path, *, held: bool) -> bool:
    """Tell whether SQLite can make its files beside an archive's, now or, where it is held, later."""
    return os.access(folder, os.W_OK, effective_ids=True) and (held or not _lacks_room(folder))


def _lacks_room(folder: Path) -> bool:
    try:
        return shutil.disk_usage(folder).free < _LEAST_BYTES
    except OSError:
        return False


def _is_full(error: BaseException | None, folder: Path) -> bool:
    """Tell whether SQLite failed because the disk of its file is full."""
    code = (getattr(error, "sqlite_errorcode", None) or 0) & 0xFF
    return code == sqlite3.SQLITE_FULL or (code in _OF_FULL_DISKS and _lacks_room(folder))


def _full(file: Path) -> SystemFault:
    helps = _FULL.format(" (`slamhive home --size` says what takes how much)")
    return SystemFault(f"archive {file}: the disk of {file.parent} is full{helps}")


def _damaged(url: URL, cause: str) -> InputError:
    return InputError(
        f"archive {shown(url)}: the file is damaged ({cause}); `slamhive archive check` says where, "
        "`slamhive archive restore` puts a backup in its place"
    )


def _read_only_name(file: Path) -> str:
    """Return SQLite's name of a file in a folder where it can't make its own beside it."""
    name = f"file:{quote(str(file.absolute()))}?mode=ro"
    log = file.with_name(f"{file.name}-wal")
    # Whoever works with the file has its log there, and then the file alone is not the whole of it. On a full
    # disk an empty log is what somebody left who could do no more.
    is_worked_with = log.exists() and (log.stat().st_size > 0 or not _lacks_room(file.parent))
    return name if is_worked_with else f"{name}&immutable=1"


def _beginning(url: str) -> str:
    """Return as much of a text as holds no password, however wrongly it is written."""
    found = _SCHEME.match(url)
    return f"'{found[1]}://…'" if found else "what is given"


def _tune_sqlite(engine: Engine, settings: tuple[str, ...]) -> None:
    def prepare(connection: Any, _record: Any) -> None:
        # The driver's own transactions begin too late; the event below begins them.
        connection.isolation_level = None
        try:
            for setting in settings:
                connection.execute(f"PRAGMA {setting}").close()
        except Exception:
            connection.close()
            raise

    def begin(connection: Connection) -> None:
        write = connection.get_execution_options().get("slamhive_write")
        connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")

    event.listen(engine, "connect", prepare)
    event.listen(engine, "begin", begin)


def _tune_postgresql(engine: Engine, *, read_only: bool) -> None:
    def give_up(_dialect: Any, _record: Any, _words: Any, settings: dict[str, Any]) -> None:
        for name, value in _GIVING_UP.items():
            settings.setdefault(name, value)

    def prepare(connection: Any, _record: Any) -> None:
        with connection.cursor() as cursor:
            cursor.execute(_POSTGRESQL_READING)
        connection.commit()

    event.listen(engine, "do_connect", give_up)
    if read_only:
        event.listen(engine, "connect", prepare)


def _prepare(engine: Engine, *, read_only: bool) -> None:
    """Make the tables, once among all processes that open the archive, or check their version."""
    with engine.connect() as connection:
        found = version_of(connection)
        if found is None and read_only:
            raise InputError(f"archive {shown(engine.url)}: {nothing_of_ours(connection)}")
    if found is None:
        with exclusively(engine) as connection:
            alone_with_tables(connection)
            found = version_of(connection)
            if found is None:
                _make_tables(connection)
                return
    if found != schema.VERSION:
        raise wrong_version(engine.url, found)


def _make_tables(connection: Connection) -> None:
    """Make the tables, in no database where another program has one of their names.

    Raises:
        InputError: It has.
    """
    found = inspect(connection)
    for table in schema.metadata.sorted_tables:
        if found.has_table(table.name):
            there = {column["name"] for column in found.get_columns(table.name)}
            if missing := [column.name for column in table.columns if column.name not in there]:
                raise InputError(
                    f"archive {shown(connection.engine.url)}: holds another program's table "
                    f"{table.name!r}, which has no {missing[0]}; name another archive in SLAMHIVE_ARCHIVE"
                )
    schema.metadata.create_all(connection)
    row = {"version": schema.VERSION, "identity": str(uuid.uuid4())}
    connection.execute(insert(schema.schema_version).values(row))


def _make_file(file: Path, parsed: URL) -> None:
    """Make an archive's file, whole when it is there: an empty one is never a new one.

    Raises:
        InputError: the folder can't be written.
        SystemFault: the disk refuses.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with made_aside(file) as aside:
            engine = open_engine(parsed.set(database=str(aside)))
            try:
                with exclusively(engine) as connection:
                    _make_tables(connection)
            except SystemFault as error:  # of a name that nobody knows
                raise SystemFault(str(error).replace(str(aside), str(file))) from None
            finally:
                engine.dispose()
            publish(aside, file)
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise _full(file) from None
        raise InputError(f"archive {file}: {file.parent}: {error.strerror}") from None


@contextmanager
def made_aside(file: Path) -> Iterator[Path]:
    """Yield a name beside a database's, under which it is made; what has it is gone at the end.

    It has a lock of its own, of which a killed process lets go: what such a one left goes first.

    Raises:
        OSError: the disk refuses.
    """
    _remove_left(file)
    while True:
        lock = file.with_name(f".{file.name}.{os.urandom(6).hex()}.lock")
        # No lock on the database itself: closing it would let go of SQLite's own.
        held = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        fcntl.flock(held, fcntl.LOCK_EX)
        if os.fstat(held).st_nlink:
            break
        os.close(held)  # taken for a leftover before it was locked
    try:
        yield lock.with_suffix(".making")
    finally:
        remove_database(lock.with_suffix(".making"))
        lock.unlink(missing_ok=True)
        os.close(held)


def _remove_left(file: Path) -> None:
    """Remove what killed processes left of a database that they made: what has a lock that nobody holds."""
    made = re.compile(rf"(\.{re.escape(file.name)}\.[0-9a-f]{{12}})\.lock")
    names = os.listdir(file.parent)  # noqa: PTH208 - names alone
    for match in filter(None, map(made.fullmatch, names)):
        with suppress(OSError), file.with_name(match[0]).open("rb") as held:  # another user's is theirs
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # With what was made beside it, as of an upgrade of a copy.
            for name in names:
                if name.startswith((f"{match[1]}.making", f".{match[1]}.making")):
                    file.with_name(name).unlink(missing_ok=True)
            file.with_name(match[0]).unlink(missing_ok=True)


def remove_database(file: Path) -> None:
    """Remove an SQLite database with what stands beside it, if it is there."""
    for rest in ("", "-wal", "-shm", "-journal"):
        file.with_name(f"{file.name}{rest}").unlink(missing_ok=True)


def publish(aside: Path, file: Path) -> bool:
    """Give a whole file its name unless there is one of that name; tells whether it was given.

    Raises:
        OSError: the disk refuses.
    """
    # SQLite brings its log into the file as it closes, and says no failure.
    log = aside.with_name(f"{aside.name}-wal")
    if log.exists() and (left := log.stat().st_size):
        code = errno.ENOSPC if shutil.disk_usage(aside.parent).free < left else errno.EIO
        raise OSError(code, os.strerror(code), str(aside))
    flush(aside)
    try:
        os.link(aside, file)
    except FileExistsError:
        return False
    except OSError:  # a file system without links
        if file.exists():
            return False
        aside.replace(file)
    flush(file.parent)
    return True
