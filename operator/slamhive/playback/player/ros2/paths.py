# SPDX-License-Identifier: Apache-2.0
"""Poses of nav_msgs/Path as bytes: of a path that grows, those that are new or that changed.

Decoded as a whole, each message of an hour's path would take longer than the next one's coming.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.playback.player.poses import NANOSECONDS, Pose

if TYPE_CHECKING:
    from collections.abc import Iterator

_LITTLE_ENDIAN_CDR = b"\x00\x01"
_POSE_BYTES = 56
"""Of position and rotation, seven doubles."""


class PathReader:
    """Reads one path's messages, each beside the one before.

    In CDR numbers lie at multiples of their size, counted from the fifth byte. Behind the first pose all
    others have one length, as far as the names of their frames have.
    """

    def __init__(self) -> None:
        self._before = np.zeros((0, 0), dtype=np.uint8)

    def changed(self, data: bytes) -> Iterator[Pose]:
        """Yield the poses of a message that the one before didn't have.

        Raises:
            ValueError: The message isn't laid out as said above.
        """
        if data[:2] != _LITTLE_ENDIAN_CDR:
            raise ValueError("not CDR of little endian")
        content = np.frombuffer(data, dtype=np.uint8)[4:]
        begin = _aligned(12 + _word(content, 8), 4) + 4
        count = _word(content, begin - 4)
        if not count:
            return
        second = _aligned(begin + 12 + _word(content, begin + 8), 8) + _POSE_BYTES
        yield from _poses(_sized(content, begin, 1, second - begin), second - begin)
        if count == 1:
            return
        length = _aligned(12 + _word(content, second + 8), 8) + _POSE_BYTES
        rows = _sized(content, second, count - 1, length)
        if (rows[:, 8:12] != rows[0, 8:12]).any():
            raise ValueError("names of frames have different lengths")
        before = self._before if self._before.shape[1] == length else self._before[:0].reshape(0, length)
        same = min(len(rows), len(before))
        new = np.ones(len(rows), dtype=bool)
        new[:same] = (rows[:same] != before[:same]).any(axis=1)
        self._before = rows
        yield from _poses(rows[new], length)


def _aligned(place: int, size: int) -> int:
    return -(-place // size) * size


def _word(content: np.ndarray, place: int) -> int:
    if place + 4 > len(content):
        raise ValueError("the message is cut off")
    return int(content[place : place + 4].view("<u4")[0])


def _sized(content: np.ndarray, begin: int, count: int, length: int) -> np.ndarray:
    """Return `count` rows of bytes, (count, length)."""
    if begin + count * length > len(content):
        raise ValueError("the message is cut off")
    return content[begin : begin + count * length].reshape(count, length)


def _poses(rows: np.ndarray, length: int) -> Iterator[Pose]:
    stamps = np.ascontiguousarray(rows[:, :8]).view("<u4").tolist()
    numbers = np.ascontiguousarray(rows[:, length - _POSE_BYTES :]).view("<f8").tolist()
    for (seconds, rest), (x, y, z, *turn) in zip(stamps, numbers, strict=True):
        a, b, c, d = turn
        yield Pose(seconds * NANOSECONDS + rest, (x, y, z), (a, b, c, d))
