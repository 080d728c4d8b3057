# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import asyncio
import heapq
import itertools
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.queue import LAST_BACKOFF_SECONDS, Queue

if TYPE_CHECKING:
    from collections.abc import Callable


def key(name: str) -> Key:
    return Key(Kind.MAPPING_RUN, "lab", name)


A, B = key("a"), key("b")


class Alarm:
    """A call that can be called off."""

    def __init__(self, callback: Callable[[], None]) -> None:
        self.callback: Callable[[], None] | None = callback

    def cancel(self) -> None:
        self.callback = None


class FakeTimer:
    """A clock that moves when told to."""

    def __init__(self) -> None:
        self.now = 0.0
        self._alarms: list[tuple[float, int, Alarm]] = []
        self._numbers = itertools.count()

    def time(self) -> float:
        return self.now

    def call_later(self, delay: float, callback: Callable[..., None], *args: Any) -> Alarm:
        alarm = Alarm(lambda: callback(*args))
        heapq.heappush(self._alarms, (self.now + delay, next(self._numbers), alarm))
        return alarm

    def advance(self, seconds: float) -> None:
        self.now += seconds
        while self._alarms and self._alarms[0][0] <= self.now:
            alarm = heapq.heappop(self._alarms)[2]
            if alarm.callback is not None:
                alarm.callback()


@pytest.fixture
def timer() -> FakeTimer:
    return FakeTimer()


@pytest.fixture
def queue(timer: FakeTimer) -> Queue:
    return Queue(timer, jitter=lambda: 1.0)


async def test_the_same_key_waits_once(queue: Queue) -> None:
    for item in (A, B, A, A):
        queue.add(item)
    assert len(queue) == 2
    assert [await queue.get(), await queue.get()] == [A, B]
    assert len(queue) == 0


async def test_what_comes_while_a_key_is_handled_brings_it_back(queue: Queue) -> None:
    queue.add(A)
    await queue.get()
    queue.add(A)
    assert len(queue) == 0
    queue.done(A)
    assert await queue.get() == A


async def test_a_delayed_key_comes_in_time(queue: Queue, timer: FakeTimer) -> None:
    queue.add(A, 5.0)
    timer.advance(4.9)
    assert (len(queue), queue.delayed) == (0, 1)
    timer.advance(0.1)
    assert (len(queue), queue.delayed) == (1, 0)


@pytest.mark.parametrize("delays", [(30.0, 5.0), (5.0, 30.0)])
async def test_the_earlier_time_wins(queue: Queue, timer: FakeTimer, delays: tuple[float, float]) -> None:
    for delay in delays:
        queue.add(A, delay)
    timer.advance(5.0)
    assert await queue.get() == A
    queue.done(A)
    timer.advance(100.0)
    assert len(queue) == 0


async def test_a_wish_to_return_later_survives_the_handling(queue: Queue, timer: FakeTimer) -> None:
    queue.add(A)
    await queue.get()
    queue.add(A, 10.0)
    queue.done(A)
    timer.advance(9.9)
    assert len(queue) == 0
    timer.advance(0.2)
    assert len(queue) == 1


async def test_failures_wait_longer_each_time_until_forgotten(queue: Queue) -> None:
    queue.add(A)
    waits = [queue.retry(A) for _ in range(10)]
    assert waits[:4] == [0.5, 1.0, 2.0, 4.0]
    assert waits[-1] == LAST_BACKOFF_SECONDS
    queue.forget(A)
    assert queue.retry(A) == 0.5
    assert queue.failures(A) == 1


async def test_a_reader_that_is_cancelled_takes_nothing_along(queue: Queue) -> None:
    reader = asyncio.create_task(queue.get())
    await asyncio.sleep(0)
    queue.add(A)
    reader.cancel()
    with pytest.raises(asyncio.CancelledError):
        await reader
    assert await queue.get() == A


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("add"), st.integers(0, 3), st.sampled_from([0.0, 0.0, 1.0, 7.0])),
        st.tuples(st.just("retry"), st.integers(0, 3), st.just(0.0)),
        st.tuples(st.just("get"), st.just(0), st.just(0.0)),
        st.tuples(st.just("done"), st.integers(0, 3), st.just(0.0)),
        st.tuples(st.just("wait"), st.just(0), st.sampled_from([0.5, 3.0])),
    ),
    max_size=60,
)


@given(STEPS)
def test_never_two_at_once_and_nothing_lost(steps: list[tuple[str, int, float]]) -> None:
    asyncio.run(_play(steps))


async def _play(steps: list[tuple[str, int, float]]) -> None:
    timer = FakeTimer()
    queue = Queue(timer, jitter=lambda: 0.5)
    keys = [key(str(number)) for number in range(4)]
    active: set[Key] = set()
    owed: set[Key] = set()
    for what, number, seconds in steps:
        item = keys[number]
        if what in {"add", "retry"}:
            queue.add(item, seconds) if what == "add" else queue.retry(item)
            owed.add(item)
        elif what == "get" and len(queue):
            got = await queue.get()
            assert got not in active
            active.add(got)
            owed.discard(got)
        elif what == "done" and item in active:
            active.discard(item)
            queue.done(item)
        elif what == "wait":
            timer.advance(seconds)
    for item in active:
        queue.done(item)
    timer.advance(100.0)
    assert {await queue.get() for _ in range(len(queue))} == owed
    assert queue.delayed == 0
