# SPDX-License-Identifier: Apache-2.0
"""The main loop: workers take keys from the cluster's queue and have their objects reconciled.

A reconciler that fails is tried again, the later the more often it fails; it never ends the operator.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass

from slamhive.kube.api.errors import ApiError, Conflict, NotFound
from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.cluster import Cluster
from slamhive.kube.failing import tell_failure, tell_recovery
from slamhive.model.errors import InputError, SlamHiveError

Reconcile = Callable[[Cluster, Key], Awaitable[float | None]]
"""Function that brings an object to where it should be; returns the seconds to look again after, None for not
before something changes."""

SLOW_RETRY_SECONDS = 300.0
FAILURES_TOLD = 5
"""Failures in a row from which on an object says so itself; what waiting can't mend is told at once."""
STUCK_SECONDS = 300.0
_RECOVERY_SECONDS = 15.0

_log = logging.getLogger("slamhive.operator")


@dataclass
class _Trouble:
    """Failures of one object's reconciler in a row.

    Attributes:
        uid: the object's uid: those of a later object of its name are others.
        failures: how many there were.
        logged: what was last logged of it.
        told: whether the object was made to say so.
    """

    uid: str | None
    failures: int = 0
    logged: str = ""
    told: bool = False


class Loop:
    """Workers, and the account of what fails.

    Args:
        cluster: where the keys come from.
        reconcilers: by kind, what is called for a key.
    """

    def __init__(self, cluster: Cluster, reconcilers: Mapping[Kind, Reconcile]) -> None:
        self._cluster = cluster
        self._queue = cluster.queue
        self._reconcilers = reconcilers
        self._troubles: dict[Key, _Trouble] = {}
        self._busy_since: dict[Key, float] = {}

    async def work(self) -> None:
        """Handle one key after the other, for ever."""
        while True:
            key = await self._queue.get()
            try:
                await self.handle(key)
            finally:
                self._queue.done(key)

    async def handle(self, key: Key) -> None:
        """Reconcile one object and queue what follows from how that went."""
        started = self._busy_since[key] = time.monotonic()
        outcome = "unforeseen"
        try:
            with self._cluster.acting_for(key):
                outcome = await self._reconcile(key)
        finally:
            self._busy_since.pop(key, None)
            self._cluster.metrics.observe_reconcile(str(key.kind), outcome, time.monotonic() - started)

    async def _reconcile(self, key: Key) -> str:
        """Reconcile one object; returns how that went, in one word."""
        try:
            await self._cluster.find_pods()
            again = await self._reconcilers[key.kind](self._cluster, key)
        except SlamHiveError as error:
            self._put_off(key, error)
            await self._count(key, error, passes=error.retryable or isinstance(error, Conflict | NotFound))
            return error.reason
        except Exception as error:  # noqa: BLE001 - no single object ends the operator
            self._cluster.metrics.count_error(str(key.kind), "unforeseen")
            delay = self._queue.retry(key)
            _log.exception("%s: reconciling failed in an unforeseen way; again in %.1f s", key, delay)
            await self._count(key, error, passes=True)
            return "unforeseen"
        self._queue.forget(key)
        if not await self._has_recovered(key):
            again = min(_RECOVERY_SECONDS, again or _RECOVERY_SECONDS)
        if again is not None:
            self._queue.add(key, again)
        return "ok"

    def _put_off(self, key: Key, error: SlamHiveError) -> None:
        """Queue a key that failed for later, and log why where that is news."""
        self._cluster.metrics.count_error(str(key.kind), error.reason)
        if isinstance(error, Conflict | NotFound):
            # Ordinary: someone else wrote or deleted first, and the watch is about to tell.
            _log.debug("%s: %s; again in %.1f s", key, error, self._queue.retry(key))
            return
        if error.retryable or isinstance(error, ApiError):
            delay = self._queue.retry(key)  # a right may be given back any moment
        else:
            delay = SLOW_RETRY_SECONDS
            self._queue.add(key, delay)
        # What is tried again every few minutes is logged when its message changes, not each time.
        trouble, message = self._trouble(key), str(error)
        if trouble.logged != message:
            trouble.logged = message
            level = logging.ERROR if isinstance(error, InputError) else logging.WARNING
            _log.log(level, "%s: %s; again in %.1f s", key, message, delay)

    async def _count(self, key: Key, error: Exception, *, passes: bool) -> None:
        """Have an object say what keeps it from going on, once that doesn't look like passing."""
        trouble = self._trouble(key)
        trouble.failures += 1
        if not passes or trouble.failures >= FAILURES_TOLD:
            trouble.told = True
            await tell_failure(self._cluster, key, error)

    async def _has_recovered(self, key: Key) -> bool:
        """Take back what an object was made to say; False where that could not be done."""
        trouble = self._troubles.pop(key, None)
        told = trouble is not None and trouble.told
        if await tell_recovery(self._cluster, key, told=told):
            return True
        if trouble is not None:
            self._troubles[key] = _Trouble(trouble.uid, told=told)
        return False

    def _trouble(self, key: Key) -> _Trouble:
        body = self._cluster.store.get(key)
        uid = body["metadata"]["uid"] if body else None
        if key not in self._troubles or self._troubles[key].uid != uid:
            self._troubles[key] = _Trouble(uid)
        return self._troubles[key]

    @property
    def stuck(self) -> list[Key]:
        """Return the keys that have been reconciled for suspiciously long."""
        now = time.monotonic()
        return [key for key, since in self._busy_since.items() if now - since > STUCK_SECONDS]
