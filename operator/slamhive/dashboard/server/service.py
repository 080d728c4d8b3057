# SPDX-License-Identifier: Apache-2.0
"""Service behind the API: from a request to an answer, with fresh data, workers that compute, and a cache."""

from __future__ import annotations

import asyncio
import gzip
import logging
import os
import zlib
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from contextlib import aclosing
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from fastapi import Request, Response
from starlette.responses import StreamingResponse

from slamhive import __version__
from slamhive.analysis.searches.robustness import searches_of
from slamhive.analysis.selection import find_repeated
from slamhive.dashboard.answering.encoding import (
    TYPES,
    Body,
    Format,
    Table,
    choose_format,
    encode,
    encode_blocks,
)
from slamhive.dashboard.answering.totals import StoredSweeps, SweepTotals
from slamhive.dashboard.answering.workers import AnswerLimits, AnswerWorkers
from slamhive.dashboard.answers import common_support
from slamhive.dashboard.problems import Problem, SourceUnavailable, TooCostly
from slamhive.dashboard.server.security import HEAD

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Iterator

    from starlette.types import Send

    from slamhive.dashboard.answers.common_support import Meant, ResultMaterial
    from slamhive.dashboard.sources.archived import Snapshot, Source
    from slamhive.model.search import Search

_log = logging.getLogger("slamhive.dashboard")

T = TypeVar("T")
G = TypeVar("G")

REMEMBERED_BYTES = 24 * 2**20
"""Bytes of answers that are kept for those who ask the same."""

_SMALL = 1024
_LEVEL = 4
_THREADS = 4
_UNPACKED = 2**18
_KEPT_REFUSALS = 1000


@dataclass(frozen=True)
class Answer:
    """An answer as it goes over the wire.

    Attributes:
        content: its bytes, packed by gzip where that is worth it.
        length: bytes of what is packed; None where it is not packed.
        link: address of the next page.
    """

    content: bytes
    length: int | None
    link: str | None

    def unpacked(self) -> Iterator[bytes]:
        """Go through what is packed in blocks."""
        unpacking = zlib.decompressobj(wbits=31)
        left = self.content
        while left:
            yield unpacking.decompress(left, _UNPACKED)
            left = unpacking.unconsumed_tail


@dataclass
class _Pending:
    """An answer that is being computed, and how many wait for it."""

    task: asyncio.Task[Answer]
    waiting: int = 0


