# SPDX-License-Identifier: Apache-2.0
"""Pages over several homes: whose each run is, its files from its own home, and news of all of them."""

from __future__ import annotations

from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from slamhive.archive import Archive
from slamhive.dashboard.server.app import create_app
from slamhive.dashboard.sources import archived as sources
from slamhive.dashboard.sources.homes import Homes
from slamhive.tables.homes import homes_beside

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable


@asynccontextmanager
async def pages(mine: Any, *others: Any) -> AsyncIterator[httpx.AsyncClient]:
    """Yield a client that asks the application without a network."""
    app = create_app(Homes(mine.home, homes_beside(mine.home, [str(one.path) for one in others])))
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost") as client,
    ):
        yield client


async def rows(client: httpx.AsyncClient) -> dict[str, Any]:
    answer = await client.get("/api/v1/runs?columns=uid,home,algorithm,ate.rmse")
    assert answer.status_code == 200, answer.text
    return {row["uid"]: row for row in answer.json()["items"]}


@pytest.fixture
def two(keep: Callable[[str], Any]) -> tuple[Any, Any]:
    """Two homes with a run of one UID, of algorithms of one name."""
    mine, anna = keep("mine"), keep("anna")
    mine.run("a")
    anna.run("a", content="c2", version="v2", error=0.3)
    return mine, anna


async def test_runs_of_one_uid_are_told_apart_with_their_files(two: tuple[Any, Any]) -> None:
    async with pages(*two) as client:
        found = await rows(client)
        assert {uid: (row["home"], row["algorithm"]) for uid, row in found.items()} == {
            "a": ("here", "icp"),
            "a~anna": ("anna", "icp @anna"),
        }
        for uid, content in (("a", "c1"), ("a~anna", "c2")):
            answer = await client.get(f"/api/v1/runs/{uid}/files/run/output/trajectory.txt")
            assert answer.text.endswith(f"# {content}\n")
            record = (await client.get(f"/api/v1/runs/{uid}")).json()
            assert record["files"] is True


async def test_what_comes_to_another_home_is_shown(
    two: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sources, "LOOK_SECONDS", 0.0)
    monkeypatch.setattr(sources, "_REST", 0.0)
    mine, anna = two
    async with pages(mine, anna) as client:
        assert len(await rows(client)) == 2
        anna.run("b", content="c3", version="v2")
        assert len(await rows(client)) == 3


async def test_catalog_and_sweeps_are_those_of_all_homes(keep: Callable[[str], Any]) -> None:
    mine, anna = keep("mine"), keep("anna")
    mine.run("a")
    anna.run("b", content="c2", sweep="t")
    async with pages(mine, anna) as client:
        answer = (await client.get("/api/v1/sweeps")).json()
        assert {sweep["name"] for sweep in answer["items"]} == {"s", "t"}


async def test_nothing_is_written_to_another_home(two: tuple[Any, Any]) -> None:
    mine, anna = two
    before = sorted(path.relative_to(anna.path) for path in anna.path.rglob("*"))
    async with pages(mine, anna) as client:
        await rows(client)
    assert sorted(path.relative_to(anna.path) for path in anna.path.rglob("*")) == before


async def test_a_home_that_is_damaged_later_is_said_and_the_others_go_on(
    two: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, anna = two
    with Archive.open(anna.home.archive_url) as archive:
        assert archive.count() == 1
    homes = Homes(mine.home, homes_beside(mine.home, [str(anna.path)]))
    (anna.path / "archive.sqlite").write_bytes(b"no database " * 1000)
    app = create_app(homes)
    async with app.router.lifespan_context(app):
        snapshot = await homes.fresh()
    assert any(problem.startswith("home anna: ") for problem in snapshot.problems)
    assert len(snapshot.frame) == 1
