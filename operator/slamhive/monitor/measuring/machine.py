# SPDX-License-Identifier: Apache-2.0
"""The machine we are on."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from functools import cache

from slamhive.monitor.measuring.processes import read_file, stat_fields

_TICK = os.sysconf("SC_CLK_TCK")


@cache
def cpu_model() -> str:
    """Return the processor's name as the kernel gives it; on ARM the numbers of its maker and part."""
    facts: dict[str, str] = {}
    with suppress(OSError):
        first = read_file("/proc/cpuinfo").partition(b"\n\n")[0].decode("utf-8", "replace")
        for line in first.splitlines():
            key, _, value = line.partition(":")
            facts.setdefault(key.strip(), value.strip())
    if "model name" in facts:
        return facts["model name"]
    parts = [facts[key] for key in ("CPU implementer", "CPU variant", "CPU part") if key in facts]
    return " ".join([os.uname().machine, *parts])


def process_start(pid: int) -> float:
    """Return the time a process was made, on the monotonic clock, s; the kernel tells it to a tick.

    Raises:
        OSError: The process is gone.
    """
    since_boot = int(stat_fields(read_file(f"/proc/{pid}/stat"))[19]) / _TICK
    return time.monotonic() - max(time.clock_gettime(time.CLOCK_BOOTTIME) - since_boot, 0.0)
