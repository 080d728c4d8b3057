# SPDX-License-Identifier: Apache-2.0
"""Processes by pid and start time, their descendants, and their end.

A pid alone names nobody: the kernel gives it again. Pid and start time together (field 22 of
/proc/<pid>/stat, in ticks since boot) are unique while the machine runs.
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import time
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

_PR_SET_PDEATHSIG = 1
_PR_SET_DUMPABLE = 4
_PR_SET_CHILD_SUBREAPER = 36
_LIBC = ctypes.CDLL(None, use_errno=True)


class ProcessIdentity(NamedTuple):
    """One process for good: its pid and its start, in clock ticks since boot."""

    pid: int
    start: int


def set_parent_death_signal(number: int) -> None:
    """Have the kernel send us this signal when the thread that started us ends."""
    _prctl(_PR_SET_PDEATHSIG, number)


def become_subreaper() -> None:
    """Become the parent of every descendant whose own parent ends."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def forbid_inspection() -> None:
    """Close our memory, files and root directory to other processes of our user.

    The algorithm has the same user, and could else rewrite through /proc what is said of it. Ending us is not
    kept from it. A program that we start is open again; until then a child of ours is closed too.
    """
    _prctl(_PR_SET_DUMPABLE, 0)


def allow_inspection() -> None:
    """Undo that: also our own writing to /proc/self."""
    _prctl(_PR_SET_DUMPABLE, 1)


def limit_data(more: int) -> None:
    """Refuse memory to this process beyond so many bytes more than it has, most of which a fork shares.

    Of data and not of addresses: a library's code costs nothing that is not there already.
    """
    with open("/proc/self/status", encoding="ascii", errors="replace") as status:  # noqa: PTH123 - pathlib takes long to import
        has = next((int(line.split()[1]) << 10 for line in status if line.startswith("VmData:")), 0)
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = has + more if hard < 0 else min(has + more, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most if hard < 0 else hard))


def _prctl(option: int, value: int) -> None:
    if _LIBC.prctl(option, ctypes.c_ulong(value), 0, 0, 0) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"prctl: {os.strerror(number)}")


def read_file(path: str) -> bytes:
    """Return the bytes of a file of /proc.

    Raises:
        OSError: The process is gone or not ours to see.
    """
    with open(path, "rb", buffering=0) as file:  # noqa: PTH123 - pathlib costs 8 ms of start-up
        return file.readall()


def stat_fields(data: bytes) -> list[bytes]:
    """Split /proc/<pid>/stat behind the program's name, so that [0] is field 3 of proc(5), the state."""
    return data[data.rindex(b")") + 2 :].split()


def identify(pid: int) -> ProcessIdentity | None:
    """Return the living process with this pid, None if there is none or only its remains (a zombie)."""
    try:
        fields = stat_fields(read_file(f"/proc/{pid}/stat"))
    except (OSError, ValueError):
        return None
    return None if fields[0] in (b"Z", b"X") else ProcessIdentity(pid, int(fields[19]))


def is_alive(process: ProcessIdentity) -> bool:
    """Tell whether this very process still lives."""
    return identify(process.pid) == process


def boot_id() -> str:
    """Return the identity of this boot of the machine among all others."""
    return read_file("/proc/sys/kernel/random/boot_id").decode().strip()


def pid_namespace() -> int:
    """Return the number of our pid namespace: pids of another one mean nothing here."""
    return os.stat("/proc/self/ns/pid").st_ino  # noqa: PTH116


def kernel_lists_children() -> bool:
    """Tell whether /proc lists a process's children; it doesn't in every kernel (CONFIG_PROC_CHILDREN)."""
    return os.path.exists(f"/proc/self/task/{os.getpid()}/children")  # noqa: PTH110


def children(pid: int) -> list[int]:
    """Return the children of all threads of a process, none if it is gone."""
    found: list[int] = []
    if not kernel_lists_children():
        # Such a kernel tells parents alone: all processes are asked for theirs.
        parents = ((int(name), _parent(name)) for name in os.listdir("/proc") if name.isdigit())  # noqa: PTH208
        return [child for child, parent in parents if parent == pid]
    with suppress(OSError):
        for task in os.listdir(f"/proc/{pid}/task"):  # noqa: PTH208
            with suppress(OSError):
                found.extend(map(int, read_file(f"/proc/{pid}/task/{task}/children").split()))
    return found


def _parent(pid: str) -> int | None:
    try:
        return int(stat_fields(read_file(f"/proc/{pid}/stat"))[1])
    except (OSError, ValueError):
        return None


def descendants(pids: Iterable[int]) -> list[int]:
    """Return all descendants of some processes, parents before their children."""
    found: dict[int, None] = {}
    waiting = list(pids)
    for pid in waiting:
        for child in children(pid):
            if child not in found:
                found[child] = None
                waiting.append(child)
    return list(found)


def send(process: ProcessIdentity, number: int) -> bool:
    """Send a signal to this very process, never to another that has its pid by now."""
    try:
        descriptor = os.pidfd_open(process.pid)
    except OSError:
        return False
    try:
        # Checked after the pidfd was opened: alive now means alive then, so the descriptor is of this very
        # process.
        if not is_alive(process):
            return False
        signal.pidfd_send_signal(descriptor, number)
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return True


def end_processes(find: Callable[[], Iterable[ProcessIdentity]], seconds: float) -> list[ProcessIdentity]:
    """End processes for good, also when they fork faster than they can be counted.

    Each round stops everything it finds until nothing new turns up, then kills: what is stopped can't fork.

    Args:
        find: Returns the living processes to end.
        seconds: How long to try.

    Returns:
        The processes that could not be ended (in an uninterruptible sleep, or another user's).
    """
    deadline = time.monotonic() + seconds
    while True:
        stopped: set[ProcessIdentity] = set()
        while new := set(find()) - stopped:
            for process in new:
                send(process, signal.SIGSTOP)
            stopped |= new
            if time.monotonic() > deadline:
                break
        for process in stopped:
            send(process, signal.SIGKILL)
        if not stopped or time.monotonic() > deadline:
            return sorted(stopped)
        time.sleep(0.002)
