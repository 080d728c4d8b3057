# SPDX-License-Identifier: Apache-2.0
"""The machine we are on: its processor, its clock, and the processors that a run has of it.

All is of files of the kernel's that an algorithm can't write. What they don't tell is left out.
"""

from __future__ import annotations

import os
import time
from contextlib import suppress
from functools import cache
from typing import TypedDict

from slamhive.monitor.measuring.processes import read_file, stat_fields

SYSTEM = "/sys/devices/system/cpu"
"""Folder in which the kernel tells of processors."""

_TICK = os.sysconf("SC_CLK_TCK")
_MOST_PROCESSORS = 1 << 16


class MachineReport(TypedDict, total=False):
    """Facts on a machine as summary.json has them; those that can't be read are absent."""

    cores: int
    smt: bool
    governor: str
    turbo: bool
    exclusiveCores: bool


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


def machine_report(*, exclusive: bool | None, folder: str = SYSTEM) -> MachineReport:
    """Return the facts that the kernel tells of this machine now.

    Args:
        exclusive: whether no other program may use the run's processors; None: not known.
        folder: where the kernel tells of processors.
    """
    found: MachineReport = {}
    if siblings := _words_of_each(folder, "topology/thread_siblings_list"):
        found["cores"] = len(siblings)
    if (threads := _word(f"{folder}/smt/active")) in {"0", "1"}:
        found["smt"] = threads == "1"
    if words := governors(folder):
        found["governor"] = ", ".join(words)
    if (clocked_up := turbo(folder)) is not None:
        found["turbo"] = clocked_up
    if exclusive is not None:
        found["exclusiveCores"] = exclusive
    return found


def governors(folder: str = SYSTEM) -> list[str]:
    """Return the words by which processors' clocks are governed, sorted; none where the kernel hides them."""
    return sorted(_words_of_each(folder, "cpufreq/scaling_governor"))


def turbo(folder: str = SYSTEM) -> bool | None:
    """Tell whether processors may be clocked beyond their base; None where the kernel hides it."""
    if (off := _word(f"{folder}/intel_pstate/no_turbo")) in {"0", "1"}:
        return off == "0"
    boost = _word(f"{folder}/cpufreq/boost")
    return boost == "1" if boost in {"0", "1"} else None


def processors_of(text: str) -> set[int] | None:
    """Return the processors of a list as the kernel writes it, such as 0-3,8; None where it is none."""
    found: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        end = last if dash else first
        if not (first.isdecimal() and end.isdecimal() and int(end) < _MOST_PROCESSORS):
            return None
        found.update(range(int(first), int(end) + 1))
    return found or None


def processors_text(numbers: object) -> str | None:
    """Return the processors that a supervisor was told, in words; None where that isn't known."""
    if not isinstance(numbers, list) or not all(type(number) is int for number in numbers):
        return None
    return ",".join(map(str, sorted(numbers))) or None


def process_start(pid: int) -> float:
    """Return the time a process was made, on the monotonic clock, s; the kernel tells it to a tick.

    Raises:
        OSError: The process is gone.
    """
    since_boot = int(stat_fields(read_file(f"/proc/{pid}/stat"))[19]) / _TICK
    return time.monotonic() - max(time.clock_gettime(time.CLOCK_BOOTTIME) - since_boot, 0.0)


def _words_of_each(folder: str, file: str) -> set[str]:
    """Return the words in a file of each processor that has one."""
    try:
        names = os.listdir(folder)  # noqa: PTH208
    except OSError:
        return set()
    numbered = (name for name in names if name.startswith("cpu") and name[3:].isdecimal())
    return {_word(f"{folder}/{name}/{file}") for name in numbered} - {""}


def _word(path: str) -> str:
    try:
        return read_file(path).decode("ascii", "replace").strip()
    except OSError:
        return ""
