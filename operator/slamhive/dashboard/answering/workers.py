# SPDX-License-Identifier: Apache-2.0
"""Workers: processes that each compute one answer within a budget, and are ended at it.

What is known to cost little is computed in the dashboard itself, in a lane of its own.

A worker is ended when its CPU seconds, its memory or its time are used up, and when nobody waits for it any
more. How many there are at once is limited, and so is how many questions wait for one.
docs/decisions/0003-answers-in-workers.md says why they are forked.
"""

from __future__ import annotations

import asyncio
import logging
import os
import pickle
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import aclosing, suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

from slamhive.dashboard.answering.forking import BEGUN, BLOCK, END, MEMORY, MISTAKE, REFUSED, blocks, fork
from slamhive.dashboard.problems import Busy, Problem, TooCostly, WorkerRefusal
from slamhive.monitor.measuring.processes import read_file, stat_fields

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Callable, Iterable

T = TypeVar("T")

ROW_BYTES = 256
"""Bytes for each row of the table that an answer may take, where that is more than its budget of memory."""

_BUFFER = 2**18
_LOOK_SECONDS = 0.2
_NICE = 10
_GONE = -1
_TICK = os.sysconf("SC_CLK_TCK")
_ENDED_BY_OTHERS = {-signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT}
_HALVED_SECONDS = 10.0
_KEPT_CLIENTS = 1000
_LESS = "ask for fewer runs, columns or groups"
_log = logging.getLogger("slamhive.dashboard")


@dataclass(frozen=True)
class AnswerBudget:
    """Limits of CPU time, duration and memory for one answer of the dashboard.

    Attributes:
        cpu_seconds: of the worker.
        seconds: from its start to its last byte.
        memory: bytes beyond the table that it was forked with.
    """

    cpu_seconds: int = 10
    seconds: float = 30.0
    memory: int = 64 * 2**20

    def of(self, rows: int) -> AnswerBudget:
        """Return the budget for a table of so many rows: figures of each are some numbers for a while."""
        return replace(self, memory=max(self.memory, ROW_BYTES * rows))


@dataclass(frozen=True)
class AnswerLimits:
    """Limits for all answers of the dashboard together: their budgets, how many are computed, how many wait.

    Attributes:
        answer: budget of an answer.
        stream: budget of a whole table that is sent as it is made.
        inside: answers that are known to cost little, computed at once in the dashboard itself.
        short: answers computed at once in workers.
        long: further ones that have taken more than ``long_seconds`` of CPU, with less of a right to it.
        streams: whole tables at once; who asks for another is told to come back.
        waiting, waiting_of_one: questions that wait, of all and of one address.
        waiting_seconds: how long one waits at most.
    """

    answer: AnswerBudget = AnswerBudget()
    stream: AnswerBudget = AnswerBudget(cpu_seconds=60, seconds=300.0, memory=96 * 2**20)
    inside: int = 2
    short: int = 2
    long: int = 1
    long_seconds: float = 1.0
    streams: int = 1
    waiting: int = 64
    waiting_of_one: int = 32
    waiting_seconds: float = 20.0


@dataclass
class AnswerCost:
    """CPU time and memory that a worker process took to compute an answer.

    Attributes:
        cpu_seconds: user and system.
        memory: bytes resident at most, those of the table it was forked with among them.
    """

    cpu_seconds: float = 0.0
    memory: int = 0


@dataclass(eq=False)
class _AnswerProcess:
    pid: int
    handle: int
    client: str
    lane: str
    budget: AnswerBudget
    began: float = field(default_factory=time.monotonic)
    reason: Problem | None = None
    begun_with: int | None = None
    most: int = 0

    @property
    def grown(self) -> int:
        """Bytes it held at most, beyond those it began with; 0 where it ended before it could say."""
        return 0 if self.begun_with is None else self.most - self.begun_with

    def end(self, reason: Problem | None = None) -> None:
        """Kill it; the first reason is told."""
        self.reason = self.reason or reason
        if self.handle == _GONE:
            return
        with suppress(OSError):  # by its handle: its number may be another's by now
            signal.pidfd_send_signal(self.handle, signal.SIGKILL)

    def step_back(self) -> None:
        """Let others have the processor first."""
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, self.pid, _NICE)

    def cpu_seconds(self) -> float:
        """Return the CPU time it has used so far, s."""
        try:
            fields = stat_fields(read_file(f"/proc/{self.pid}/stat"))
        except (OSError, ValueError):
            return 0.0
        return (int(fields[11]) + int(fields[12])) / _TICK


