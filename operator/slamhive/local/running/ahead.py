# SPDX-License-Identifier: Apache-2.0
"""Environments of a job's algorithms made ahead of its runs, side by side with the recording they wait for.

Who makes them takes a core as a run does, so that nothing that is measured shares one with them, and leaves
one to the run that generates the recording. What fails here fails again where a run needs it, which says why.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.local.programs.unavailable import GivenUp
from slamhive.model.errors import SlamHiveError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from slamhive.local.home.catalog import AlgorithmEntry
    from slamhive.local.programs.cores import CorePool
    from slamhive.local.running.workbench import Workbench


def missing(bench: Workbench, names: Iterable[str]) -> set[str]:
    """Return those of some algorithms whose environments have to be made before they run."""
    found = set()
    for name in names:
        with suppress(SlamHiveError, OSError):
            if bench.programs.is_to_make(bench.workshop.algorithm(name)):
                found.add(name)
    return found


def make_ahead(
    names: Iterable[str], bench: Workbench, cores: CorePool, most: int, stopped: Callable[[], bool]
) -> list[threading.Thread]:
    """Begin to make the environments of algorithms, and return the threads that do.

    Args:
        names: the algorithms, that which is needed first the first.
        bench: what runs share.
        cores: lends a core to each thread.
        most: how many threads at most.
        stopped: tells whether none is wanted any more.
    """
    entries = deque(bench.workshop.algorithm(name) for name in names)
    args = (entries, bench, cores, stopped)
    count = max(0, min(len(entries), most, cores.size - 1))
    # Daemons, as runs are: a second Ctrl-C shall not wait for them.
    threads = [threading.Thread(target=_make, args=args, daemon=True) for _ in range(count)]
    for thread in threads:
        thread.start()
    return threads


def _make(
    entries: deque[AlgorithmEntry], bench: Workbench, cores: CorePool, stopped: Callable[[], bool]
) -> None:
    with suppress(SlamHiveError, OSError, GivenUp):
        taken = cores.take(1, stopped)
        if taken is None:
            return
        try:
            os.sched_setaffinity(0, taken[0])  # of this thread, and of what it starts
            while entries and not stopped():
                with suppress(SlamHiveError, OSError, IndexError):
                    bench.programs.get(entries.popleft())
        finally:
            cores.give_back(taken)
