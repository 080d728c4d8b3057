# SPDX-License-Identifier: Apache-2.0
"""Recordings of any of the three formats, read through one door.

Everything that reads a bag comes through `Recording`: it turns what third-party parsers raise on
damaged files into one sentence, and finds the header stamp of a message without decoding it.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from slamhive.data.files.damage import remedy
from slamhive.model.algorithm import RecordingFormat
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from pathlib import Path

    import numpy.typing as npt
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

    from slamhive.model.dataset import Dataset

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")

_HEADER = "std_msgs/msg/Header"


@dataclass(frozen=True)
class Topic:
    """A topic of a recording.

    Attributes:
        name: Its name.
        message_type: Type of its messages, in ROS 2 spelling.
        count: Number of messages that the index states.
    """

    name: str
    message_type: str
    count: int


@dataclass(frozen=True, eq=False)
class Scan:
    """The times of a topic's messages, in the order of the recording.

    Attributes:
        times: Record times, ns, shape (n,).
        stamps: Header stamps, ns, shape (n,); the record times where messages carry no header.
        has_header: Whether the stamps are header stamps.
        size_bytes: Size of the messages together.
    """

    times: npt.NDArray[np.int64]
    stamps: npt.NDArray[np.int64]
    has_header: bool
    size_bytes: int


class Recording:
    """An open recording.

    Args:
        paths: Its files, in the order of time.
        recording_format: How it is stored.

    Raises:
        DataError: It is missing, empty, truncated or of another format.
    """

    def __init__(self, paths: Sequence[Path], recording_format: RecordingFormat) -> None:
        self.paths = list(paths)
        self.format = recording_format
        for path in self.paths:
            _check_path(path, recording_format)
        # Most commands know of recordings without reading one, and this takes a third of a second.
        from rosbags.highlevel import AnyReader  # noqa: PLC0415
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

        store = Stores.ROS1_NOETIC if recording_format is RecordingFormat.ROSBAG1 else Stores.ROS2_HUMBLE
        try:
            self._reader = AnyReader(self.paths, default_typestore=get_typestore(store))
            self._reader.open()
        except Exception as error:  # noqa: BLE001 - parsers raise anything on hostile bytes
            raise self._unreadable(error, indexed=False) from None
        try:
            self.topics = self._topics()
        except BaseException:
            self._reader.close()
            raise

    @property
    def label(self) -> str:
        """Return the name of the recording for messages to the user."""
        return ", ".join(str(path) for path in self.paths)

    @property
    def is_ros2(self) -> bool:
        """Tell whether messages are serialised as ROS 2 does it."""
        return self._reader.is2

    @property
    def typestore(self) -> Typestore:
        """Return the message types of the recording."""
        return self._reader.typestore

    @property
    def connections(self) -> list[Connection]:
        """Return the connections of the recording: a topic may have several."""
        return self._reader.connections

    @property
    def start_ns(self) -> int:
        """Return the time of the first record, ns."""
        return int(self._reader.start_time)

    @property
    def seconds(self) -> float:
        """Return the time from the first record to the last, s."""
        return float(self._reader.duration) / 1e9

    def messages(
        self, topics: Collection[str], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Read the messages of some topics in the order of their record times (ns).

        Args:
            topics: Their names.
            start: Record time from which messages are read, ns; None for all.
            stop: Record time before which they are, ns; None for all.

        Raises:
            DataError: The recording breaks off or its content is damaged.
        """
        chosen = [connection for connection in self.connections if connection.topic in topics]
        if not chosen:
            return
        messages = self._reader.messages(chosen, start, stop)
        while True:
            try:
                item = next(messages)
            except StopIteration:
                return
            except Exception as error:  # noqa: BLE001 - parsers raise anything on hostile bytes
                raise self._unreadable(error, indexed=True) from None
            yield item

    def decode(self, raw: bytes, message_type: str) -> Any:
        """Decode a message.

        Raises:
            DataError: The bytes are no such message.
        """
        try:
            return self._reader.deserialize(raw, message_type)
        except Exception as error:  # noqa: BLE001 - parsers raise anything on hostile bytes
            raise DataError(
                f"{self.label}: a message of type {message_type} is damaged ({_said(error)})"
            ) from None

    def first(self, topic: str) -> Any:
        """Return the first message of a topic.

        Raises:
            DataError: There is none, or it is damaged.
        """
        for connection, _, raw in self.messages({topic}):
            return self.decode(raw, connection.msgtype)
        raise DataError(f"{topic} in {self.label}: no messages")

    def encode(self, message: Any, message_type: str) -> memoryview:
        """Encode a message as the recording does it."""
        if self.is_ros2:
            return self.typestore.serialize_cdr(message, message_type)
        return self.typestore.serialize_ros1(message, message_type)

    def has_header(self, message_type: str) -> bool:
        """Tell whether messages of a type begin with a header."""
        fields = self.typestore.fielddefs.get(message_type, (None, []))[1]
        return bool(fields) and fields[0][1][1] == _HEADER

    def stamp_reader(self, message_type: str) -> Callable[[bytes], int] | None:
        """Return a function that finds the header stamp (ns) in a raw message, None for types without one."""
        if not self.has_header(message_type):
            return None
        return _ros2_stamp if self.is_ros2 else _ros1_stamp

    def scan(
        self, topics: Collection[str], progress: Callable[[float], None] | None = None
    ) -> dict[str, Scan]:
        """Read the times of all messages of some topics.

        Args:
            topics: What to scan.
            progress: Called with the share of the messages that are read, 0 to 1, now and then.

        Raises:
            DataError: The recording is damaged.
        """
        readers = {name: self.stamp_reader(self.topics[name].message_type) for name in topics}
        times: dict[str, list[int]] = {name: [] for name in topics}
        stamps: dict[str, list[int]] = {name: [] for name in topics}
        sizes = dict.fromkeys(topics, 0)
        total = max(1, sum(self.topics[name].count for name in topics))
        for number, (connection, time, raw) in enumerate(self.messages(topics)):
            name = connection.topic
            reader = readers[name]
            times[name].append(time)
            try:
                stamps[name].append(time if reader is None else reader(raw))
            except struct.error:
                raise DataError(
                    f"{self.label}: {name}: message {len(times[name])} is cut off after {len(raw)} bytes"
                ) from None
            sizes[name] += len(raw)
            if progress and number % 256 == 0:
                progress(min(1.0, number / total))
        return {
            name: Scan(np.array(times[name]), np.array(stamps[name]), readers[name] is not None, sizes[name])
            for name in topics
        }

    def close(self) -> None:
        """Close the files."""
        self._reader.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _topics(self) -> dict[str, Topic]:
        topics: dict[str, Topic] = {}
        for connection in self.connections:
            name = connection.topic
            before = topics.get(name)
            if before and before.message_type != connection.msgtype:
                raise DataError(
                    f"{self.label}: the topic {name} has messages of two types, {before.message_type} and "
                    f"{connection.msgtype}"
                )
            topics[name] = Topic(
                name, connection.msgtype, connection.msgcount + (before.count if before else 0)
            )
        if not any(topic.count for topic in topics.values()):
            raise DataError(f"{self.label}: empty: there is no message in it; record it again")
        return topics

    def _unreadable(self, error: Exception, *, indexed: bool) -> DataError:
        hints = dict.fromkeys(remedy(path, indexed=indexed) for path in self.paths)
        return DataError(f"{self.label}: can't be read as {self.format} ({_said(error)}): {'; '.join(hints)}")


