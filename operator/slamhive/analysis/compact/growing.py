# SPDX-License-Identifier: Apache-2.0
"""Arrays that grow in place: a large table takes more rows without standing in memory twice meanwhile."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

LARGE = 50_000
"""Rows from which on room is left behind an array: what nothing is written to takes no memory."""

_SHARE = 8


class SpareRoom(np.ndarray[Any, Any]):
    """Memory of an array, with room behind it.

    Attributes:
        ends: where the array ends that has it; nothing while somebody makes a longer one. A set, as neither
            threads nor forks need a lock to take something out of it.
    """

    ends: set[int]


def joined(parts: Sequence[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    """Return arrays one behind the other, in the memory of the first if nobody has what is behind it."""
    first, count = parts[0], sum(map(len, parts))
    if count < LARGE or any(part.dtype != first.dtype for part in parts):
        return np.concatenate(parts)
    room, begin, more = first.base, len(first), parts[1:]
    if not (isinstance(room, SpareRoom) and count <= len(room) and _took(room.ends, begin)):
        room, begin, more = SpareRoom(count + count // _SHARE, first.dtype), 0, parts
        room.ends = set()
    for part in more:
        room[begin : begin + len(part)] = part
        begin += len(part)
    room.ends.add(count)
    return np.ndarray(count, first.dtype, buffer=room)


def _took(ends: set[int], end: int) -> bool:
    try:
        ends.remove(end)
    except KeyError:
        return False
    return True
