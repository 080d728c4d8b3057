# SPDX-License-Identifier: Apache-2.0
"""Sources of CPU and memory figures: the kernel's accounts of a cgroup, version 1 or 2.

Both supervisor and sidecar read a `UsageSource` ten times a second. Files stay open between readings: half
the cost of a reading is the open, and the file of a cgroup that is gone then fails and isn't another's.
"""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, NamedTuple, Protocol

from slamhive.monitor.measuring.processes import read_file
from slamhive.monitor.measuring.resident import ResidentMemory

if TYPE_CHECKING:
    from collections.abc import Sequence


class Sample(NamedTuple):
    """One reading of a process tree.

    Attributes:
        time: Monotonic clock, s.
        cpu: CPU seconds used since the tree began.
        working_set: What is used less the page cache that could go at once, bytes.
        anonymous: Memory without a file behind it, bytes.
        resident: Resident memory of all processes, the most since the sample before, bytes.
    """

    time: float
    cpu: float
    working_set: int
    anonymous: int
    resident: int


class UsageSource(Protocol):
    """Something that knows the CPU and memory of one process tree."""

    @property
    def name(self) -> str:
        """`cgroup-v1`, `cgroup-v2` or `proc`."""

    def read(self) -> Sample:
        """Read the present figures.

        Raises:
            OSError: The tree's account is gone.
        """

    def processes(self) -> Sequence[int]:
        """Return the ids of the tree's processes."""

    def kernel_peak(self) -> int | None:
        """Return the kernel's own peak of memory with page cache, bytes, where it keeps one."""

    def pressure(self) -> float | None:
        """Return the seconds in which some thread waited for a processor, where the kernel counts them."""

    def close(self) -> None:
        """Let go of open files."""


class CgroupV1Source:
    """The account of a cgroup of version 1: controllers cpuacct and memory, each in its own tree."""

    name = "cgroup-v1"

    def __init__(self, cpuacct: str, memory: str) -> None:
        """Open the account.

        Args:
            cpuacct: The cgroup's directory in the tree of the cpuacct controller.
            memory: The same for memory.

        Raises:
            OSError: One of the two has no account.
        """
        self._memory_directory = memory
        self._procs = f"{cpuacct}/cgroup.procs"
        self._files = _Files()
        self._resident = ResidentMemory()
        try:
            self._cpu = self._files.open(f"{cpuacct}/cpuacct.usage")
            self._usage = self._files.open(f"{memory}/memory.usage_in_bytes")
            self._stat = self._files.open(f"{memory}/memory.stat")
        except OSError:
            self._files.close()
            raise

    def read(self) -> Sample:
        """Read the present figures; the working set as the kubelet counts it, usage − total_inactive_file."""
        cpu = int(os.pread(self._cpu, 64, 0)) / 1e9
        stat = os.pread(self._stat, 8192, 0)
        usage = int(os.pread(self._usage, 64, 0))
        return Sample(
            time.monotonic(),
            cpu,
            max(usage - field(stat, b"total_inactive_file"), 0),
            field(stat, b"total_rss"),
            self._resident.read(self.processes()),
        )

    def processes(self) -> list[int]:
        """Return the ids of the tree's processes.

        The file is opened for it: to who reads it again within a second, an open one repeats what it said.
        """
        return [int(pid) for pid in read_file(self._procs).split()]

    def kernel_peak(self) -> int | None:
        """Return memory.max_usage_in_bytes."""
        return read_number(f"{self._memory_directory}/memory.max_usage_in_bytes")

    def pressure(self) -> float | None:
        """Version 1 has no pressure."""
        return None

    def close(self) -> None:
        """Let go of open files."""
        self._files.close()
        self._resident.close()


class CgroupV2Source:
    """The account of a cgroup of version 2 with the memory controller."""

    name = "cgroup-v2"

    def __init__(self, directory: str) -> None:
        """Open the account.

        Raises:
            OSError: The cgroup has no account of CPU or memory.
        """
        self._directory = directory
        self._files = _Files()
        self._resident = ResidentMemory()
        try:
            self._cpu = self._files.open(f"{directory}/cpu.stat")
            self._current = self._files.open(f"{directory}/memory.current")
            self._stat = self._files.open(f"{directory}/memory.stat")
            self._procs = self._files.open(f"{directory}/cgroup.procs")
        except OSError:
            self._files.close()
            raise

    def read(self) -> Sample:
        """Read the present figures; the working set as the kubelet counts it, current − inactive_file."""
        cpu = field(os.pread(self._cpu, 2048, 0), b"usage_usec") / 1e6
        stat = os.pread(self._stat, 8192, 0)
        current = int(os.pread(self._current, 64, 0))
        working_set = max(current - field(stat, b"inactive_file"), 0)
        resident = self._resident.read(self.processes())
        return Sample(time.monotonic(), cpu, working_set, field(stat, b"anon"), resident)

    def processes(self) -> list[int]:
        """Return the ids of the tree's processes."""
        return read_pids(self._procs)

    def kernel_peak(self) -> int | None:
        """Return memory.peak (Linux 5.19 and later)."""
        return read_number(f"{self._directory}/memory.peak")

    def pressure(self) -> float | None:
        """Return the total of `some` in cpu.pressure, s."""
        try:
            with open(f"{self._directory}/cpu.pressure", "rb") as file:  # noqa: PTH123 - pathlib costs 8 ms
                first = file.readline()
            return int(first.rpartition(b"total=")[2]) / 1e6
        except (OSError, ValueError):  # pressure may be switched off in the kernel
            return None

    def close(self) -> None:
        """Let go of open files."""
        self._files.close()
        self._resident.close()


def cgroup_source_at(root: str) -> UsageSource | None:
    """Open the account of the cgroup whose file system is seen at `root`, as inside a container.

    Args:
        root: For instance `/proc/<pid>/root/sys/fs/cgroup` of a process in the container.

    Returns:
        The source, or None where neither version has controllers for CPU and memory.
    """
    # Distributions mount both controllers in one place, and differ in how they call it.
    for name in ("cpuacct", "cpu,cpuacct", "cpuacct,cpu"):
        try:
            return CgroupV1Source(f"{root}/{name}", f"{root}/memory")
        except OSError:
            continue
    try:
        return CgroupV2Source(root)
    except OSError:
        return None


def field(data: bytes, key: bytes) -> int:
    """Return the number behind `key` in lines of `key number`, 0 if there is none."""
    _, found, rest = (b"\n" + data).partition(b"\n" + key + b" ")
    return int(rest[: rest.find(b"\n")] if b"\n" in rest else rest) if found else 0


def read_number(path: str) -> int | None:
    """Return the number a file holds, None if it can't be read or says `max`."""
    try:
        with open(path, "rb") as file:  # noqa: PTH123
            return int(file.read())
    except (OSError, ValueError):
        return None


def read_pids(descriptor: int) -> list[int]:
    """Return the process ids listed in an open cgroup.procs."""
    data = b""
    while chunk := os.pread(descriptor, 65536, len(data)):
        data += chunk
    return [int(pid) for pid in data.split()]


class _Files:
    """Descriptors that are closed together."""

    def __init__(self) -> None:
        self._descriptors: list[int] = []

    def open(self, path: str) -> int:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        self._descriptors.append(descriptor)
        return descriptor

    def close(self) -> None:
        while self._descriptors:
            os.close(self._descriptors.pop())
