# SPDX-License-Identifier: Apache-2.0
"""The same contract for every database that an archive can live in."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import create_engine, text

from slamhive.archive import Archive, schema
from slamhive.model.results import Outcome, Phase, Result, RunRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sqlalchemy import Connection, Table


@pytest.fixture
def sqlite_url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path / 'sub' / 'archive.sqlite'}"


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest) -> str:
    return str(request.getfixturevalue(f"{request.param}_url"))


@pytest.fixture
def archive(url: str) -> Iterator[Archive]:
    with Archive.open(url) as opened:
        yield opened


@pytest.fixture
def make_run() -> Callable[..., RunRecord]:
    def make(uid: str = "u1", **changes: Any) -> RunRecord:
        fields: dict[str, Any] = {
            "uid": uid,
            "name": f"run-{uid}",
            "sweep": "study",
            "spec": {
                "algorithmRef": {"name": "kiss-icp"},
                "datasetRef": {"name": "hall"},
                "sensors": "lidar",
                "parameters": {"voxelSize": None, "maxRange": 60.5, "name": "x\u00e9"},
                "input": {"pace": "Lockstep"},
                "repetition": 2,
                "seed": 7,
            },
            "phase": Phase.SUCCEEDED,
            "finished": datetime(2026, 1, 2, 3, 4, 5, 678901, tzinfo=UTC),
        }
        return RunRecord.model_validate(fields | changes)

    return make


@pytest.fixture
def make_result() -> Callable[..., Result]:
    def make(
        evaluation: str = "default", outcome: Outcome = Outcome.TRACKED, rmse: float = 0.1 + 0.2
    ) -> Result:
        values = {"ate": {"rmse": rmse}, "rpe": [{"rmse": 1 / 3}], "alignment": "se3", "scale": 1.0}
        return Result(evaluation=evaluation, outcome=outcome, coverage=0.9999999999999999, values=values)

    return make


@pytest.fixture
def put_version() -> Callable[[str, int], None]:
    return _put_version


def _put_version(url: str, version: int) -> None:
    """Write the archive in versionN.sql to a database, with the tables of that version."""
    held = sqlite3.connect(":memory:")
    held.executescript(Path(__file__).with_name(f"version{version}.sql").read_text())
    engine = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))
    if engine.dialect.name == "sqlite":
        Path(str(engine.url.database)).parent.mkdir(parents=True)
        with closing(sqlite3.connect(str(engine.url.database))) as file:
            held.backup(file)
        return
    added = {"search"} | ({"note", "tags", "noted"} if version <= 4 else set())
    added |= {"divided_to"} if version <= 3 else set()
    if version <= 2:
        added |= {"identity"}
    if version == 1:
        added |= {"namespace", "cluster", "sweep_uid", "evaluations"}
    with engine.begin() as connection:
        schema.metadata.create_all(connection)
        if version <= 3:
            schema.shapes.drop(connection)
        for table in schema.metadata.sorted_tables:
            if version > 3 or table is not schema.shapes:
                _fill(connection, table, held, added, "JSON" if version > 3 else "JSONB")
    engine.dispose()


def _fill(
    connection: Connection, table: Table, held: sqlite3.Connection, added: set[str], documents: str
) -> None:
    """Make a table one of an earlier version, with its rows.

    Args:
        connection: where it is.
        table: as it is today.
        held: has the rows.
        added: columns that it did not have then.
        documents: the type of its documents then.
    """
    of_documents = {column.name for column in table.columns if isinstance(column.type, schema.JsonDocument)}
    for name in sorted(of_documents):
        kind = f'ALTER COLUMN "{name}" TYPE {documents} USING "{name}"::text::{documents}'
        unset = f'ALTER COLUMN "{name}" DROP DEFAULT'
        connection.execute(text(f"ALTER TABLE {table.name} {unset}, {kind}"))
    for name in sorted(added & set(table.columns.keys())):
        connection.execute(text(f"ALTER TABLE {table.name} DROP COLUMN {name}"))
    cursor = held.execute(f"SELECT * FROM {table.name}")
    names = [item[0] for item in cursor.description]
    marks = ", ".join(
        f"CAST(:{name} AS {documents})" if name in of_documents else f":{name}" for name in names
    )
    columns = ", ".join(f'"{name}"' for name in names)
    for values in cursor.fetchall():
        row = {
            name: datetime.fromisoformat(value)
            if value is not None and isinstance(table.columns[name].type, schema.UtcDateTime)
            else value
            for name, value in zip(names, values, strict=True)
        }
        connection.execute(text(f"INSERT INTO {table.name} ({columns}) VALUES ({marks})"), row)
