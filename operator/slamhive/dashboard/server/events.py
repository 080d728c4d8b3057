# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/events``: what changed, as server-sent events."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING

from slamhive.dashboard.answering.encoding import encode_json
from slamhive.dashboard.answers.catalog import state
from slamhive.dashboard.problems import SourceUnavailable

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator

    from slamhive.dashboard.server.service import Service
    from slamhive.dashboard.sources.archived import Snapshot

CHECK_SECONDS = 2.0
QUIET_SECONDS = 15.0
MAX_LISTENERS = 200
RETRY_MILLISECONDS = 3000


class Events:
    """Tells all listeners of each change; the data are looked at once for all of them.

    Args:
        service: where the data come from.
        most_of_one: listeners of one address.
    """

    def __init__(self, service: Service, most_of_one: int = MAX_LISTENERS) -> None:
        self._service = service
        self._most_of_one = most_of_one
        self._changed = asyncio.Condition()
        self._latest: tuple[str, bytes] = ("", b"")
        self._watcher: asyncio.Task[None] | None = None
        self._stopped = False
        self._listeners: Counter[str] = Counter()

    async def stream(self, address: str = "") -> AsyncGenerator[bytes, None]:
        """Go through the events for one listener: nothing once it has a place, then the present state.

        Args:
            address: of who listens.

        Raises:
            SourceUnavailable: as many are listening as may.
        """
        of_one, of_all = self._listeners[address], self._listeners.total()
        if of_one >= self._most_of_one or of_all >= MAX_LISTENERS:
            raise SourceUnavailable(
                f"{of_all} pages are listening, {of_one} of this address: ask /api/v1 every few seconds"
            )
        self._listeners[address] += 1
        try:
            yield b""
            if self._watcher is None or self._watcher.done():
                self._watcher = asyncio.create_task(self._watch(), name="events")
            yield f"retry: {RETRY_MILLISECONDS}\n\n".encode()
            seen = ""
            while not self._stopped:
                event = await self._next(seen)
                if event is None:
                    yield b": still here\n\n"
                else:
                    seen = event[0]
                    yield event[1]
        finally:
            self._listeners -= Counter([address])  # none is kept at 0

    async def stop(self) -> None:
        """Let all listeners go."""
        self._stopped = True
        if self._watcher is not None:
            self._watcher.cancel()
        async with self._changed:
            self._changed.notify_all()

    async def _next(self, seen: str) -> tuple[str, bytes] | None:
        async with self._changed:
            try:
                async with asyncio.timeout(QUIET_SECONDS):
                    await self._changed.wait_for(lambda: self._stopped or self._latest[0] not in {"", seen})
            except TimeoutError:
                return None
        return None if self._stopped else self._latest

    async def _watch(self) -> None:
        while self._listeners and not self._stopped:
            begun = time.monotonic()
            snapshot = await self._service.source.fresh()
            if snapshot.revision != self._latest[0]:
                data = await self._service.run(partial(self._event, snapshot))
                async with self._changed:
                    self._latest = (snapshot.revision, data)
                    self._changed.notify_all()
            await asyncio.sleep(max(0.1, CHECK_SECONDS - (time.monotonic() - begun)))

    def _event(self, snapshot: Snapshot) -> bytes:
        content = encode_json(state(snapshot, self._service.source))
        return b"event: revision\nid: " + snapshot.revision.encode() + b"\ndata: " + content + b"\n\n"
