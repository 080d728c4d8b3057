# SPDX-License-Identifier: Apache-2.0
"""The supervisor of one run: starts the algorithm, samples it, holds it to its limits, ends all of it.

What it supervises is a `Program`: processes of its own or a container. It is the reaper of every descendant,
so "no children left" is exact: a daemon that forked twice comes back to it. It ends when its parent does.
What it finds out goes to usage.csv while the run runs, and as the very last thing to summary.json; a run
folder without summary.json is a run that did not finish.
"""

from __future__ import annotations

import os
import select
import signal
import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from slamhive.contract.metrics import AlgorithmMetrics
from slamhive.contract.output import read_output
from slamhive.monitor.measuring.accounting import Accounting, Contention, SampleTimes
from slamhive.monitor.measuring.hierarchy import host_throttled
from slamhive.monitor.measuring.interference import Interference
from slamhive.monitor.measuring.processes import (
    become_subreaper,
    identify,
    read_file,
    set_parent_death_signal,
)
from slamhive.monitor.measuring.reader import ReaderClock
from slamhive.monitor.measuring.sources import field
from slamhive.monitor.metrics import reader_report
from slamhive.monitor.outcome import ProgramEnding, StopDecision, judge, out_of_memory
from slamhive.monitor.playing import played_mean_cores, played_to_the_end
from slamhive.monitor.programs.files import OutputPipe, UsageTable
from slamhive.monitor.programs.launch import LaunchError
from slamhive.monitor.programs.log import BoundedLog
from slamhive.monitor.programs.orphans import write_atomically
from slamhive.monitor.programs.output import OutputMeter
from slamhive.monitor.programs.program import NO_ACCOUNT, OwnProcesses
from slamhive.monitor.summary import Reason, RunSummary

if TYPE_CHECKING:
    from slamhive.monitor.measuring.accounting import MeasuredUsage
    from slamhive.monitor.programs.program import Program
    from slamhive.monitor.spec import SupervisorSpec

# The kernel tells of our parent's end by this signal. It comes too when only the thread that started us
# ended, so it makes us look and means nothing by itself.
_PARENT_SIGNAL = signal.SIGUSR1
_STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
_END_SECONDS = 20.0


