# SPDX-License-Identifier: Apache-2.0
"""The work queue: which objects to look at, each once, and never the same one twice at a time.

What is added while an object is being handled is remembered and comes back when it is done, so nothing that
happened meanwhile is missed. An object that waits for a later time and is added for an earlier one comes
at the earlier.
"""

from __future__ import annotations

import asyncio
import random
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.kube.api.kinds import Key

FIRST_BACKOFF_SECONDS = 0.5
LAST_BACKOFF_SECONDS = 60.0


class Cancellable(Protocol):
    """Handle of a scheduled call that can still be cancelled, as asyncio's TimerHandle."""

    def cancel(self) -> None:
        """Call it off."""


class Timer(Protocol):
    """The part of an event loop that the queue needs; tests give one with a clock of their own."""

    def time(self) -> float:
        """Return the time in s."""

    def call_later(self, delay: float, callback: Callable[..., None], *args: Any) -> Cancellable:
        """Call a function in some seconds."""


class Queue:
    """Keys that wait to be handled.

    Args:
        timer: clock and alarm; default: the running event loop.
        jitter: returns a number in [0, 1), so that what failed together does not return together.
    """

    def __init__(self, timer: Timer | None = None, jitter: Callable[[], float] = random.random) -> None:
        self._timer = timer
        self._jitter = jitter
        self._ready: asyncio.Queue[Key] = asyncio.Queue()
        self._queued: set[Key] = set()
        self._active: set[Key] = set()
        self._later: dict[Key, tuple[float, Cancellable]] = {}
        self._again: dict[Key, float] = {}
        self._failures: dict[Key, int] = {}

    def __len__(self) -> int:
        """Return the number of keys that are ready to be handled."""
        return len(self._queued)

    @property
    def delayed(self) -> int:
        """Return the number of keys that wait for a later time."""
        return len(self._later)

    @property
    def active(self) -> frozenset[Key]:
        """Return the keys that are being handled."""
        return frozenset(self._active)

    def add(self, key: Key, delay: float = 0.0) -> None:
        """Have a key handled, in some seconds at the latest."""
        due = self._clock.time() + max(delay, 0.0)
        if key in self._active:
            # Never two workers on one object: what comes meanwhile is handled when this one is done.
            self._again[key] = min(due, self._again.get(key, due))
        elif key not in self._queued:
            self._schedule(key, due)

    async def get(self) -> Key:
        """Wait for a key; ``done`` must follow."""
        key = await self._ready.get()
        self._queued.discard(key)
        self._active.add(key)
        return key

    def done(self, key: Key) -> None:
        """Say that a key's handling is over, well or not."""
        self._active.discard(key)
        due = self._again.pop(key, None)
        if due is not None:
            self._schedule(key, due)

    def retry(self, key: Key) -> float:
        """Have a key that failed handled again, later each time it fails; returns the seconds."""
        # The wait doubles, up to a minute; a part of it is drawn, so that what failed together comes back
        # apart.
        failures = self._failures.get(key, 0)
        self._failures[key] = failures + 1
        longest = min(LAST_BACKOFF_SECONDS, FIRST_BACKOFF_SECONDS * 2.0 ** min(failures, 20))
        delay = longest * (0.75 + 0.25 * self._jitter())
        self.add(key, delay)
        return delay

    def failures(self, key: Key) -> int:
        """Return the number of times that a key has failed in a row."""
        return self._failures.get(key, 0)

    def forget(self, key: Key) -> None:
        """Forget that a key ever failed."""
        self._failures.pop(key, None)

    @property
    def _clock(self) -> Timer:
        if self._timer is None:
            self._timer = asyncio.get_running_loop()
        return self._timer

    def _schedule(self, key: Key, due: float) -> None:
        waiting = self._later.get(key)
        # One alarm a key: the earlier one stands.
        if waiting is not None:
            if waiting[0] <= due:
                return
            waiting[1].cancel()
            del self._later[key]
        delay = due - self._clock.time()
        if delay > 0:
            self._later[key] = (due, self._clock.call_later(delay, self._arrive, key))
        else:
            self._arrive(key)

    def _arrive(self, key: Key) -> None:
        self._later.pop(key, None)
        self._queued.add(key)
        self._ready.put_nowait(key)
