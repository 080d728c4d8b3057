# SPDX-License-Identifier: Apache-2.0
"""Seam of the supervisor: a program, of whatever kind, and the kind that is processes of its own."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

from slamhive.monitor.measuring.cgroup import make_run_cgroup
from slamhive.monitor.measuring.proc import ProcSource
from slamhive.monitor.measuring.processes import (
    ProcessIdentity,
    boot_id,
    children,
    descendants,
    end_processes,
    identify,
    pid_namespace,
)
from slamhive.monitor.measuring.resident import largest_ended
from slamhive.monitor.programs.launch import launch
from slamhive.monitor.programs.orphans import TOKEN, ProcessRecord

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.monitor.measuring.sources import UsageSource
    from slamhive.monitor.spec import SupervisorSpec

NO_ACCOUNT = "none"
"""Name of the source of a program that never ran, as far as anyone saw."""
_UNENDED = "processes of the run could not be ended"
_CGROUP_LEFT = "a cgroup of the run could not be removed"


class Program(Protocol):
    """The algorithm of one run, by whatever it is executed."""

    source: UsageSource
    """Its account."""
    limits_memory: bool
    """The kernel holds it to its memory limit."""
    limits_tasks: bool
    """The kernel holds it to its number of tasks."""

    @property
    def ended(self) -> bool:
        """Its first process has ended."""

    @property
    def status(self) -> int | None:
        """Wait status of its first process, known at the latest when `end` returns; None if it never ran."""

    def start(self, outputs: tuple[int, int]) -> float:
        """Start it and return when that was, monotonic clock, s.

        Args:
            outputs: Descriptors for its stdout and its stderr.

        Raises:
            LaunchError: It can't be started.
        """

    def reap(self) -> None:
        """Take note of children that ended."""

    def ask_to_end(self) -> None:
        """Send SIGTERM to all of it, stopped processes included."""

    def left(self) -> int:
        """Return the number of processes that outlived the first one."""

    def end(self, deadline: float, idle: Callable[[], None]) -> str | None:
        """End all of it by force, and return what is to be noted where that failed.

        Args:
            deadline: Monotonic clock, s.
            idle: Called while this waits; takes what is printed.
        """

    def oom_kills(self) -> int:
        """Return the number of its processes that the kernel killed for want of memory."""

    def throttled(self) -> float | None:
        """Return the seconds in which a CPU quota of its own held it back, None where nothing counts that."""

    def largest_ended(self) -> int | None:
        """Return the resident peak of its largest process that ended, bytes, None where that is unknown."""

    def explain(self, last_line: str) -> str | None:
        """Return the reason that it never ran, where its last line is that of who was to start it."""

    def close(self) -> str | None:
        """Let go of what was made for it, and return what is to be noted where that failed."""


class OwnProcesses:
    """An algorithm as descendants of the supervisor, in a cgroup of its own where one can be made."""

    def __init__(self, spec: SupervisorSpec, supervisor: ProcessIdentity) -> None:
        """Prepare; nothing is started yet."""
        self._spec = spec
        self._me = supervisor
        self._first: int | None = None
        self.status: int | None = None
        self._cgroup = make_run_cgroup(supervisor) if spec.cgroup == "auto" else None
        limited = self._cgroup is not None and self._cgroup.limit(spec.memory_limit_bytes, spec.task_limit)
        self.limits_memory = limited
        self.limits_tasks = self._cgroup is not None
        self.source: UsageSource = ProcSource() if self._cgroup is None else self._cgroup.source

    @property
    def ended(self) -> bool:
        """The first process has ended."""
        return self.status is not None

    def start(self, outputs: tuple[int, int]) -> float:
        """Start it; the record of who runs is written before.

        Raises:
            LaunchError: The program, the working directory or a processor isn't there.
        """
        groups = tuple(self._cgroup.directories) if self._cgroup else ()
        record = ProcessRecord(boot_id(), pid_namespace(), self._me, None, groups)
        # Before the algorithm starts: were we killed in between, the next slamhive finds by it what we left.
        record.write(self._spec.process_path)
        environment = {**self._spec.env, TOKEN: record.token}
        started = launch(self._spec, environment, outputs, groups)
        self._first = started.pid
        # A cgroup counts from the algorithm on; /proc counts our child's time before it became the algorithm
        # too.
        if isinstance(self.source, ProcSource):
            self.source.leave_out(started.cpu)
        replace(record, algorithm=identify(started.pid)).write(self._spec.process_path)
        return started.start

    def reap(self) -> None:
        """Take note of children that ended; orphans of the run are ours, as we are the subreaper."""
        with suppress(ChildProcessError):
            while True:
                pid, status = os.waitpid(-1, os.WNOHANG)
                if pid == 0:
                    return
                if pid == self._first:
                    self.status = status

    def ask_to_end(self) -> None:
        """Send SIGTERM to every descendant."""
        for pid in descendants([self._me.pid]):
            # A stopped process takes a signal only when it is continued.
            for number in (signal.SIGTERM, signal.SIGCONT):
                with suppress(OSError):
                    os.kill(pid, number)

    def left(self) -> int:
        """Return the number of descendants."""
        return len(descendants([self._me.pid]))

    def end(self, deadline: float, idle: Callable[[], None]) -> str | None:  # noqa: ARG002
        """End every descendant; done when the kernel says that we have no children."""
        # Exact, as we are the subreaper: every orphan of the run is our child. No name and no session has to
        # be guessed.
        while children(self._me.pid):
            if time.monotonic() > deadline:
                return _UNENDED
            if self._cgroup is not None:
                self._cgroup.kill()
            end_processes(self._living, max(deadline - time.monotonic(), 0.0))
            self.reap()
        return None

    def oom_kills(self) -> int:
        """Return the kills that the cgroup counted."""
        return self._cgroup.oom_kills() if self._cgroup else 0

    def throttled(self) -> float | None:
        """Return the throttled time that the cgroup counted, s."""
        return self._cgroup.throttled() if self._cgroup else None

    def largest_ended(self) -> int | None:
        """Return the kernel's figure for those that we waited for."""
        return largest_ended()

    def explain(self, last_line: str) -> str | None:  # noqa: ARG002
        """Return nothing: what can't be started is told by `start`."""
        return None

    def close(self) -> str | None:
        """Remove the cgroup."""
        return _CGROUP_LEFT if self._cgroup is not None and not self._cgroup.remove() else None

    def _living(self) -> list[ProcessIdentity]:
        self.reap()
        return [found for found in map(identify, descendants([self._me.pid])) if found is not None]