def recording_paths(dataset: Dataset, root: Path) -> list[Path]:
    """Return the files of a dataset's recording.

    Raises:
        DataError: The dataset is a synthetic one that was not made yet.
    """
    files = dataset.spec.recording.files
    if not files:
        raise DataError(f"dataset {dataset.name!r}: its synthetic recording was not made yet")
    return [root / file.path for file in files]


def open_recording(dataset: Dataset, root: Path) -> Recording:
    """Open the recording of a dataset.

    Args:
        dataset: The dataset.
        root: The folder that its paths start from.

    Raises:
        DataError: It is missing, empty, truncated or of another format.
    """
    return Recording(recording_paths(dataset, root), dataset.spec.recording.format)


def guess_format(path: Path) -> RecordingFormat:
    """Tell the format of a recording by what lies at its path.

    Raises:
        DataError: There is nothing, or nothing known.
    """
    if not path.exists():
        raise DataError(f"{path}: no such file or folder")
    if path.is_dir() and (path / "metadata.yaml").is_file():
        return RecordingFormat.ROSBAG2
    if path.suffix == ".bag":
        return RecordingFormat.ROSBAG1
    if path.suffix == ".mcap":
        return RecordingFormat.MCAP
    if path.suffix == ".rawlog":
        raise DataError(
            f"{path}: rawlogs of MRPT aren't read; convert it to a ROS bag, or take the CARMEN log of the "
            "same recording (.log, .clf), if there is one"
        )
    raise DataError(
        f"{path}: not a recording: a ROS 1 bag ends in .bag, an MCAP file in .mcap, a ROS 2 bag is a folder "
        "with metadata.yaml"
    )


def _check_path(path: Path, recording_format: RecordingFormat) -> None:
    found = guess_format(path)
    if found is not recording_format:
        raise DataError(f"{path}: recording.format says {recording_format}, but this is {found}")
    if path.is_file() and path.stat().st_size == 0:
        raise DataError(f"{path}: an empty file of 0 bytes; copy or record it again")


def _ros1_stamp(raw: bytes) -> int:
    seconds, nanoseconds = struct.unpack_from("<II", raw, 4)
    return int(seconds) * 10**9 + int(nanoseconds)


def _ros2_stamp(raw: bytes) -> int:
    order = "<" if raw[1] & 1 else ">"
    seconds, nanoseconds = struct.unpack_from(f"{order}iI", raw, 4)
    return int(seconds) * 10**9 + int(nanoseconds)


def _said(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 160 else text[:160] + "…"
