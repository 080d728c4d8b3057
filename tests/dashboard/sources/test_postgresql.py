# SPDX-License-Identifier: Apache-2.0
"""An archive in PostgreSQL that is killed under a dashboard and comes back."""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import anyio
import pytest
from sqlalchemy import create_engine, exc, text

sys.path.insert(0, str(Path(__file__).parents[2] / "archive"))

from servers import PostgreSQL, postgresql

from slamhive.archive import Archive
from slamhive.dashboard.sources.archived import Workstation

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator

pytest.importorskip("psycopg")


@pytest.fixture
def server() -> Iterator[PostgreSQL]:
    with postgresql() as made:
        if made is None:
            pytest.skip("no PostgreSQL here: apt-get install postgresql")
        yield made


async def until(found: Callable[[], Awaitable[bool]], seconds: float = 120) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + seconds
    while not await found():
        assert time.monotonic() < deadline
        await anyio.sleep(0.1)


async def test_a_killed_archive_stays_on_view_and_is_followed_again(
    server: PostgreSQL, open_app: Callable[..., Any], make_run: Callable[..., Any]
) -> None:
    with Archive.open(server.url) as archive:
        archive.put_runs(make_run(number) for number in range(3))
    async with open_app(Workstation(server.url)) as client:

        async def problems(count: int) -> bool:
            return len((await client.get(""))["problems"]) == count

        async def shown(count: int) -> bool:
            return bool((await client.get("/runs"))["total"] == count)

        await until(lambda: shown(3))
        server.kill()
        await until(lambda: problems(1))
        assert await shown(3)
        board = (await client.get("/analysis/leaderboard"))["boards"]
        assert board
        # What needs the database itself says that it is away.
        assert (await client.raw.get("/api/v1/runs/uid-000")).status_code == 503
        assert (await client.raw.get("/readyz")).status_code == 200
        server.start()
        await until(lambda: problems(0))
        with Archive.open(server.url) as archive:
            archive.put_run(make_run(4))
        await until(lambda: shown(4))
        assert (await client.get("/runs/uid-004"))["uid"] == "uid-004"


ROOT = Path(__file__).parents[3]


async def test_an_account_that_only_reads_sees_all_pages_and_changes_nothing(
    server: PostgreSQL, open_app: Callable[..., Any], make_run: Callable[..., Any]
) -> None:
    """The account is made by what the documentation says, word for word."""
    with Archive.open(server.url) as archive:
        archive.put_runs(make_run(number) for number in range(3))
    (words,) = re.findall(
        r"```sql\n(.*?)```", (ROOT / "docs/kubernetes.md").read_text(encoding="utf-8"), re.DOTALL
    )
    owner = create_engine(server.url.replace("postgresql://", "postgresql+psycopg://"))
    with owner.begin() as connection:
        connection.execute(text(words))
    url = server.url.replace("slamhive@", "slamhive_reader@")
    async with open_app(Workstation(url)) as client:
        for path in ("", "/runs", "/runs/uid-001", "/analysis/leaderboard", "/algorithms", "/sweeps"):
            assert (await client.raw.get(f"/api/v1{path}")).status_code == 200
        assert (await client.get("/runs"))["total"] == 3
        # What a newer operator does to the tables is said, and what was read stays on view.
        with owner.begin() as connection:
            connection.execute(text("UPDATE slamhive_schema SET version = 9"))

        async def said() -> bool:
            return any("newer slamhive (schema 9" in told for told in (await client.get(""))["problems"])

        await until(said)
        assert (await client.get("/runs"))["total"] == 3
        with owner.begin() as connection:
            connection.execute(text("UPDATE slamhive_schema SET version = 4"))
    # The session's own setting is no wall: the database's is.
    reader = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))
    for change in (
        "DELETE FROM runs",
        "UPDATE slamhive_schema SET version = 1",
        "DROP TABLE runs",
    ):
        with reader.connect() as connection, pytest.raises(exc.ProgrammingError, match=r"denied|owner"):
            connection.execute(text(change))
    reader.dispose()
    with owner.connect() as connection:
        assert connection.execute(text("SELECT count(*) FROM runs")).scalar() == 3
    owner.dispose()
