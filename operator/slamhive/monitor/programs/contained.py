# SPDX-License-Identifier: Apache-2.0
"""An algorithm in a container of a container engine (podman, docker), as its supervisor sees it.

slamhive has created the container. The supervisor starts it, reads the account of the cgroup that the engine
made for it, and removes it. Between creation and start the engine's runtime waits inside the container, where
the engine can be told to (podman): there the account is opened, so that neither the runtime's own work counts
as the algorithm's nor anything of the algorithm is missed.

The cgroup is gone soon after the container's first process. That process's end is waited for, and the account
read once more before anything else is done.
"""

from __future__ import annotations

import os
import re
import select
import signal
import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from slamhive.monitor.measuring.cgroup import cgroup_of
from slamhive.monitor.measuring.processes import (
    ProcessIdentity,
    boot_id,
    descendants,
    end_processes,
    identify,
    pid_namespace,
    read_file,
    send,
)
from slamhive.monitor.measuring.sources import Sample
from slamhive.monitor.programs.engine import COMMAND_SECONDS, EngineError, run_engine
from slamhive.monitor.programs.guard import Guard
from slamhive.monitor.programs.launch import LaunchError
from slamhive.monitor.programs.orphans import TOKEN, ProcessRecord
from slamhive.monitor.programs.program import NO_ACCOUNT
from slamhive.monitor.spec import ContainedSpec
from slamhive.monitor.summary import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slamhive.monitor.measuring.cgroup import RunCgroup
    from slamhive.monitor.measuring.sources import UsageSource
    from slamhive.monitor.spec import SupervisorSpec

_LOOK_SECONDS = 0.002
_ASK_SECONDS = 0.02
_LEAVE_SECONDS = 30.0
_SIGNALLED = 128
# Said where an algorithm can't be started: by the small first program of a container (podman's catatonit,
# docker's tini) or, without one, by the runtime (runc, crun).
_NEVER_RAN = re.compile(
    r"(?:ERROR \(catatonit:\d+\): failed to exec pid1"
    r"|\[FATAL tini \(\d+\)\] exec .* failed"
    r'|(?:^exec |\b(?:runc|OCI runtime)\b.* exec:? )(?:"[^"]*"|/\S*?)(?:: stat [^:]*)?'
    r"|executable file `[^`]*` not found in \$PATH|\bopen executable|\bexec container process [^`]*`[^`]*`)"
    r": ([\w ]+)"
)
_NOT_THERE = "it, or the interpreter that its first line names, is not in the image"
_NOT_ALLOWED = "the image doesn't let everyone run it, and no algorithm runs as root"


class NoAccount:
    """The account of a container that has none, as it never ran."""

    name = NO_ACCOUNT

    def read(self) -> Sample:
        """Return zeros."""
        return Sample(time.monotonic(), 0.0, 0, 0, 0)

    def processes(self) -> Sequence[int]:
        """Return none."""
        return ()

    def kernel_peak(self) -> int | None:
        """Return None."""
        return None

    def pressure(self) -> float | None:
        """Return None."""
        return None

    def close(self) -> None:
        """Do nothing."""


class Account:
    """The account of a container's cgroup, which lasts longer than the cgroup."""

    def __init__(self, group: RunCgroup, *, fresh: bool) -> None:
        """Begin.

        Args:
            group: The cgroup.
            fresh: Whether nothing of the algorithm has run yet: what was used so far is the runtime's.
        """
        self._group = group
        self._source = group.source
        self.name = self._source.name
        self._before = self._source.read().cpu if fresh else 0.0
        self._last = NoAccount().read()
        self._peak: int | None = None
        self._oom_kills = 0
        self._throttled: float | None = None
        self._closed = False

    def read(self) -> Sample:
        """Read the present figures, or again the last ones when the cgroup is gone."""
        if not self._closed:
            try:
                found = self._source.read()
            except OSError:
                self._closed = True
            else:
                # While a cgroup is being taken apart it has no processes, and then no memory, any more.
                self._last = found._replace(cpu=max(found.cpu - self._before, self._last.cpu))
        return self._last._replace(time=time.monotonic())

    def close_books(self) -> None:
        """Read everything for the last time."""
        self.read()
        self.kernel_peak()
        self.oom_kills()
        self.throttled()
        self._closed = True

    def processes(self) -> Sequence[int]:
        """Return the ids of its processes."""
        with suppress(OSError):
            return () if self._closed else self._source.processes()
        return ()

    def kernel_peak(self) -> int | None:
        """Return the kernel's own peak of memory."""
        if not self._closed:
            self._peak = self._source.kernel_peak() or self._peak
        return self._peak

    def pressure(self) -> float | None:
        """Return the seconds in which some thread waited for a processor."""
        return None if self._closed else self._source.pressure()

    def oom_kills(self) -> int:
        """Return the number of its processes that the kernel killed for want of memory."""
        if not self._closed:
            self._oom_kills = max(self._group.oom_kills(), self._oom_kills)
        return self._oom_kills

    def throttled(self) -> float | None:
        """Return the seconds in which its CPU limit held it back."""
        if not self._closed:
            found = self._group.throttled()
            self._throttled = self._throttled if found is None else found
        return self._throttled

    def close(self) -> None:
        """Let go of open files."""
        self._closed = True
        self._source.close()


