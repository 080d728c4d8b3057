# SPDX-License-Identifier: Apache-2.0
"""Benchmark of writing finished runs to an archive that holds few or many, beside the database's own import.

The rows that fill an archive are copies of measured ones under identities of their own, made in the database.
What is written and timed then comes through the archive's own methods, in batches as the operator and
`slamhive fetch` write, and one by one as a workstation does. The peer gets the same rows in its own fastest
way, into a table with the same indexes: COPY in PostgreSQL, `executemany` in SQLite. CPU seconds of this
process are shown too, as a busy machine lengthens the others.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).parent))

from bench_dashboard import make_record, postgresql
from sqlalchemy import text

from slamhive.archive import Archive, documents, schema
from slamhive.archive.connection import exclusively, open_engine, parse
from slamhive.archive.records import run_row

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sqlalchemy import Connection, Engine

    from slamhive.model.results import RunRecord

FILLED = (0, 100_000, 1_000_000)
"""Runs in the archive before those that are measured; --rows asks for more."""

SEEDS = 500
BATCHES = 2000
SINGLY = 100
LEAST = 500.0
MOST_BYTES = 2000.0
FLAT = 0.8
"""The share of an empty archive's rate that a full one has to keep."""

_RANDOM = {
    "sqlite": {"uid": "lower(hex(randomblob(16)))", "content_hash": "lower(hex(randomblob(32)))"},
    "postgresql": {
        "uid": "md5(random()::text || r.id)",
        "content_hash": "md5(random()::text || r.id) || md5(random()::text)",
    },
}


@dataclass(frozen=True)
class Rate:
    """Rate at which runs were written to an archive.

    Attributes:
        wall: runs a second.
        cpu: runs a second of this process's CPU.
    """

    wall: float
    cpu: float


def timed(count: int, work: Any) -> Rate:
    """Do something and return its rate."""
    cpu, wall = time.process_time(), time.perf_counter()
    work()
    return Rate(count / (time.perf_counter() - wall), count / (time.process_time() - cpu))


def multiply(connection: Connection, wanted: int) -> None:
    """Bring an archive to a number of runs: copies of those in it under other identities."""
    drawn = _RANDOM[connection.dialect.name]
    own = {
        **drawn,
        "name": "r.name || '-' || r.id",
        "id": "r.id + :shift",
        "folder": "r.folder || '-' || r.id",
    }
    names = [f'"{column.name}"' for column in schema.runs.columns]
    values = [own.get(column.name, f'r."{column.name}"') for column in schema.runs.columns]
    found = [f'"{column.name}"' for column in schema.results.columns]
    measured = ["r.run_id + :shift" if name == '"run_id"' else f"r.{name}" for name in found]
    while True:
        count, last = connection.execute(text("SELECT count(*), coalesce(max(id), 0) FROM runs")).one()
        if count >= wanted:
            return
        given = {"shift": last, "most": wanted - count}
        for table, key, into, of in (
            ("runs", "id", names, values),
            ("results", "run_id", found, measured),
        ):
            connection.execute(
                text(
                    f"INSERT INTO {table} ({', '.join(into)}) SELECT {', '.join(of)} FROM {table} r "
                    f"WHERE r.{key} <= :most"
                ),
                given,
            )


def fill(engine: Engine, wanted: int) -> None:
    """Bring an archive to a number of runs, and let PostgreSQL know the next identity."""
    with engine.connect() as connection, connection.begin():
        multiply(connection, wanted)
        if engine.dialect.name == "postgresql":
            connection.execute(
                text("SELECT setval(pg_get_serial_sequence('runs', 'id'), (SELECT max(id) FROM runs))")
            )


def fresh(number: int, beginning: int) -> list[RunRecord]:
    """Return runs that no archive has."""
    found = []
    for place in range(beginning, beginning + number):
        record = make_record(place % 10_000)
        found.append(record.model_copy(update={"uid": f"{place:08d}-fresh", "name": f"fresh-{place}"}))
    return found


def size_of(connection: Connection) -> tuple[float, float]:
    """Return bytes of the runs with their indexes, and of the results with theirs."""
    if connection.dialect.name == "postgresql":
        sizes = [
            connection.execute(text(f"SELECT pg_total_relation_size('{name}')")).scalar_one()
            for name in ("runs", "results")
        ]
        return float(sizes[0]), float(sizes[1])
    query = text(
        "SELECT sum(CASE WHEN tbl_name = 'runs' THEN pgsize END), "
        "sum(CASE WHEN tbl_name = 'results' THEN pgsize END) "
        "FROM dbstat('main', 1) JOIN sqlite_schema USING (name)"
    )
    runs, results = connection.execute(query).one()
    return float(runs), float(results)


