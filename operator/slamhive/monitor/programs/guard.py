# SPDX-License-Identifier: Apache-2.0
"""A process that outlives its supervisor by one command, which removes the container of a killed one.

A container is no child of its supervisor, so the kernel ends it with nobody. The supervisor holds a pipe that
the guard reads from: it reads a byte when the supervisor has removed the container itself, and the end of the
pipe when the supervisor is gone without.
"""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


class Guard:
    """The guard of one container."""

    def __init__(self, command: Sequence[str]) -> None:
        """Start it; it runs the command if we end without a word.

        Args:
            command: Removes the container, running or not.
        """
        descriptor, self._told = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            try:
                _keep_watch(descriptor, command)
            finally:
                os._exit(1)
        os.close(descriptor)

    def dismiss(self) -> None:
        """Have it end without having done anything, and wait for that."""
        if self._told >= 0:
            with suppress(OSError):
                os.write(self._told, b"0")
            os.close(self._told)
            self._told = -1
            with suppress(ChildProcessError):
                os.waitpid(self.pid, 0)


def _keep_watch(descriptor: int, command: Sequence[str]) -> None:
    # Signals to the supervisor's group are none of its: what ends that one is what it waits for.
    os.setsid()
    signal.set_wakeup_fd(-1)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR1):
        signal.signal(number, signal.SIG_IGN)
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nothing, stream)
    for name in os.listdir("/proc/self/fd"):  # noqa: PTH208
        if int(name) > 2 and int(name) != descriptor:
            with suppress(OSError):
                os.close(int(name))
    if os.read(descriptor, 1):
        os._exit(0)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR1):
        signal.signal(number, signal.SIG_DFL)
    os.execvp(command[0], list(command))  # noqa: S606
