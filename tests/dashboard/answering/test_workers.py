# SPDX-License-Identifier: Apache-2.0
"""Workers end at their budgets, leave nothing behind, and answer those first who ask little."""

from __future__ import annotations

import asyncio
import errno
import os
import signal
import threading
import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from slamhive.analysis.frame import Frame
from slamhive.dashboard.answering.workers import AnswerBudget, AnswerCost, AnswerLimits, AnswerWorkers
from slamhive.dashboard.problems import BadRequest, Busy, Problem, TooCostly
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator

SMALL = AnswerLimits(
    answer=AnswerBudget(cpu_seconds=1, seconds=300.0, memory=64 * 2**20),
    stream=AnswerBudget(cpu_seconds=5, seconds=300.0, memory=64 * 2**20),
    short=1,
    long=1,
    long_seconds=60.0,
    streams=1,
    waiting=2,
    waiting_of_one=2,
    waiting_seconds=300.0,
)


@pytest.fixture
async def workers() -> AsyncIterator[AnswerWorkers]:
    found = AnswerWorkers(SMALL)
    yield found
    await found.stop()


def spin() -> None:
    while True:
        pass


def sleep() -> None:
    threading.Event().wait()


def grow() -> int:
    return len(bytearray(os.urandom(1)) * (256 * 2**20))


async def until(found: Callable[[], bool]) -> None:
    """Wait until something is so."""
    async with asyncio.timeout(300):
        while not found():  # noqa: ASYNC110 - processes tell no event
            await asyncio.sleep(0.005)


async def process_of(workers: AnswerWorkers) -> int:
    """Return the number of the process that works."""
    await until(lambda: bool(workers._running))
    return next(iter(workers._running)).pid


def is_gone(pid: int) -> bool:
    return not Path(f"/proc/{pid}").exists()


def waits(pid: int) -> bool:
    return Path(f"/proc/{pid}/stat").read_text().split()[2] == "S"


async def test_it_returns_what_was_computed_here(workers: AnswerWorkers) -> None:
    table = list(range(1000))
    assert await workers.compute(lambda: sum(table)) == 499_500
    assert await workers.compute(os.getpid) != os.getpid()
    assert await workers.compute(lambda: b"x" * 5_000_000) == b"x" * 5_000_000


@pytest.mark.parametrize(
    ("error", "status", "retry"),
    [(BadRequest("so not", "where"), 400, None), (InputError("nor so"), 400, None), (Busy("no"), 503, 5)],
)
async def test_what_it_refuses_is_told(
    workers: AnswerWorkers, error: Exception, status: int, retry: int | None
) -> None:
    def refuse() -> None:
        raise error

    with pytest.raises(Problem) as raised:
        await workers.compute(refuse)
    assert (raised.value.status, raised.value.retry_after) == (status, retry)
    assert raised.value.body()["error"] == str(error)


