# SPDX-License-Identifier: Apache-2.0
"""Recorder of what the player hears: frames and poses, with sensor stamp and wall clock."""

from __future__ import annotations

import bisect
import itertools
import json
import math
import os
import stat
import threading
from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.playback.player.poses import COVARIANCE_NAMES, NANOSECONDS, Pose, seconds_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from slamhive.playback.protocol import FrameSource

_METRICS_BYTES = 4 << 20
_MARGIN = 0.05
"""Share of a frame's period by which a pose that belongs to its end may reach into the next one."""


class Heard(NamedTuple):
    """A pose and when it came, wall clock in ns."""

    pose: Pose
    arrival: int


class Track:
    """Poses of one source by their stamps, taken from the thread that hears them.

    Attributes:
        broken: Number of those that were none.
        latest: Wall clock at which the last one came, ns.

    Args:
        offset: To add to stamps, s.
    """

    def __init__(self, offset: float) -> None:
        self._offset = round(offset * NANOSECONDS)
        self._lock = threading.Condition()
        self._first: dict[int, Heard] = {}
        self._last: dict[int, Pose] = {}
        self.broken = 0
        self.latest: int | None = None

    def poses(self, found: Iterable[Pose], arrival: int) -> None:
        """Take the poses of a message that arrived at a wall clock in ns; a stamp may come again."""
        with self._lock:
            for pose in found:
                if not pose.is_sound:
                    self.broken += 1
                    continue
                self._first.setdefault(pose.stamp, Heard(pose, arrival))
                self._last[pose.stamp] = pose
                self.latest = arrival
            self._lock.notify_all()

    @property
    def count(self) -> int:
        """The number of poses."""
        return len(self._last)

    def final(self) -> str:
        """Return the trajectory in the TUM format, each stamp with its last pose."""
        with self._lock:
            return self._text(self._last.values())

    def online(self) -> str:
        """Return the trajectory in the TUM format, each stamp with the pose it was first given."""
        with self._lock:
            return self._text(heard.pose for heard in self._first.values())

    def covariances(self) -> str:
        """Return the covariances of the poses that stamps had first, as CSV; empty where there are none."""
        with self._lock:
            known = sorted(heard.pose for heard in self._first.values() if heard.pose.covariance)
        return "".join([COVARIANCE_NAMES, *(pose.row(self._offset) for pose in known)]) if known else ""

    def heard(self) -> list[Heard]:
        """Return for each stamp the pose that it was first given, in the order in which they came."""
        with self._lock:
            return sorted(self._first.values(), key=lambda heard: heard.arrival)

    def _text(self, poses: Iterable[Pose]) -> str:
        return "".join(pose.line(self._offset) for pose in sorted(poses))


