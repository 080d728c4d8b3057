# SPDX-License-Identifier: Apache-2.0
"""The player's own node: it hears frames and poses, and lets the bag run. The one module that knows rospy."""

from __future__ import annotations

import struct
import time
from typing import TYPE_CHECKING, Any

import rospy  # type: ignore[import-not-found]
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped  # type: ignore[import-not-found]
from nav_msgs.msg import Odometry, Path  # type: ignore[import-not-found]
from std_srvs.srv import SetBool  # type: ignore[import-not-found]
from tf2_msgs.msg import TFMessage  # type: ignore[import-not-found]

from slamhive.playback.player.poses import NANOSECONDS, reader
from slamhive.playback.player.programs import BAG_NODE, PLAYER_NODE
from slamhive.playback.protocol import PlayError

if TYPE_CHECKING:
    from slamhive.playback.player.recorder import Recorder, Track
    from slamhive.playback.protocol import FrameSource, PoseSource

_TYPES = {
    "PoseStamped": PoseStamped,
    "PoseWithCovarianceStamped": PoseWithCovarianceStamped,
    "Odometry": Odometry,
    "Path": Path,
    "TF": TFMessage,
}
_BUFFER_BYTES = 1 << 24
_STAMP = struct.Struct("<4xII")
_SERVICE_SECONDS = 10.0


class Ears:
    """Hears frames and poses.

    Begin before simulated time is set: this node lives by the wall clock.

    Args:
        poses: Where poses come from.
        frames: What counts as a frame.
        recorder: Who is told.
    """

    def __init__(self, poses: PoseSource, frames: FrameSource, recorder: Recorder) -> None:
        rospy.init_node(PLAYER_NODE[1:], disable_signals=True, disable_rosout=True)
        self._recorder = recorder
        self._poses = self.hear_poses(poses, recorder)
        # Frames are not decoded: their headers lie at the beginning.
        self._frames = self._hear(frames.topic, rospy.AnyMsg, self._frame)

    def hear_poses(self, source: PoseSource, track: Track) -> Any:
        """Have the poses of a source taken by a track, and return the subscription."""
        read = reader(source)

        def take(message: Any) -> None:
            arrival = time.time_ns()
            track.poses(read(message), arrival)

        subscription = self._hear(source.topic, _TYPES[source.type], take)
        if source.type == "TF" and source.topic != "/tf_static":
            self._hear("/tf_static", TFMessage, take)
        return subscription

    def _hear(self, topic: str, kind: Any, call: Any) -> Any:
        return rospy.Subscriber(topic, kind, call, buff_size=_BUFFER_BYTES, tcp_nodelay=True)

    @property
    def linked(self) -> bool:
        """True if a publisher of frames is connected: they would be heard if the bag were played now."""
        return bool(self._frames.get_num_connections())

    @property
    def has_poses(self) -> bool:
        """True if a publisher of poses is connected."""
        return bool(self._poses.get_num_connections())

    def _frame(self, message: Any) -> None:
        arrival = time.time_ns()
        seconds, nanoseconds = _STAMP.unpack_from(message._buff)  # noqa: SLF001 - rospy's only way
        self._recorder.frame(seconds * NANOSECONDS + nanoseconds, arrival)


def release_bag() -> None:
    """Let the bag run that was started paused.

    Raises:
        PlayError: It can't be asked to.
    """
    name = f"{BAG_NODE}/pause_playback"
    try:
        rospy.wait_for_service(name, _SERVICE_SECONDS)
        rospy.ServiceProxy(name, SetBool)(False)
    except (rospy.ROSException, rospy.ServiceException) as error:
        raise PlayError(f"rosbag play doesn't begin: {error}") from None
