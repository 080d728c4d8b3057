# SPDX-License-Identifier: Apache-2.0
"""Interference with the measuring process: it was stopped, starved, or given other limits.

The algorithm has our user. Our files and memory are closed to it (`forbid_inspection`), but the kernel lets
it send us signals and change our limits and priority. Whoever does so wants other figures, so that each try
is said of them. What ends us needs no word here: a run without its supervisor is a fault.
"""

from __future__ import annotations

import os
import resource
import signal

# No sample for so long is more than a busy machine does to us, s.
_GAP_SECONDS = 5.0
_LIMITS = (
    resource.RLIMIT_AS,
    resource.RLIMIT_CPU,
    resource.RLIMIT_DATA,
    resource.RLIMIT_FSIZE,
    resource.RLIMIT_NOFILE,
    resource.RLIMIT_STACK,
    resource.RLIMIT_NPROC,
    resource.RLIMIT_MEMLOCK,
    resource.RLIMIT_SIGPENDING,
)


class Interference:
    """Looks at ourselves with every sample."""

    def __init__(self) -> None:
        """Remember how we are; from now on we notice when we go on after a stop."""
        self.notes: list[str] = []
        self._stops = 0
        self._limits = _limits()
        self._priority = _priority()
        self._last: float | None = None
        signal.signal(signal.SIGCONT, self._go_on)

    def look(self, now: float) -> None:
        """Compare with what was before.

        Args:
            now: Monotonic clock, s: the time of the sample that follows.
        """
        if self._last is not None and now - self._last > _GAP_SECONDS:
            self.note("the monitor took no sample for more than 5 s")
        self._last = now
        if self._stops:
            self.note("the monitor was stopped, or made to go on, by a signal")
        if _limits() != self._limits:
            self._limits = _limits()
            self.note("the monitor's limits were changed")
        if _priority() != self._priority:
            self._priority = _priority()
            self.note("the monitor's priority was changed")

    def note(self, text: str) -> None:
        """Take down something once."""
        if text not in self.notes:
            self.notes.append(text)

    def _go_on(self, _number: int, _frame: object) -> None:
        self._stops += 1


def _limits() -> list[tuple[int, int]]:
    return [resource.getrlimit(name) for name in _LIMITS]


def _priority() -> tuple[int, int, int]:
    """Return scheduler, its priority and niceness; not the processors, which a cluster's node may change."""
    scheduler = os.sched_getscheduler(0)
    return scheduler, os.sched_getparam(0).sched_priority, os.getpriority(os.PRIO_PROCESS, 0)
