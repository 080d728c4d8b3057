# SPDX-License-Identifier: Apache-2.0
"""The clock of the threads that read the recording, where they say who they are by their name."""

from __future__ import annotations

import os
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.monitor.measuring.processes import read_file

if TYPE_CHECKING:
    from collections.abc import Iterable

NAME = b"slamhive-reader"
# Looking at more threads than these would disturb the run that is measured.
_MOST_THREADS = 200


class ReaderClock:
    """Adds up the CPU time of the reader's threads, those that have ended too."""

    def __init__(self) -> None:
        self._clocks: dict[str, float] = {}

    @property
    def seconds(self) -> float | None:
        """CPU seconds as last seen, None where no thread called itself the reader."""
        return sum(self._clocks.values()) if self._clocks else None

    def look(self, processes: Iterable[int]) -> None:
        """Read the clocks of the reader's threads in some processes."""
        left = _MOST_THREADS
        for process in processes:
            with suppress(OSError):
                for thread in os.listdir(f"/proc/{process}/task")[:left]:  # noqa: PTH208
                    left -= 1
                    with suppress(OSError, ValueError, IndexError):
                        self._read(f"/proc/{process}/task/{thread}")
            if left <= 0:
                return

    def _read(self, thread: str) -> None:
        if read_file(f"{thread}/comm").strip() == NAME:
            self._clocks[thread] = int(read_file(f"{thread}/schedstat").split()[0]) / 1e9
