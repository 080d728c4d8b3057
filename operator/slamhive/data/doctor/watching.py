# SPDX-License-Identifier: Apache-2.0
"""Watching of a recording: all its messages pass once, and each watcher gathers what it judges by.

A watcher is of one sensor. What is judged between sensors, such as clocks, is judged when all have passed,
from what their watchers gathered.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from rosbags.interfaces import Connection

    from slamhive.data.doctor.findings import Finding
    from slamhive.data.recordings.reading import Recording, Scan
    from slamhive.model.dataset import DatasetSpec
    from slamhive.model.sensors import Sensor


class PassingMessage:
    """A message that passes; it is decoded once, for all who ask.

    Attributes:
        index: Its number among the messages of its topic, from 0.
        time: Record time, ns.
        stamp: Header stamp, ns; the record time where there is no header.
        raw: Its bytes.
    """

    __slots__ = ("_decode", "_decoded", "index", "raw", "stamp", "time")

    def __init__(self, index: int, time: int, stamp: int, raw: bytes, decode: Callable[[bytes], Any]) -> None:
        self.index, self.time, self.stamp, self.raw = index, time, stamp, raw
        self._decode = decode
        self._decoded: Any = None

    @property
    def decoded(self) -> Any:
        """Return the message.

        Raises:
            DataError: The bytes are no such message.
        """
        if self._decoded is None:
            self._decoded = self._decode(self.raw)
        return self._decoded


@dataclass(frozen=True)
class WatchedSensor:
    """A sensor of a dataset whose messages are watched.

    Attributes:
        name: Its name.
        sensor: The sensor as declared.
        message_type: Type of its messages.
        messages: Their number, as the index states it; of a sample, how many that has at most.
        spec: The dataset's spec, for what a judgement needs of other sensors.
    """

    name: str
    sensor: Sensor
    message_type: str
    messages: int
    spec: DatasetSpec

    @property
    def where(self) -> str:
        """Return the sensor's field, for sentences."""
        return f"sensors.{self.name}"

    def seconds(self, stamp: int) -> float:
        """Return the sensor time of a header stamp (ns), s."""
        return stamp / 1e9 + self.sensor.time_offset


class MessageWatcher:
    """Gatherer over the messages of one sensor; a subclass says what it takes and what it finds.

    Attributes:
        of: the sensor.
        repeated: indices of messages that are the one before them again.
    """

    def __init__(self, of: WatchedSensor) -> None:
        self.of = of
        self.repeated: list[int] = []

    def take(self, message: PassingMessage) -> None:
        """Take in a message.

        Raises:
            DataError: It is damaged: the sensor's other messages go on without this watcher.
        """
        raise NotImplementedError

    def findings(self) -> Iterable[Finding]:
        """Yield the findings of the messages, once all have passed."""
        return ()


@dataclass(frozen=True)
class WatchedRecording:
    """Result of watching: times by topic, watchers by sensor, and what ended one early.

    Attributes:
        scans: Times of the messages by topic.
        watchers: By sensor, in the order of the dataset.
        broken: A sentence for each watcher that a message ended.
    """

    scans: Mapping[str, Scan]
    watchers: Mapping[str, Sequence[MessageWatcher]]
    broken: list[str] = field(default_factory=list)


def watch(
    recording: Recording,
    watchers: Mapping[str, Sequence[MessageWatcher]],
    topics: Mapping[str, str],
    progress: Callable[[float], None] | None = None,
    messages: Iterable[tuple[Connection, int, bytes]] | None = None,
) -> WatchedRecording:
    """Read all messages of sensors once, and hand each to the watchers of its sensors.

    Args:
        recording: The recording.
        watchers: By sensor.
        topics: The topic of each sensor.
        progress: Called with the share of the messages that are read, 0 to 1, now and then.
        messages: Those that pass; None for all.

    Raises:
        DataError: The recording is damaged.
    """
    names = set(topics.values())
    living = {
        topic: [one for name in topics if topics[name] == topic for one in watchers.get(name, ())]
        for topic in names
    }
    broken: list[str] = []

    def see(connection: Connection, index: int, time: int, stamp: int, raw: bytes) -> None:
        decode = partial(recording.decode, message_type=connection.msgtype)
        message = PassingMessage(index, time, stamp, raw, decode)
        for watcher in living[connection.topic][:]:
            try:
                watcher.take(message)
            except DataError as error:
                living[connection.topic].remove(watcher)
                broken.append(f"{watcher.of.where}: message {index + 1}: {error}")

    return WatchedRecording(recording.scan(names, progress, see, messages), watchers, broken)
