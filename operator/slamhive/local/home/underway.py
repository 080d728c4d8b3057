# SPDX-License-Identifier: Apache-2.0
"""Runs that are under way in a home, as the processes of this machine tell: each has a supervisor.

The archive knows a run when it has ended, and what a killed slamhive left in its folders tells of a run that
is over as if it went on; a process is there or it isn't, whichever runner started it.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

_PROGRAM = b"slamhive.monitor"
_SPEC = b"--spec"


def runs_under_way(runs: Path, processes: Path = Path("/proc")) -> set[tuple[str, str]]:
    """Return the runs that are at work, by the names of the sweep's folder and of their own in it.

    Args:
        runs: folder of a home that holds the runs, a folder of them a sweep.
        processes: where the kernel lists processes.
    """
    root = Path(os.path.realpath(runs))
    found = set()
    for number in filter(str.isdigit, os.listdir(processes)):  # noqa: PTH208 - there are hundreds
        with suppress(OSError, ValueError, IndexError):  # it has ended, or is another one
            words = (processes / number / "cmdline").read_bytes().split(b"\0")
            if _PROGRAM not in words or _SPEC not in words:
                continue
            told = os.fsdecode(words[words.index(_SPEC) + 1])
            sweep, run, _ = Path(os.path.realpath(told)).relative_to(root).parts
            found.add((sweep, run))
    return found
