# SPDX-License-Identifier: Apache-2.0
"""Tests of which questions the dashboard answers itself, and of its queue when many ask the others."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.dashboard.answering.workers import AnswerLimits, AnswerWorkers
from slamhive.dashboard.problems import BadRequest, Busy
from slamhive.dashboard.sources.archived import Workstation

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from slamhive.dashboard.answering.workers import AnswerCost

sys.path.append(str(Path(__file__).parents[2] / "bench"))

from bench_dashboard import fill


@pytest.fixture(scope="session")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home with runs of eight algorithms on ten datasets with twenty parameters."""
    home = tmp_path_factory.mktemp("filled")
    fill(f"sqlite:///{home / 'archive.sqlite'}", 800)
    return home


@pytest.mark.parametrize(
    ("question", "by_a_worker"),
    [
        ("runs?algorithm=orb-slam3&coverage%3E=0.5&sort=ate.rmse&limit=100", False),
        ("analysis/points?x=parameters.p0&y=ate.rmse&colour=algorithm", False),
        ("analysis/leaderboard", False),
        ("analysis/aggregate?by=algorithm,dataset", False),
        ("algorithms", False),
        ("analysis/aggregate?by=id", True),
        ("analysis/aggregate", True),
        ("analysis/leaderboard?by=algorithm,dataset", True),
        ("analysis/importance", True),
        ("runs?where=" + " or ".join(f"id == {number}" for number in range(40)), True),
    ],
)
async def test_who_computes(
    filled: Path, open_app: Callable[..., Any], question: str, by_a_worker: bool
) -> None:
    asked: list[AnswerCost] = []
    async with open_app(Workstation(f"sqlite:///{filled / 'archive.sqlite'}", filled)) as client:
        client.raw._transport.app.state.service.workers.told = asked.append
        await client.get(f"/{question}")
    assert bool(asked) is by_a_worker


@pytest.mark.parametrize(
    ("question", "computes"),
    [
        ("analysis/aggregate", "analysis.aggregated"),
        ("runs?format=csv", "many_runs.whole_table"),
        ("analysis/common", "common_support.meant"),
    ],
)
async def test_what_takes_too_much_memory_is_computed_once(
    api: Any, monkeypatch: pytest.MonkeyPatch, question: str, computes: str
) -> None:
    def end(*_: object, **__: object) -> None:
        signal.signal(signal.SIGSEGV, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGSEGV)

    monkeypatch.setattr(f"slamhive.dashboard.answers.{computes}", end)
    begun: list[AnswerCost] = []
    api.raw._transport.app.state.service.workers.told = begun.append
    answers = [await api.raw.get(f"/api/v1/{question}") for _ in range(2)]
    assert {answer.status_code for answer in answers} == {422}
    assert not any("retry-after" in answer.headers for answer in answers)
    assert "MiB of memory: ask for fewer runs, columns or groups" in answers[1].json()["error"]
    assert len(begun) == 1


@pytest.fixture
async def workers() -> AsyncIterator[AnswerWorkers]:
    found = AnswerWorkers(AnswerLimits(inside=1, waiting=1, waiting_of_one=1, waiting_seconds=300.0))
    yield found
    await found.stop()


async def test_questions_wait_for_those_before_them(workers: AnswerWorkers) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def slow() -> str:
        begun.set()
        go_on.wait()
        return "first"

    first = asyncio.create_task(workers.compute_inside(slow, "one"))
    await asyncio.to_thread(begun.wait)
    second = asyncio.create_task(workers.compute_inside(lambda: "second", "other"))
    await asyncio.sleep(0)
    with pytest.raises(Busy):
        await workers.compute_inside(lambda: "third", "another")
    assert await workers.compute(lambda: "by a worker", "another") == "by a worker"
    go_on.set()
    assert await asyncio.gather(first, second) == ["first", "second"]


async def test_what_is_wrong_is_told_and_the_place_is_free_again(workers: AnswerWorkers) -> None:
    def wrong() -> None:
        raise BadRequest("no such column", "by")

    for _ in range(3):
        with pytest.raises(BadRequest, match="no such column"):
            await workers.compute_inside(wrong, "one")


async def test_a_client_that_leaves_keeps_no_place(workers: AnswerWorkers) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def slow() -> None:
        begun.set()
        go_on.wait()

    left = asyncio.create_task(workers.compute_inside(slow, "one"))
    await asyncio.to_thread(begun.wait)
    left.cancel()
    with pytest.raises(asyncio.CancelledError):
        await left
    go_on.set()
    assert await workers.compute_inside(lambda: "next", "other") == "next"
