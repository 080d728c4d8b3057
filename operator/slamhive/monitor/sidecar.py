# SPDX-License-Identifier: Apache-2.0
"""`python -m slamhive.monitor.sidecar`: in a run's pod, watches the algorithm and writes the summary.

The kubelet starts it before the algorithm and ends it afterwards by SIGTERM. What it finds out is in
usage.csv while the algorithm runs, in summary.json when it has ended, and in short in the container's
termination message. What it knows is in its memory alone: one that was killed can't be believed any more,
so that the next ends the algorithm and says so.

Exit codes: 0, summary.json says how the run ended; 1, no summary could be written; 2, wrong specification.
"""

from __future__ import annotations

import json
import os
import sys
import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from slamhive.contract.output import read_output
from slamhive.monitor.measuring.machine import cpu_model, machine_report, process_start, processors_text
from slamhive.monitor.measuring.processes import forbid_inspection, read_file
from slamhive.monitor.metrics import reader_report
from slamhive.monitor.outcome import StopDecision, out_of_memory
from slamhive.monitor.playing import played_mean_cores
from slamhive.monitor.pod.containers import Container, Finder
from slamhive.monitor.pod.sidecarstate import SidecarState
from slamhive.monitor.pod.termination import VERSION, termination_message, write_message
from slamhive.monitor.pod.watching import UNENDED, USAGE, Watch
from slamhive.monitor.programs.orphans import write_atomically
from slamhive.monitor.signals import Signals
from slamhive.monitor.spec import TERMINATION_MESSAGE, SidecarSpec, SpecError
from slamhive.monitor.summary import Reason, RunSummary
from slamhive.playback.outcome import read_report

if TYPE_CHECKING:
    from slamhive.contract.output import OutputContents
    from slamhive.monitor.measuring.accounting import Accounting, MeasuredUsage
    from slamhive.monitor.measuring.processes import ProcessIdentity

VARIABLE = "SLAMHIVE_SIDECAR"
_SUMMARY = "summary.json"
_CONFIGURATION = "config.yaml"
_LEFT_SECONDS = 5.0
_RESTARTED = "the monitor was ended while the algorithm ran: nobody knows what it did since"
_EARLY = "the algorithm ran before the monitor watched it"
_UNSEEN = "the algorithm was never seen: it did not start, or ended within milliseconds"


