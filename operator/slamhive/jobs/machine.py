# SPDX-License-Identifier: Apache-2.0
"""Processors and memory that this container may use, by its affinity and its cgroup.

The evaluator's Job sizes its batch by it.
"""

from __future__ import annotations

import os

from slamhive.monitor.measuring.hierarchy import cpu_quota, own_hierarchies
from slamhive.monitor.measuring.sources import read_number

_UNLIMITED = 1 << 60
"""cgroup version 1 writes no limit as a number near 2^63."""


def usable_cores() -> int:
    """Return the number of processors that may be kept busy: at least one, whole ones of a quota."""
    cores, quota = len(os.sched_getaffinity(0)), cpu_quota()
    return max(1, cores if quota is None else min(cores, int(quota)))


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
