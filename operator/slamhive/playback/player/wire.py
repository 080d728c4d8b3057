# SPDX-License-Identifier: Apache-2.0
"""Seam between a session and a ROS: all that differs between ROS 1 and ROS 2."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from slamhive.playback.player.poses import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

# Both a ROS 1 message (its sequence number) and CDR (its encapsulation) have four bytes before the stamp.
_STAMP = struct.Struct("<4xII")


class Message(NamedTuple):
    """A recorded message, as bytes.

    Attributes:
        time: At which it was recorded, ns.
        topic: The name under which it is played.
        data: As it goes over the wire.
    """

    time: int
    topic: str
    data: bytes

    @property
    def stamp(self) -> int:
        """The stamp of its header, ns; of messages that begin with one."""
        return header_stamp(self.data)


def header_stamp(data: bytes) -> int:
    """Return the stamp, ns, of the header that a message as bytes begins with."""
    seconds, nanoseconds = _STAMP.unpack_from(data)
    return int(seconds) * NANOSECONDS + int(nanoseconds)


class Obstacle(NamedTuple):
    """Reason why a node can't be played to yet.

    Attributes:
        text: Of a sentence that begins with "the node", such as ``did not subscribe to /points``.
        why: What is known besides, such as ``it subscribes to /scan``.
        reason: Of the run's failure if it stays: AlgorithmFailed or SystemFault.
    """

    text: str
    why: str = ""
    reason: str = "AlgorithmFailed"

    def sentence(self, seconds: float) -> str:
        """Return the sentence that a run ends with when it stayed for so many seconds."""
        why = f"; {self.why}" if self.why else ""
        return f"the node {self.text} in {seconds:g} s{why}"


class Outlet(Protocol):
    """Outlet of messages and of the clock, for `Clockwork`."""

    def publish(self, message: Message) -> None:
        """Publish a message."""

    def tick(self, now: int) -> None:
        """Publish the simulated time, ns."""


class Wire(Protocol):
    """A ROS that a node can be reached by, with the recording ready to be played."""

    @property
    def variables(self) -> Mapping[str, str]:
        """Environment variables by which the algorithm's node finds it."""

    @property
    def has_poses(self) -> bool:
        """True if a publisher of poses is connected."""

    @property
    def announces_poses(self) -> bool:
        """True if somebody has announced poses, who may still be out of reach."""

    def published(self) -> list[str]:
        """Return the topics of poses that the node publishes, each with its type."""

    def obstacle(self) -> Obstacle | None:
        """Return the obstacle to playing to the node now, None if there is none."""

    def check(self) -> None:
        """Make sure that it still works.

        Raises:
            PlayError: It doesn't.
        """

    def play(self, goes_on: Callable[[], bool]) -> bool:
        """Play the recording, and return whether that went to its end.

        Args:
            goes_on: Asked all the time whether to.

        Raises:
            PlayError: It can't be played.
        """

    def numbers(self) -> dict[str, Any]:
        """Return the counts of playing, for metrics.json."""

    def remark(self) -> str:
        """Return a sentence about what was odd at the end, but no failure; empty where nothing was."""

    def end(self) -> None:
        """End it, and leave nothing of it."""