class Sidecar:
    """Watches the algorithm of one pod."""

    def __init__(self, spec: SidecarSpec) -> None:
        """Take a specification; signals are ours from now on."""
        self._spec = spec
        self._signals = Signals()

    def run(self) -> int:
        """Wait for the algorithm, watch it, write the summary, wait to be ended; return the exit code."""
        summary = self._summary(self._follow())
        written = self._write(summary)
        try:
            write_message(self._spec.termination_message, termination_message(summary))
        except OSError as error:
            _say(f"{self._spec.termination_message}: {error.strerror}")
        # A native sidecar that ends is started again by the kubelet: it stays until it is told to end.
        while not self._signals.told:
            self._signals.wait()
        return 0 if written else 1

    def _follow(self) -> SidecarState:
        """Watch the algorithm to its end; what is known of it then."""
        state = SidecarState()
        # Files of an earlier life of ours: what the algorithm did in between was seen by nobody, so the run
        # is a fault.
        restarted = any(os.path.lexists(self._path(name)) for name in (USAGE, _SUMMARY))
        if restarted:
            state.note(_RESTARTED)
            state.stop = StopDecision(Reason.SYSTEM_FAULT, _RESTARTED, at_once=True)
        container = self._attach(state)
        if container is not None:
            try:
                if restarted:
                    container.end(_LEFT_SECONDS)
                elif Watch(self._spec, container, state).run(self._signals):
                    _end_left(container, state)
            finally:
                container.close()
        return state

    def _attach(self, state: SidecarState) -> Container | None:
        """Return the algorithm's container once it runs, None if it never comes or is gone already."""
        first, late = self._wait(state)
        if first is None:
            return None
        try:
            container = Container(first)
        except OSError:
            return None
        state.first, state.start = first, time.monotonic()
        # It ran before the monitor was closed to it: its figures are kept, marked as doubtful.
        if late:
            state.suspicions.append(_EARLY)
            with suppress(OSError):
                state.start = process_start(first.pid)
        state.started_at = time.time() - (time.monotonic() - state.start)
        if not container.exact:
            state.note("the container's cgroup can't be read: figures are those of its processes in /proc")
        return container

    def _wait(self, state: SidecarState) -> tuple[ProcessIdentity | None, bool]:
        """Wait for the algorithm's first process; tell too whether it was there before we looked."""
        finder = Finder(self._spec.container, self._spec.companions)
        try:
            first, late = finder.look(time.monotonic()), True
            self._copy_configuration(state)  # by which the kubelet knows that we watch: see builders/run.py
            while first is None and not self._signals.told:
                self._signals.wait(finder.interval(time.monotonic()))
                first, late = finder.look(time.monotonic()), False
            if finder.by_exclusion:
                state.note("the algorithm hides its environment and was found by exclusion")
            return first, late
        finally:
            finder.close()

    def _summary(self, state: SidecarState) -> dict[str, Any]:
        spec = self._spec
        folder = f"{spec.run_directory}/output"
        output = read_output(folder, spec.frames, spec.poses)
        if output.fault is not None and state.stop is None:
            state.stop = StopDecision(Reason.SYSTEM_FAULT, output.fault)
        account = state.accounting
        usage, problem = (None, None) if account is None else self._usage(state, account, output)
        if usage is None:
            state.note(_UNSEEN if state.stop is None else state.stop.message)
        else:
            mean = played_mean_cores(folder, self._path(USAGE), state.started_at)
            if mean is not None:
                usage = replace(usage, cpu=replace(usage.cpu, mean_cores=mean))
        stop = state.stop or (out_of_memory(spec.memory_limit_bytes) if state.oom_kills else None)
        summary = RunSummary(
            # The kubelet alone knows how the container ended: the algorithm is not our child.
            exit_code=None,
            signal=None,
            reason=stop.reason if stop else None,
            message=stop.message if stop else "",
            started_at=state.started_at if usage else None,
            finished_at=state.started_at + usage.wall_seconds if usage else None,
            usage=usage,
            log_tail="",
            left_processes=state.left,
            metrics_problem=output.metrics_problem(problem),
            output=output,
            notes=tuple(state.notes),
        )
        told = summary.as_json()
        if told["usage"] and state.exclusive:
            told["usage"]["processors"] = processors_text(list(state.cpuset or ()))
        return {
            **told,
            **_played(folder),
            "node": os.environ.get("NODE_NAME") or None,
            "cpuModel": cpu_model(),
            "machine": machine_report(exclusive=state.exclusive),
        }

    def _usage(
        self, state: SidecarState, account: Accounting, output: OutputContents
    ) -> tuple[MeasuredUsage, str | None]:
        """Return the figures, and what was wrong with what metrics.json says of the reader."""
        reader = reader_report(output.metrics).share(
            account.cpu_seconds, included=self._spec.includes_reader, measured=state.reader
        )
        doubts = [*state.suspicions, *([reader.suspicion] if reader.suspicion else [])]
        usage = account.usage(
            state.source,
            data_seconds=self._spec.data_seconds,
            reader_cpu_seconds=reader.cpu_seconds,
            includes_reader=reader.included,
            throttled_seconds=state.throttled,
            contended_seconds=state.contended,
            kernel_peak=state.kernel_peak,
            suspicions=doubts,
        )
        return usage, reader.note

    def _copy_configuration(self, state: SidecarState) -> None:
        if self._spec.configuration is not None:
            try:
                text = read_file(self._spec.configuration).decode("utf-8", "surrogateescape")
                write_atomically(self._path(_CONFIGURATION), text, durable=False)
            except (OSError, ValueError) as error:
                state.note(f"{_CONFIGURATION} could not be kept: {error}")

    def _write(self, summary: dict[str, Any]) -> bool:
        try:
            write_atomically(self._path(_SUMMARY), json.dumps(summary, indent=2, allow_nan=False) + "\n")
        except OSError as error:
            _say(f"{self._path(_SUMMARY)}: {error.strerror}")
            return False
        return True

    def _path(self, name: str) -> str:
        return f"{self._spec.run_directory}/{name}"


def _end_left(container: Container, state: SidecarState) -> None:
    """End what outlived the first process, so that nobody changes the output any more."""
    left = [process for process in container.processes() if process != container.first]
    state.left = len(left)
    if left and container.end(_LEFT_SECONDS):
        state.note(UNENDED)


def _played(output: str) -> dict[str, Any]:
    """Return the player's report on a run that it played to."""
    found = read_report(output)
    return {} if found is None else {"played": found._asdict()}


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def main() -> int:
    """Watch the run that the environment describes and return the exit code."""
    forbid_inspection()
    try:
        spec = SidecarSpec.from_json(os.environ.get(VARIABLE, ""))
    except SpecError as error:
        message = f"{VARIABLE}: {error}" if VARIABLE in os.environ else f"{VARIABLE} is not set"
        _say(message)
        told = {"v": VERSION, "reason": "SystemFault", "message": message[:1000]}
        with suppress(OSError):
            write_message(TERMINATION_MESSAGE, json.dumps(told).encode())
        return 2
    try:
        return Sidecar(spec).run()
    except OSError as error:
        _say(f"the run can't be watched: {error.strerror}: {error.filename}")
        return 1


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # skips the interpreter's clean-up
