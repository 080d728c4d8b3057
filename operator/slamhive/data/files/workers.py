# SPDX-License-Identifier: Apache-2.0
"""Threads that encode and decode images beside the thread that reads or writes a recording, few waiting.

Writers of folders and importers use them: memory stays the same however long a recording is.
"""

from __future__ import annotations

import os
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Self, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_THREADS = 4
_WAITING = 2
"""Images that wait for each thread at most."""
_QUEUED = 4096
"""Items without work that wait between those with work at most."""


class Workers:
    """A few threads. Leaving the context waits for what is under way; after an error the rest is dropped."""

    def __init__(self) -> None:
        # The cores of this process: a run's recording is prepared on the run's own.
        count = min(len(os.sched_getaffinity(0)), _THREADS)
        self._limit = count * _WAITING
        self._pool = ThreadPoolExecutor(count)
        self._waiting: deque[Future[Any]] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            while kind is None and self._waiting:
                self._waiting.popleft().result()
        finally:
            self._pool.shutdown(cancel_futures=True)

    def later(self, work: Callable[[], None]) -> None:
        """Have something done; waits while too much is under way, and raises what earlier work raised."""
        while len(self._waiting) >= self._limit:
            self._waiting.popleft().result()
        self._waiting.append(self._pool.submit(work))

    def ahead(
        self, items: Iterable[tuple[_Item, Callable[[], _Result] | None]]
    ) -> Iterator[tuple[_Item, _Result | None]]:
        """Yield items with the results of their work, in order; the work of later ones is begun meanwhile.

        Args:
            items: Each with its work, None where there is none.
        """
        waiting: deque[tuple[_Item, Future[_Result] | None]] = deque()
        busy = 0
        for item, work in items:
            waiting.append((item, None if work is None else self._pool.submit(work)))
            busy += work is not None
            # What is done, or takes nothing, waits for nobody.
            while waiting and (busy > self._limit or len(waiting) > _QUEUED or _is_done(waiting[0][1])):
                first, future = waiting.popleft()
                busy -= future is not None
                yield first, None if future is None else future.result()
        for item, future in waiting:
            yield item, None if future is None else future.result()


def _is_done(future: Future[Any] | None) -> bool:
    return future is None or future.done()
