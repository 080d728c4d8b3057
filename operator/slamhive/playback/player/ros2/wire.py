# SPDX-License-Identifier: Apache-2.0
"""Wire to a ROS 2 node: one rclpy process that publishes the recording as bytes, by the clock."""

from __future__ import annotations

import ctypes
import os
import time
from typing import TYPE_CHECKING, Any

from slamhive.playback.player.playing import Clockwork
from slamhive.playback.player.recorder import write_atomically
from slamhive.playback.player.ros2 import shm
from slamhive.playback.player.ros2.bags import Ros2Bag
from slamhive.playback.player.ros2.transport import Domain, check_rmw, check_room, profile
from slamhive.playback.protocol import PROFILE_FILE, PlayError, ros2_variables

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.playback.player.recorder import Recorder, Track
    from slamhive.playback.player.ros2.node import PlayerNode
    from slamhive.playback.player.wire import Message, Obstacle
    from slamhive.playback.protocol import PlayRequest, PoseSource

_OWN_PROFILE = "player.xml"
_OLDER = ("humble", "iron", "jazzy")
"""Distributions whose Fast DDS knows its profile by the older name of the variable."""
_TRIES = 5
_M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD = -3, -1
_HEARD_SECONDS = 5.0
_CHECK_SECONDS = 0.5


class Ros2Wire:
    """A domain of our own, with the recording open and its topics announced.

    Args:
        request: What to play.
        folder: The player's own.
        recorder: Takes frames and poses.
        keyframes: Takes the poses of keyframes, where there are some.
        stopped: Asked whether to give up waiting.

    Raises:
        PlayError: Something that it needs isn't there.
    """

    def __init__(
        self,
        request: PlayRequest,
        folder: Path,
        recorder: Recorder,
        keyframes: Track | None,
        stopped: Callable[[], bool],
    ) -> None:
        self._request = request
        self._recorder = recorder
        _keep_memory()
        self._bag = Ros2Bag(request.recording, request.topics | request.remap)
        for topic in request.topics.values():
            if topic not in self._bag.topics:
                raise PlayError(f"the recording has no topic {topic}, which the node is to be given")
        shm.remove_dead_segments()
        check_rmw(request.rmw)
        check_room(self._bag.largest)
        for name, own in ((PROFILE_FILE, False), (_OWN_PROFILE, True)):
            write_atomically(folder / name, profile(self._bag.largest, own=own))
        self._domain, self._node = self._begin(folder, recorder, keyframes, stopped)
        self.variables = ros2_variables(
            self._domain.number, str(folder / PROFILE_FILE), request.rmw, str(folder)
        )
        self._clockwork = Clockwork(request, recorder, self)
        self._published: dict[str, int] = dict.fromkeys(self._bag.topics, 0)
        self._next_check = 0.0

    def _begin(
        self, folder: Path, recorder: Recorder, keyframes: Track | None, stopped: Callable[[], bool]
    ) -> tuple[Domain, PlayerNode]:
        """Return a domain on which nobody is, and our node there."""
        request = self._request
        sources: list[tuple[PoseSource, Track]] = [(request.poses, recorder)]
        if request.keyframes is not None and keyframes is not None:
            sources.append((request.keyframes, keyframes))
        for _ in range(_TRIES if request.domain is None else 1):
            domain = Domain(request.domain)
            told = ros2_variables(domain.number, str(folder / _OWN_PROFILE), request.rmw, str(folder))
            if os.environ.get("ROS_DISTRO") not in _OLDER:
                del told["FASTRTPS_DEFAULT_PROFILES_FILE"]
            os.environ.update(told)
            # rclpy reads the variables when it is imported.
            from slamhive.playback.player.ros2.node import PlayerNode  # noqa: PLC0415

            node = PlayerNode(request, domain.number, self._bag.topics, sources)
            others = node.others(stopped)
            if not others:
                return domain, node
            node.end()
            domain.release()
        raise PlayError(
            f"nodes of other programs are on ROS 2 domain {domain.number} of this machine: "
            f"{', '.join(others)}; nothing is played to them"
        )

    @property
    def has_poses(self) -> bool:
        """True if a publisher of poses is there, of the type that was named."""
        return self._node.has_poses

    @property
    def announces_poses(self) -> bool:
        """True if somebody has announced poses, who may still be out of reach."""
        return self._node.has_poses

    def published(self) -> list[str]:
        """Return the topics of poses that the node publishes, each with its type."""
        return self._node.published()

    def obstacle(self) -> Obstacle | None:
        """Return the obstacle to playing to the node now, None if there is none."""
        return self._node.obstacle(self._bag.begin)

    def check(self) -> None:
        """Make sure that nobody else is on the domain, and that the node takes what is played.

        Raises:
            PlayError: A foreign node is there, or messages pile up.
        """
        now = time.monotonic()
        if now >= self._next_check:
            self._next_check = now + _CHECK_SECONDS
            self._node.check()

    def play(self, goes_on: Callable[[], bool]) -> bool:
        """Play the recording, and return whether that went to its end.

        Raises:
            PlayError: It can't be played, or something of it was lost on the way.
        """
        if not self._clockwork.run(self._bag.messages(), goes_on):
            return False
        self._ask_witness()
        return True

    def publish(self, message: Message) -> None:
        """Publish a message."""
        if message.topic == self._request.frames.topic:
            self._recorder.frame(message.stamp, time.time_ns())
        self._node.publish(message)
        self._published[message.topic] += 1

    def tick(self, now: int) -> None:
        """Publish the simulated time, ns."""
        self._node.tick(now)

    def numbers(self) -> dict[str, Any]:
        """Return the counts of playing, for metrics.json."""
        return self._clockwork.numbers() | self._node.numbers()

    def remark(self) -> str:
        """Return a sentence about parameters that nobody took; empty where there are none."""
        return self._node.remark()

    def end(self) -> None:
        """Leave the domain, and nothing in shared memory."""
        self._node.end()
        self._domain.release()
        shm.remove_dead_segments()

    def _ask_witness(self) -> None:
        """Make sure that a subscriber of our own heard all that was played.

        Raises:
            PlayError: It didn't: what the node lost may be our fault.
        """
        deadline = time.monotonic() + _HEARD_SECONDS
        while (lost := self._lost()) and time.monotonic() < deadline:
            time.sleep(0.01)
        for topic, count in lost.items():
            raise PlayError(
                f"{count} of {self._published[topic]} messages on {topic} were lost on the way: this machine "
                "is too busy to play to a node"
            )

    def _lost(self) -> dict[str, int]:
        heard = self._node.heard()
        return {
            topic: self._published[topic] - count
            for topic, count in heard.items()
            if count < self._published[topic]
        }


def _keep_memory() -> None:
    """Have the C library keep what large messages leave: from the kernel it takes longer than copying one."""
    library = ctypes.CDLL(None)
    for option, size in ((_M_MMAP_THRESHOLD, 32 << 20), (_M_TRIM_THRESHOLD, 64 << 20)):
        library.mallopt(option, size)
