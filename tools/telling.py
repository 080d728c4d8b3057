# SPDX-License-Identifier: Apache-2.0
"""Running of pip and uv for ``.venv``, with their progress on a terminal or in a log.

The standard library alone: this runs before there is anything else.
"""

from __future__ import annotations

import shutil
import subprocess
import threading
import time
from typing import IO, TYPE_CHECKING

from slamhive.local.programs.installing import InstallStep

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from slamhive.local.programs.installing import Steps

_LINES = 12
"""Lines while packages come, where there is no terminal."""
_FIRST_WAIT = 10.0
"""Time without news after which a line comes, s; twice as long each time."""


class Teller:
    """Says how far an installation is: by one line that changes on a terminal, by a few lines elsewhere.

    Args:
        to: where.
        clock: monotonic time, s.
    """

    def __init__(self, to: IO[str], clock: Callable[[], float] = time.monotonic) -> None:
        self._to = to
        self._clock = clock
        self._began = self._said = clock()
        self._wait = _FIRST_WAIT
        self._lines = 0
        self._step = InstallStep("beginning", 0, 0)
        self._lock = threading.Lock()

    def take(self, step: InstallStep) -> None:
        """Take a step."""
        with self._lock:
            self._step = step
            # A log keeps every line: a few are enough, evenly over the packages.
            due = step.total and step.done * _LINES >= self._lines * step.total
            if self._to.isatty():
                self._redraw()
            elif due or step.what.startswith("installing"):
                self._print()

    def beat(self) -> None:
        """Say that it goes on, where nothing was said for a while."""
        with self._lock:
            if self._to.isatty():
                self._redraw()
            elif self._clock() - self._said >= self._wait:
                self._wait *= 2
                self._print()

    def end(self) -> None:
        """Take the line that changes away."""
        if self._to.isatty():
            self._to.write("\r\x1b[K")
            self._to.flush()

    def _text(self) -> str:
        step = self._step
        counted = f"{step.done} of {step.total} packages, " if step.total else ""
        return f"{counted}{self._clock() - self._began:.0f} s: {step.what}"

    def _print(self) -> None:
        self._said = self._clock()
        self._lines += 1
        self._to.write(f"{self._text()}\n")
        self._to.flush()

    def _redraw(self) -> None:
        width = shutil.get_terminal_size().columns - 1
        self._to.write(f"\r\x1b[K{self._text()[:width]}")
        self._to.flush()


def install(
    command: Sequence[str], steps: Steps, teller: Teller, variables: Mapping[str, str], held: int
) -> list[str]:
    """Run pip or uv, tell how far it is, and return what it said where it failed, nothing where it did not.

    Args:
        command: what is run.
        steps: follows it.
        teller: tells how far it is.
        variables: those that it is started with.
        held: descriptor of a lock that it holds as long as it runs.
    """
    ended, said = threading.Event(), []

    def beats() -> None:
        while not ended.wait(1.0):
            teller.beat()

    beating = threading.Thread(target=beats, daemon=True)
    with subprocess.Popen(
        command,
        env=variables,
        pass_fds=(held,),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    ) as process:
        beating.start()
        try:
            for line in process.stdout or ():
                step = steps.step(line)
                if step is not None:
                    teller.take(step)
                elif line.strip():
                    said.append(line.rstrip())
        except BaseException:
            process.kill()
            raise
        finally:
            ended.set()
            beating.join()
            teller.end()
    return (said or [f"exit code {process.returncode}"]) if process.returncode else []
