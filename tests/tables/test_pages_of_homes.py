# SPDX-License-Identifier: Apache-2.0
"""Pages over several homes: whose each run is, its files from its own home, and news of all of them."""

from __future__ import annotations

import sqlite3
from contextlib import asynccontextmanager, closing
from pathlib import Path
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


def spoil(home: Any, change: str = "spec = '1'") -> None:
    """Change a column of all runs of a home to what no program of ours writes."""
    with closing(sqlite3.connect(home.path / "archive.sqlite")) as connection, connection:
        connection.execute(f"UPDATE runs SET {change}")


@pytest.mark.parametrize("change", ["spec = '1'", "evaluations = '{'", "created = 'x'", "labels = '[7]'"])
async def test_an_odd_run_of_another_home_is_left_out_and_named(two: tuple[Any, Any], change: str) -> None:
    mine, anna = two
    spoil(anna, change)
    async with pages(mine, anna) as client:
        assert set(await rows(client)) == {"a"}
        (problem,) = (await client.get("/api/v1")).json()["problems"]
        assert problem.startswith("home anna: run 'a' can't be read, and is left out: ")
        assert problem.endswith("`slamhive archive check` says more")
        assert (await client.get("/api/v1/runs/a")).status_code == 200


async def test_a_home_that_cannot_be_read_takes_no_page_down(two: tuple[Any, Any]) -> None:
    mine, anna = two
    places = homes_beside(mine.home, [str(anna.path)])
    (anna.path / "archive.sqlite").write_bytes(b"no database " * 1000)
    app = create_app(Homes(mine.home, places))
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost") as client,
    ):
        assert set(await rows(client)) == {"a"}
        for address in ("/", "/api/v1", "/api/v1/sweeps", "/api/v1/algorithms", "/api/v1/datasets"):
            answer = await client.get(address)
            assert answer.status_code == 200, answer.text
        assert (await client.get("/api/v1")).json()["problems"][0].startswith("home anna: ")


def test_commands_say_what_they_leave_out(two: tuple[Any, Any], run_command: Callable[..., Any]) -> None:
    mine, anna = two
    spoil(anna)
    for words in (("list",), ("table",), ("export", "--columns", "uid")):
        code, out, err = run_command("results", *words, f"--also={anna.path}")
        assert (code, "anna" in out) == (0, False), err
        said = "run 'a' can't be read, and is left out: a document of it is no JSON: spec"
        assert said in " ".join(err.split())
    spoil(mine)
    code, _, err = run_command("results", "list")
    assert (code, " ".join(err.split()).count("is left out")) == (0, 1)


def test_files_of_a_run_that_cannot_be_read_stay(keep: Any, run_command: Callable[..., Any]) -> None:
    mine = keep("mine")
    first = mine.run("a")
    mine.run("b", content="c1", folder=first.folder, files=False, name="s-b")
    spoil(mine, "spec = '1' WHERE uid = 'a'")
    assert run_command("gc", "--unrecorded", "--yes")[0] == 0
    assert run_command("results", "prune", "--sweep", "s", "--yes")[0] == 0
    assert (Path(first.folder) / "run" / "output" / "trajectory.txt").exists()
    code, _, err = run_command("archive", "check")
    assert (code, "a: spec.algorithmRef" in err or "runs: a: " in err) == (1, True)
