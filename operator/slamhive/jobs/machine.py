# SPDX-License-Identifier: Apache-2.0
"""What this container may use of the machine: processors and memory, by its affinity and its cgroup."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from slamhive.monitor.hierarchy import own_hierarchies
from slamhive.monitor.sources import read_number

_UNLIMITED = 1 << 60
"""cgroup version 1 writes no limit as a number near 2^63."""


def usable_cores() -> int:
    """Return how many processors may be kept busy: at least one, whole ones of a quota."""
    cores = len(os.sched_getaffinity(0))
    for directory in _directories():
        quota = _quota(directory)
        if quota is not None:
            cores = min(cores, int(quota))
    return max(1, cores)


def free_memory() -> int | None:
    """Return the bytes that may still be taken below the limit of the cgroup, None without a limit."""
    free = [
        limit - (read_number(f"{directory}/{used}") or 0)
        for directory in _directories()
        for name, used in (
            ("memory.max", "memory.current"),
            ("memory.limit_in_bytes", "memory.usage_in_bytes"),
        )
        if (limit := read_number(f"{directory}/{name}")) is not None and limit < _UNLIMITED
    ]
    return max(0, min(free)) if free else None


def _directories() -> list[str]:
    try:
        return [tree.directory for tree in own_hierarchies()]
    except (OSError, ValueError):
        return []


def _quota(directory: str) -> float | None:
    with suppress(OSError, ValueError):
        quota, period = Path(directory, "cpu.max").read_text(encoding="ascii").split()
        return None if quota == "max" else float(quota) / float(period)
    quota_us, period_us = (read_number(f"{directory}/cpu.cfs_{name}_us") for name in ("quota", "period"))
    if quota_us is None or period_us is None or quota_us <= 0 or period_us <= 0:
        return None
    return quota_us / period_us
