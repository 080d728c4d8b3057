# SPDX-License-Identifier: Apache-2.0
"""Processes forked off ours that compute within limits of memory and CPU time: their end is no end of ours.

What strangers wrote is measured there: by runners, evaluators and dashboards. These have threads, of which a
fork keeps one alone. So what is computed there touches nothing that another thread may have been in the
middle of: no database, no event loop, no log. It computes with numpy and plain values, and reads files.
"""

from __future__ import annotations

import gc
import math
import os
import resource
import signal
import sys
import threading
import time
import traceback
import warnings
import weakref
from contextlib import nullcontext, suppress
from functools import cached_property, lru_cache
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from slamhive.contract.heap import keep_memory
from slamhive.monitor.measuring.processes import limit_data, read_file, stat_fields

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

_KEPT_BYTES = 16 << 20
"""Memory that is kept between answers: what is given back and taken again has to be zeroed each time."""
_LARGE_BYTES = 4 << 20
"""Size of arrays from which on each is given back at once."""
_STILL_SECONDS = 60.0
"""After which a process that answers is to have used CPU time."""


class LimitError(Exception):
    """Answering a question took more than the process that answers may take, or ended it.

    Attributes:
        is_lasting: It would end so again.
    """

    def __init__(self, sentence: str, *, is_lasting: bool) -> None:
        super().__init__(sentence)
        self.is_lasting = is_lasting


class BoundedProcess:
    """A process that answers questions one after another, on the processors of who asks.

    It is forked when there is a question, and lives as long as this object and its process do; one that ends
    at a limit is followed by another. Threads may ask it.

    Args:
        answer: Called there with a question and all that was given with questions so far.
        cpu_seconds: CPU time of an answer.
        memory: Bytes that it may have beyond what it is forked with; None for no limit.
    """

    def __init__(
        self, answer: Callable[[Any, dict[str, Any]], Any], cpu_seconds: int, memory: int | None
    ) -> None:
        self._answer, self._cpu_seconds, self._memory = answer, cpu_seconds, memory
        self._lock = threading.RLock()
        self._pipe: Connection | None = None
        self._pid = self._life = self._owner = 0
        self._given: dict[str, Any] = {}
        self._forsaken: weakref.finalize[Any, Any] | None = None

    def ask(self, question: Any, **given: Any) -> Any:
        """Return the answer to a question.

        Args:
            question: What can be pickled.
            given: Values that questions share, each of which is sent once.

        Raises:
            LimitError: It took too much.
            RuntimeError: Answering failed.
        """
        with self._lock:
            pipe = self._pipe if self._owner == os.getpid() else None
            pipe = pipe or self._begin()
            new = {name: value for name, value in given.items() if self._given.get(name) is not value}
            self._given |= new
            try:
                pipe.send((os.sched_getaffinity(0), question, new))
                found, told = self._received(pipe)
            except (EOFError, OSError):
                raise self._ended() from None
            except BaseException:
                self.close()
                raise
            if found is None:
                self.close()
                raise LimitError(f"it takes more than {told >> 20:,} MiB of memory", is_lasting=True)
        if not found:
            raise RuntimeError(told)
        return told

    def close(self) -> None:
        """End the process; whoever waits for an answer is told."""
        if self._pipe is None or self._owner != os.getpid():
            return
        with suppress(ProcessLookupError):
            os.kill(self._pid, signal.SIGKILL)
        with self._lock:
            if self._pipe is not None:
                self._ended()

    def _begin(self) -> Connection:
        pipe, its = Pipe()
        ended, self._life = os.pipe2(os.O_CLOEXEC)
        try:
            self._pid = fork_apart(lambda: self._serve(its, ended), (its.fileno(), ended))
        finally:
            its.close()
            os.close(ended)
        self._pipe, self._given, self._owner = pipe, {}, os.getpid()
        # A finalizer of ours could come after that of the pipe, whose descriptor is another's by then.
        self._forsaken = weakref.finalize(self, _forsake, pipe, self._life, self._pid, self._owner)
        return pipe

    def _received(self, pipe: Connection) -> Any:
        """Return the message of the process, which computes meanwhile; it might wait for a lock of ours."""
        used: list[bytes] | None = None
        while not pipe.poll(_STILL_SECONDS):
            before, used = used, stat_fields(read_file(f"/proc/{self._pid}/stat"))[11:13]
            if used == before:
                self.close()
                raise LimitError("the process that did it stood still", is_lasting=False)
        return pipe.recv()

    def _ended(self) -> LimitError:
        """Let go of a process that ends, and return why it does."""
        if self._forsaken is not None:
            self._forsaken.detach()
        if self._pipe is not None:
            self._pipe.close()
        self._pipe = None
        os.close(self._life)
        _, status = os.waitpid(self._pid, 0)
        number = os.waitstatus_to_exitcode(status)
        if number == -signal.SIGXCPU:
            return LimitError(f"it takes more than {self._cpu_seconds} s of CPU time", is_lasting=True)
        # The kernel kills where the machine's memory is short, which may be otherwise next time.
        by_others = number in {-signal.SIGKILL, -signal.SIGTERM, -signal.SIGHUP}
        return LimitError(f"the process that did it ended ({number})", is_lasting=not by_others)

    def _serve(self, pipe: Connection, ended: int) -> None:
        """Be the process."""
        # The kernel's own signal comes when the thread that forked us ends, which may be that of a run.
        threading.Thread(target=lambda: (os.read(ended, 1), os._exit(0)), daemon=True).start()
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        limit(self._cpu_seconds, self._memory)
        keep_memory(_KEPT_BYTES, _LARGE_BYTES)  # numpy's arrays, for the next ones
        given: dict[str, Any] = {}
        while True:
            try:
                processors, question, new = pipe.recv()
                if processors != os.sched_getaffinity(0):
                    os.sched_setaffinity(0, processors)
                given |= new
                limit(self._cpu_seconds)
                pipe.send((True, self._answer(question, given)))
            except EOFError:
                return
            except MemoryError:
                pipe.send((None, self._memory or 0))
            except Exception:  # noqa: BLE001 - told to who asked
                pipe.send((False, traceback.format_exc()))


