# SPDX-License-Identifier: Apache-2.0
"""Frames that come to an adapter that is a ROS node, and the node's own numbers; knows no ROS.

Imported by ``adapter_ros`` and ``adapter_ros2``. The algorithm works on frames one by one. What comes
meanwhile waits in a short queue that loses its oldest, as the Algorithm declares under `realtime`. Stamps are
left as they are in the headers: the player adds what the sensor's clock is off.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from typing import TYPE_CHECKING, Any

from adapter_recording import Item, inertial_order
from adapter_support import NANOSECONDS, Run, Stopwatch, write_atomically

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from adapter_support import Sensor

_WAIT_SECONDS = 0.2


class Arrivals:
    """Messages that came and wait for the algorithm.

    Args:
        run: The run.
        decoders: Role to a function of a message and its sensor, as `adapter_recording.Recording` takes them.
        ended: Tells whether the node was told to end.
        queue: Frames that wait at most.

    Attributes:
        offered: Frames that came.
        dropped: Those of them that the queue lost.
    """

    def __init__(
        self,
        run: Run,
        decoders: Mapping[str, Callable[[Any, Sensor], Any]],
        ended: Callable[[], bool],
        queue: int = 1,
    ) -> None:
        self._sensors = {role: run.sensor(role) for role in decoders}
        self._decoders = decoders
        self._ended = ended
        self._queue = queue
        self._waiting: deque[Any] = deque()
        self._news = threading.Condition()
        self.offered = self.dropped = 0

    @property
    def sensors(self) -> Mapping[str, Sensor]:
        """The sensors to listen to, by role."""
        return self._sensors

    def _taken(self) -> Iterator[Any]:
        """Yield waiting messages and frames, in the order they came, until the node is told to end."""
        while not self._ended():
            with self._news:
                if not self._waiting:
                    self._news.wait(_WAIT_SECONDS)
                    continue
                first = self._waiting.popleft()
            yield first

    def _decoded(self, role: str, stamp: int, message: Any) -> Item:
        return Item(role, stamp, self._decoders[role](message, self._sensors[role]))


class JoinedFrames(Arrivals):
    """The messages of one time, from all roles, as they come."""

    def __init__(
        self,
        run: Run,
        decoders: Mapping[str, Callable[[Any, Sensor], Any]],
        ended: Callable[[], bool],
        queue: int = 1,
    ) -> None:
        super().__init__(run, decoders, ended, queue)
        self._limit = NANOSECONDS / (next(iter(self._sensors.values())).rate or 30.0) / 2
        self._halves: dict[str, deque[tuple[int, Any]]] = {role: deque(maxlen=8) for role in decoders}

    def take(self, role: str, stamp: int, message: Any) -> None:
        """Take in a message with its stamp in ns, from any thread."""
        with self._news:
            self._halves[role].append((stamp, message))
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
            if len(self._waiting) == self._queue:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append([(role, *waiting.popleft()) for role, waiting in self._halves.items()])
            self._news.notify()

    def __iter__(self) -> Iterator[list[Item]]:
        """Yield frames, decoded, in the order of the roles, until the node is told to end."""
        for frame in self._taken():
            yield [self._decoded(*message) for message in frame]


class InertialScans(Arrivals):
    """Scans (role lidar) and inertial samples (role imu) as they come, on the lidar's clock.

    Samples are never lost.
    """

    def __init__(
        self,
        run: Run,
        decoders: Mapping[str, Callable[[Any, Sensor], Any]],
        ended: Callable[[], bool],
        queue: int = 1,
    ) -> None:
        super().__init__(run, decoders, ended, queue)
        self._lidar = self._sensors["lidar"]
        self._latest: dict[str, int] = {}

    def take(self, role: str, stamp: int, message: Any) -> None:
        """Take in a message with its stamp in ns, from any thread, unless it is no later than the last."""
        stamp += self._sensors[role].offset - self._lidar.offset
        with self._news:
            if stamp <= self._latest.get(role, stamp - 1):
                return
            self._latest[role] = stamp
            if role == "lidar":
                self.offered += 1
                scans = [index for index, (kind, *_) in enumerate(self._waiting) if kind == "lidar"]
                if len(scans) == self._queue:
                    del self._waiting[scans[0]]
                    self.dropped += 1
            self._waiting.append((role, stamp, message))
            self._news.notify()

    def __iter__(self) -> Iterator[Item]:
        """Yield each scan behind the samples of its time, decoded, until the node is told to end."""
        return inertial_order((self._decoded(*message) for message in self._taken()), self._lidar)


def write_numbers(run: Run, frames: Arrivals, watch: Stopwatch, **extra: Any) -> None:
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
