# SPDX-License-Identifier: Apache-2.0
"""Sharing of work between processors: processes forked off ours take it in turns with ourselves.

The same rules as for answers' workers (``monitor.measuring.bounded``): the work asks no database.
"""

from __future__ import annotations

import os
import pickle
import signal
import struct
from contextlib import suppress
from typing import TYPE_CHECKING, TypeVar

from slamhive.monitor.measuring.bounded import fork_apart
from slamhive.monitor.measuring.processes import set_parent_death_signal

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

T = TypeVar("T")

LEAST = 20
"""Pieces of work from which on another process is worth its start."""

_NUMBER = struct.Struct("!I")


def shared(works: Sequence[Callable[[], T]], first: Callable[[], None]) -> tuple[list[T], list[int]]:
    """Return the results of some works, done here and beside us, and the numbers of those done beside us.

    Args:
        works: each may be done anywhere, at any time.
        first: what only this process can do, while others begin.
    """
    beside = min(len(os.sched_getaffinity(0)) - 1, len(works) // LEAST)
    if beside < 1:
        first()
        return [work() for work in works], []
    # All take the next number from a pipe. It holds 64 KiB, or less where its user has many pipes: what it
    # doesn't take is done in the end.
    queue, end = os.pipe2(os.O_CLOEXEC)
    os.set_blocking(end, False)
    os.write(end, b"".join(map(_NUMBER.pack, range(len(works)))))
    os.close(end)
    others: list[tuple[int, int]] = []
    try:
        with suppress(OSError):  # there is no process left: all is done by those there are
            others.extend(_begun(works, queue) for _ in range(beside))
        first()
        mine = _done(works, queue)
        theirs: dict[int, T] = {}
        for _, answers in others:
            with suppress(EOFError, pickle.UnpicklingError), os.fdopen(os.dup(answers), "rb") as stream:
                theirs |= pickle.load(stream)  # noqa: S301 - written by a process of ours
    finally:
        os.close(queue)
        for pid, answers in others:
            os.close(answers)
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
    found = mine | theirs
    # What one took that ended before it could answer is done here too, and says here what is wrong with it.
    return [found[at] if at in found else work() for at, work in enumerate(works)], sorted(theirs)


def _begun(works: Sequence[Callable[[], T]], queue: int) -> tuple[int, int]:
    """Start a process that takes works from a queue; return its id, and the pipe that it answers by."""
    answers, its = os.pipe2(os.O_CLOEXEC)
    parent = os.getpid()

    def work() -> None:
        set_parent_death_signal(signal.SIGKILL)
        if os.getppid() == parent:
            content = pickle.dumps(_done(works, queue))
            with os.fdopen(its, "wb") as stream:
                stream.write(content)

    try:
        return fork_apart(work, (queue, its)), answers
    finally:
        os.close(its)


def _done(works: Sequence[Callable[[], T]], queue: int) -> dict[int, T]:
    """Do works until the queue is empty."""
    found = {}
    while len(number := os.read(queue, _NUMBER.size)) == _NUMBER.size:
        at = _NUMBER.unpack(number)[0]
        found[at] = works[at]()
    return found
