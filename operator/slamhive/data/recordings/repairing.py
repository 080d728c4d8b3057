# SPDX-License-Identifier: Apache-2.0
"""Recordings under the repair of their dataset: whoever opens one by its dataset sees the clean stream.

What is left out, and what the stamps become, is known when a recording is opened; what is in a message is
changed as it passes. Files are never touched.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from dataclasses import dataclass, replace
from functools import partial
from heapq import merge
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.recordings.clouds import move_point_times, retime_points, returned_points
from slamhive.data.recordings.kinds import IMU, KINDS
from slamhive.data.recordings.reading import Recording, recording_paths
from slamhive.data.recordings.streams import camera_info_topic
from slamhive.model.errors import DataError, suggestion
from slamhive.model.repair import BackwardStamps
from slamhive.model.sensors import SensorType

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping
    from pathlib import Path

    import numpy.typing as npt
    from rosbags.interfaces import Connection

    from slamhive.data.recordings.reading import Scan
    from slamhive.model.dataset import Dataset
    from slamhive.model.repair import ClockRepair, SensorRepair
    from slamhive.model.sensors import Sensor

    Numbers = npt.NDArray[np.float64]
    Times = npt.NDArray[np.int64]
    Change = Callable[[int, bytes | bytearray], bytes | bytearray | memoryview]

END_OF_STAMPS = 2**31 * 10**9
"""Stamp that messages of ROS 2 can't have any more, ns."""
_SAME_INSTANT = 1000
"""Nanoseconds by which record times that were made of stamps may differ from them: digits of a float."""
IMU_NUMBERS, IMU_RATE, IMU_FORCE = 37, slice(13, 16), slice(25, 28)
"""float64 at the end of a sensor_msgs/Imu, and the places of its turning rates and specific forces."""
FORCES: dict[str, Callable[[Any], Any]] = {
    IMU: lambda message: message.linear_acceleration,
    "geometry_msgs/msg/AccelStamped": lambda message: message.accel.linear,
    "geometry_msgs/msg/AccelWithCovarianceStamped": lambda message: message.accel.accel.linear,
    "geometry_msgs/msg/Vector3Stamped": lambda message: message.vector,
}
"""Messages that specific forces can be taken from."""


def open_recording(dataset: Dataset, root: Path) -> Recording:
    """Open the recording of a dataset, as its repair leaves it.

    Args:
        dataset: The dataset.
        root: The folder that its paths start from.

    Raises:
        DataError: It is missing, empty, truncated or of another format, or lacks what its repair names.
    """
    if not dataset.spec.topic_repairs:
        return Recording(recording_paths(dataset, root), dataset.spec.recording.format, _scan_topics(dataset))
    return RepairedRecording(dataset, root)


def _scan_topics(dataset: Dataset) -> set[str]:
    """Return the topics of a dataset's LiDARs, whose scans pass as PointCloud2."""
    return {one.topic for one in dataset.spec.sensors.values() if one.type is SensorType.LIDAR}


@dataclass(frozen=True, eq=False)
class _Clock:
    """Fate of the messages of a topic, by their numbers: kept or not, stamps, record times.

    Attributes:
        scan: Their times as recorded.
        kept: Which are kept, shape (n,).
        stamps: Their stamps afterwards, ns, shape (n,).
        times: Their record times afterwards, ns, shape (n,).
    """

    scan: Scan
    kept: npt.NDArray[np.bool_]
    stamps: Times
    times: Times

    def number(self, time: int | None) -> int:
        """Return the number of the first message from a record time on, as recorded."""
        return 0 if time is None else int(np.searchsorted(self.scan.times, time))

    def as_recorded(self, time: int | None) -> int | None:
        """Return the record time that a message had which has this one now, or later."""
        if time is None:
            return None
        number = int(np.searchsorted(self.times, time))
        return int(self.scan.times[number] if number < len(self.times) else self.scan.times[-1] + 1)