class Service:
    """State that all requests to the dashboard share: data source, worker processes and kept answers.

    Args:
        source: where the data come from.
        limits: what answers may cost.
    """

    def __init__(self, source: Source, limits: AnswerLimits | None = None) -> None:
        self.source = source
        self.workers = AnswerWorkers(limits)
        self._totals = SweepTotals(self.workers)
        threads = min(_THREADS, (os.cpu_count() or 1) + 1)
        self.executor = ThreadPoolExecutor(threads, thread_name_prefix="answer")
        self._looking = ThreadPoolExecutor(1, thread_name_prefix="look")
        self._kept: OrderedDict[tuple[str, ...], Answer] = OrderedDict()
        self._bytes = 0
        self._refusals: OrderedDict[tuple[str, ...], Problem] = OrderedDict()
        self._pending: dict[tuple[str, ...], _Pending] = {}

    async def start(self) -> None:
        """Begin to look after the data."""
        await self.source.start(self._looking)

    async def stop(self) -> None:
        """End."""
        await self.workers.stop()
        await self.source.stop()
        self.executor.shutdown(wait=False, cancel_futures=True)
        self._looking.shutdown(wait=False, cancel_futures=True)

    async def fresh(self) -> Snapshot:
        """Return the data as they are now.

        Raises:
            SourceUnavailable: there are none yet.
        """
        snapshot = await self.source.fresh()
        if not self.source.ready:
            raise SourceUnavailable("; ".join(snapshot.problems) or "the data are still being read")
        return snapshot

    async def asked_for(self, _: Snapshot) -> StoredSweeps:
        """Return the sweeps that the archive knows, with how many runs each has."""
        records = await self.run(self.source.sweeps)
        return StoredSweeps(records, await self._totals.of(records))

    async def threshold_searches(self, _: Snapshot) -> dict[str, Search]:
        """Return the searches of the sweeps that sought thresholds, by identity."""
        return searches_of({sweep.uid: sweep.spec for sweep in await self.run(self.source.sweeps)})

    async def run(self, compute: Callable[[], T]) -> T:
        """Look something up in a thread: what asks databases, and costs little."""
        return await asyncio.get_running_loop().run_in_executor(self.executor, compute)

    async def answer(
        self,
        request: Request,
        compute: Callable[[Snapshot], Body],
        little: Callable[[Snapshot], bool] | None = None,
    ) -> Response:
        """Return an answer computed of the data, or 304 where the client has it already.

        Args:
            request: what is asked.
            compute: makes the answer.
            little: tells whether that is known to cost little; otherwise, and by default, a worker does it.
        """

        async def nothing(_: Snapshot) -> None:
            return None

        return await self.answer_with(request, nothing, lambda data, _: compute(data), little)

    async def answer_of_files(
        self,
        request: Request,
        meant: Callable[[Snapshot], Meant],
        compute: Callable[[Snapshot, ResultMaterial], Body],
    ) -> Response:
        """Return an answer computed of the data and of the files of some runs.

        Args:
            request: what is asked.
            meant: chooses the runs.
            compute: makes the answer.
        """
        client = client_of(request)

        async def material(snapshot: Snapshot) -> ResultMaterial:
            chosen = await self.workers.compute(lambda: meant(snapshot), client, len(snapshot.frame))
            return await self.run(lambda: common_support.material(self.source, chosen))

        return await self.answer_with(request, material, compute)

    async def answer_with(
        self,
        request: Request,
        gather: Callable[[Snapshot], Awaitable[G]],
        compute: Callable[[Snapshot, G], Body],
        little: Callable[[Snapshot], bool] | None = None,
    ) -> Response:
        """Return an answer computed of the data and of what is gathered for it beforehand.

        Args:
            request: what is asked.
            gather: gets what a worker can't: records of the archive.
            compute: makes the answer.
            little: as for ``answer``.
        """
        snapshot = await self.fresh()
        form = choose_format(request.query_params.get("format"), request.headers.get("accept", ""))
        headers = _headers(snapshot, form)
        if headers["ETag"] in request.headers.get("if-none-match", ""):
            return Response(status_code=304, headers=headers)

        async def make() -> Answer:
            given = await gather(snapshot)
            work = partial(_answer, compute, snapshot, given, form)
            client = client_of(request)
            if little is not None and little(snapshot):
                return await self.workers.compute_inside(work, client)
            await self.run(partial(find_repeated, snapshot.frame))  # once for all workers of this state
            return await self.workers.compute(work, client, len(snapshot.frame))

        key = (snapshot.revision, request.url.path, request.url.query, form)
        answer = await self._remembered(key, make, request)
        if answer.link:
            headers["Link"] = f'<{answer.link}>; rel="next"'
        if answer.length is None:
            return Response(answer.content, media_type=TYPES[form], headers=headers)
        if _takes_gzip(request):
            headers["Content-Encoding"] = "gzip"
            return Response(answer.content, media_type=TYPES[form], headers=headers)
        headers["Content-Length"] = str(answer.length)
        return StreamingResponse(answer.unpacked(), media_type=TYPES[form], headers=headers)

    async def stream(self, request: Request, make: Callable[[Snapshot], Table]) -> Response:
        """Return a whole table as a file, sent as a worker makes it; nothing of it is remembered."""
        snapshot = await self.fresh()
        form = choose_format(request.query_params.get("format"), request.headers.get("accept", ""))
        headers = _headers(snapshot, form)
        if headers["ETag"] in request.headers.get("if-none-match", ""):
            return Response(status_code=304, headers=headers)
        key = (snapshot.revision, request.url.path, request.url.query, form)
        self._recall(key)
        packed = _takes_gzip(request) and form is Format.CSV
        if packed:
            headers["Content-Encoding"] = "gzip"

        def work() -> Iterator[bytes]:
            blocks = encode_blocks(make(snapshot), form)
            return _packed(blocks) if packed else blocks

        blocks = self._streamed(key, work, client_of(request))
        try:
            first = await anext(blocks, b"")  # what is wrong is known by now, and has a status of its own
        except BaseException:
            await blocks.aclose()
            raise

        if request.scope.get(HEAD):
            await blocks.aclose()
            return Response(media_type=TYPES[form], headers=headers)

        async def sent() -> AsyncIterator[bytes]:
            try:
                yield first
                async for block in blocks:
                    yield block
            finally:
                await blocks.aclose()

        return _SentTable(sent(), media_type=TYPES[form], headers=headers)

    async def _remembered(
        self, key: tuple[str, ...], make: Callable[[], Awaitable[Answer]], request: Request
    ) -> Answer:
        kept = self._kept.get(key)
        if kept is not None:
            self._kept.move_to_end(key)
            return kept
        self._recall(key)
        pending = self._pending.get(key)
        if pending is None:
            # Who asks the same meanwhile waits for the same answer.
            pending = self._pending[key] = _Pending(asyncio.ensure_future(_call(make)))
        answer = await self._awaited(key, pending, request)
        if key not in self._kept and len(answer.content) < REMEMBERED_BYTES // 4:
            self._kept[key] = answer
            self._bytes += len(answer.content)
            while self._bytes > REMEMBERED_BYTES:
                self._bytes -= len(self._kept.popitem(last=False)[1].content)
        return answer

    async def _awaited(self, key: tuple[str, ...], pending: _Pending, request: Request) -> Answer:
        """Wait for an answer as long as the client does; the last one to leave ends what computes it."""
        pending.waiting += 1
        left = asyncio.ensure_future(_departure(request))
        try:
            await asyncio.wait({pending.task, left}, return_when=asyncio.FIRST_COMPLETED)
            if not pending.task.done():
                raise SourceUnavailable("the client has left")
            return pending.task.result()
        except TooCostly as error:
            self._refuse(key, error)
            raise
        finally:
            left.cancel()
            pending.waiting -= 1
            if not pending.waiting:
                pending.task.cancel()
            if self._pending.get(key) is pending and (pending.task.done() or not pending.waiting):
                del self._pending[key]

    async def _streamed(
        self, key: tuple[str, ...], work: Callable[[], Iterator[bytes]], client: str
    ) -> AsyncGenerator[bytes, None]:
        async with aclosing(self.workers.stream(work, client)) as blocks:
            try:
                async for block in blocks:
                    yield block
            except TooCostly as error:
                self._refuse(key, error)
                raise

    def _refuse(self, key: tuple[str, ...], error: TooCostly) -> None:
        """Remember a question that costs too much: it would be the same again, at the same cost."""
        self._refusals[key] = error
        while len(self._refusals) > _KEPT_REFUSALS:
            self._refusals.popitem(last=False)

    def _recall(self, key: tuple[str, ...]) -> None:
        if key in self._refusals:
            raise self._refusals[key].with_traceback(None)