class Supervisor:
    """Runs one algorithm from start to summary."""

    def __init__(self, spec: SupervisorSpec) -> None:
        """Take a specification; nothing is started yet."""
        self._spec = spec
        self._parent = spec.parent_pid or os.getppid()
        self._signals: list[int] = []
        self._notes: list[str] = []
        self._stop: StopDecision | None = None
        self._kill_at: float | None = None
        self._poll = select.poll()
        self._reader = ReaderClock()

    def run(self) -> RunSummary:
        """Run the algorithm to its end, or end it, and write the summary.

        Raises:
            OSError: One of the files can't be written; nothing of the run is left running.
        """
        self._prepare()
        spec = self._spec
        self._program = self._make_program()
        try:
            self._polled_limit = None if self._program.limits_memory else spec.memory_limit_bytes
            self._log = BoundedLog(spec.log_path, spec.log_limit_bytes)
            self._table = UsageTable(spec.usage_path)
            self._output = OutputMeter(spec.output_directory, spec.output_limit_bytes, spec.output_file_limit)
            summary = self._supervise()
        finally:
            self._end_tree()
            self._note(self._program.close())
        # Written when nothing of the run lives any more: who finds a summary may trust that the output is
        # final.
        summary = replace(summary, notes=tuple(self._notes))
        write_atomically(spec.summary_path, summary.to_json())
        return summary

    def _prepare(self) -> None:
        become_subreaper()
        for name in os.listdir("/proc/self/fd"):  # noqa: PTH208
            # What slamhive has open (its archive, its sockets) is none of the algorithm's.
            if int(name) > 2:
                with suppress(OSError):
                    os.set_inheritable(int(name), False)
        self._wake, wake = os.pipe()
        for descriptor in (self._wake, wake):
            os.set_blocking(descriptor, False)
        self._poll.register(self._wake, select.POLLIN)
        signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
        signal.pthread_sigmask(signal.SIG_SETMASK, ())
        for number in (*_STOP_SIGNALS, _PARENT_SIGNAL):
            signal.signal(number, lambda number, _frame: self._signals.append(number))
        signal.signal(signal.SIGCHLD, lambda _number, _frame: None)
        set_parent_death_signal(_PARENT_SIGNAL)
        self._interference = Interference()
        me = identify(os.getpid())
        if me is None:
            raise ProcessLookupError(0, "no process table is mounted", "/proc")
        self._me = me

    def _make_program(self) -> Program:
        if self._spec.contained is None:
            return OwnProcesses(self._spec, self._me)
        from slamhive.monitor.programs.contained import Contained  # noqa: PLC0415 - 20 ms that others needn't wait for

        return Contained(self._spec, self._me, self._poll)

    def _note(self, problem: str | None) -> None:
        if problem is not None and problem not in self._notes:
            self._notes.append(problem)

    def _supervise(self) -> RunSummary:
        spec = self._spec
        throttled_before, kills_before = host_throttled(), _machine_oom_kills()
        self._out, self._err = (OutputPipe(self._log, self._poll) for _ in range(2))
        self._start = time.monotonic()
        self._follow_signals(self._start)
        if self._stop is None:
            try:
                self._start = self._program.start((self._out.writer, self._err.writer))
            except LaunchError as error:
                self._stop = StopDecision(error.reason, str(error))
        started_at = time.time() - (time.monotonic() - self._start)
        self._accounting = Accounting(self._start)
        self._contention = Contention(spec.cpus, self._program.source, self._start)
        if self._stop is None:
            self._watch()
        finished, left = self._finish()
        # Before the output is read, which may take a while: what the machine does meanwhile isn't the run's.
        throttled, oom_kills = self._throttled(throttled_before), _machine_oom_kills() - kills_before
        folder = spec.output_directory
        output = None if folder is None else read_output(folder, spec.frames, spec.poses)
        if output is not None and output.fault is not None and self._stop is None:
            self._stop = StopDecision(Reason.SYSTEM_FAULT, output.fault)
        usage, problem = self._usage(
            finished, throttled, AlgorithmMetrics({}) if output is None else output.metrics
        )
        self._close_files()
        played = played_mean_cores(spec.output_directory, spec.usage_path, started_at)
        if played is not None:
            usage = replace(usage, cpu=replace(usage.cpu, mean_cores=played))
        last_line = self._err.last_line() or self._out.last_line()
        never_ran = self._program.explain(last_line)
        if never_ran is not None and self._stop is None:
            self._stop = StopDecision(Reason.ALGORITHM_FAILED, never_ran)
        ending = ProgramEnding(
            status=self._program.status,
            stop=self._stop,
            last_line=last_line,
            group_oom_kills=self._program.oom_kills(),
            machine_oom_kills=oom_kills,
            memory_limit=spec.memory_limit_bytes,
            was_played=spec.is_played and played_to_the_end(folder),
        )
        measured = self._program.source.name != NO_ACCOUNT
        if not measured:
            self._note("it never ran, or ended before its account could be opened: nothing was measured")
        return RunSummary(
            **judge(ending)._asdict(),
            started_at=started_at,
            finished_at=started_at + finished - self._start,
            usage=usage if measured else None,
            log_tail=self._log.tail(),
            left_processes=left,
            metrics_problem=None if output is None else output.metrics_problem(problem),
            output=output,
        )

    def _watch(self) -> None:
        """Sample and keep the limits until the algorithm's first process has ended, or must be killed."""
        timeout = self._spec.timeout_seconds
        times = SampleTimes(self._start, self._spec.interval_seconds)
        deadline = None if timeout is None else self._start + timeout
        self._program.reap()
        while not self._program.ended:
            due = min(moment for moment in (times.due, deadline, self._kill_at) if moment is not None)
            self._sleep(due - time.monotonic())
            now = time.monotonic()
            self._program.reap()
            self._follow_signals(now)
            if self._program.ended or (self._kill_at is not None and now >= self._kill_at):
                return
            if deadline is not None and now >= deadline:
                message = self._contention.overrun(deadline - self._start)
                deadline = None
                self._end(StopDecision(Reason.DEADLINE_EXCEEDED, message), now)
            if now >= times.due:
                self._sample(now)
                times.advance(now)

    def _sleep(self, seconds: float) -> None:
        """Wait for a signal, for time to pass, and while the algorithm prints much, for its output."""
        for descriptor, _ in self._poll.poll(max(seconds, 0.0) * 1000):
            if descriptor == self._wake:
                os.read(self._wake, 4096)
            else:
                self._drain()

    def _drain(self) -> None:
        self._out.drain()
        self._err.drain()

    def _follow_signals(self, now: float) -> None:
        """Follow signals: the first asks the run to stop, a second doesn't wait for it."""
        signals, self._signals = self._signals, []
        if os.getppid() != self._parent:
            self._end(StopDecision(Reason.CANCELLED, "the process that started the run ended"), now)
        for number in signals:
            if number in _STOP_SIGNALS:
                again = self._kill_at is not None
                self._end(StopDecision(Reason.CANCELLED, "cancelled"), now)
                if again:
                    self._kill_at = now

    def _end(self, stop: StopDecision, now: float) -> None:
        """End the run: kill it now, or ask all of it to end and kill it later. The first reason stays."""
        self._stop = self._stop or stop
        if stop.at_once:
            self._kill_at = now
        elif self._kill_at is None:
            self._kill_at = now + self._spec.kill_grace_seconds
            self._program.ask_to_end()

    def _sample(self, now: float) -> None:
        self._interference.look(now)
        sample = self._program.source.read()
        self._table.add(sample.time - self._start, self._accounting.add(sample), sample)
        self._drain()
        limit = self._spec.memory_limit_bytes
        too_much = self._polled_limit is not None and sample.working_set > self._polled_limit
        if too_much or self._program.oom_kills() > 0:
            self._end(out_of_memory(limit), now)
        tasks = self._spec.task_limit
        # A cgroup bounds this by itself; a fork bomb has to be killed at once, as it only grows while it is
        # asked to end.
        source = self._program.source
        if not self._program.limits_tasks and tasks is not None and len(source.processes()) > tasks:
            message = f"it had more than {tasks} processes at the same time"
            self._end(StopDecision(Reason.ALGORITHM_FAILED, message, at_once=True), now)
        if self._contention.due(now):
            self._contention.add(now, sample.cpu)
            self._table.flush()
            self._reader.look(source.processes())
            problem = self._output.problem(now, source.processes())
            if problem is not None:
                self._end(problem, now)

    def _finish(self) -> tuple[float, int]:
        """End what is left; return when the first process ended and how many outlived it."""
        if not self._program.ended:
            self._end_tree()
            return time.monotonic(), 0
        finished = time.monotonic()
        left = self._program.left()
        self._end_tree()
        return finished, left

    def _end_tree(self) -> None:
        """End all of the run."""
        self._note(self._program.end(time.monotonic() + _END_SECONDS, self._drain))

    def _throttled(self, before: float | None) -> float | None:
        """Return for how long the run was held back, s: by its own limit or by one around the supervisor.

        Args:
            before: what ``host_throttled`` said when the run began.
        """
        own = self._program.throttled()
        now = host_throttled()
        if before is None or now is None:
            return own
        return max(own or 0.0, now - before)

    def _usage(
        self, finished: float, throttled: float | None, metrics: AlgorithmMetrics
    ) -> tuple[MeasuredUsage, str | None]:
        """Take the last sample, exact as everything has ended, and sum up.

        Returns:
            The figures, and what was wrong with what metrics.json says of the reader.
        """
        spec = self._spec
        # Read when all has ended, so that no CPU time is missing, but stamped with the end of the first
        # process: waiting for stragglers is no wall time of the run.
        source = self._program.source
        sample = source.read()._replace(time=finished)
        cores = self._accounting.add(sample, final=True)
        self._table.add(finished - self._start, cores, sample)
        self._contention.add(finished, sample.cpu)
        self._interference.look(finished)
        self._table.flush()
        if self._table.touched:
            self._interference.note("usage.csv was changed by another program")
        reader = reader_report(metrics).share(
            sample.cpu, included=spec.includes_reader, measured=self._reader.seconds
        )
        if reader.suspicion is not None:
            self._interference.note(reader.suspicion)
        usage = self._accounting.usage(
            source.name,
            data_seconds=spec.data_seconds,
            reader_cpu_seconds=reader.cpu_seconds,
            includes_reader=reader.included,
            throttled_seconds=throttled,
            contended_seconds=self._contention.seconds,
            kernel_peak=source.kernel_peak(),
            largest_process=self._program.largest_ended(),
            suspicions=self._interference.notes,
        )
        return usage, reader.note

    def _close_files(self) -> None:
        self._out.close()
        self._err.close()
        self._log.close()
        self._table.close()
        for path, error in (
            (self._spec.log_path, self._log.error),
            (self._spec.usage_path, self._table.error),
        ):
            if error is not None:
                self._notes.append(f"{path} is incomplete: {error.strerror}")


def _machine_oom_kills() -> int:
    with suppress(OSError):
        return field(read_file("/proc/vmstat"), b"oom_kill")
    return 0