class AnswerWorkers:
    """Computes answers in processes of their own.

    Who has used least of late is next: an address that asks for much waits behind the others.

    Attributes:
        told: called with the cost of each worker that is gone; None for nobody.
    """

    def __init__(self, limits: AnswerLimits | None = None) -> None:
        self._limits = limits or AnswerLimits()
        self._busy = {"inside": 0, "short": 0, "long": 0, "streams": 0}
        self._waiting: dict[str, list[tuple[str, asyncio.Future[None]]]] = {"inside": [], "short": []}
        self._threads = ThreadPoolExecutor(self._limits.inside, thread_name_prefix="inside")
        self._used: dict[str, tuple[float, float]] = {}
        self._running: dict[_AnswerProcess, asyncio.Future[int]] = {}
        self.told: Callable[[AnswerCost], None] | None = None

    async def compute_inside(self, work: Callable[[], T], client: str = "") -> T:
        """Return the result of a function that costs little, computed in a thread of this process.

        A fork takes some 20 ms, and as long again until the worker has its own copy of what it looks at. What
        is computed here can't be ended.

        Args:
            work: computes.
            client: address of who asks.

        Raises:
            Problem: what the function raised; or too many are waiting.
        """
        await self._enter("inside", client)
        loop = asyncio.get_running_loop()

        def timed() -> T:
            begin = time.thread_time()
            try:
                return work()
            finally:  # what fails, or what nobody waits for any more, has cost as much
                loop.call_soon_threadsafe(self._add_use, client, time.thread_time() - begin)

        computing = loop.run_in_executor(self._threads, timed)
        computing.add_done_callback(self._computed_inside)
        return await asyncio.shield(computing)

    def _computed_inside(self, computing: asyncio.Future[Any]) -> None:
        if not computing.cancelled():
            computing.exception()  # if nobody waits any more, nobody need hear of it
        self._leave("inside")

    async def compute(self, work: Callable[[], T], client: str = "", rows: int = 0) -> T:
        """Return the result of a function, computed in a worker.

        Args:
            work: computes; what it returns can be pickled.
            client: address of who asks.
            rows: of the table that it goes through.

        Raises:
            Problem: what the function raised; or its budget is used up; or too many are waiting.
        """
        await self._enter("short", client)
        found = bytearray()
        one = self._run(lambda: [pickle.dumps(work(), pickle.HIGHEST_PROTOCOL)], client, "short", rows)
        async with aclosing(one) as parts:
            async for part in parts:
                found += part
        result: T = pickle.loads(found)  # noqa: S301 - written by a process of ours
        return result

    async def stream(
        self, work: Callable[[], Iterable[bytes]], client: str = ""
    ) -> AsyncGenerator[bytes, None]:
        """Go through the blocks that a function yields in a worker, made no faster than they are taken.

        Args:
            work: yields blocks.
            client: address of who asks.

        Raises:
            Problem: as for ``compute``.
        """
        if self._busy["streams"] >= self._limits.streams:
            raise Busy("another whole table is being sent: ask again in a few seconds, or take pages", 10)
        self._busy["streams"] += 1
        async with aclosing(self._run(work, client, "streams")) as parts:
            async for part in parts:
                yield part

    async def stop(self) -> None:
        """End all workers."""
        for worker in list(self._running):
            worker.end()
        if self._running:
            await asyncio.wait(list(self._running.values()))
        self._threads.shutdown(wait=False, cancel_futures=True)

    async def _enter(self, lane: str, client: str) -> None:
        """Wait for a place.

        Raises:
            Busy: too many are waiting, or no place came free.
        """
        most: int = getattr(self._limits, lane)
        if self._busy[lane] < most:
            self._busy[lane] += 1
            return
        waiting = self._waiting[lane]
        mine = sum(other == client for other, _ in waiting)
        if len(waiting) >= self._limits.waiting or mine >= self._limits.waiting_of_one:
            raise Busy("too many questions are waiting: ask again in a few seconds")
        place = asyncio.get_running_loop().create_future()
        ticket = client, place
        waiting.append(ticket)
        try:
            async with asyncio.timeout(self._limits.waiting_seconds):
                await place
        except BaseException as error:
            if ticket in waiting:
                waiting.remove(ticket)
            elif place.done() and not place.cancelled():
                self._leave(lane)  # it came too late
            if isinstance(error, TimeoutError):
                raise Busy("other questions take long: ask again in a few seconds") from None
            raise

    def _leave(self, lane: str) -> None:
        """Give a place back, and to the one that has used least."""
        self._busy[lane] -= 1
        waiting = self._waiting.get(lane, [])
        now = time.monotonic()  # one moment for all: who came first is next among equals
        while waiting and self._busy[lane] < getattr(self._limits, lane):
            ticket = min(waiting, key=lambda one: self._used_by(one[0], now))
            waiting.remove(ticket)
            if not ticket[1].done():
                self._busy[lane] += 1
                ticket[1].set_result(None)

    def _add_use(self, client: str, seconds: float) -> None:
        if len(self._used) >= _KEPT_CLIENTS:
            self._used.clear()
        now = time.monotonic()
        self._used[client] = self._used_by(client, now) + seconds, now

    def _used_by(self, client: str, now: float) -> float:
        seconds, when = self._used.get(client, (0.0, now))
        return float(seconds * 0.5 ** ((now - when) / _HALVED_SECONDS))

    async def _run(
        self, work: Callable[[], Iterable[bytes]], client: str, lane: str, rows: int = 0
    ) -> AsyncGenerator[bytes, None]:
        """Go through the blocks of a worker; its place is given back when it is gone."""
        budget = (self._limits.stream if lane == "streams" else self._limits.answer).of(rows)
        loop = asyncio.get_running_loop()
        try:
            pid, pipe = fork(work, budget.cpu_seconds, budget.memory)
        except OSError as error:
            self._leave(lane)
            raise Busy(f"no worker can be started at present: {error.strerror}") from None
        worker = _AnswerProcess(pid, os.pidfd_open(pid), client, lane, budget)
        if lane == "streams":
            worker.step_back()
        gone = self._running[worker] = loop.create_future()
        loop.add_reader(worker.handle, self._gone, worker)
        watch = loop.create_task(self._watch(worker), name="watch a worker")
        opened = os.fdopen(pipe, "rb", buffering=0)
        transport: asyncio.BaseTransport | None = None
        try:
            reader = asyncio.StreamReader(_BUFFER)
            transport, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), opened)
            ended = False
            async with aclosing(blocks(reader)) as parts:
                async for kind, part in parts:
                    if kind == BLOCK:
                        yield part
                    elif kind == BEGUN:
                        worker.begun_with = int(part) * 1024
                    elif kind == END:
                        ended = True
                    else:
                        raise _problem(kind, part, budget)
            if not ended:
                status = await asyncio.shield(gone)
                raise worker.reason or _death(status, worker.grown, budget)
        finally:
            watch.cancel()
            worker.end()
            transport.close() if transport is not None else opened.close()

    def _gone(self, worker: _AnswerProcess) -> None:
        asyncio.get_running_loop().remove_reader(worker.handle)
        _, status, usage = os.wait4(worker.pid, 0)
        os.close(worker.handle)
        worker.handle = _GONE  # the number is the next one's by now
        self._running.pop(worker).set_result(status)
        cost = AnswerCost(usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024)
        worker.most = cost.memory
        self._add_use(worker.client, cost.cpu_seconds)
        if self.told is not None:
            self.told(cost)
        self._leave(worker.lane)

    async def _watch(self, worker: _AnswerProcess) -> None:
        """End a worker when its time is over; let the others pass one that takes long."""
        while True:
            await asyncio.sleep(_LOOK_SECONDS)
            if time.monotonic() - worker.began > worker.budget.seconds:
                seconds = worker.budget.seconds
                worker.end(Busy(f"the answer was not ready in {seconds:g} s: ask again later", 30))
            if worker.lane != "short" or worker.cpu_seconds() < self._limits.long_seconds:
                continue
            if self._busy["long"] < self._limits.long:
                worker.step_back()
                self._busy["long"] += 1
                worker.lane = "long"
                self._leave("short")
            elif self._waiting["short"]:
                worker.end(Busy("this takes long, and so does what others ask: ask again in a while", 10))


