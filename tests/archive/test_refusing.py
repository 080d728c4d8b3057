# SPDX-License-Identifier: Apache-2.0
"""Databases that take no writes, or no more of them: a sentence that says so, and nothing half written."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import Engine, create_engine, event, make_url, text

from slamhive.archive import Archive
from slamhive.archive.keeping import backup, check, restore
from slamhive.model.errors import SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from slamhive.model.results import Result, RunRecord

    MakeRun = Callable[..., RunRecord]
    MakeResult = Callable[..., Result]


def tell(url: str, *statements: str) -> None:
    engine = create_engine(url, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        for statement in statements:
            connection.execute(text(statement))
    engine.dispose()


@pytest.fixture
def replica(postgresql_url: str, make_run: MakeRun) -> str:
    """A server with five runs that takes no writes, as one that follows another."""
    with Archive.open(postgresql_url) as archive:
        archive.put_runs(make_run(f"u{k}") for k in range(5))
    name = make_url(postgresql_url).database
    tell(postgresql_url, f"ALTER DATABASE {name} SET default_transaction_read_only = on")
    return postgresql_url


def test_a_replica_is_read_and_says_why_it_takes_no_run(
    replica: str, tmp_path: Path, make_run: MakeRun
) -> None:
    with Archive.open(replica, read_only=True) as archive:
        assert archive.count() == 5
    with Archive.open(replica) as archive:
        with pytest.raises(SystemFault, match=r"read-only transaction; it takes no writes: a replica"):
            archive.put_run(make_run("new"))
        assert archive.count() == 5
    assert check(replica).faults == []
    backup(replica, tmp_path / "copy.sqlite")
    with pytest.raises(SystemFault, match="takes no writes"):
        restore(replica, tmp_path / "copy.sqlite", force=True)


def test_no_archive_is_made_on_a_replica(postgresql_url: str) -> None:
    name = make_url(postgresql_url).database
    tell(postgresql_url, f"ALTER DATABASE {name} SET default_transaction_read_only = on")
    with pytest.raises(SystemFault, match="takes no writes"):
        Archive.open(postgresql_url)


def test_a_file_opened_for_reading_says_why_it_takes_no_run(sqlite_url: str, make_run: MakeRun) -> None:
    Archive.open(sqlite_url).close()
    with (
        Archive.open(sqlite_url, read_only=True) as archive,
        pytest.raises(SystemFault, match="it takes no writes"),
    ):
        archive.put_run(make_run("new"))


@contextmanager
def no_room(url: str) -> Iterator[None]:
    """Let a database meet a full disk."""
    if url.startswith("postgresql"):
        words = "could not extend file: No space left on device"
        tell(
            url,
            "CREATE FUNCTION refuse() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN "
            f"RAISE EXCEPTION USING ERRCODE = 'disk_full', MESSAGE = '{words}'; END $$",
            "CREATE TRIGGER refusing BEFORE INSERT ON results FOR EACH ROW EXECUTE FUNCTION refuse()",
        )
        yield
        tell(url, "DROP TRIGGER refusing ON results")
        return

    def hold(connection: Any, _record: Any) -> None:
        (pages,) = connection.execute("PRAGMA page_count").fetchone()
        connection.execute(f"PRAGMA max_page_count = {pages}").close()

    event.listen(Engine, "connect", hold)
    try:
        yield
    finally:
        event.remove(Engine, "connect", hold)


def test_a_full_disk_costs_the_batch_that_met_it_and_no_other(
    url: str, make_run: MakeRun, make_result: MakeResult
) -> None:
    runs = [make_run(f"u{k}", log_tail="x" * 5000, results=[make_result()]) for k in range(600)]
    with Archive.open(url) as archive:
        archive.put_runs(runs[:5])
    with (
        no_room(url),
        Archive.open(url) as archive,
        pytest.raises(SystemFault, match="what it holds stays: make room"),
    ):
        archive.put_runs(runs[5:])
    assert check(url).faults == []
    with Archive.open(url) as archive:
        assert {one.uid for one in archive.runs()} == {f"u{k}" for k in range(5)}
        archive.put_runs(runs[5:])
        assert archive.count() == 600
