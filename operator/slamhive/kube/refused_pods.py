# SPDX-License-Identifier: Apache-2.0
"""The API server's words on pods that it refused to Jobs, which only Events hold.

To find those of one Job the server goes through all Events of the namespace, which a large Sweep makes
hundreds of thousands of, and on a slow cluster most Jobs wait for their pods for a while. So one listing
answers for all Jobs of a namespace, and the next one comes the later the longer it took.
"""

from __future__ import annotations

import asyncio
import time
from collections import defaultdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.kube.api.client import Api

REASON = "FailedCreate"
BETWEEN_SECONDS = 2.0
"""Shortest time between two listings of a namespace."""
SHARE = 20
"""Times as long as a listing took until the next one."""


class RefusedPods:
    """Finds out why Jobs have no pods.

    Args:
        api: the Kubernetes API.
        clock: returns the time in s since 1970.
        stopwatch: returns seconds, to measure how long a listing takes.
    """

    def __init__(
        self, api: Api, clock: Callable[[], float], stopwatch: Callable[[], float] = time.monotonic
    ) -> None:
        self._api = api
        self._clock = clock
        self._stopwatch = stopwatch
        self._told: dict[str, dict[str, str]] = {}
        self._due: dict[str, float] = {}
        self._listing: defaultdict[str, asyncio.Lock] = defaultdict(asyncio.Lock)

    async def message(self, namespace: str, job_uid: str) -> str | None:
        """Return the last word on a Job's pod, as of the last listing; None where there was none.

        Raises:
            ApiError: the server can't be asked, or may not be by this account.
        """
        async with self._listing[namespace]:
            # Asked behind the lock: whoever waited for it finds the answer of the listing before.
            if self._clock() >= self._due.get(namespace, 0.0):
                began = self._stopwatch()
                events = await self._api.events(namespace, REASON)
                took = self._stopwatch() - began
                self._told[namespace] = {
                    event["involvedObject"]["uid"]: str(event.get("message") or "")
                    for event in events
                    if (event.get("involvedObject") or {}).get("uid")
                }
                self._due[namespace] = self._clock() + max(BETWEEN_SECONDS, SHARE * took)
            return self._told[namespace].get(job_uid)