def copied(engine: Engine, records: Sequence[RunRecord]) -> Rate:
    """Write the rows of runs in the database's own way to a table with the same indexes."""
    rows = [run_row(record) for record in records]
    with exclusively(engine) as connection:
        documents.store(connection, ("runs", rows))
    columns = [column for column in schema.runs.columns if column.name in rows[0]]
    names = ", ".join(f'"{column.name}"' for column in columns)
    lines = [[_plain(column, row[column.name]) for column in columns] for row in rows]
    with engine.connect() as connection:
        held: Any = connection.connection.driver_connection
        if engine.dialect.name == "postgresql":
            held.execute("CREATE TABLE peer (LIKE runs INCLUDING ALL)")

            def work() -> None:
                with held.cursor() as cursor, cursor.copy(f"COPY peer ({names}) FROM STDIN") as copy:
                    for line in lines:
                        copy.write_row(line)
                held.commit()
        else:
            held.execute("CREATE TABLE peer AS SELECT * FROM runs WHERE 0")
            for number, column in enumerate(("uid", "name", "algorithm", "dataset", "content_hash")):
                held.execute(f"CREATE INDEX peer_{number} ON peer ({column})")
            held.commit()

            def work() -> None:
                marks = ", ".join("?" * len(columns))
                held.execute("BEGIN IMMEDIATE")
                held.executemany(f"INSERT INTO peer ({names}) VALUES ({marks})", lines)
                held.commit()

        found = timed(len(rows), work)
        held.execute("DROP TABLE peer")
        held.commit()
        return found


def _plain(column: Any, value: Any) -> Any:
    if isinstance(column.type, schema.JsonDocument) and value is not None:
        return json.dumps(value, separators=(",", ":"))
    return value.replace(tzinfo=None).isoformat(" ") if hasattr(value, "tzinfo") else value


def say(what: str, rate: Rate, beside: str) -> None:
    """Print a rate beside what it is held against."""
    print(f"{what} · {rate.wall:,.0f} runs/s ({rate.cpu:,.0f} a second of CPU) · {beside}", flush=True)


def measure(name: str, url: str, filled: Sequence[int]) -> None:
    """Print the rates of one database at each number of runs in it."""
    with Archive.open(url) as archive:
        archive.put_runs(make_record(number) for number in range(SEEDS))
    engine = open_engine(parse(url))
    beginning, empty = 0, None
    try:
        for wanted in filled:
            fill(engine, wanted)
            many, few = fresh(BATCHES, beginning), fresh(SINGLY, beginning + BATCHES)
            beginning += BATCHES + SINGLY
            peer = copied(engine, many)
            with Archive.open(url) as archive:
                rate = timed(len(many), lambda: archive.put_runs(many))  # noqa: B023 - called at once
                single = timed(len(few), lambda: [archive.put_run(one) for one in few])  # noqa: B023
            place = f"{name}, {wanted:,} runs in it"
            enough = "" if rate.wall >= LEAST else ", TOO SLOW"
            say(f"{place}: in batches", rate, f"at least {LEAST:g} runs/s{enough}")
            say(f"{place}: one by one", single, "–")
            say(f"{place}: its own import of the same rows without results", peer, "peer")
            empty = empty or rate
            share = rate.cpu / empty.cpu
            verdict = "" if share >= FLAT else ", NOT FLAT"
            print(f"{place}: share of the empty archive's rate · {share:.2f} · {FLAT:g}{verdict}", flush=True)
        with engine.connect() as connection:
            count = connection.execute(text("SELECT count(*) FROM runs")).scalar_one()
            runs, results = (size / count for size in size_of(connection))
        verdict = "" if runs <= MOST_BYTES else ", TOO MUCH"
        print(
            f"{name}: on disk, a run beside its results · {runs:,.0f} B · limit {MOST_BYTES:,.0f} B{verdict}",
            flush=True,
        )
        print(f"{name}: on disk, its results · {results:,.0f} B · –", flush=True)
    finally:
        engine.dispose()


def main() -> int:
    """Measure each database that is there."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, nargs="+", default=FILLED, help="runs in it, growing")
    parser.add_argument("--only", choices=("sqlite", "postgresql"))
    options = parser.parse_args()
    if options.only != "postgresql":
        with tempfile.TemporaryDirectory() as folder:
            measure("SQLite", f"sqlite:///{folder}/archive.sqlite", options.rows)
    if options.only != "sqlite":
        with postgresql() as server:
            if server is None:
                print("PostgreSQL · not installed · apt-get install postgresql", flush=True)
            else:
                measure("PostgreSQL", server.url, options.rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
