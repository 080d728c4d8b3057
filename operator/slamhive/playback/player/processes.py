# SPDX-License-Identifier: Apache-2.0
"""The algorithm's processes, as the player sees them in /proc: found by their environment, and ended."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

_KILL_SECONDS = 5.0
_LOOK_SECONDS = 0.05
_PPID, _GROUP, _START = 1, 2, 19


class Process(NamedTuple):
    """A process: a number alone may belong to another one later."""

    pid: int
    start: int
    parent: int
    group: int


def stat_of(pid: int) -> Process | None:
    """Return a process that has not ended, None if there is none of that number."""
    with suppress(OSError, ValueError, IndexError):
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
        fields = text.rpartition(")")[2].split()
        if fields[0] not in "ZX":
            return Process(pid, int(fields[_START]), int(fields[_PPID]), int(fields[_GROUP]))
    return None


def carriers(mark: str) -> list[Process]:
    """Return the processes that have NAME=VALUE in their environment, this one left out."""
    wanted, found = mark.encode(), []
    for name in os.listdir("/proc"):  # noqa: PTH208
        if not name.isdigit() or int(name) == os.getpid():
            continue
        with suppress(OSError):
            if wanted in Path(f"/proc/{name}/environ").read_bytes().split(b"\0"):
                process = stat_of(int(name))
                if process is not None:
                    found.append(process)
    return found


class AlgorithmProcesses:
    """The algorithm, from its first process to its last.

    Args:
        mark: NAME=VALUE that its processes have in their environment.
    """

    def __init__(self, mark: str) -> None:
        self._mark = mark
        self._first: Process | None = None

    def seen(self) -> bool:
        """Tell whether it has been started."""
        if self._first is None:
            found = carriers(self._mark)
            known = {process.pid for process in found}
            roots = [process for process in found if process.parent not in known]
            self._first = min(roots, key=lambda process: process.start, default=None)
        return self._first is not None

    def lives(self) -> bool:
        """Tell whether its first process is there."""
        first = self._first
        if first is None:
            return False
        now = stat_of(first.pid)
        return now is not None and now.start == first.start

    def end(self, seconds: float, hurry: Callable[[], bool]) -> str:
        """End it: as Ctrl-C does in a terminal, then by SIGTERM, then by SIGKILL.

        Args:
            seconds: How long it may take after SIGINT.
            hurry: Asked whether it has to be quicker.

        Returns:
            The signal that did it.
        """
        first = self._first
        if first is None:
            return "none"
        if self.lives():
            with suppress(OSError):
                if first.group == first.pid:
                    os.killpg(first.group, signal.SIGINT)
                else:
                    os.kill(first.pid, signal.SIGINT)
        if self._gone(seconds, hurry):
            return "SIGINT"
        for number in (signal.SIGTERM, signal.SIGKILL):
            for process in carriers(self._mark):
                with suppress(OSError):
                    os.kill(process.pid, number)
            if self._gone(_KILL_SECONDS):
                return number.name
        return "none"

    def _gone(self, seconds: float, hurry: Callable[[], bool] = lambda: False) -> bool:
        deadline = time.monotonic() + seconds
        while self.lives():
            if time.monotonic() > deadline or hurry():
                return False
            time.sleep(_LOOK_SECONDS)
        return True
