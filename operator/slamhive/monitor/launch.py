# SPDX-License-Identifier: Apache-2.0
"""Start an algorithm: pinned, in a session and a cgroup of its own, to die with its supervisor."""

from __future__ import annotations

import os
import resource
import signal
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.monitor.processes import set_parent_death_signal

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from slamhive.monitor.spec import SupervisorSpec

# When the machine itself runs out of memory, the algorithm goes before slamhive does.
_OOM_SCORE = b"800"


class LaunchError(Exception):
    """An algorithm could not be started; the message says why."""


def launch(spec: SupervisorSpec, environment: dict[str, str], output: int, cgroups: Sequence[str]) -> int:
    """Start the algorithm.

    Args:
        spec: What to start.
        environment: Its complete environment.
        output: Descriptor for its stdout and stderr.
        cgroups: Directories of the cgroups to join.

    Returns:
        Its pid.

    Raises:
        LaunchError: The program, the working directory or a processor isn't there.
    """
    report, told = os.pipe()
    supervisor = os.getpid()
    pid = os.fork()
    if pid == 0:
        _become(spec, environment, output, cgroups, supervisor=supervisor, told=told)
    os.close(told)
    with open(report, "rb") as file:  # noqa: PTH123
        problem = file.read()
    if problem:
        raise LaunchError(problem.decode("utf-8", "replace"))
    return pid


def _become(
    spec: SupervisorSpec,
    environment: dict[str, str],
    output: int,
    cgroups: Sequence[str],
    *,
    supervisor: int,
    told: int,
) -> None:
    """Turn this child into the algorithm; `told` closes by itself when that succeeds."""
    step = "prepare the process"
    try:
        os.setsid()
        set_parent_death_signal(signal.SIGKILL)
        if os.getppid() != supervisor:
            os._exit(1)
        _reset_signals()
        _redirect(output)
        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
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
        os.execvpe(spec.argv[0], spec.argv, environment)  # noqa: S606 - the algorithm itself
    except (OSError, OverflowError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no such number"
        os.write(told, f"cannot {step}: {reason}".encode())
    finally:
        os._exit(127)


def _reset_signals() -> None:
    """Undo what Python and those before it ignore; handlers go by themselves, ignored signals don't."""
    for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}:
        with suppress(OSError, ValueError):
            signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())


def _redirect(output: int) -> None:
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(output, 1)
    os.dup2(output, 2)


def _join(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))


def _write(path: str, data: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
    try:
        os.write(descriptor, data)
    finally:
        os.close(descriptor)
