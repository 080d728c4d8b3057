# SPDX-License-Identifier: Apache-2.0
"""Wire to a ROS 1 node. In real time `rosbag play` plays; stepped, the player's own node does."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from slamhive.playback.player.playing import Clockwork
from slamhive.playback.player.poses import POSE_TYPES
from slamhive.playback.player.ros1.programs import BAG_NODE, PLAYER_NODE, Master, RosProgram, play_bag
from slamhive.playback.player.wire import Obstacle
from slamhive.playback.protocol import PlayError, ros1_variables

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.playback.player.recorder import Recorder, Track
    from slamhive.playback.protocol import PlayRequest

_LOOK_SECONDS = 0.02


class Ros1Wire:
    """A master of our own, and the bag beside it, paused before its first message.

    Args:
        request: What to play.
        folder: The player's own.
        recorder: Takes frames and poses.
        keyframes: Takes the poses of keyframes, where there are some.
        stopped: Asked whether to give up waiting.

    Raises:
        PlayError: The master doesn't start.
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
        self._bag: RosProgram | None = None
        self._clockwork: Clockwork | None = None
        self._master = Master(folder, request.port, stopped)
        self.variables = ros1_variables(self._master.uri, str(folder / "ros"))
        # rospy looks for the master as soon as it is imported.
        from slamhive.playback.player.ros1.node import BagOutlet, Ros1Ears  # noqa: PLC0415

        self._ears = Ros1Ears(request.poses, None if request.stepped else request.frames, recorder)
        if request.keyframes is not None and keyframes is not None:
            self._ears.hear_poses(request.keyframes, keyframes)
        self._master.set_simulated_time()
        names = request.topics | request.remap
        if request.stepped:
            self._outlet = BagOutlet(request.recording, names, request.frames.topic, recorder)
            self._clockwork = Clockwork(request, recorder, self._outlet)
        else:
            self._bag = play_bag(folder, request.recording, request.rate, names)

    @property
    def has_poses(self) -> bool:
        """True if a publisher of poses is connected."""
        return self._ears.has_poses

    @property
    def announces_poses(self) -> bool:
        """True if somebody has announced poses, who may still be out of reach."""
        return self._master.has_publisher(self._request.poses.topic)

    def published(self) -> list[str]:
        """Return the topics of poses that the node publishes, each with its type."""
        return self._master.published(POSE_TYPES)

    def obstacle(self) -> Obstacle | None:
        """Return the obstacle to playing to the node now, None if there is none."""
        if self._bag is not None and self._bag.status is not None:
            raise PlayError(f"rosbag play ended before it began: {self._bag.last_line()}")
        wanted = list(self._request.topics.values())
        taken = self._master.taken(wanted, PLAYER_NODE if self._bag is None else BAG_NODE)
        missing = sorted(set(wanted) - set(taken))
        if missing:
            return Obstacle(f"did not subscribe to {', '.join(missing)}")
        return None if self._ears.linked else Obstacle("could not be heard")

    def check(self) -> None:
        """Make sure that the master is there.

        Raises:
            PlayError: It has ended.
        """
        self._master.check()

    def play(self, goes_on: Callable[[], bool]) -> bool:
        """Play the bag, and return whether that went to its end.

        Raises:
            PlayError: It can't be played.
        """
        if self._clockwork is not None:
            return self._clockwork.run(self._outlet.messages(), goes_on)
        from slamhive.playback.player.ros1.node import release_bag  # noqa: PLC0415

        release_bag()
        while self._bag is not None and self._bag.status is None:
            if not goes_on():
                return False
            time.sleep(_LOOK_SECONDS)
        if self._bag is not None and self._bag.status:
            raise PlayError(f"rosbag play failed: {self._bag.last_line()}")
        return True

    def numbers(self) -> dict[str, Any]:
        """Return the counts of playing: `rosbag play` has none."""
        return self._clockwork.numbers() if self._clockwork is not None else {}

    def remark(self) -> str:
        """Return nothing: what a ROS 1 node asks for can't be told."""
        return ""

    def end(self) -> None:
        """End the bag, then the master."""
        for program in (self._bag, self._master):
            if program is not None:
                program.end()
