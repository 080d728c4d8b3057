# SPDX-License-Identifier: Apache-2.0
"""Signals that ask the monitor to end, noted without interrupting what it is doing."""

from __future__ import annotations

import os
import select
import signal
from contextlib import suppress

_NUMBERS = (signal.SIGTERM, signal.SIGINT)


class Signals:
    """Counts the requests to end; its descriptor is ready to be read when there are new ones.

    Attributes:
        told: There was one.
    """

    def __init__(self) -> None:
        self.told = False
        self.descriptor, wake = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._poll = select.poll()
        self._poll.register(self.descriptor, select.POLLIN)
        signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
        for number in _NUMBERS:
            # Without a handler the signal would end this process before the descriptor is read.
            signal.signal(number, lambda _number, _frame: None)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _NUMBERS)

    def take(self) -> int:
        """Return the number that came since the last time."""
        count = 0
        with suppress(BlockingIOError):
            count = sum(number in _NUMBERS for number in os.read(self.descriptor, 4096))
        self.told = self.told or count > 0
        return count

    def wait(self, seconds: float | None = None) -> None:
        """Wait for one, as long as that or for ever."""
        if self._poll.poll(None if seconds is None else seconds * 1000):
            self.take()
