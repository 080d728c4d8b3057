# SPDX-License-Identifier: Apache-2.0
"""A process forked off the dashboard: it has the table (copy on write), computes, and answers by a pipe.

It is one of `slamhive.monitor.measuring.bounded`, for one answer.
"""

from __future__ import annotations

import asyncio
import errno
import fcntl
import os
import pickle
import resource
import signal
import struct
import traceback
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.dashboard.problems import told
from slamhive.monitor.measuring.bounded import fork_apart, limit
from slamhive.monitor.measuring.processes import set_parent_death_signal

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Callable, Iterable

HEAD = struct.Struct("!cQ")
"""Head of each block in the pipe: its kind, and its length."""

BEGUN, BLOCK, END, REFUSED, MISTAKE, MEMORY = b"S", b"B", b"E", b"R", b"X", b"M"
_NICE = 5
"""Priority of workers: computing and sending by the dashboard itself come first."""

_PIPE_BYTES = 2**20


def fork(work: Callable[[], Iterable[bytes]], cpu_seconds: int, memory: int) -> tuple[int, int]:
    """Start a process that writes what a function yields to a pipe; returns its id and the pipe's end.

    Args:
        work: yields blocks.
        cpu_seconds: at which the kernel ends it.
        memory: bytes that it may have beyond what it is forked with.

    Raises:
        OSError: there is no process or no descriptor left.
    """
    mine, its = os.pipe2(os.O_CLOEXEC)
    parent = os.getpid()
    try:
        with suppress(OSError):
            os.set_blocking(mine, False)
            fcntl.fcntl(its, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        pid = fork_apart(lambda: _work(work, its, (cpu_seconds, memory, parent)), (its,))
    except BaseException:
        os.close(mine)
        raise
    finally:
        os.close(its)
    return pid, mine


def _work(work: Callable[[], Iterable[bytes]], pipe: int, limits: tuple[int, int, int]) -> None:
    """Be the forked process."""
    cpu_seconds, memory, parent = limits
    try:
        set_parent_death_signal(signal.SIGKILL)
        if os.getppid() != parent:
            return
        os.nice(_NICE)
        limit(cpu_seconds, memory)
        _send(pipe, BEGUN, str(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss).encode())
        for block in work():
            _send(pipe, BLOCK, block)
        _send(pipe, END, b"")
    except BaseException as error:  # noqa: BLE001 - whatever it is, the dashboard tells it
        with suppress(BaseException):  # without memory even this may fail: then it ends without a word
            _send(pipe, *_ending(error))


def _ending(error: BaseException) -> tuple[bytes, bytes]:
    """Return the kind and the content of the block that tells an error."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return MEMORY, b""
    found = told(error)
    if found is not None:
        return REFUSED, pickle.dumps(found)
    return MISTAKE, pickle.dumps((type(error).__name__, "".join(traceback.format_exception(error))))


def _send(pipe: int, kind: bytes, block: bytes) -> None:
    left = memoryview(HEAD.pack(kind, len(block)) + block)
    while left:
        left = left[os.write(pipe, left) :]


async def blocks(reader: asyncio.StreamReader) -> AsyncGenerator[tuple[bytes, bytes], None]:
    """Go through what comes from a forked process, as (what it is, the block), until it is gone."""
    with suppress(asyncio.IncompleteReadError):
        while True:
            kind, length = HEAD.unpack(await reader.readexactly(HEAD.size))
            yield kind, await reader.readexactly(length)
