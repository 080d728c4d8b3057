# SPDX-License-Identifier: Apache-2.0
"""Meter of one request's cost: CPU seconds and MiB of this process and of the workers that it started."""

from __future__ import annotations

import resource
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slamhive.dashboard.answering.workers import AnswerCost

CPU_SECONDS = 62.0
"""A stream's 60, and what leads to it; answers end at 10 by themselves."""

MIB = 128.0
"""A worker's 64 beyond the table, a stream's 96, and the answer here."""


class Meter:
    """Measures requests one after the other.

    Args:
        workers: of the application.
        cpu_seconds: that a request may take.
        mib: that it may add to what there is.
    """

    def __init__(self, workers: Any, cpu_seconds: float = CPU_SECONDS, mib: float = MIB) -> None:
        self._most = cpu_seconds, mib
        self._costs: list[AnswerCost] = []
        self._began = 0.0
        self._resident = 0.0
        self._peak = 0.0
        self.largest = [0.0, 0.0]
        if workers is not None:
            workers.told = self._costs.append

    def begin(self) -> None:
        """Begin to measure."""
        self._costs.clear()
        self._peak = 0.0
        try:
            Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak begins anew
        except OSError:  # a process that is closed to inspection is so to itself, unless it is root's
            self._peak = _status("VmHWM")
        self._began = _cpu_seconds()
        self._resident = _status("VmRSS")

    def end(self) -> str:
        """Return the excess since it began; empty where there was none."""
        cpu = _cpu_seconds() - self._began
        peak = _status("VmHWM")
        mine = peak if peak > self._peak else _status("VmRSS")
        peaks = [mine, *(cost.memory / 2**20 for cost in self._costs)]
        return self.judge(cpu, max(peaks) - self._resident)

    def judge(self, cpu_seconds: float, mib: float) -> str:
        """Return the excess of some figures; empty where there is none."""
        self.largest = [max(self.largest[0], cpu_seconds), max(self.largest[1], mib)]
        if cpu_seconds > self._most[0]:
            return f"took {cpu_seconds:.1f} s of CPU time, and may take {self._most[0]:g}"
        if mib > self._most[1]:
            return f"took {mib:.0f} MiB more, and may take {self._most[1]:g}"
        return ""


def _cpu_seconds() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def _status(name: str) -> float:
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) / 1024
    return 0.0
