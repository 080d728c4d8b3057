# SPDX-License-Identifier: Apache-2.0
"""Outcome of a process: from how it ended to a reason and a sentence. Pure; no process is touched."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from typing import NamedTuple

from slamhive.contract.lines import is_report
from slamhive.monitor.summary import Reason


class StopDecision(NamedTuple):
    """A decision to end a run.

    Attributes:
        reason: Why.
        message: In a sentence.
        at_once: Without asking the algorithm first, as every moment makes it worse.
    """

    reason: Reason
    message: str
    at_once: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramEnding:
    """Facts about a run's end that its outcome is judged by: wait status, stop decision, OOM kills.

    Attributes:
        status: Wait status of the algorithm's first process, None if it never ran.
        stop: The decision to end it, None if it ended by itself.
        last_line: The last line it printed to stderr, or to stdout where there is none.
        group_oom_kills: Processes of the run's cgroup that the kernel killed for want of memory.
        machine_oom_kills: The same on the entire machine while the run ran.
        memory_limit: Bytes the run was allowed.
        was_played: A player had played its recording to the end and then asked it to go.
    """

    status: int | None
    stop: StopDecision | None = None
    last_line: str = ""
    group_oom_kills: int = 0
    machine_oom_kills: int = 0
    memory_limit: int | None = None
    was_played: bool = False


class ProgramOutcome(NamedTuple):
    """Exit code or signal, and what they mean; reason None for success."""

    exit_code: int | None
    signal: int | None
    reason: Reason | None
    message: str


def out_of_memory(limit: int | None) -> StopDecision:
    """Return the decision to end a run that took too much memory."""
    most = "there is" if limit is None else f"its limit of {limit / 2**20:.0f} MiB"
    return StopDecision(Reason.OUT_OF_MEMORY, f"it needed more memory than {most}", at_once=True)


def judge(ending: ProgramEnding) -> ProgramOutcome:
    """Say how a run ended."""
    status = ending.status
    exited = status is not None and os.WIFEXITED(status)
    killed = status is not None and os.WIFSIGNALED(status)
    code = os.WEXITSTATUS(status) if exited and status is not None else None
    number = os.WTERMSIG(status) if killed and status is not None else None
    stop = ending.stop
    # Without a cgroup of the run's own nobody says whom the kernel killed for memory: a SIGKILL that nobody
    # here sent, while it did so, is taken for that.
    if stop is None and (
        ending.group_oom_kills > 0 or (number == signal.SIGKILL and ending.machine_oom_kills > 0)
    ):
        stop = out_of_memory(ending.memory_limit if ending.group_oom_kills else None)
    if stop is not None:
        return ProgramOutcome(code, number, stop.reason, stop.message)
    # Many nodes abort when they are told to go: that says nothing of their poses.
    if code == 0 or ending.was_played:
        return ProgramOutcome(code, number, None, "")
    what = f"exit code {code}" if number is None else f"ended by signal {number} ({_name(number)})"
    line = "" if number is not None and is_report(ending.last_line) else ending.last_line
    message = f"{what}: {line}" if line else what
    return ProgramOutcome(code, number, Reason.ALGORITHM_FAILED, message)


def _name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # a real-time signal
        return f"SIGRTMIN+{number - signal.SIGRTMIN}"
