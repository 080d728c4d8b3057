# SPDX-License-Identifier: Apache-2.0
"""Watch of the algorithm's container, from when it is found to its end: samples, limits, figures."""

from __future__ import annotations

import os
import select
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.monitor.measuring.accounting import Accounting, Contention, SampleTimes
from slamhive.monitor.measuring.hierarchy import cpuset, own_cpuset_directory
from slamhive.monitor.measuring.interference import Interference
from slamhive.monitor.measuring.reader import ReaderClock
from slamhive.monitor.outcome import StopDecision, out_of_memory
from slamhive.monitor.programs.files import UsageTable
from slamhive.monitor.programs.output import OutputMeter
from slamhive.monitor.summary import Reason

if TYPE_CHECKING:
    from slamhive.monitor.pod.containers import Container
    from slamhive.monitor.pod.sidecarstate import SidecarState
    from slamhive.monitor.signals import Signals
    from slamhive.monitor.spec import SidecarSpec

USAGE = "usage.csv"
UNENDED = "processes of the algorithm could not be ended"
_END_SECONDS = 10.0
# The kubelet ends the sidecar after the algorithm; where it doesn't, the algorithm may still end by itself.
_LEAVE_SECONDS = 2.0


class Watch:
    """Watches one container."""

    def __init__(self, spec: SidecarSpec, container: Container, state: SidecarState) -> None:
        """Begin; what is found out goes into `state`."""
        self._spec = spec
        self._container = container
        self._state = state
        self._kill_at: float | None = None
        self._leave_at: float | None = None
        now = time.monotonic()
        self.accounting = Accounting(state.start)
        self._interference = Interference()
        self._interference.notes.extend(state.suspicions)
        self._reader = ReaderClock()
        self._output = OutputMeter(
            f"{spec.run_directory}/output", spec.output_limit_bytes, spec.output_file_limit
        )
        try:
            self._table = UsageTable(f"{spec.run_directory}/{USAGE}")
        except OSError as error:
            state.note(f"{USAGE} could not be written: {error.strerror}")
            self._table = UsageTable(os.devnull)
        state.source = container.source.name
        self._own_cpuset = own_cpuset_directory()
        self._contention = Contention(container.processors(), container.source, now)

    def run(self, signals: Signals) -> bool:
        """Watch until the container's first process has ended, or can't be ended.

        Returns:
            False if we were told to leave before.
        """
        poll = select.poll()
        poll.register(self._container.pidfd, select.POLLIN)
        poll.register(signals.descriptor, select.POLLIN)
        timeout = self._spec.timeout_seconds
        deadline = None if timeout is None else self._state.start + timeout
        times = SampleTimes(self._state.start, self._spec.interval_seconds)
        self._sample(time.monotonic())
        self._save()
        while True:
            moments = (times.due, deadline, self._kill_at, self._leave_at)
            due = min(moment for moment in moments if moment is not None)
            ready = poll.poll(max(due - time.monotonic(), 0.0) * 1000)
            now = time.monotonic()
            if any(descriptor == self._container.pidfd for descriptor, _ in ready):
                return self._ended(now)
            # The first request leaves the algorithm time to end by itself, as the pod's grace goes on; a
            # second one doesn't.
            if told := signals.take():
                self._leave_at = now + _LEAVE_SECONDS if told == 1 and self._leave_at is None else now
            if self._leave_at is not None and now >= self._leave_at:
                return self._leave(now)
            if deadline is not None and now >= deadline:
                message = self._contention.overrun(deadline - self._state.start)
                deadline = None
                self._end(StopDecision(Reason.DEADLINE_EXCEEDED, message), now)
            if self._kill_at is not None and now >= self._kill_at:
                return self._kill()
            if now >= times.due:
                self._sample(now)
                times.advance(now)

    def _sample(self, now: float) -> None:
        """Take a sample; none where the account is gone, which its end is about to tell."""
        self._interference.look(now)
        with suppress(OSError, ValueError):
            sample = self._container.source.read()
            self._table.add(sample.time - self._state.start, self.accounting.add(sample), sample)
            self._hold_to_limits(now, sample.working_set)
            if self._contention.due(now):
                self._contention.add(now, sample.cpu)
                self._reader.look(self._container.source.processes())
                self._save()
        problem = self._output.problem(now, self._container.source.processes())
        if problem is not None:
            self._end(problem, now)

    def _hold_to_limits(self, now: float, memory: int) -> None:
        spec, container = self._spec, self._container
        limit, tasks = spec.memory_limit_bytes, spec.task_limit
        self._state.oom_kills = max(self._state.oom_kills, container.oom_kills())
        # A cgroup of its own has the kernel keep the limit; elsewhere these looks do.
        too_much = not container.exact and limit is not None and memory > limit
        if too_much or self._state.oom_kills:
            self._end(out_of_memory(limit), now)
        if tasks is not None and container.tasks() > tasks:
            what = "processes and threads" if container.exact else "processes"
            message = f"it had more than {tasks} {what} at the same time"
            self._end(StopDecision(Reason.ALGORITHM_FAILED, message, at_once=True), now)

    def _end(self, stop: StopDecision, now: float) -> None:
        """End the algorithm: now, or ask it to end and kill it later. The first reason stays."""
        self._state.stop = self._state.stop or stop
        if stop.at_once:
            self._kill_at = now
        elif self._kill_at is None:
            self._kill_at = now + self._spec.kill_grace_seconds
            self._container.ask_to_end()

    def _kill(self) -> bool:
        if self._container.end(_END_SECONDS):
            self._state.note(UNENDED)
        return self._ended(time.monotonic())

    def _leave(self, now: float) -> bool:
        why = StopDecision(Reason.CANCELLED, "the pod was ended while the algorithm ran")
        self._state.stop = self._state.stop or why
        self._finish(now, final=False)
        return False

    def _ended(self, now: float) -> bool:
        """Read the account at once: the container's cgroup goes within milliseconds."""
        self._finish(now, final=True)
        return True

    def _finish(self, now: float, *, final: bool) -> None:
        state = self._state
        state.ended = final
        self._interference.look(now)
        try:
            sample = self._container.source.read()._replace(time=now)
        except (OSError, ValueError):
            late = now - state.last
            state.note(f"the account was gone at the end: the last {late:.2f} s of the run are missing")
        else:
            self._table.add(now - state.start, self.accounting.add(sample, final=final), sample)
            self._contention.add(now, sample.cpu)
        self._save()
        self._table.close()
        if self._table.error is not None:
            state.note(f"{USAGE} is incomplete: {self._table.error.strerror}")

    def _look_at_processors(self) -> None:
        """See which processors the container may use, and whether we may use them too.

        The kubelet's static CPU manager gives a container of whole processors some of its own, and us, who
        ask for less, the others. By the cgroups, which the algorithm can't write: affinities it can.
        """
        theirs, ours = self._container.cpuset(), self._own_cpuset and cpuset(self._own_cpuset)
        if theirs and ours:
            self._state.cpuset = theirs
            self._state.exclusive = self._state.exclusive is not False and theirs.isdisjoint(ours)

    def _save(self) -> None:
        """Keep what is known now."""
        state, container = self._state, self._container
        state.last = time.monotonic()
        state.contended = self._contention.seconds
        state.kernel_peak = container.source.kernel_peak() or state.kernel_peak
        state.oom_kills = max(state.oom_kills, container.oom_kills())
        self._look_at_processors()
        throttled = container.throttled()
        state.throttled = state.throttled if throttled is None else throttled
        state.accounting = self.accounting
        state.reader = self._reader.seconds
        self._table.flush()
        if self._table.touched:
            self._interference.note(f"{USAGE} was changed by another program")
        state.suspicions = list(self._interference.notes)