class RepairedRecording(Recording):
    """An open recording whose messages pass under the repair of its dataset.

    Record times stay, so that what reached the disk late still does; those that were made of the stamps, as
    converters do, move with them.

    Args:
        dataset: The dataset.
        root: The folder that its paths start from.

    Raises:
        DataError: As of `Recording`; or the repair names a topic that isn't there, or leaves no message.
    """

    def __init__(self, dataset: Dataset, root: Path) -> None:
        super().__init__(recording_paths(dataset, root), dataset.spec.recording.format, _scan_topics(dataset))
        self._clocks: dict[str, _Clock] = {}
        self._changes: dict[str, list[Change]] = {}
        self._moved: set[str] = set()
        try:
            self._plan_all(dataset.spec.sensors, dataset.spec.topic_repairs)
        except BaseException:
            self.close()
            raise
        self._moved = {
            topic
            for topic, clock in self._clocks.items()
            if not np.array_equal(clock.times, clock.scan.times)
        }

    @property
    def start_ns(self) -> int:
        """Return a time before which there is no record, ns."""
        return min([super().start_ns, *(int(self._clocks[topic].times[0]) for topic in self._moved)])

    @property
    def seconds(self) -> float:
        """Return the time from `start_ns` to one after which there is no record, s."""
        end = super().start_ns + round(super().seconds * 1e9)
        ends = [end, *(int(self._clocks[topic].times[-1]) for topic in self._moved)]
        return (max(ends) - self.start_ns) / 1e9

    def messages(
        self, topics: Collection[str], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Read the repaired messages of some topics; arguments and errors as of `Recording.messages`."""
        moved = sorted(self._moved & {*topics})
        streams = [self._repaired({*topics}.difference(moved), start, stop)]
        for topic in moved:
            clock = self._clocks[topic]
            streams.append(self._repaired({topic}, clock.as_recorded(start), clock.as_recorded(stop)))
        return merge(*streams, key=lambda message: message[1]) if moved else streams[0]

    def _repaired(
        self, topics: Collection[str], start: int | None, stop: int | None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield repaired messages in the order as recorded, between record times as they were."""
        clocks = {topic: self._clocks[topic] for topic in topics if topic in self._clocks}
        numbers = {topic: clock.number(start) - 1 for topic, clock in clocks.items()}
        for connection, time, raw in super().messages(topics, start, stop):
            topic, number, at = connection.topic, -1, time
            if topic in clocks:
                number = numbers[topic] = numbers[topic] + 1
                if not clocks[topic].kept[number]:
                    continue
                at = int(clocks[topic].times[number])
            changed: Any = raw
            for change in self._changes.get(topic, ()):
                changed = change(number, changed)
            yield connection, at, changed if changed is raw else bytes(changed)

    def _plan_all(self, sensors: Mapping[str, Sensor], repairs: Mapping[str, SensorRepair]) -> None:
        """Note what is done with the messages of each sensor, and with its camera_info."""
        clocks: dict[str, _Clock] = {}
        changes: dict[str, list[Change]] = {}
        for name, sensor in sensors.items():
            topic, repair = self.topics.get(sensor.topic), repairs.get(sensor.topic)
            # Topics that aren't there, or are of another type, `check_topic` tells of.
            if repair is None or topic is None or topic.name in changes:
                continue
            if topic.message_type not in KINDS[sensor.type].messages:
                continue
            clock, changes[topic.name] = self._plan(f"repair.sensors.{name}", sensor, repair)
            if clock is None:
                continue
            clocks[topic.name] = clock
            info = camera_info_topic(self, topic.name) if sensor.camera else None
            if info is not None and info not in clocks:
                clocks[info] = _following(clock, self.scan([info])[info], repair)
                changes[info] = [self._restamped(clocks[info].stamps)]
        # At once, as all that was read for it is as recorded.
        self._clocks, self._changes = clocks, changes
        for topic_name, clock in clocks.items():
            self.topics[topic_name] = replace(self.topics[topic_name], count=int(clock.kept.sum()))

    def _plan(self, where: str, sensor: Sensor, repair: SensorRepair) -> tuple[_Clock | None, list[Change]]:
        """Return the fate of a sensor's messages, and the changes of each."""
        changes: list[Change] = []
        clock = self._clock(sensor.topic, repair, where)
        if sensor.type is SensorType.LIDAR:
            later = None if clock is None else clock.stamps - clock.scan.stamps
            changes += self._cloud_changes(sensor, repair, later)
        if repair.forces is not None and clock is not None:
            clock, forces = self._joined(sensor.topic, clock, repair, where)
            changes.append(lambda number, raw: self._sample(raw, IMU_FORCE, lambda _: forces[number]))
        for places, scale in ((IMU_FORCE, repair.force_scale), (IMU_RATE, repair.rate_scale)):
            if scale is not None:
                changes.append(partial(self._scaled, places, scale))
        if clock is not None:
            changes.append(self._restamped(clock.stamps))
        return clock, changes

    def _cloud_changes(self, sensor: Sensor, repair: SensorRepair, later: Times | None) -> Iterator[Change]:
        """Yield the change of a LiDAR's points, where there is one: with the stamps go absolute times."""
        kind = self.topics[sensor.topic].message_type
        field = sensor.lidar.time_field if sensor.lidar else None
        where = f"{sensor.topic} in {self.label}"
        moves = False
        if later is not None and field is not None and repair.point_times is None:
            first = self.first(sensor.topic)
            moves = move_point_times(first, field, 1, where) is not first

        def change(number: int, raw: bytes | bytearray) -> Any:
            message = self.decode(bytes(raw), kind)
            if repair.point_times is not None:
                message = retime_points(message, str(field), str(repair.point_times), where)
            elif moves and later is not None:
                message = move_point_times(message, str(field), int(later[number]), where)
            return self.encode(returned_points(message, where, field) if repair.no_returns else message, kind)

        if repair.point_times is not None or repair.no_returns or moves:
            yield change

    def _clock(self, topic: str, repair: SensorRepair, where: str) -> _Clock | None:
        """Return the fate of a topic's messages; None where all stay as stamped."""
        wanted = (repair.shift, repair.drift, repair.stamps, repair.drop_leading, repair.forces)
        if not repair.drop and all(one is None for one in wanted):
            return None
        scan = self.scan([topic])[topic]
        kept = np.ones(len(scan.stamps), dtype=np.bool_)
        kept[: repair.drop_leading or 0] = False
        beyond = [number for number in repair.drop if not 0 <= number < len(kept)]
        if beyond:
            raise DataError(
                f"{where}.drop: there is no message {beyond[0]} of {topic} in {self.label}, which has "
                f"{len(kept)}, counted from 0"
            )
        kept[repair.drop] = False
        clock = _clocked(scan, kept, repair)
        if not clock.kept.any():
            raise DataError(f"{where}: it leaves none of {len(kept)} messages of {topic} in {self.label}")
        wrong = clock.stamps[clock.kept & ((clock.stamps < 0) | (clock.stamps >= END_OF_STAMPS))]
        if wrong.size:
            raise DataError(
                f"{where}: a stamp of {topic} in {self.label} would be {wrong[0] / 1e9:g} s, which no "
                "message can have"
            )
        return clock

    def _joined(
        self, topic: str, clock: _Clock, repair: SensorRepair, where: str
    ) -> tuple[_Clock, npt.NDArray[np.float64]]:
        """Return the samples within the span of the forces, and these at each sample, shape (n, 3)."""
        name = str(repair.forces)
        found = self.topics.get(name)
        others = [one for one in self.topics.values() if one.name != topic]
        fitting = [one.name for one in others if one.message_type in FORCES]
        if found is None or not found.count:
            raise DataError(
                f"{where}.forces: no messages of a topic {name!r} in {self.label}{suggestion(name, fitting)}"
            )
        if found.message_type not in FORCES:
            raise DataError(
                f"{where}.forces: {name} has messages of type {found.message_type}; allowed: "
                f"{', '.join(FORCES)}"
            )
        take, rows = FORCES[found.message_type], []
        for connection, _, raw in self.messages({name}):
            vector = take(self.decode(raw, connection.msgtype))
            rows.append((vector.x, vector.y, vector.z))
        other = _clocked(self.scan([name])[name], np.ones(len(rows), dtype=np.bool_), repair, moved=False)
        order = np.argsort(other.stamps[other.kept], kind="stable")
        stamps, table = other.stamps[other.kept][order], np.array(rows)[other.kept][order]
        at = _clocked(clock.scan, clock.kept, repair, moved=False).stamps
        within = clock.kept & (at >= stamps[0]) & (at <= stamps[-1])
        if not within.any():
            raise DataError(
                f"{where}.forces: no message of {topic} is within the time of {name}'s in {self.label}"
            )
        wanted, known = (at - stamps[0]).astype(np.float64), (stamps - stamps[0]).astype(np.float64)
        forces = np.column_stack([np.interp(wanted, known, column) for column in table.T])
        return replace(clock, kept=within), forces

    def _restamped(self, stamps: Times) -> Change:
        return lambda number, raw: restamped(raw, int(stamps[number]), is_ros2=self.is_ros2)

    def _scaled(self, places: slice, scale: float, _: int, raw: bytes | bytearray) -> bytearray:
        return self._sample(raw, places, lambda numbers: numbers * scale)

    def _sample(
        self, raw: bytes | bytearray, places: slice, become: Callable[[Numbers], Numbers]
    ) -> bytearray:
        return changed_sample(raw, places, become, is_ros2=self.is_ros2)


def restamped(raw: bytes | bytearray, stamp: int, *, is_ros2: bool) -> bytearray:
    """Return a message that begins with a header, with another stamp (ns)."""
    changed = bytearray(raw)
    form = "iI" if is_ros2 else "II"
    struct.pack_into(f"{_order(changed, is_ros2=is_ros2)}{form}", changed, 4, *divmod(stamp, 10**9))
    return changed


def changed_sample(
    raw: bytes | bytearray, places: slice, become: Callable[[Numbers], Numbers], *, is_ros2: bool
) -> bytearray:
    """Return a sample of an IMU with some of its numbers changed, `IMU_RATE` or `IMU_FORCE`."""
    changed = bytearray(raw)
    order = _order(changed, is_ros2=is_ros2)
    numbers = np.frombuffer(changed, f"{order}f8", IMU_NUMBERS, len(changed) - 8 * IMU_NUMBERS)
    numbers[places] = become(numbers[places])
    return changed


def _order(raw: bytearray, *, is_ros2: bool) -> str:
    """Return the order of a message's bytes, as `struct` writes it."""
    return ">" if is_ros2 and not raw[1] & 1 else "<"


def _clocked(scan: Scan, kept: npt.NDArray[np.bool_], repair: SensorRepair, *, moved: bool = True) -> _Clock:
    """Return the stamps of messages after a repair; without shift and drift where they aren't `moved`."""
    stamps, kept = scan.stamps, kept.copy()
    if repair.stamps is BackwardStamps.RECORDED:
        # Whole numbers: float64 has 256 ns at the times of today.
        stamps = scan.times + np.sort(stamps - scan.times)[len(stamps) // 2]
    elif repair.stamps is BackwardStamps.DROP:
        numbers = np.flatnonzero(kept)
        kept[numbers] = False
        kept[numbers[longest_run(stamps[numbers])]] = True
    if not moved or not kept.any():
        return _Clock(scan, kept, stamps, scan.times)
    shifted = _shifted(stamps, int(stamps[kept][0]), repair)
    return _Clock(scan, kept, shifted, _moved_times(scan, shifted - stamps))


def _shifted(stamps: Times, first: int, repair: ClockRepair) -> Times:
    drifted = np.rint((stamps - first) * (repair.drift or 0.0)).astype(np.int64)
    return np.asarray(stamps + drifted + round((repair.shift or 0.0) * 1e9))


def longest_run(stamps: Times) -> npt.NDArray[np.intp]:
    """Return the places of the longest of all rows of stamps that never go back (patience sorting).

    So one stamp that is ahead goes itself, and not all that come after it.
    """
    tops: list[int] = []
    ends: list[int] = []
    before = np.full(len(stamps), -1, dtype=np.intp)
    for place, stamp in enumerate(stamps.tolist()):
        pile = bisect_right(tops, stamp)
        if pile:
            before[place] = ends[pile - 1]
        tops[pile : pile + 1], ends[pile : pile + 1] = [stamp], [place]
    run = [ends[-1]] if ends else []
    while run and before[run[-1]] >= 0:
        run.append(int(before[run[-1]]))
    return np.array(run[::-1], dtype=np.intp)


def _following(images: _Clock, scan: Scan, repair: ClockRepair) -> _Clock:
    """Return the fate of camera_info: that of the image of the same stamp."""
    stay, before = images.kept, images.scan.stamps
    kept = dict(zip(before[stay].tolist(), images.stamps[stay].tolist(), strict=True))
    lost = {*before[~stay].tolist()} - kept.keys()
    # Others, such as a latched one, belong to no image; one that nobody stamped stays so.
    alone = np.where(scan.stamps > 0, _shifted(scan.stamps, int(before[stay][0]), repair), scan.stamps)
    given = zip(scan.stamps.tolist(), alone.tolist(), strict=True)
    stamps = np.array([kept.get(stamp, other) for stamp, other in given], dtype=np.int64)
    stays = np.array([stamp not in lost for stamp in scan.stamps.tolist()], dtype=np.bool_)
    return _Clock(scan, stays, stamps, _moved_times(scan, stamps - scan.stamps))


def _moved_times(scan: Scan, later: Times) -> Times:
    """Return record times: as they are, or later by so much where they were made of the stamps."""
    are_stamps = bool((np.abs(scan.times - scan.stamps) <= _SAME_INSTANT).all())
    return np.asarray(scan.times + later) if are_stamps else scan.times
