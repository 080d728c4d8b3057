# SPDX-License-Identifier: Apache-2.0
"""From a request to an answer: fresh data, a few threads to compute in, a memory of what was asked before."""

from __future__ import annotations

import asyncio
import gzip
import os
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from fastapi import Request, Response

from slamhive import __version__
from slamhive.dashboard.encoding import TYPES, Body, Format, choose_format, encode
from slamhive.dashboard.problems import Unavailable

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.dashboard.sources import Snapshot, Source

T = TypeVar("T")

REMEMBERED_BYTES = 24 * 2**20
"""What answers are kept for those who ask the same."""

_FAIR = frozenset({"Grid", "Random", "Sobol"})
"""Ways of searching that don't look at results."""

_SMALL = 1024
_LEVEL = 4
_THREADS = 4


@dataclass(frozen=True)
class Answer:
    """An answer as it goes over the wire."""

    plain: bytes | None
    packed: bytes | None
    link: str | None

    @property
    def size(self) -> int:
        """Bytes it takes to keep."""
        return len(self.plain or b"") + len(self.packed or b"")


class Service:
    """What all requests share.

    Args:
        source: where the data come from.
    """

    def __init__(self, source: Source) -> None:
        self.source = source
        threads = min(_THREADS, (os.cpu_count() or 1) + 1)
        self.executor = ThreadPoolExecutor(threads, thread_name_prefix="answer")
        self._looking = ThreadPoolExecutor(1, thread_name_prefix="look")
        self._kept: OrderedDict[tuple[str, ...], Answer] = OrderedDict()
        self._bytes = 0
        self._pending: dict[tuple[str, ...], asyncio.Future[Answer]] = {}

    async def start(self) -> None:
        """Begin to look after the data."""
        await self.source.start(self._looking)

    async def stop(self) -> None:
        """End."""
        await self.source.stop()
        self.executor.shutdown(wait=False, cancel_futures=True)
        self._looking.shutdown(wait=False, cancel_futures=True)

    async def fresh(self) -> Snapshot:
        """Return the data as they are now.

        Raises:
            Unavailable: there are none yet.
        """
        snapshot = await self.source.fresh()
        if not self.source.ready:
            raise Unavailable("; ".join(snapshot.problems) or "the data are still being read")
        return snapshot

    async def adaptive_sweeps(self) -> frozenset[str]:
        """Return the names of the sweeps whose points were chosen by earlier results."""
        await self.fresh()
        sweeps = await self.run(self.source.sweeps)
        methods = {sweep.name: (sweep.spec.get("search") or {}).get("method", "Grid") for sweep in sweeps}
        return frozenset(name for name, method in methods.items() if method not in _FAIR)

    async def run(self, compute: Callable[[], T]) -> T:
        """Compute something in a thread."""
        return await asyncio.get_running_loop().run_in_executor(self.executor, compute)

    async def answer(self, request: Request, compute: Callable[[Snapshot], Body]) -> Response:
        """Return what a computation makes of the data, or 304 where the client has it already."""
        snapshot = await self.fresh()
        form = choose_format(request.query_params.get("format"), request.headers.get("accept", ""))
        tag = f'W/"{__version__}-{snapshot.revision}-{form}"'
        headers = {
            "ETag": tag,
            "Cache-Control": "no-cache",
            "Vary": "Accept, Accept-Encoding",
            "X-Revision": snapshot.revision,
        }
        if tag in request.headers.get("if-none-match", ""):
            return Response(status_code=304, headers=headers)
        key = (snapshot.revision, request.url.path, request.url.query, form)
        answer = await self._remembered(key, lambda: _make(compute(snapshot), form))
        if answer.link:
            headers["Link"] = f'<{answer.link}>; rel="next"'
        packed = "gzip" in request.headers.get("accept-encoding", "")
        content = answer.packed if packed else answer.plain
        if content is None:
            content = answer.plain if answer.packed is None else gzip.decompress(answer.packed)
        elif packed:
            headers["Content-Encoding"] = "gzip"
        return Response(content, media_type=TYPES[form], headers=headers)

    async def _remembered(self, key: tuple[str, ...], make: Callable[[], Answer]) -> Answer:
        kept = self._kept.get(key)
        if kept is not None:
            self._kept.move_to_end(key)
            return kept
        pending = self._pending.get(key)
        if pending is None:
            # Who asks the same meanwhile waits for the same answer.
            pending = asyncio.ensure_future(self.run(make))
            self._pending[key] = pending
            pending.add_done_callback(lambda _: self._pending.pop(key, None))
        answer = await asyncio.shield(pending)
        if key not in self._kept and answer.size < REMEMBERED_BYTES // 4:
            self._kept[key] = answer
            self._bytes += answer.size
            while self._bytes > REMEMBERED_BYTES:
                self._bytes -= self._kept.popitem(last=False)[1].size
        return answer


def _make(body: Body, form: Format) -> Answer:
    content = encode(body, form)
    if len(content) < _SMALL:
        return Answer(content, None, body.link)
    return Answer(None, gzip.compress(content, _LEVEL, mtime=0), body.link)
