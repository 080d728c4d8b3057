# SPDX-License-Identifier: Apache-2.0
"""The player's own node of ROS 1: it hears frames and poses, and publishes. No other module knows rospy."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import rosbag  # type: ignore[import-not-found]
import rospy  # type: ignore[import-not-found]
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped  # type: ignore[import-not-found]
from nav_msgs.msg import Odometry, Path  # type: ignore[import-not-found]
from rosgraph_msgs.msg import Clock  # type: ignore[import-not-found]
from std_srvs.srv import SetBool  # type: ignore[import-not-found]
from tf2_msgs.msg import TFMessage  # type: ignore[import-not-found]

from slamhive.playback.player.poses import NANOSECONDS, reader
from slamhive.playback.player.ros1.programs import BAG_NODE, PLAYER_NODE
from slamhive.playback.player.wire import Message, header_stamp
from slamhive.playback.protocol import PlayError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

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
_QUEUE = 100
"""Messages that wait for a slow node's connection, as `rosbag play` has it."""
_SERVICE_SECONDS = 10.0


class Ros1Ears:
    """Hears frames and poses.

    Begin before simulated time is set: this node lives by the wall clock.

    Args:
        poses: Where poses come from.
        frames: What counts as a frame; None if another tells the recorder.
        recorder: Who is told.
    """

    def __init__(self, poses: PoseSource, frames: FrameSource | None, recorder: Recorder) -> None:
        rospy.init_node(PLAYER_NODE[1:], disable_signals=True, disable_rosout=True)
        self._recorder = recorder
        self._poses = self.hear_poses(poses, recorder)
        # Frames are not decoded: their headers lie at the beginning.
        self._frames = self._hear(frames.topic, rospy.AnyMsg, self._frame) if frames is not None else None

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
        return self._frames is None or bool(self._frames.get_num_connections())

    @property
    def has_poses(self) -> bool:
        """True if a publisher of poses is connected."""
        return bool(self._poses.get_num_connections())

    def _frame(self, message: Any) -> None:
        arrival = time.time_ns()
        self._recorder.frame(header_stamp(message._buff), arrival)  # noqa: SLF001 - rospy's only way


class BagOutlet:
    """Publishes a bag's messages as they are, and the clock.

    Args:
        recording: Path of the bag.
        names: The names under which topics are played, by those in the bag; others keep theirs.
        frames: The topic of frames, as it is played.
        recorder: Told of frames as they are published.
    """

    def __init__(self, recording: str, names: Mapping[str, str], frames: str, recorder: Recorder) -> None:
        self._bag = rosbag.Bag(recording)
        self._names = names
        self._frames = frames
        self._recorder = recorder
        self._clock = rospy.Publisher("/clock", Clock, queue_size=_QUEUE)
        self._publishers: dict[str, Any] = {}
        for connection in self._bag._get_connections():  # noqa: SLF001 - as rosbag's own programs do
            topic = names.get(connection.topic, connection.topic)
            latched = connection.topic == "/tf_static" or connection.header.get("latching") in {"1", b"1"}
            if topic not in self._publishers:
                self._publishers[topic] = rospy.Publisher(
                    topic, _kind_of(connection), queue_size=_QUEUE, latch=latched, tcp_nodelay=True
                )

    def messages(self) -> Iterator[Message]:
        """Yield the bag's messages in the order of their times."""
        for topic, (_, data, *_rest), time_ in self._bag.read_messages(raw=True):
            yield Message(time_.to_nsec(), self._names.get(topic, topic), data)

    def publish(self, message: Message) -> None:
        """Publish a message."""
        publisher = self._publishers[message.topic]
        raw = publisher.data_class()
        raw._buff = message.data  # noqa: SLF001 - as above
        if message.topic == self._frames:
            self._recorder.frame(message.stamp, time.time_ns())
        publisher.publish(raw)

    def tick(self, now: int) -> None:
        """Publish the simulated time, ns."""
        self._clock.publish(Clock(rospy.Time(*divmod(now, NANOSECONDS))))


def _kind_of(connection: Any) -> type:
    """Return a message class of a connection's type whose messages are bytes."""
    fields = {
        "_type": connection.datatype,
        "_md5sum": connection.md5sum,
        "_full_text": connection.msg_def,
        "__slots__": [],
    }
    return type("Raw", (rospy.AnyMsg,), fields)


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
