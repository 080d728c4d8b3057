# SPDX-License-Identifier: Apache-2.0
"""Delivery of messages in another order than they were recorded in: late, or in a neighbour's place.

Times of recording change by it, stamps don't. Players and readers of bags go by the times of recording;
folders of files have none, so nothing can be late in them.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import numpy.typing as npt

    from slamhive.data.recordings.reading import Scan

    Times = npt.NDArray[np.int64]
    Mask = npt.NDArray[np.bool_]

_Connection = TypeVar("_Connection")


def added_delay(scan: Scan, kept: Mask, late: float, share: float, drawn: np.random.Generator) -> Times:
    """Return the delays added to the times of recording of a topic's messages, ns, shape (n,).

    The second and third message kept may change places, the fourth and fifth, and so on; the first, which
    others are counted from, stays first.

    Args:
        scan: Their times.
        kept: Those that are delivered at all, shape (n,).
        late: Seconds by which all are late.
        share: Of the messages kept that are in a neighbour's place.
        drawn: Says which pairs.
    """
    added = np.full(len(scan.times), round(late * 1e9), dtype=np.int64)
    chances = drawn.random(len(scan.times))
    later = np.flatnonzero(kept)[1:]
    first, second = later[: len(later) // 2 * 2].reshape(-1, 2).T
    chosen = np.argsort(chances[first], kind="stable")[: round(share * (len(later) + 1) / 2)]
    steps = scan.times[second[chosen]] - scan.times[first[chosen]]
    added[first[chosen]] += steps
    added[second[chosen]] -= steps
    return added


def in_order(
    messages: Iterable[tuple[_Connection, int, int, bytes]], earliest: int
) -> Iterator[tuple[_Connection, int, bytes]]:
    """Yield messages in the order of their new times; what is ahead waits in memory.

    Args:
        messages: Connection, time of recording, what is added to it (ns), and bytes, as they were recorded.
        earliest: The least that is added to any, ns.
    """
    waiting: list[tuple[int, int, _Connection, bytes]] = []
    for number, (connection, time, added, raw) in enumerate(messages):
        # What comes from here on can't be earlier than this.
        while waiting and waiting[0][0] <= time + earliest:
            at, _, one, data = heappop(waiting)
            yield one, at, data
        heappush(waiting, (time + added, number, connection, raw))
    while waiting:
        at, _, one, data = heappop(waiting)
        yield one, at, data
