# SPDX-License-Identifier: Apache-2.0
"""Listening on ROS 2: the poses that a node publishes, and a witness of what the player publishes.

Messages are taken as bytes, in a thread of its own, so that no poses delay what is played. They have the time
at which the middleware received them: how often they are looked for changes no latency.
"""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import rclpy  # type: ignore[import-not-found]
from rclpy.qos import (  # type: ignore[import-not-found]
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rosbags.typesys import Stores, get_typestore

from slamhive.playback.player.poses import reader
from slamhive.playback.player.ros2.paths import PathReader
from slamhive.playback.player.ros2.types import message_type

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from slamhive.playback.player.poses import Pose
    from slamhive.playback.player.recorder import Track
    from slamhive.playback.protocol import PoseSource

EARS = "slamhive_ears"
MESSAGES = {
    "PoseStamped": "geometry_msgs/msg/PoseStamped",
    "PoseWithCovarianceStamped": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "Odometry": "nav_msgs/msg/Odometry",
    "Path": "nav_msgs/msg/Path",
    "TF": "tf2_msgs/msg/TFMessage",
}
"""Types of messages, by their name in an Algorithm."""
_LOOK_SECONDS, _PATIENT_SECONDS = 0.004, 0.02
"""Between two looks, where what is played waits for poses and where nothing does."""
_END_SECONDS = 10.0
_NUMBERING, _NUMBER = "rmw_fastrtps_cpp", "publication_sequence_number"


def everything(reliability: Any, durability: Any = DurabilityPolicy.VOLATILE) -> Any:
    """Return a quality of service that keeps all messages."""
    return QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=reliability, durability=durability)


class Ros2Ears:
    """Takes poses as they come, and counts what is played, until it is ended.

    Args:
        context: Of rclpy.
        sources: Where poses come from, with who takes them.
        played: The types of the topics that the witness hears, by their names.
        hasty: Whether somebody waits for poses.
    """

    def __init__(
        self,
        context: Any,
        sources: Iterable[tuple[PoseSource, Track]],
        played: Mapping[str, type],
        *,
        hasty: bool,
    ) -> None:
        self._node = rclpy.create_node(
            EARS, context=context, start_parameter_services=False, enable_rosout=False
        )
        self._sources = [_PoseTopics(self._node, source, track) for source, track in sources]
        # A reliable subscriber gets all in order: the number of the newest tells how many came, without the
        # others being kept. Other makes than Fast DDS don't number messages.
        self._numbered = rclpy.get_rmw_implementation_identifier() == _NUMBERING
        kept = QoSProfile(depth=1) if self._numbered else everything(ReliabilityPolicy.RELIABLE)
        self._witnesses = {topic: _Taken(self._node, topic, kind, kept) for topic, kind in played.items()}
        self._heard = dict.fromkeys(played, 0)
        self._lock = threading.Lock()
        self._pause = _LOOK_SECONDS if hasty else _PATIENT_SECONDS
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="ears", daemon=True)
        self._thread.start()

    def heard(self) -> Mapping[str, int]:
        """Take what the witness has, and return the number of messages that it heard, by the topic."""
        with self._lock:
            for topic, witness in self._witnesses.items():
                for _, _, number in witness:
                    self._heard[topic] = number or self._heard[topic] + 1
        return self._heard

    def end(self) -> None:
        """Stop listening."""
        self._stop.set()
        self._thread.join(_END_SECONDS)
        self._node.destroy_node()

    def _listen(self) -> None:
        while not self._stop.wait(self._pause):
            for source in self._sources:
                source.take()
            if not self._numbered:
                self.heard()


class _Taken:
    """Iterates over the messages that a subscription has now.

    Yields:
        Bytes, when they came (wall clock, ns), and the message's number; None where it has none.
    """

    def __init__(self, node: Any, topic: str, kind: type, qos: Any) -> None:
        self._kind = kind
        self._subscription = node.create_subscription(kind, topic, _nothing, qos, raw=True)
        self._node = node

    @property
    def publishers(self) -> int:
        return int(self._subscription.handle.get_publisher_count())

    def __iter__(self) -> Any:
        handle = self._subscription.handle
        while True:
            with handle:
                found = handle.take_message(self._kind, True)
            if found is None:
                return
            about = found[1]
            yield found[0], about.get("received_timestamp") or time.time_ns(), about.get(_NUMBER)

    def end(self) -> None:
        self._node.destroy_subscription(self._subscription)


def _nothing(_: object) -> None:
    """Do nothing: no executor has the ears' node."""


class _PoseTopics:
    """The poses of one source, for one track.

    Both kinds of subscriptions are there from the start: one that is best effort hears every publisher, a
    reliable one loses nothing of those that are. Where the latter has all publishers, and heard one, the
    former goes; until then it is asked first, as it is connected sooner, and what comes twice is one pose.
    """

    def __init__(self, node: Any, source: PoseSource, track: Track) -> None:
        self._track = track
        self._read = reader(source)
        self._name = MESSAGES[source.type]
        self._store = get_typestore(Stores.LATEST)
        self._path = PathReader() if source.type == "Path" else None
        kind = message_type(self._name)
        reliable = everything(ReliabilityPolicy.RELIABLE)
        self._any: _Taken | None = _Taken(node, source.topic, kind, everything(ReliabilityPolicy.BEST_EFFORT))
        self._reliable = [_Taken(node, source.topic, kind, reliable)]
        self._sure = self._reliable[0]
        if source.type == "TF" and source.topic != "/tf_static":
            kept = everything(ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
            self._reliable.insert(0, _Taken(node, "/tf_static", kind, kept))

    def take(self) -> None:
        if self._any is not None:
            self._take(self._any)
        heard = [self._take(taken) for taken in self._reliable]
        if self._any is not None and heard[-1] and self._sure.publishers >= self._any.publishers:
            self._any.end()
            self._any = None

    def _take(self, taken: _Taken) -> int:
        """Take the messages that are there, and return their number."""
        count = 0
        for data, arrival, _ in taken:
            count += 1
            try:
                self._track.poses(self._poses(data), arrival)
            except Exception:  # noqa: BLE001 - what a peer sends may be anything
                self._track.broken += 1
        return count

    def _poses(self, data: bytes) -> Iterator[Pose]:
        if self._path is not None:
            with suppress(ValueError):
                return iter(list(self._path.changed(data)))
        return self._read(self._store.deserialize_cdr(data, self._name))
