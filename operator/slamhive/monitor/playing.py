# SPDX-License-Identifier: Apache-2.0
"""Mean cores of a run that was played to: over the time it was, without the wait before and after.

The player writes into output/playback.json when it began to play and when the last pose came (wall clock);
usage.csv has the cores between any two samples.
"""

from __future__ import annotations

import json
import math
from contextlib import suppress
from itertools import pairwise
from typing import TYPE_CHECKING

from slamhive.contract.files import read_regular

if TYPE_CHECKING:
    from collections.abc import Iterator

_REPORT_BYTES = 64 << 10


def played_mean_cores(output_directory: str | None, usage_path: str, started_at: float) -> float | None:
    """Return the mean cores while a recording was played.

    Args:
        output_directory: Where the player's report may be.
        usage_path: usage.csv, complete.
        started_at: Wall clock at which its time is 0, s.

    Returns:
        None where nothing was played, or what was written of it makes no sense.
    """
    window = _window(output_directory)
    if window is None:
        return None
    begin, end = (moment - started_at for moment in window)
    used = seconds = 0.0
    with suppress(OSError, ValueError):
        for (before, _), (now, cores) in pairwise(_rows(usage_path)):
            overlap = min(now, end) - max(before, begin)
            if overlap > 0:
                used += cores * overlap
                seconds += overlap
    return used / seconds if seconds > 0 else None


def _rows(path: str) -> Iterator[tuple[float, float]]:
    # The first line's cores count from the start on, as each line's from the one before.
    yield 0.0, 0.0
    with open(path, encoding="ascii") as file:  # noqa: PTH123
        next(file, None)
        for line in file:
            time, cores, *_ = line.split(",")
            yield float(time), float(cores)


def _window(output_directory: str | None) -> tuple[float, float] | None:
    if output_directory is None:
        return None
    try:
        found = json.loads(read_regular(f"{output_directory}/playback.json", _REPORT_BYTES))
        begin, end = float(found["playStart"]), float(found["playEnd"])
    except (OSError, ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return None
    return (begin, end) if math.isfinite(begin) and math.isfinite(end) and begin < end else None