def _problem(kind: bytes, part: bytes, budget: AnswerBudget) -> Problem:
    """Return the problem that a worker told instead of an answer."""
    if kind == REFUSED:
        return WorkerRefusal(*pickle.loads(part))  # noqa: S301 - written by a process of ours
    if kind == MISTAKE:
        name, text = pickle.loads(part)  # noqa: S301
        _log.error("an error in the dashboard itself\n%s", text)
        sentence = f"an error in the dashboard itself ({name}); its log says more"
        return WorkerRefusal(500, {"error": sentence, "field": None})
    return _too_much_memory(budget) if kind == MEMORY else Busy("the answer was lost on its way")


def _death(status: int, grown: int, budget: AnswerBudget) -> Problem:
    """Return the problem for a worker that ended and was not ended from here.

    Args:
        status: how it ended, as of ``os.wait``.
        grown: bytes it held at most, beyond those it began with.
        budget: its limits.
    """
    number = os.waitstatus_to_exitcode(status)
    if number == -signal.SIGXCPU:
        return TooCostly(f"the answer takes more than {budget.cpu_seconds} s of CPU time: {_LESS}")
    if number in _ENDED_BY_OTHERS and grown < budget.memory // 2:
        # Not at its own limit: all processes together were at theirs, and it is the first one to go.
        return Busy("memory was short, and the answer was given up: ask again in a while", 10)
    # A library that gets no memory may end in any way, and would end so again.
    _log.warning("a process that computed an answer ended (%s)", number)
    return _too_much_memory(budget)


def _too_much_memory(budget: AnswerBudget) -> Problem:
    return TooCostly(f"the answer takes more than {budget.memory // 2**20} MiB of memory: {_LESS}")
