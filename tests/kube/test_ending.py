# SPDX-License-Identifier: Apache-2.0
"""Tasks that are to end."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.kube.ending import end_tasks

if TYPE_CHECKING:
    import pytest


async def deaf(times: int) -> None:
    """Go on for ever, whatever comes, for so many cancellations."""
    for _ in range(times):
        with suppress(asyncio.CancelledError):
            await asyncio.Event().wait()
    await asyncio.Event().wait()


async def begun(times: int) -> asyncio.Task[None]:
    task = asyncio.create_task(deaf(times), name=f"deaf {times} times")
    await asyncio.sleep(0)
    return task


async def test_a_task_that_missed_a_cancellation_gets_another() -> None:
    tasks = [await begun(times) for times in range(3)]
    await end_tasks(tasks, again_seconds=0.01, longest_seconds=600)
    assert all(task.cancelled() for task in tasks)


async def test_a_task_that_never_ends_is_left_and_named(caplog: pytest.LogCaptureFixture) -> None:
    task = await begun(1_000_000)
    await end_tasks([task], again_seconds=0.01, longest_seconds=0.05)
    assert not task.done()
    assert "deaf 1000000 times did not end within 0.05 s" in caplog.text
    task.get_coro().close()


async def test_what_has_ended_is_not_waited_for() -> None:
    async def breaks() -> None:
        raise ValueError

    task = asyncio.create_task(breaks())
    await asyncio.wait([task])
    await end_tasks([task], again_seconds=600, longest_seconds=600)
    assert isinstance(task.exception(), ValueError)