class Recorder(Track):
    """Takes frames and the poses that belong to them.

    Args:
        frames: What counts as a frame.
        moved: To add to the stamps of poses beside the sensor's offset, s.
    """

    def __init__(self, frames: FrameSource, moved: float = 0.0) -> None:
        super().__init__(frames.time_offset + moved)
        self._source = frames
        self._frames: dict[int, int] = {}
        self._looked = 0
        self._answered: set[int | None] = set()

    def frame(self, stamp: int, arrival: int) -> None:
        """Take a frame by its header's stamp and the wall clock of its arrival, both ns."""
        with self._lock:
            self._frames.setdefault(stamp, arrival)

    def wait_for_pose(self, frame: int, seconds: float) -> bool:
        """Wait until a frame, told by its header's stamp in ns, has a pose; False if it has none in time."""
        with self._lock:
            return self._lock.wait_for(lambda: self._has_pose(frame), max(seconds, 0.0))

    def _has_pose(self, frame: int) -> bool:
        news = list(self._first)[self._looked :]
        self._looked += len(news)
        stamps = sorted(self._frames) if news else []
        self._answered |= {self._frame_of(stamp, stamps) for stamp in news}
        return frame in self._answered

    def latencies(self) -> list[tuple[int, int, int]]:
        """Return for each frame with a pose its stamp, its arrival and that of its first pose, ns."""
        poses = self.heard()
        with self._lock:
            stamps = sorted(self._frames)
            first: dict[int, int] = {}
            for heard in poses:
                frame = self._frame_of(heard.pose.stamp, stamps)
                if frame is not None:
                    first.setdefault(frame, heard.arrival)
            return [(stamp, self._frames[stamp], first[stamp]) for stamp in stamps if stamp in first]

    def _frame_of(self, stamp: int, stamps: Sequence[int]) -> int | None:
        """Return the stamp of the frame that a pose belongs to."""
        period = self._source.period * NANOSECONDS
        margin = round(_MARGIN * period)
        if self._source.match == "At":
            after = bisect.bisect_left(stamps, stamp)
            near = min(stamps[max(after - 1, 0) : after + 1], key=lambda one: abs(one - stamp), default=None)
            return near if near is not None and abs(near - stamp) < period / 2 else None
        if self._source.match == "After":
            index = bisect.bisect_left(stamps, stamp - margin) - 1
        else:
            index = bisect.bisect_right(stamps, stamp + margin)
        if not 0 <= index < len(stamps) or abs(stamps[index] - stamp) > period + margin:
            return None
        return stamps[index]

    def metrics(self) -> dict[str, Any]:
        """Return the numbers that become results."""
        found = self.latencies()
        offered = len(self._frames)
        values: dict[str, Any] = {"framesOffered": offered, "posesPublished": len(self._first)}
        if self._source.every:
            values |= {"framesProcessed": len(found), "framesDropped": offered - len(found)}
        if self.broken:
            values["posesBroken"] = self.broken
        if found:
            latencies = sorted((pose - frame) / NANOSECONDS for _, frame, pose in found)
            values["latencySeconds"] = {
                "mean": round(math.fsum(latencies) / len(latencies), 6),
                "median": round(quantile(latencies, 0.5), 6),
                "p95": round(quantile(latencies, 0.95), 6),
                "p99": round(quantile(latencies, 0.99), 6),
                "max": round(latencies[-1], 6),
            }
        return values

    def factor(self, rate: float, *, stepped: bool) -> float | None:
        """Return the real-time factor: the time that the node took over the time it had, None if unknown.

        By the clock it took the time from the first frame to the last pose, that in queues included.
        Stepped it took for each frame the time until its pose, at least that until the next frame; where the
        pose came after the next frame only, as some nodes need that, the time since then or that time stood.

        Args:
            rate: Speed of playback.
            stepped: Whether time stood before each frame until the last one had its pose.
        """
        poses = {stamp: pose for stamp, _, pose in self.latencies()}
        with self._lock:
            frames = sorted(self._frames.items())
        if not poses or len(frames) < 2:
            return None
        had = (frames[-1][0] - frames[0][0]) / rate
        if not stepped:
            end = max(frames[-1][1], *poses.values())
            return round((end - frames[0][1]) / had, 4)
        took = 0.0
        for (stamp, arrival), (later, following) in itertools.pairwise(frames):
            period = (later - stamp) / rate
            came = poses.get(stamp, following)
            held = following - arrival - period
            in_turn = stamp in poses and came <= following
            took += max(came - arrival if in_turn else max(came - following, held), period)
        return round(took / had, 4)

    def table(self) -> str:
        """Return the latencies as CSV: sensor stamp, wall clock of frame and pose, latency, all in s."""
        lines = ["stamp,frame_arrival,pose_arrival,latency\n"]
        offset = round(self._source.time_offset * NANOSECONDS)
        for stamp, frame, pose in self.latencies():
            times = ",".join(seconds_text(value) for value in (stamp + offset, frame, pose))
            lines.append(f"{times},{(pose - frame) / NANOSECONDS:.6f}\n")
        return "".join(lines)


def quantile(values: Sequence[float], share: float) -> float:
    """Return a quantile of sorted values, linear between two of them (Hyndman and Fan's type 7)."""
    place = share * (len(values) - 1)
    low = math.floor(place)
    high = min(low + 1, len(values) - 1)
    return values[low] + (values[high] - values[low]) * (place - low)


def merge_metrics(path: Path, values: dict[str, Any]) -> None:
    """Add numbers to metrics.json; what the algorithm has written there stays."""
    try:
        found = json.loads(read_regular(path))
    except (OSError, ValueError, RecursionError):
        found = {}
    known = found if isinstance(found, dict) else {}
    write_atomically(path, json.dumps(values | known, indent=1) + "\n")


def read_regular(path: Path) -> bytes:
    """Read a file that the algorithm wrote: no link to elsewhere, no pipe to wait on, no endless size."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    with open(descriptor, "rb") as file:  # noqa: PTH123
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode) or status.st_size > _METRICS_BYTES:
            raise ValueError(path)
        return file.read(_METRICS_BYTES)


def write_atomically(path: Path, text: str) -> None:
    """Write a file so that no reader ever sees half of it."""
    temporary = path.with_name(f".{path.name}.part")
    temporary.unlink(missing_ok=True)  # never through a link that someone put there
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)
