# SPDX-License-Identifier: Apache-2.0
"""Any value in any column of an archive: the run is read or left out by name, and no other is touched."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from contextlib import closing
from random import Random
from typing import TYPE_CHECKING, Any

import archives
import odd
import pytest
from views import Views

from slamhive.archive import Archive
from slamhive.archive.connection import connect
from slamhive.archive.keeping import check
from slamhive.tables.loading import load

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from slamhive.model.results import RunRecord
    from slamhive.tables.snapshots import Loaded

pytestmark = pytest.mark.filterwarnings("ignore::slamhive.model.leftout.LeftOutWarning")

SEED = 4
"""An archive of 30 runs, with results and sweeps."""
THOROUGH = os.environ.get("SLAMHIVE_EXAMPLES") == "thorough"
COMMANDS = (
    *(
        "results list",
        "results list --superseded",
        "results table",
        "results export",
        "results table --rows dataset",
    ),
    *("sweep list --size", "gc --dry-run", "home --size", "archive merge {home}/other --dry-run"),
    *("results prune --failed --dry-run", "report -o {home}/report.html", "paper-table"),
)


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Views]:
    with Views(tmp_path_factory.mktemp("odd")) as found:
        yield found


def call_all(views: Views) -> None:
    """Call commands, one of them with a copy of the archive in another home."""
    other = views.home / "other"
    other.mkdir(exist_ok=True)
    shutil.copyfile(views.home / "archive.sqlite", other / "archive.sqlite")
    for command in COMMANDS:
        views.command(*command.format(home=views.home).split())


def spoiled(file: Path, values: Any) -> dict[int, tuple[str, str, Any]]:
    """Add a run for each value to an archive, and return what each of them has where, by id."""
    found = {}
    with closing(sqlite3.connect(file)) as connection, connection:
        like = connection.execute("SELECT run_id FROM results ORDER BY run_id LIMIT 1").fetchone()[0]
        for one in values:
            number = odd.put(connection, like, *one)
            if number is not None:
                found[number] = one
    return found


def read(file: Path) -> tuple[list[RunRecord], dict[int | None, str], Loaded]:
    """Return the records of an archive, what is left out of them by number, and its table."""
    url = f"sqlite:///{file}"
    with Archive.open(url, read_only=True) as archive:
        records = list(archive.runs())
        left_out = {one.number: one.what for one in archive.left_out.values()}
    engine = connect(url, read_only=True)
    try:
        return records, left_out, load(engine)
    finally:
        engine.dispose()


def test_any_value_in_any_column_costs_its_own_run_alone(views: Views) -> None:
    file = views.home / "archive.sqlite"
    views.write(archives.made_up(Random(SEED)))
    before, nothing, table = read(file)
    assert not nothing
    known = {record.uid for record in before}
    whole = table.frame.records(table.frame.stored)
    added = spoiled(file, odd.all_values())
    assert len(added) > 1500
    records, left_out, loaded = read(file)
    assert [record for record in records if record.uid in known] == before
    assert {one.number for one in loaded.left_out} == set(left_out)
    assert len(records) + len(left_out) == len(before) + len(added)
    json.dumps([record.as_json() for record in records], allow_nan=False).encode()
    rows = loaded.frame.records(loaded.frame.stored)
    json.dumps(rows, allow_nan=False).encode()
    assert {row["id"] for row in rows} == {row["id"] for row in whole} | added.keys() - left_out.keys()
    kept = [{name: row[name] for name in table.frame.stored} for row in rows if row["uid"] in known]
    assert [row["ate.rmse"] for row in kept] == [row["ate.rmse"] for row in whole]
    faults = " ".join(check(f"sqlite:///{file}").faults)
    with closing(sqlite3.connect(file)) as connection:
        uids = dict(connection.execute("SELECT id, uid FROM runs"))
    assert [
        number
        for number in left_out
        if not any(one in faults for one in (f"runs: {uids[number]!s}: ", f"results: {number} "))
    ] == []


def test_what_can_be_read_is_shown_everywhere(views: Views) -> None:
    """Runs of odd values that no rule of the tables refuses, by all commands and addresses."""
    file = views.home / "archive.sqlite"
    views.write(archives.made_up(Random(SEED)))
    added = spoiled(file, list(odd.all_values())[:: 1 if THOROUGH else 7])
    records, left_out, _ = read(file)
    assert len(added) > len(left_out) > 100
    call_all(views)
    told = views.get("/api/v1")
    assert any("can't be read, and is left out" in problem for problem in told["problems"])
    # Events have no end.
    addresses = [one for one in views.get("/api/v1/openapi.json")["paths"] if not one.endswith("/events")]
    some = [record.uid for record in records if record.uid.startswith("odd")][::20]
    for address in addresses:
        uids = some if "{uid}" in address else [""]
        for uid in uids:
            views.ask(address.replace("{uid}", uid))


@pytest.mark.parametrize("value", ["1", "[1]"])
@pytest.mark.parametrize(
    ("table", "column"), [("sweeps", "spec"), ("algorithms", "spec"), ("datasets", "labels")]
)
def test_an_odd_sweep_or_catalog_entry_is_left_out(views: Views, table: str, column: str, value: str) -> None:
    views.write(archives.made_up(Random(SEED)))
    with closing(sqlite3.connect(views.home / "archive.sqlite")) as connection, connection:
        for name in ("algorithms", "datasets"):
            connection.execute(f"INSERT INTO {name} VALUES ('a', 'h', '{{}}', '{{}}', '{{}}', '2026-01-01')")
        connection.execute(f"UPDATE {table} SET {column} = ?", (value,))
    before = len(views.get("runs")["items"])
    assert before
    for address in ("/api/v1", "/api/v1/sweeps", "/api/v1/algorithms", "/api/v1/datasets"):
        views.get(address)
    call_all(views)
