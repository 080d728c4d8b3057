# SPDX-License-Identifier: Apache-2.0
"""The processors of this machine: whole cores for runs, so that parallel runs share none."""

from __future__ import annotations

import os
import platform
import threading
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.local.home.leases import LeaseKind
from slamhive.monitor.measuring.hierarchy import cpu_quota

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.home.leases import Lease, Leases

_LOOK_SECONDS = 0.1
"""Time between two looks of a runner whether another one has given back a core."""


def whole_cores() -> list[tuple[int, ...]]:
    """Return the cores this process may use, each as the logical processors that make it up."""
    groups: dict[str, list[int]] = defaultdict(list)
    for cpu in sorted(os.sched_getaffinity(0)):
        # Hyper-threads of a core share its execution units: two runs on one core would slow each other down.
        groups[_siblings(cpu)].append(cpu)
    return [tuple(cpus) for cpus in groups.values()]


def _siblings(cpu: int) -> str:
    """Return the logical processors of a processor's core, as the kernel writes them."""
    try:
        return Path(f"/sys/devices/system/cpu/cpu{cpu}/topology/thread_siblings_list").read_text().strip()
    except OSError:
        return str(cpu)


def within(cores: list[tuple[int, ...]], limit: float | None) -> list[tuple[int, ...]]:
    """Return as many cores as can be kept busy under a quota, one at least: more would be held back."""
    chosen = cores[:1]
    for core in cores[1:]:
        if limit is not None and sum(map(len, [*chosen, core])) > limit:
            break
        chosen.append(core)
    return chosen


def cores_here() -> int:
    """Return the number of cores that runs of this process may have: as many as a quota allows."""
    return len(within(whole_cores(), cpu_quota()))


class CorePool:
    """Lends whole cores to runs, each to one at a time, those of other runners in the home included.

    Who wants cores takes a ticket, one a runner at a time, so that runners take turns; the lowest ticket has
    what comes free until it has enough.

    Args:
        leases: of the home.
        cores: logical processors by core; default: those this process may use, as many as a quota allows.
    """

    def __init__(self, leases: Leases, cores: list[tuple[int, ...]] | None = None) -> None:
        self._leases = leases
        self._cores = {
            _name(core): core for core in (cores if cores is not None else within(whole_cores(), cpu_quota()))
        }
        self.size = len(self._cores)
        self._mine: dict[tuple[int, ...], Lease] = {}
        self._gathered: list[Lease] = []
        self._turn = threading.Lock()
        self._changed = threading.Condition()

    def take(self, count: int, stopped: Callable[[], bool] = lambda: False) -> list[tuple[int, ...]] | None:
        """Wait for cores and take them; a wish beyond the machine gets all of it.

        Args:
            count: how many.
            stopped: tells whether they are not wanted any more.

        Returns:
            The cores; None where they are not wanted any more.

        Raises:
            InputError: the home can't be written.
        """
        # A sweep that asks for more than this machine has still runs here, one run at a time.
        count = min(count, self.size)
        while not self._turn.acquire(timeout=_LOOK_SECONDS):
            if stopped():
                return None
        try:
            ticket = self._leases.queue()
            try:
                taken = self._wait(count, ticket, stopped)
            finally:
                self._leases.give_back([ticket])
        finally:
            self._turn.release()
        if taken is None:
            return None
        cores = dict(sorted((self._core(lease), lease) for lease in taken))
        with self._changed:
            self._mine |= cores
        return list(cores)

    def give_back(self, cores: list[tuple[int, ...]]) -> None:
        """Return cores taken before."""
        with self._changed:
            leases = [self._mine.pop(core) for core in cores]
        self._leases.give_back(leases)
        with self._changed:
            self._changed.notify_all()

    def descriptors(self, cores: list[tuple[int, ...]]) -> tuple[int, ...]:
        """Return the open files by which cores are held: a supervisor given them holds them too."""
        with self._changed:
            return tuple(self._mine[core].descriptor for core in cores)

    def elsewhere(self) -> int:
        """Return the number of our cores that other runners have, while any is waited for."""
        held = self._leases.held(LeaseKind.CORES, self._cores)
        with self._changed:
            mine = {lease.name for lease in (*self._mine.values(), *self._gathered)}
        return len(held - mine) if self._turn.locked() else 0

    def _core(self, lease: Lease) -> tuple[int, ...]:
        return self._cores[lease.name]

    def _wait(self, count: int, ticket: Lease, stopped: Callable[[], bool]) -> list[Lease] | None:
        taken = self._gathered = []
        try:
            while not stopped():
                taken += self._leases.take_some(LeaseKind.CORES, self._cores, count - len(taken), ticket)
                if len(taken) >= count:
                    found, self._gathered = taken, []
                    return found
                with self._changed:
                    self._changed.wait(_LOOK_SECONDS)
            return None
        finally:
            self._leases.give_back(self._gathered)
            self._gathered = []


def _name(core: tuple[int, ...]) -> str:
    """Return the name of a core on all machines that may share a home, whichever part of it is ours."""
    return f"{_machine()}-{_siblings(core[0]).split(',')[0].split('-')[0]}"


@cache
def _machine() -> str:
    """Return the identity of this machine among others, the same in all of its containers."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return platform.node()
