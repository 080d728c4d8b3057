# SPDX-License-Identifier: Apache-2.0
"""A process forked off the dashboard: it has the table (copy on write), computes, and answers by a pipe.

The dashboard has threads, of which a fork keeps one alone. So the forked process touches nothing that another
thread may have been in the middle of: no database, no event loop, no log. It computes with numpy and plain
values, reads files of runs, and ends without cleaning up.
"""

from __future__ import annotations

import asyncio
import errno
import fcntl
import gc
import os
import pickle
import resource
import signal
import struct
import sys
import threading
import traceback
import warnings
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from slamhive.dashboard.problems import told
from slamhive.monitor.measuring.processes import limit_data, set_parent_death_signal

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Callable, Iterable, Sequence

HEAD = struct.Struct("!cQ")
"""Head of each block in the pipe: its kind, and its length."""

BLOCK, END, REFUSED, MISTAKE, MEMORY = b"B", b"E", b"R", b"X", b"M"
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
    locked = _locked_properties()
    mine, its = os.pipe2(os.O_CLOEXEC)
    parent = os.getpid()
    try:
        with suppress(OSError):
            os.set_blocking(mine, False)
            fcntl.fcntl(its, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        with warnings.catch_warnings():
            # From Python 3.12 on it warns of the threads; why that is well is said above.
            warnings.simplefilter("ignore", DeprecationWarning)
            pid = os.fork()
    except BaseException:
        os.close(mine)
        os.close(its)
        raise
    if not pid:
        _work(work, its, (cpu_seconds, memory, parent), locked)
    os.close(its)
    return pid, mine


def _work(
    work: Callable[[], Iterable[bytes]],
    pipe: int,
    limits: tuple[int, int, int],
    locked: Sequence[cached_property[Any]],
) -> NoReturn:
    """Be the forked process."""
    try:
        for one in locked:
            one.lock = threading.RLock()  # type: ignore[attr-defined]
        _let_go(pipe)
        _limit(*limits)
        gc.freeze()  # what is collected later is not the table: going through that would copy it
        for block in work():
            _send(pipe, BLOCK, block)
        _send(pipe, END, b"")
    except BaseException as error:  # noqa: BLE001 - whatever it is, the dashboard tells it
        with suppress(BaseException):  # without memory even this may fail: then it ends without a word
            _send(pipe, *_ending(error))
    finally:
        os._exit(0)


def _ending(error: BaseException) -> tuple[bytes, bytes]:
    """Return the kind and the content of the block that tells an error."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return MEMORY, b""
    found = told(error)
    if found is not None:
        return REFUSED, pickle.dumps(found)
    return MISTAKE, pickle.dumps((type(error).__name__, "".join(traceback.format_exception(error))))


def _let_go(pipe: int) -> None:
    """Close what belongs to the dashboard, above all its connections, and have no part in its signals."""
    with suppress(ValueError):
        signal.set_wakeup_fd(-1)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGXCPU):
        with suppress(ValueError):
            signal.signal(number, signal.SIG_DFL)
    for name in os.listdir("/proc/self/fd"):  # noqa: PTH208 - with paths it would be more to collect
        if int(name) > 2 and int(name) != pipe:
            with suppress(OSError):
                os.close(int(name))


def _limit(cpu_seconds: int, memory: int, parent: int) -> None:
    set_parent_death_signal(signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(0)
    os.nice(_NICE)
    with suppress(OSError):
        # Where memory runs out all the same, the kernel is to end this process and not the dashboard.
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, cpu_seconds + 1))
    limit_data(memory)


def _send(pipe: int, kind: bytes, block: bytes) -> None:
    left = memoryview(HEAD.pack(kind, len(block)) + block)
    while left:
        left = left[os.write(pipe, left) :]


def _locked_properties() -> list[cached_property[Any]]:
    """Return the properties of ours that have a lock, as they do up to Python 3.11.

    Another thread may hold one at the moment of the fork, and would never give it back in the new process.
    """
    if not hasattr(cached_property(len), "lock"):
        return []
    count = len(sys.modules)
    if _known.get("modules") != count:
        _known["modules"] = count
        _known["properties"] = [
            item
            for name, module in list(sys.modules.items())
            if name.startswith("slamhive")
            for held in list(vars(module).values())
            if isinstance(held, type) and held.__module__ == name
            for item in vars(held).values()
            if isinstance(item, cached_property)
        ]
    properties: list[cached_property[Any]] = _known["properties"]
    return properties


_known: dict[str, Any] = {}


async def blocks(reader: asyncio.StreamReader) -> AsyncGenerator[tuple[bytes, bytes], None]:
    """Go through what comes from a forked process, as (what it is, the block), until it is gone."""
    with suppress(asyncio.IncompleteReadError):
        while True:
            kind, length = HEAD.unpack(await reader.readexactly(HEAD.size))
            yield kind, await reader.readexactly(length)
