# SPDX-License-Identifier: Apache-2.0
"""The processors of this machine: whole cores for runs, so that parallel runs share none."""

from __future__ import annotations

import os
import platform
import threading
from collections import defaultdict
from functools import cache
from pathlib import Path

from slamhive.monitor.hierarchy import own_hierarchies


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


def quota() -> float | None:
    """Return how many processors' time cgroups allow us, as containers limit it; None for no limit."""
    limits = []
    for tree in own_hierarchies():
        directory = tree.directory
        while directory.startswith(tree.mount):
            limit = _quota_v2(directory) if tree.version == 2 else _quota_v1(directory)
            if limit is not None:
                limits.append(limit)
            directory = directory.rpartition("/")[0]
    return min(limits, default=None)


def _quota_v2(directory: str) -> float | None:
    try:
        most, period = Path(directory, "cpu.max").read_text().split()
    except (OSError, ValueError):
        return None
    return None if most == "max" else int(most) / int(period)


def _quota_v1(directory: str) -> float | None:
    try:
        most, period = (
            int(Path(directory, f"cpu.cfs_{word}_us").read_text()) for word in ("quota", "period")
        )
    except (OSError, ValueError):
        return None
    return most / period if most > 0 else None


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
        self._free = list(cores if cores is not None else within(whole_cores(), quota()))
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


@cache
def cpu_model() -> str:
    """Return the processor's name as the kernel gives it; on ARM the numbers of its maker and part."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        text = ""
    facts = dict(line.split(":", 1) for line in reversed(text.splitlines()) if ":" in line)
    facts = {key.strip(): value.strip() for key, value in facts.items()}
    if "model name" in facts:
        return facts["model name"]
    parts = [facts[key] for key in ("CPU implementer", "CPU variant", "CPU part") if key in facts]
    if parts:
        return f"{platform.machine()} {' '.join(parts)}"
    return platform.processor() or platform.machine()