class Contained:
    """The container of one run."""

    limits_memory = True
    limits_tasks = True

    def __init__(self, spec: SupervisorSpec, supervisor: ProcessIdentity, poll: select.poll) -> None:
        """Prepare; nothing is started yet.

        Args:
            spec: The run.
            supervisor: Who we are.
            poll: Told of the end of the container's first process.
        """
        self._spec = spec
        self._me = supervisor
        self._poll = poll
        self._container = ContainedSpec.from_json(spec.contained)
        self._first: ProcessIdentity | None = None
        self._pidfd: int | None = None
        self._attached: int | None = None
        self._attached_status: int | None = None
        self._account: Account | None = None
        self._gone = False
        self._removed = False
        # Where memory ran out, podman leaves an empty file `oom` in the folder that it was started in.
        os.chdir(os.path.dirname(spec.process_path))  # noqa: PTH120
        # From here on the container goes with us, however we end.
        self._guard = Guard(self._command(*self._container.removal, self._container.identity))
        self.source: UsageSource = NoAccount()

    @property
    def ended(self) -> bool:
        """The first process has ended, or the engine says that all is over."""
        return self._gone or self._attached_status is not None

    @property
    def status(self) -> int | None:
        """Wait status of the algorithm: what the engine passes on, exit codes above 128 as signals."""
        status = self._attached_status
        if status is None or not os.WIFEXITED(status):
            return None
        code = os.WEXITSTATUS(status)
        number = code - _SIGNALLED
        return number if number in signal.valid_signals() else status

    def start(self, outputs: tuple[int, int]) -> float:
        """Start it.

        Raises:
            LaunchError: The engine can't, or was ended meanwhile.
        """
        record = ProcessRecord(boot_id(), pid_namespace(), self._me, None, ())
        record.write(self._spec.process_path)
        if self._container.pid_path is not None:
            try:
                self._engine("init", self._container.identity)
            except LaunchError as error:
                never_ran = self.explain(str(error))
                raise error if never_ran is None else LaunchError(never_ran) from None
            self._attend(int(read_file(self._container.pid_path)), fresh=True)
        began = time.monotonic()
        self._attach(outputs, record.token)
        start = self._until_it_runs() or began
        replace(record, algorithm=self._first).write(self._spec.process_path)
        return start

    def _attend(self, pid: int, *, fresh: bool) -> None:
        """Open the account of the container's first process, and have its end told of."""
        first = identify(pid)
        if first is None:
            return
        with suppress(OSError):
            self._pidfd = os.pidfd_open(pid)
        if self._pidfd is None or identify(pid) != first:
            return
        self._first = first
        self._poll.register(self._pidfd, select.POLLIN)
        group = cgroup_of(pid)
        if group is None:
            if identify(pid) is None:
                return
            why = f"{self._container.engine[0]} gave the container no control group with CPU and memory"
            raise LaunchError(why, Reason.SYSTEM_FAULT)
        self._account = Account(group, fresh=fresh)
        self.source = self._account

    def _attach(self, outputs: tuple[int, int], token: str) -> None:
        """Start the container with our pipes for what it prints, and follow it to its end."""
        quiet = ("--sig-proxy=false",) if self._container.pid_path is not None else ()
        command = self._command("start", "--attach", *quiet, self._container.identity)
        # As our child alone tells the container's exit code, it isn't one of `subprocess`.
        self._attached = os.posix_spawnp(
            command[0],
            command,
            {**os.environ, TOKEN: token},
            file_actions=[
                (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0),
                (os.POSIX_SPAWN_DUP2, outputs[0], 1),
                (os.POSIX_SPAWN_DUP2, outputs[1], 2),
            ],
            setpgroup=0,
        )

    def _until_it_runs(self) -> float | None:
        """Wait until the runtime has become the container's first program, and return when that was seen."""
        waiting = self._name()
        ask_at = time.monotonic()
        deadline = time.monotonic() + COMMAND_SECONDS
        why = "it said nothing"
        while time.monotonic() < deadline:
            self.reap()
            if self.ended:
                return None
            if self._first is None and time.monotonic() >= ask_at:
                # Podman can't answer about a container that ends while it looks: ask again, its end is told.
                try:
                    asked = self._engine("inspect", "--format", "{{.State.Pid}}", self._container.identity)
                except LaunchError as error:
                    asked, why = "", str(error)
                if asked.strip().isdigit() and int(asked) > 0:
                    self._attend(int(asked), fresh=False)
                    return time.monotonic()
                ask_at = time.monotonic() + _ASK_SECONDS
            if self._first is not None and self._name() != waiting:
                return time.monotonic()
            time.sleep(_LOOK_SECONDS)
        raise LaunchError(f"{self._container.engine[0]} didn't start it: {why}", Reason.SYSTEM_FAULT)

    def _name(self) -> bytes | None:
        if self._first is None:
            return None
        with suppress(OSError):
            return read_file(f"/proc/{self._first.pid}/comm")
        return None

    def reap(self) -> None:
        """Take note of the end of the container, and of the engine's programs that ended."""
        if not self._gone and self._pidfd is not None and _is_ready(self._pidfd):
            self._note_end()
        with suppress(ChildProcessError):
            while True:
                pid, status = os.waitpid(-1, os.WNOHANG)
                if pid == 0:
                    return
                if pid == self._attached:
                    self._attached_status = status

    def _note_end(self) -> None:
        if not self._gone:
            self._gone = True
            if self._account is not None:
                self._account.close_books()
            if self._pidfd is not None:
                self._poll.unregister(self._pidfd)

    def ask_to_end(self) -> None:
        """Send SIGTERM to all in the container; where that is not ours to do, the engine does."""
        pids = self.source.processes()
        try:
            for pid in pids:
                for number in (signal.SIGTERM, signal.SIGCONT):
                    with suppress(ProcessLookupError):
                        os.kill(pid, number)
        except PermissionError:
            self._try("kill", "--signal", "TERM", self._container.identity)

    def left(self) -> int:
        """Return 0: the kernel has ended all of the container with its first process."""
        return 0

    def end(self, deadline: float, idle: Callable[[], None]) -> str | None:
        """End the container and remove it; all that the engine left of itself below us goes too."""
        if self._removed:
            return None
        if self._first is not None and not self._gone and not send(self._first, signal.SIGKILL):
            self._try("kill", "--signal", "KILL", self._container.identity)
        until = max(deadline, time.monotonic() + _LEAVE_SECONDS)
        while self._attached is not None and self._attached_status is None and time.monotonic() < until:
            self.reap()
            idle()
            time.sleep(_LOOK_SECONDS)
        self.reap()
        problem = self._remove()
        self._guard.dismiss()
        # Programs of the engine: what remains of them waits for nothing any more.
        end_processes(self._living, _LEAVE_SECONDS)
        self.reap()
        self._removed = problem is None
        return problem

    def _remove(self) -> str | None:
        problem = self._try(*self._container.removal, self._container.identity)
        if problem is None or "no such container" in problem.lower() or "no container" in problem.lower():
            return None
        return f"the container {self._container.identity[:12]} could not be removed: {problem}"

    def oom_kills(self) -> int:
        """Return the kills that its cgroup counted."""
        return self._account.oom_kills() if self._account else 0

    def throttled(self) -> float | None:
        """Return the throttled time that its cgroup counted, s."""
        return self._account.throttled() if self._account else None

    def largest_ended(self) -> int | None:
        """Return None: those that we waited for are programs of the engine."""
        return None

    def explain(self, last_line: str) -> str | None:
        """Return the reason that the algorithm never started inside of its container, None where it did."""
        return explain(self._spec.argv[0], last_line)

    def close(self) -> str | None:
        """Let go of open files."""
        self.source.close()
        if self._pidfd is not None:
            os.close(self._pidfd)
            self._pidfd = None
        return None

    def _living(self) -> list[ProcessIdentity]:
        self.reap()
        return [found for found in map(identify, descendants([self._me.pid])) if found is not None]

    def _command(self, *words: str) -> list[str]:
        return [*self._container.engine, *words]

    def _engine(self, *words: str) -> str:
        """Have the engine do something.

        Raises:
            LaunchError: It doesn't.
        """
        try:
            return run_engine(self._command(*words))
        except EngineError as error:
            why = f"{self._container.engine[0]} {words[0]}: {error}"
            raise LaunchError(why, Reason.SYSTEM_FAULT) from None

    def _try(self, *words: str) -> str | None:
        """Have the engine do something, and return why it doesn't."""
        try:
            run_engine(self._command(*words))
        except EngineError as error:
            return str(error)
        return None


def explain(program: str, said: str) -> str | None:
    """Return the reason that a program never started in its container, by what is said; None if it did."""
    found = _NEVER_RAN.search(said)
    if found is None:
        return None
    why = found[1].strip().capitalize()
    if "not found" in why:
        why = "No such file or directory"
    hint = _NOT_ALLOWED if "ermission" in why else _NOT_THERE
    return f"cannot start {program}: {why}; {hint}"


def _is_ready(descriptor: int) -> bool:
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(0))
