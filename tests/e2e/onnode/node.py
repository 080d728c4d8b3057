# SPDX-License-Identifier: Apache-2.0
"""The node's own view of a container: its control group's account, its first process."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.monitor.measuring.sources import CgroupV1Source, CgroupV2Source

if TYPE_CHECKING:
    from slamhive.monitor.measuring.sources import UsageSource

ROOT = Path("/sys/fs/cgroup")


@dataclass
class Account:
    """CPU time and memory of a container by the kernel's account, until its control group was gone.

    Attributes:
        cpu_seconds: CPU time.
        working_set: the largest working set seen, bytes.
        kernel_peak: the kernel's own peak, bytes.
    """

    cpu_seconds: float = 0.0
    working_set: int = 0
    kernel_peak: int = 0


class Watch:
    """Reads a container's account every 5 ms until it is gone.

    Args:
        container: its id, without the runtime's name.
    """

    def __init__(self, container: str) -> None:
        self._source = _source(container)
        self._account = Account()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def end(self, seconds: float) -> Account:
        """Wait for the container's end and return its account."""
        self._thread.join(seconds)
        assert not self._thread.is_alive(), "the container goes on"
        return self._account

    def _read(self) -> None:
        pause, account = threading.Event(), self._account
        while True:
            try:
                sample = self._source.read()
            except OSError:
                return
            account.cpu_seconds = sample.cpu
            account.working_set = max(account.working_set, sample.working_set)
            account.kernel_peak = self._source.kernel_peak() or account.kernel_peak
            pause.wait(0.005)


def _source(container: str) -> UsageSource:
    found = {path for path in ROOT.rglob(f"*{container}*") if path.is_dir()}
    cpu = next((path for path in found if path.relative_to(ROOT).parts[0].startswith("cpu")), None)
    if cpu is None:
        return CgroupV2Source(str(found.pop()))
    memory = next(path for path in found if path.relative_to(ROOT).parts[0] == "memory")
    accounts = [path for path in found if (path / "cpuacct.usage").exists()]
    return CgroupV1Source(str(accounts[0]), str(memory))


def processes(pod_uid: str, words: str) -> list[int]:
    """Return the ids of a pod's processes whose command line holds some words."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            ours = pod_uid in (path / "cgroup").read_text()
            if ours and words in (path / "cmdline").read_bytes().replace(b"\0", b" ").decode():
                found.append(int(path.name))
        except OSError:
            continue
    return found
