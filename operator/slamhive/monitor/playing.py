# SPDX-License-Identifier: Apache-2.0
"""Playing as the player tells it in output/playback.json: whether it was done, and the mean cores meanwhile.

The mean is over the time of playing, from its begin to the last pose (wall clock), without the wait before
and after; usage.csv has the cores between any two samples.
"""

from __future__ import annotations

import json
import math
from contextlib import suppress
from itertools import pairwise
from typing import TYPE_CHECKING, Any

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


def played_to_the_end(output_directory: str | None) -> bool:
    """Tell whether the player says that it played everything and then asked the program to end."""
    return _report(output_directory).get("state") == "Ended"


def _report(output_directory: str | None) -> dict[str, Any]:
    """Return the player's report; empty where nothing was played, or it is none."""
    found = None
    with suppress(OSError, ValueError, RecursionError):
        if output_directory is not None:
            found = json.loads(read_regular(f"{output_directory}/playback.json", _REPORT_BYTES))
    return found if isinstance(found, dict) else {}


def _window(output_directory: str | None) -> tuple[float, float] | None:
    found = _report(output_directory)
    try:
        begin, end = float(found["playStart"]), float(found["playEnd"])
    except (ValueError, TypeError, KeyError, OverflowError):
        return None
    return (begin, end) if math.isfinite(begin) and math.isfinite(end) and begin < end else None
