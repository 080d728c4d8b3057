# SPDX-License-Identifier: Apache-2.0
"""The processors of this machine: whole cores for runs, so that parallel runs share none."""

from __future__ import annotations

import os
import threading
from collections import defaultdict
from pathlib import Path

from slamhive.monitor.hierarchy import cpu_quota


def whole_cores() -> list[tuple[int, ...]]:
    """Return the cores this process may use, each as the logical processors that make it up."""
    groups: dict[str, list[int]] = defaultdict(list)
    for cpu in sorted(os.sched_getaffinity(0)):
        siblings = Path(f"/sys/devices/system/cpu/cpu{cpu}/topology/thread_siblings_list")
        try:
            # Hyper-threads of one core share its execution units: two runs on one core would slow each other
            # down.
            key = siblings.read_text().strip()
        except OSError:
            key = str(cpu)
        groups[key].append(cpu)
    return [tuple(cpus) for cpus in groups.values()]


def within(cores: list[tuple[int, ...]], limit: float | None) -> list[tuple[int, ...]]:
    """Return as many cores as can be kept busy under a quota, one at least: more would be held back."""
    chosen = cores[:1]
    for core in cores[1:]:
        if limit is not None and sum(map(len, [*chosen, core])) > limit:
            break
        chosen.append(core)
    return chosen


class CorePool:
    """Lends whole cores to runs.

    Args:
        cores: logical processors by core; default: those this process may use, as many as a quota allows.
    """

    def __init__(self, cores: list[tuple[int, ...]] | None = None) -> None:
        self._free = list(cores if cores is not None else within(whole_cores(), cpu_quota()))
        self.size = len(self._free)
        self._changed = threading.Condition()

    def take(self, count: int) -> list[tuple[int, ...]]:
        """Wait for cores and take them; a wish beyond the machine gets all of it."""
        # A sweep that asks for more than this machine has still runs here, one run at a time.
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
