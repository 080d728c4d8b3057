# SPDX-License-Identifier: Apache-2.0
"""What a sidecar must not forget when it is killed and started again, on disk about every second."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Self

from slamhive.monitor.orphans import write_atomically
from slamhive.monitor.outcome import Stop
from slamhive.monitor.processes import ProcessIdentity, boot_id, pid_namespace, read_file
from slamhive.monitor.summary import Reason


@dataclass(slots=True, kw_only=True)
class SidecarState:
    """What is known of the algorithm.

    Attributes:
        boot: The boot of the machine in which its process and the monotonic clock mean something.
        namespace: The pid namespace of the pod.
        first: The container's first process, None while it wasn't seen.
        start: When it was seen first, monotonic clock, s.
        started_at: The same on the wall clock, seconds since 1970.
        last: The last sample, monotonic clock, s.
        source: Name of the samples' source.
        accounting: The account so far.
        contended: Processor time it waited for while others used its processors, s.
        kernel_peak: The kernel's own peak of memory, bytes.
        oom_kills: Processes killed for want of memory.
        throttled: Time in which its CPU limit held it back, s.
        table_bytes: What of usage.csv belongs to this account.
        stop: The decision to end it: reason and sentence.
        ended: It has ended, and all this is final.
        left: Processes that outlived the first one.
        notes: What was wrong but ended nothing.
    """

    boot: str = field(default_factory=boot_id)
    namespace: int = field(default_factory=pid_namespace)
    first: ProcessIdentity | None = None
    start: float = 0.0
    started_at: float = 0.0
    last: float = 0.0
    source: str = ""
    accounting: dict[str, Any] = field(default_factory=dict)
    contended: float = 0.0
    kernel_peak: int | None = None
    oom_kills: int = 0
    throttled: float | None = None
    table_bytes: int = 0
    stop: Stop | None = None
    ended: bool = False
    left: int = 0
    notes: list[str] = field(default_factory=list)

    @property
    def here(self) -> bool:
        """Its process and its clock are those of this boot and this pod."""
        return self.boot == boot_id() and self.namespace == pid_namespace()

    def note(self, text: str) -> None:
        """Take down something once."""
        if text not in self.notes:
            self.notes.append(text)

    def save(self, path: str) -> None:
        """Write the state, never half of it.

        Raises:
            OSError: The disk refuses.
        """
        write_atomically(path, json.dumps(asdict(self)), durable=False)

    @classmethod
    def load(cls, path: str) -> Self | None:
        """Read a state, None if there is none that can be read."""
        with suppress(OSError, ValueError, TypeError, KeyError):
            values = json.loads(read_file(path))
            if values["first"] is not None:
                values["first"] = ProcessIdentity(*map(int, values["first"]))
            if values["stop"] is not None:
                reason, message, at_once = values["stop"]
                values["stop"] = Stop(Reason(reason), str(message), bool(at_once))
            return cls(**{item.name: values[item.name] for item in fields(cls)})
        return None
