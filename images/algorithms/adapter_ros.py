# SPDX-License-Identifier: Apache-2.0
"""Frames, poses and the end by SIGINT of adapters that are ROS 1 nodes.

Imported by ``kiss-icp-ros`` and ``orb-slam3-ros``.

The node takes messages as they come and works on them one by one. What comes meanwhile waits in a short
queue that loses its oldest, as the Algorithm declares under `realtime`. Stamps are left as they are in the
headers: the player adds what the sensor's clock is off.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import rospy
from adapter_recording import Item
from adapter_support import NANOSECONDS, AdapterError, Run, Stopwatch, quaternions, write_atomically
from nav_msgs.msg import Odometry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    import numpy as np
    from adapter_support import Sensor

BUFFER_BYTES = 1 << 24
"""Bytes read of a connection at a time; less than a message would make rospy copy it again and again."""

_WAIT_SECONDS = 0.2


class Frames:
    """The messages of one time, from all roles, as they come.

    Args:
        run: The run.
        decoders: Role to a function of a message and its sensor, as `adapter_recording.Recording` takes them.
        queue: Frames that wait at most.

    Attributes:
        offered: Complete frames that came.
        dropped: Those of them that the queue lost.
    """

    def __init__(
        self, run: Run, decoders: Mapping[str, Callable[[Any, Sensor], Any]], queue: int = 1
    ) -> None:
        self._run = run
        self._decoders = decoders
        self._limit = NANOSECONDS / (run.sensor(next(iter(decoders))).rate or 30.0) / 2
        self._halves: dict[str, deque[tuple[int, Any]]] = {role: deque(maxlen=8) for role in decoders}
        self._waiting: deque[list[tuple[int, Any]]] = deque(maxlen=queue)
        self._news = threading.Condition()
        self.offered = self.dropped = 0

    def subscribe(self, kind: Any) -> None:
        """Begin to listen, to messages of one type; the player takes it as: ready."""
        for role in self._decoders:
            rospy.Subscriber(
                self._run.sensor(role).topic, kind, self._take, role, buff_size=BUFFER_BYTES, tcp_nodelay=True
            )

    def _take(self, message: Any, role: str) -> None:
        stamp = message.header.stamp
        with self._news:
            self._halves[role].append((stamp.secs * NANOSECONDS + stamp.nsecs, message))
            while all(self._halves.values()):
                self._join()

    def _join(self) -> None:
        """Take the oldest of each role as a frame, or drop the one that has no partner any more."""
        heads = {role: waiting[0][0] for role, waiting in self._halves.items()}
        newest = max(heads.values())
        late = [role for role, stamp in heads.items() if newest - stamp >= self._limit]
        for role in late:
            self._halves[role].popleft()
        if not late:
            self.offered += 1
            self.dropped += len(self._waiting) == self._waiting.maxlen
            self._waiting.append([waiting.popleft() for waiting in self._halves.values()])
            self._news.notify()

    def __iter__(self) -> Iterator[list[Item]]:
        """Yield frames, decoded, in the order of the roles, until the node is told to end."""
        while not rospy.is_shutdown():
            with self._news:
                if not self._waiting:
                    self._news.wait(_WAIT_SECONDS)
                    continue
                frame = self._waiting.popleft()
            yield [
                Item(role, stamp, decode(_like_rosbags(message), self._run.sensor(role)))
                for (role, decode), (stamp, message) in zip(self._decoders.items(), frame, strict=True)
            ]


def _like_rosbags(message: Any) -> Any:
    """Return a message with its stamp named as in ROS 2, which is what the decoders read."""
    fields = {name: getattr(message, name) for name in message.__slots__}
    stamp = SimpleNamespace(sec=message.header.stamp.secs, nanosec=message.header.stamp.nsecs)
    return SimpleNamespace(**fields | {"header": SimpleNamespace(stamp=stamp)})


class Poses:
    """Publishes poses as nav_msgs/Odometry.

    Args:
        topic: The topic.
        frame: Name of the frame whose pose it is.
    """

    def __init__(self, topic: str, frame: str) -> None:
        self._publisher = rospy.Publisher(topic, Odometry, queue_size=100)
        self._frame = frame

    def publish(self, stamp: int, pose: np.ndarray) -> None:
        """Publish a pose `(4, 4)` with its stamp in ns."""
        message = Odometry()
        message.header.frame_id = "map"
        message.child_frame_id = self._frame
        message.header.stamp = rospy.Time(*divmod(stamp, NANOSECONDS))
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        place.x, place.y, place.z = map(float, pose[:3, 3])
        turn.x, turn.y, turn.z, turn.w = map(float, quaternions(pose[None, :3, :3])[0])
        self._publisher.publish(message)


def begin(name: str) -> None:
    """Become a node.

    Raises:
        AdapterError: There is no master.
    """
    if not rospy.core.rosgraph.is_master_online():
        raise AdapterError("no ROS master answers at ROS_MASTER_URI; slamhive starts one with its player")
    rospy.init_node(name)


def write_numbers(run: Run, frames: Frames, watch: Stopwatch, **extra: Any) -> None:
    """Add the node's own numbers to metrics.json, where those of the player may be.

    Args:
        run: The run.
        frames: What came.
        watch: One time per processed frame.
        extra: The algorithm's own numbers.
    """
    path = run.output / "metrics.json"
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        known = {}
    done: Sequence[float] = watch.seconds
    numbers: dict[str, Any] = {"framesProcessed": len(done), "framesDropped": frames.dropped}
    if done:
        numbers["timePerFrame"] = {"mean": round(sum(done) / len(done), 6), "max": round(max(done), 6)}
    write_atomically(path, json.dumps(known | numbers | extra, indent=1) + "\n")
