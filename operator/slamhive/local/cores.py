# SPDX-License-Identifier: Apache-2.0
"""Whole cores for runs, so that parallel runs share none."""

from __future__ import annotations

import os
import threading
from collections import defaultdict
from pathlib import Path


def whole_cores() -> list[tuple[int, ...]]:
    """Return the cores this process may use, each as the logical processors that make it up."""
    groups: dict[str, list[int]] = defaultdict(list)
    for cpu in sorted(os.sched_getaffinity(0)):
        siblings = Path(f"/sys/devices/system/cpu/cpu{cpu}/topology/thread_siblings_list")
        try:
            key = siblings.read_text().strip()
        except OSError:
            key = str(cpu)
        groups[key].append(cpu)
    return [tuple(cpus) for cpus in groups.values()]


class CorePool:
    """Lends whole cores to runs.

    Args:
        cores: logical processors by core; default: those this process may use.
    """

    def __init__(self, cores: list[tuple[int, ...]] | None = None) -> None:
        self._free = list(cores if cores is not None else whole_cores())
        self.size = len(self._free)
        self._changed = threading.Condition()

    def take(self, count: int) -> list[tuple[int, ...]]:
        """Wait for cores and take them; a wish beyond the machine gets all of it."""
        count = min(count, self.size)
        with self._changed:
            self._changed.wait_for(lambda: len(self._free) >= count)
            taken, self._free = self._free[:count], self._free[count:]
        return taken

    def give_back(self, cores: list[tuple[int, ...]]) -> None:
        """Return cores taken before."""
        with self._changed:
            self._free.extend(cores)
            self._changed.notify_all()
