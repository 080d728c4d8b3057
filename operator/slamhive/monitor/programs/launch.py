# SPDX-License-Identifier: Apache-2.0
"""Launch of an algorithm: pinned to cores, in its own session and cgroup, to die with its supervisor."""

from __future__ import annotations

import os
import resource
import signal
import time
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

from slamhive.monitor.measuring.processes import allow_inspection, set_parent_death_signal
from slamhive.monitor.summary import Reason

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from slamhive.monitor.spec import SupervisorSpec

# When the machine itself runs out of memory, the algorithm goes before slamhive does.
_OOM_SCORE = b"800"


class LaunchError(Exception):
    """An algorithm could not be started; the message says why.

    Attributes:
        reason: Whose fault that is.
    """

    def __init__(self, message: str, reason: Reason = Reason.ALGORITHM_FAILED) -> None:
        """Take the message."""
        super().__init__(message)
        self.reason = reason


class Launched(NamedTuple):
    """An algorithm that was started.

    Attributes:
        pid: Its first process.
        start: When it became the algorithm, monotonic clock, s: entering a cgroup can take 20 ms before that.
        cpu: CPU seconds the process had used by then, which are not the algorithm's.
    """

    pid: int
    start: float
    cpu: float


def launch(
    spec: SupervisorSpec, environment: dict[str, str], outputs: tuple[int, int], cgroups: Sequence[str]
) -> Launched:
    """Start the algorithm.

    Args:
        spec: What to start.
        environment: Its complete environment.
        outputs: Descriptors for its stdout and its stderr.
        cgroups: Directories of the cgroups to join.

    Raises:
        LaunchError: The program, the working directory or a processor isn't there.
    """
    report, told = os.pipe()
    supervisor = os.getpid()
    pid = os.fork()
    if pid == 0:
        _become(spec, environment, outputs, cgroups, supervisor=supervisor, told=told)
    os.close(told)
    with open(report, "rb") as file:  # noqa: PTH123
        start, _, problem = file.read().decode("utf-8", "replace").partition("\n")
    if problem or not start:
        raise LaunchError(problem or "it was killed before it began")
    moment, cpu = map(float, start.split())
    return Launched(pid, moment, cpu)


def _become(
    spec: SupervisorSpec,
    environment: dict[str, str],
    outputs: tuple[int, int],
    cgroups: Sequence[str],
    *,
    supervisor: int,
    told: int,
) -> None:
    """Turn this child into the algorithm.

    `told` takes a line with time and CPU before that moment, and what went wrong; it closes by itself when
    nothing did.
    """
    step = "prepare the process"
    try:
        os.setsid()
        set_parent_death_signal(signal.SIGKILL)
        # The supervisor died before the death signal was set: nobody would end this child any more.
        if os.getppid() != supervisor:
            os._exit(1)
        _reset_signals()
        _redirect(*outputs)
        # A core dump can have as many gigabytes as the program had of memory.
        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
        allow_inspection()  # only then is the next ours to write
        with suppress(OSError):
            _write("/proc/self/oom_score_adj", _OOM_SCORE)
        step = f"enter the working directory {spec.cwd}"
        os.chdir(spec.cwd)
        if spec.cpus:
            allowed = os.sched_getaffinity(0)
            step = f"use processors {_join(spec.cpus)} (allowed are {_join(sorted(allowed))})"
            # The kernel would silently take those there are: asking for none of them is refused.
            os.sched_setaffinity(0, spec.cpus if allowed.issuperset(spec.cpus) else ())
        step = "enter the cgroup"
        for directory in cgroups:
            _write(f"{directory}/cgroup.procs", b"0")
        step = f"start {spec.argv[0]}"
        os.write(told, f"{time.monotonic()} {time.process_time()}\n".encode())
        os.execvpe(spec.argv[0], spec.argv, environment)  # noqa: S606 - the algorithm itself
    except (OSError, OverflowError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no such number"
        separator = "" if step.startswith("start ") else "\n"
        os.write(told, f"{separator}cannot {step}: {reason}".encode())
    finally:
        os._exit(127)


def _reset_signals() -> None:
    """Undo what Python and those before it ignore; handlers go by themselves, ignored signals don't."""
    for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}:
        with suppress(OSError, ValueError):
            signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())


def _redirect(output: int, errors: int) -> None:
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(output, 1)
    os.dup2(errors, 2)


def _join(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))


def _write(path: str, data: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
    try:
        os.write(descriptor, data)
    finally:
        os.close(descriptor)
