# SPDX-License-Identifier: Apache-2.0
"""The end of tasks that go on for ever: operator, watches and tests end theirs by it."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

AGAIN_SECONDS = 1.0
LONGEST_SECONDS = 10.0

_log = logging.getLogger(__name__)


async def end_tasks(
    tasks: Iterable[asyncio.Task[object]],
    again_seconds: float = AGAIN_SECONDS,
    longest_seconds: float = LONGEST_SECONDS,
) -> None:
    """Cancel tasks until they have ended; what they raise meanwhile is of no interest any more.

    Once is not enough: a cancellation that comes as a wait with a timeout is over anyway is swallowed by
    asyncio.wait_for (until Python 3.12) and by aiohttp, and the task goes on as if there had been none.

    Args:
        tasks: what is to end.
        again_seconds: how long one may take before it is cancelled again.
        longest_seconds: how long all of them may take; what runs then still is left to its loop, and logged.
    """
    left = {task for task in tasks if not task.done()}
    clock = asyncio.get_running_loop().time
    deadline = clock() + longest_seconds
    while left and (seconds := deadline - clock()) > 0:
        for task in left:
            task.cancel()
        _, left = await asyncio.wait(left, timeout=min(again_seconds, seconds))
    if left:
        names = ", ".join(sorted(task.get_name() for task in left))
        _log.error("%s did not end within %g s of being cancelled", names, longest_seconds)