async def test_a_mistake_is_logged_here(workers: AnswerWorkers, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(Problem, match=r"an error in the dashboard itself \(ZeroDivisionError\)") as raised:
        await workers.compute(lambda: 1 // 0)
    assert raised.value.status == 500
    assert "ZeroDivisionError" in caplog.text


async def test_cpu_seconds_end(workers: AnswerWorkers) -> None:
    with pytest.raises(TooCostly, match="more than 1 s of CPU time"):
        await workers.compute(spin)


def end_by(number: int) -> None:
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)


def get_none() -> None:
    raise OSError(errno.ENOMEM, "no memory to be had")


def be_killed_at_the_limit() -> None:
    held: list[bytearray] = []
    with suppress(MemoryError):  # the heap that it is forked with may shrink: only all of it is surely more
        while True:
            held.append(bytearray(os.urandom(1)) * 2**20)
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize(
    "end",
    [
        grow,
        partial(end_by, signal.SIGSEGV),
        partial(end_by, signal.SIGABRT),
        partial(end_by, signal.SIGBUS),
        get_none,
        be_killed_at_the_limit,
        partial(os._exit, 0),
        partial(os._exit, 1),
    ],
    ids=["told", "SIGSEGV", "SIGABRT", "SIGBUS", "of the system", "SIGKILL", "wordless", "by a library"],
)
async def test_memory_ends(workers: AnswerWorkers, end: Callable[[], object]) -> None:
    with pytest.raises(TooCostly, match="more than 64 MiB of memory: ask for fewer runs"):
        await workers.compute(end)


async def test_time_ends() -> None:
    workers = AnswerWorkers(AnswerLimits(answer=AnswerBudget(seconds=0.2)))
    with pytest.raises(Busy, match=r"not ready in 0\.2 s"):
        await workers.compute(sleep)


async def test_nobody_waits_in_vain_for_one_that_was_killed(workers: AnswerWorkers) -> None:
    task = asyncio.create_task(workers.compute(sleep))
    os.kill(await process_of(workers), 9)
    with pytest.raises(Busy, match="memory was short"):
        await task
    assert await workers.compute(lambda: 1) == 1


async def test_what_nobody_waits_for_is_ended(workers: AnswerWorkers) -> None:
    task = asyncio.create_task(workers.compute(sleep))
    pid = await process_of(workers)
    task.cancel()
    await until(lambda: is_gone(pid))
    assert await workers.compute(lambda: 1) == 1


async def test_too_many_are_told_to_come_back(workers: AnswerWorkers) -> None:
    first = asyncio.create_task(workers.compute(sleep))
    await process_of(workers)
    waiting = [asyncio.create_task(workers.compute(lambda: 1)) for _ in range(2)]
    await until(lambda: len(workers._waiting["short"]) == 2)
    with pytest.raises(Busy) as raised:
        await workers.compute(lambda: 1)
    assert raised.value.retry_after
    first.cancel()
    assert await asyncio.gather(*waiting) == [1, 1]


async def test_who_has_used_least_is_next(workers: AnswerWorkers) -> None:
    with pytest.raises(TooCostly):
        await workers.compute(spin, "greedy")
    first = asyncio.create_task(workers.compute(sleep, "greedy"))
    await process_of(workers)
    order: list[str] = []

    async def ask(client: str) -> None:
        await workers.compute(lambda: 1, client)
        order.append(client)

    tasks = [asyncio.create_task(ask("greedy"))]
    await until(lambda: bool(workers._waiting["short"]))
    tasks.append(asyncio.create_task(ask("modest")))
    await until(lambda: len(workers._waiting["short"]) == 2)
    first.cancel()
    await asyncio.gather(*tasks)
    assert order == ["modest", "greedy"]


async def test_others_pass_one_that_takes_long() -> None:
    plenty = AnswerBudget(cpu_seconds=600, seconds=600.0)
    workers = AnswerWorkers(AnswerLimits(answer=plenty, short=1, long=1, long_seconds=0.1))
    long = asyncio.create_task(workers.compute(spin))
    await process_of(workers)
    assert await workers.compute(lambda: 1) == 1
    second = asyncio.create_task(workers.compute(spin))
    third = asyncio.create_task(workers.compute(lambda: 1))
    with pytest.raises(Busy, match="takes long"):
        await second
    assert await third == 1
    assert not long.done()
    await workers.stop()
    with pytest.raises(Problem):
        await long


async def test_blocks_are_made_as_they_are_taken(workers: AnswerWorkers, tmp_path: Path) -> None:
    made = tmp_path / "made"

    def blocks() -> Iterator[bytes]:
        for number in range(1000):
            made.write_text(str(number))
            yield b"x" * 2**18

    stream = workers.stream(blocks)
    assert await anext(stream) == b"x" * 2**18
    pid = await process_of(workers)
    await until(lambda: waits(pid))
    assert int(made.read_text()) < 100
    with pytest.raises(Busy):
        await anext(workers.stream(blocks))
    await stream.aclose()
    await until(lambda: is_gone(pid))


async def test_a_lock_of_another_thread_stops_no_worker(workers: AnswerWorkers) -> None:
    """Up to Python 3.11 a property that is kept has a lock for all objects of its class."""
    holding, done = threading.Event(), threading.Event()

    class Slow(dict[str, object]):
        def keys(self) -> object:  # type: ignore[override]
            holding.set()
            done.wait()
            return super().keys()

    thread = threading.Thread(target=lambda: Frame(Slow(), 0).names)
    thread.start()
    holding.wait()
    try:
        assert "uid" in await workers.compute(lambda: Frame({}, 0).names)
    finally:
        done.set()
        thread.join()


async def test_what_it_came_to_is_told(workers: AnswerWorkers) -> None:
    costs: list[AnswerCost] = []
    workers.told = costs.append
    await workers.compute(lambda: 1)
    await workers.stop()
    assert costs[0].memory > 2**20
    assert costs[0].cpu_seconds < 1


async def test_it_holds_no_connection_open(workers: AnswerWorkers) -> None:
    mine, other = os.pipe()
    task = asyncio.create_task(workers.compute(sleep))
    pid = await process_of(workers)
    folder = Path(f"/proc/{pid}/fd")
    try:
        if not os.access(folder, os.R_OK):
            pytest.skip("what is open in a process that is closed to inspection is root's to see")
        await until(lambda: len([*folder.iterdir()]) <= 4)
    finally:
        os.close(mine)
        os.close(other)
        task.cancel()


async def test_one_that_is_gone_takes_no_other_with_it(workers: AnswerWorkers, tmp_path: Path) -> None:
    go_on = tmp_path / "go on"

    def wait() -> str:
        while not go_on.exists():
            time.sleep(0.01)
        return "second"

    await workers.compute(lambda: 1)
    first = asyncio.create_task(workers.compute(sleep))
    await process_of(workers)
    (gone,) = workers._running
    first.cancel()
    await until(lambda: not workers._running)
    second = asyncio.create_task(workers.compute(wait))
    await process_of(workers)
    gone.end()
    go_on.touch()
    assert await second == "second"