class _SentTable(StreamingResponse):
    """A table on its way; one that breaks off has no end, so that nobody takes it for a whole one."""

    async def stream_response(self, send: Send) -> None:
        try:
            await super().stream_response(send)
        except Problem as error:
            _log.warning("a table broke off: %s", error)


async def _call(make: Callable[[], Awaitable[Answer]]) -> Answer:
    return await make()


async def _departure(request: Request) -> None:
    """Wait until the client has left."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


def service_of(request: Request) -> Service:
    """Return the service of the application that was asked."""
    service: Service = request.app.state.service
    return service


def client_of(request: Request) -> str:
    """Return the address of who asks."""
    return request.client.host if request.client is not None else ""


def _takes_gzip(request: Request) -> bool:
    return "gzip" in request.headers.get("accept-encoding", "")


def _headers(snapshot: Snapshot, form: Format) -> dict[str, str]:
    return {
        "ETag": f'W/"{__version__}-{snapshot.revision}-{form}"',
        "Cache-Control": "no-cache",
        "Vary": "Accept, Accept-Encoding",
        "X-Revision": snapshot.revision,
    }


def _answer(compute: Callable[[Snapshot, G], Body], snapshot: Snapshot, given: G, form: Format) -> Answer:
    body = compute(snapshot, given)
    content = encode(body, form)
    if len(content) < _SMALL:
        return Answer(content, None, body.link)
    return Answer(gzip.compress(content, _LEVEL, mtime=0), len(content), body.link)


def _packed(blocks: Iterator[bytes]) -> Iterator[bytes]:
    packing = zlib.compressobj(_LEVEL, wbits=31)
    for block in blocks:
        if found := packing.compress(block):
            yield found
    yield packing.flush()
