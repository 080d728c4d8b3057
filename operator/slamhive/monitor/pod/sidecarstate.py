# SPDX-License-Identifier: Apache-2.0
"""State of a sidecar, in its memory alone, which the algorithm can't reach."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slamhive.monitor.measuring.accounting import Accounting
    from slamhive.monitor.measuring.processes import ProcessIdentity
    from slamhive.monitor.outcome import StopDecision


@dataclass(slots=True, kw_only=True)
class SidecarState:
    """State of the algorithm as its sidecar has seen it: processes, figures measured, and end.

    Attributes:
        first: The container's first process, None while it wasn't seen.
        start: When it was seen first, monotonic clock, s.
        started_at: The same on the wall clock, seconds since 1970.
        last: The last sample, monotonic clock, s.
        source: Name of the samples' source.
        accounting: The account so far, None while there is none.
        contended: Processor time it waited for while others used its processors, s.
        kernel_peak: The kernel's own peak of memory, bytes.
        oom_kills: Processes killed for want of memory.
        throttled: Time in which its CPU limit held it back, s.
        cpuset: Processors that its cgroup lets it use, None where that isn't known.
        exclusive: Nothing else of the kubelet's may use them, None where that isn't known.
        reader: CPU seconds of threads that call themselves the reader, None where none does.
        suspicions: What speaks against the figures.
        stop: The decision to end it: reason and sentence.
        ended: It has ended, and all this is final.
        left: Processes that outlived the first one.
        notes: What was wrong but ended nothing.
    """

    first: ProcessIdentity | None = None
    start: float = 0.0
    started_at: float = 0.0
    last: float = 0.0
    source: str = ""
    accounting: Accounting | None = None
    contended: float = 0.0
    kernel_peak: int | None = None
    oom_kills: int = 0
    throttled: float | None = None
    cpuset: set[int] | None = None
    exclusive: bool | None = None
    reader: float | None = None
    suspicions: list[str] = field(default_factory=list)
    stop: StopDecision | None = None
    ended: bool = False
    left: int = 0
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        """Take down something once."""
        if text not in self.notes:
            self.notes.append(text)