def _forsake(pipe: Connection, life: int, pid: int, owner: int) -> None:
    """End the process of an object that nobody has any more."""
    if owner != os.getpid():
        return
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    pipe.close()
    os.close(life)
    os.waitpid(pid, 0)


def limit(cpu_seconds: int, memory: int | None = None) -> None:
    """Limit this process from now on; where the machine's memory runs out all the same, it goes first.

    Args:
        cpu_seconds: CPU time from now on, at which the kernel ends it.
        memory: Bytes beyond those that it has; None changes nothing of that.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    most = math.ceil(time.process_time()) + cpu_seconds
    resource.setrlimit(resource.RLIMIT_CPU, (most if hard < 0 else min(most, hard), hard))
    if memory is not None:
        with suppress(OSError):
            Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        limit_data(memory)


def fork_apart(work: Callable[[], None], keep: Collection[int]) -> int:
    """Start a process that calls a function and ends; returns its id.

    Args:
        work: Computes.
        keep: Descriptors that stay open in it, beside the first three.

    Raises:
        OSError: There is no process left.
    """
    locked = _locked_properties(len(sys.modules))
    # A model is built when it is first used, under one lock of pydantic's for all.
    building = getattr(sys.modules.get("pydantic.main"), "_rebuild_lock", nullcontext())
    with building, warnings.catch_warnings():
        # From Python 3.12 on it warns of the threads; why that is well is said above.
        warnings.simplefilter("ignore", DeprecationWarning)
        pid = os.fork()
    if not pid:
        _be_apart(work, keep, locked)
    return pid


def _be_apart(
    work: Callable[[], None], keep: Collection[int], locked: Sequence[cached_property[Any]]
) -> NoReturn:
    try:
        for one in locked:
            one.lock = threading.RLock()  # type: ignore[attr-defined]
        _let_go(keep)
        gc.freeze()  # what is collected later is not what was there: going through that would copy it
        work()
    finally:
        os._exit(0)


def _let_go(keep: Collection[int]) -> None:
    """Close what belongs to who forked us, above all its connections, and have no part in its signals."""
    with suppress(ValueError):
        signal.set_wakeup_fd(-1)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGXCPU):
        with suppress(ValueError):
            signal.signal(number, signal.SIG_DFL)
    for name in os.listdir("/proc/self/fd"):  # noqa: PTH208 - with paths it would be more to collect
        if int(name) > 2 and int(name) not in keep:
            with suppress(OSError):
                os.close(int(name))


@lru_cache(maxsize=1)
def _locked_properties(_modules: int) -> list[cached_property[Any]]:
    """Return the properties of ours that have a lock, as they do up to Python 3.11.

    Another thread may hold one at the moment of the fork, and would never give it back in the new process.

    Args:
        _modules: How many are imported: with another one there may be more.
    """
    if not hasattr(cached_property(len), "lock"):
        return []
    return [
        item
        for name, module in list(sys.modules.items())
        if name.startswith("slamhive")
        for held in list(vars(module).values())
        if isinstance(held, type) and held.__module__ == name
        for item in list(vars(held).values())
        if isinstance(item, cached_property)
    ]
