# SPDX-License-Identifier: Apache-2.0
"""Speed and size of an archive, beside the database's own way of taking the same rows in."""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sqlalchemy import create_engine, insert, make_url, select, text

from slamhive.archive import Archive, CatalogEntry, schema

if TYPE_CHECKING:
    from sqlalchemy import Engine

AT_ONCE = 50
"""Runs that the operator archives at a time."""


def open_engine(url: str) -> Engine:
    """Return an engine for an archive's URL; a connection that its server has broken is made anew."""
    return create_engine(url.replace("postgresql://", "postgresql+psycopg://"), pool_pre_ping=True)


def size(url: str) -> int:
    """Return the size of a database with its indexes, bytes."""
    engine = open_engine(url)
    try:
        with engine.connect() as connection:
            if engine.dialect.name == "postgresql":
                query = "SELECT sum(pg_total_relation_size(oid)) FROM pg_class WHERE relname IN ('runs')"
                return int(connection.execute(text(query)).scalar_one())
            pages = connection.execute(text("PRAGMA page_count")).scalar_one()
            return int(pages) * int(connection.execute(text("PRAGMA page_size")).scalar_one())
    finally:
        engine.dispose()


def speeds(url: str) -> tuple[float, float, int]:
    """Return runs a second as the operator archives them and as the database copies their rows, and how many.

    Both go into empty tables of the same server or disk.
    """
    with Archive.open(url, read_only=True) as archive:
        records = [*archive.runs()]
    if make_url(url).get_backend_name() == "sqlite":
        with tempfile.TemporaryDirectory(dir=Path(str(make_url(url).database)).parent) as folder:
            return (*_both(f"sqlite:///{folder}/archive.sqlite", url, records), len(records))
    engine = open_engine(url).execution_options(isolation_level="AUTOCOMMIT")
    name = "slamhive_speed"
    with engine.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}"))
    try:
        empty = str(url).replace("/postgres?", f"/{name}?")
        return (*_both(empty, url, records), len(records))
    finally:
        with engine.connect() as connection:
            connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
        engine.dispose()


def _both(empty: str, full: str, records: list[Any]) -> tuple[float, float]:
    # Each run comes with its Algorithm and Dataset, which are stored once.
    used = [CatalogEntry(kind=kind, name="one", spec={}) for kind in ("Algorithm", "Dataset")]
    with Archive.open(empty) as archive:
        began = time.perf_counter()
        for start in range(0, len(records), AT_ONCE):
            archive.put_used((record, *used) for record in records[start : start + AT_ONCE])
        ours = len(records) / (time.perf_counter() - began)
    source, target = open_engine(full), open_engine(empty)
    try:
        rows = {table: _rows(source, table) for table in (schema.runs, schema.results)}
        with target.begin() as connection:
            for table in (schema.results, schema.runs):
                connection.execute(table.delete())
        began = time.perf_counter()
        for table, values in rows.items():
            (_copy if target.dialect.name == "postgresql" else _insert)(target, table, values)
        return ours, len(records) / (time.perf_counter() - began)
    finally:
        source.dispose()
        target.dispose()


def _rows(engine: Engine, table: Any) -> list[dict[str, Any]]:
    with engine.connect() as connection:
        return [dict(row) for row in connection.execute(select(table)).mappings()]


def _insert(engine: Engine, table: Any, rows: list[dict[str, Any]]) -> None:
    with engine.begin() as connection:
        connection.execute(insert(table), rows)


def _copy(engine: Engine, table: Any, rows: list[dict[str, Any]]) -> None:
    names = [column.name for column in table.columns]
    columns = ", ".join(f'"{name}"' for name in names)
    raw = engine.raw_connection()
    try:
        with raw.cursor() as cursor, cursor.copy(f"COPY {table.name} ({columns}) FROM STDIN") as copy:
            for row in rows:
                copy.write_row([_plain(row[name]) for name in names])
        raw.commit()
    finally:
        raw.close()


def _plain(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, dict | list) else value
