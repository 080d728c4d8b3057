# SPDX-License-Identifier: Apache-2.0
"""Recordings of any of the three formats, read through one door.

Everything that reads a bag comes through `Recording`: it turns what third-party parsers raise on
damaged files into one sentence, and finds the header stamp of a message without decoding it.
"""

from __future__ import annotations

import re
import struct
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from slamhive.data.files.damage import remedy
from slamhive.data.recordings.kinds import POINT_CLOUD
from slamhive.data.recordings.lidarformats import add_point_cloud, is_livox, livox_cloud, packets_text
from slamhive.model.algorithm import RecordingFormat
from slamhive.model.errors import DataError
from slamhive_eval.formats.notices import NotDamagedError, Notice

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
    from pathlib import Path

    import numpy.typing as npt
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

    from slamhive.model.dataset import Dataset
    from slamhive_eval.formats.rosreading import PieceSpan

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")

LITTLE_ENDIAN, BIG_ENDIAN = b"\0\1", b"\0\0"
"""First bytes of a message in plain CDR, by the order of its bytes (OMG RTPS 10.2)."""

_HEADER = "std_msgs/msg/Header"
_TYPE = re.compile(r"\w+/msg/\w+")
_TRANSIENT_LOCAL = 1
_PIECE = re.compile(r"(.+)_(\d+)\.(bag|db3|mcap)")
"""Names of the pieces of a split recording, as recorders of ROS 1 and ROS 2 number them."""
_LATER = re.compile(r"_0*[1-9]\d*\.(db3|mcap)$")

_OTHERS = {
    ".rawlog": "rawlogs of MRPT aren't read; convert it to a ROS bag, or take the CARMEN log of the same "
    "recording (.log, .clf), if there is one",
    ".bag.active": "a bag whose recorder was killed: copy it to a name that ends in .bag, and "
    "`rosbag reindex` on that copy closes it",
    **dict.fromkeys(
        (".db3.zstd", ".mcap.zstd"),
        "a compressed file of a ROS 2 bag: add its folder, whose metadata.yaml says so, or unpack it: "
        "`zstd -d {}`",
    ),
}
"""Remedies for files that are no recordings, by their endings."""


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
        paths: Its files, in any order.
        recording_format: How it is stored.
        scans: Topics on which Livox's scans are read as PointCloud2; None: all that have them. To those that
            ask for another topic its messages pass as they are.

    Attributes:
        topics: Its topics by name.
        notices: What was noticed of its files when they were opened, each with its finding's code.

    Raises:
        DataError: It is missing, empty, truncated or of another format.
    """

    def __init__(
        self, paths: Sequence[Path], recording_format: RecordingFormat, scans: Collection[str] | None = None
    ) -> None:
        self.paths = list(paths)
        self.format = recording_format
        for path in self.paths:
            _check_path(path, recording_format)
        # Most commands know of recordings without reading one, and this takes a third of a second.
        from slamhive_eval.formats.rosreading import RosReader  # noqa: PLC0415

        try:
            self._reader = RosReader(self.paths, is_ros1=recording_format is RecordingFormat.ROSBAG1)
            self._reader.open()
        except Exception as error:  # noqa: BLE001 - parsers raise anything on hostile bytes
            raise self._unreadable(error, indexed=False) from None
        try:
            self._livox = self._livox_topics(scans)
            self.topics = self._topics()
            times = self._reader.pieces
            ordered = sorted(times, key=lambda piece: piece.start)
            self._overlaps = [
                (before, after) for before, after in pairwise(ordered) if after.start < before.end - 1
            ]
            self.notices = [*self._reader.notices, *self._order(times, ordered), *self._neighbours()]
            self.notices += self._formats()
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
        return [self._shown(connection) for connection in self._reader.connections]

    @property
    def is_converted(self) -> bool:
        """Tell whether some messages pass in another form than the files have them."""
        return bool(self._livox)

    @property
    def foreign(self) -> dict[str, str]:
        """Return topics that are left out, as their channels aren't ROS 2's, and what those are."""
        return self._reader.foreign

    @property
    def is_playable(self) -> bool:
        """Tell whether a program plays its files as they are that knows but CDR, and what is in them.

        Each topic has one type, defined in the file, and messages in CDR of this machine's order; what has to
        be latched is; and nothing is compressed, split over files, or said wrongly by the files.
        """
        if self.is_converted or len(self.paths) > 1 or self._reader.is_compressed:
            return False
        if any(notice.code.startswith("files.") for notice in self.notices):
            return False
        connections = self._reader.connections
        if self.format is RecordingFormat.ROSBAG2 and not self.paths[0].is_dir():
            return False
        one_each = len(connections) == len(self.topics)
        return one_each and all(map(self._is_plain, connections)) and self._is_whole()

    def undefined(self, message_type: str) -> str | None:
        """Return the type that has no definition: this one, or that of a field; None where all have one."""
        from slamhive_eval.formats.rosreading import parts_of  # noqa: PLC0415 - as in `__init__`

        waiting, seen = [message_type], {message_type}
        while waiting:
            name = waiting.pop()
            definition = self.typestore.fielddefs.get(name)
            if definition is None:
                return name
            waiting += [part for part in parts_of(definition) if part not in seen]
            seen.update(waiting)
        return None

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
        chosen = [connection for connection in self._reader.connections if connection.topic in topics]
        if not chosen:
            return
        messages: Iterator[tuple[Connection, int, bytes]] = self._reader.messages(chosen, start, stop)
        if self._overlaps:
            messages = _each_once(messages)
        while True:
            try:
                item = next(messages)
            except StopIteration:
                return
            except Exception as error:  # noqa: BLE001 - parsers raise anything on hostile bytes
                raise self._unreadable(error, indexed=True) from None
            yield self._as_cloud(*item) if item[0].topic in self._livox else item

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

    def some(self, topic: str, number: int) -> list[Any]:
        """Return messages of a topic spread over the recording: the first, and up to so many in all.

        Damaged ones are left out but for the first.

        Raises:
            DataError: There is none, or the first is damaged.
        """
        found = [self.first(topic)]
        last = None
        for k in range(1, number):
            start = self.start_ns + round(1e9 * self.seconds * k / number)
            with suppress(DataError):
                for connection, time, raw in self.messages({topic}, start):
                    if time != last:
                        last = time
                        found.append(self.decode(raw, connection.msgtype))
                    break
        return found

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
        self,
        topics: Collection[str],
        progress: Callable[[float], None] | None = None,
        see: Callable[[Connection, int, int, int, bytes], None] | None = None,
        messages: Iterable[tuple[Connection, int, bytes]] | None = None,
    ) -> dict[str, Scan]:
        """Read the times of all messages of some topics.

        Args:
            topics: What to scan.
            progress: Called with the share of the messages that are read, 0 to 1, now and then.
            see: Called with each message: its connection, its number on the topic from 0, its record time and
                stamp (ns), and its bytes.
            messages: Those that are read; None for all.

        Raises:
            DataError: The recording is damaged.
        """
        readers = {name: self.stamp_reader(self.topics[name].message_type) for name in topics}
        times: dict[str, list[int]] = {name: [] for name in topics}
        stamps: dict[str, list[int]] = {name: [] for name in topics}
        sizes = dict.fromkeys(topics, 0)
        total = max(1, sum(self.topics[name].count for name in topics))
        passing = self.messages(topics) if messages is None else messages
        for number, (connection, time, raw) in enumerate(passing):
            name = connection.topic
            reader = readers[name]
            times[name].append(time)
            try:
                stamp = time if reader is None else reader(raw)
            except struct.error:
                raise DataError(
                    f"{self.label}: {name}: message {len(times[name])} is cut off after {len(raw)} bytes"
                ) from None
            stamps[name].append(stamp)
            sizes[name] += len(raw)
            if see is not None:
                see(connection, len(stamps[name]) - 1, time, stamp, raw)
            if progress and number % 64 == 0:
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

    def _is_whole(self) -> bool:
        """Tell whether a plain reader finds all messages in order: it believes indexes and summaries."""
        from rosbags.rosbag2 import Reader  # noqa: PLC0415 - as in `__init__`

        with suppress(Exception), Reader(self.paths[0]) as reader:
            storage: Any = reader.storage
            files = getattr(storage, "storages", [storage])
            # Without an index an MCAP file's messages are read as they lie.
            indexed = all(getattr(one, "chunks", True) for one in files)
            return indexed and bool(
                reader.message_count == sum(topic.count for topic in self.topics.values())
            )
        return False

    def _is_plain(self, connection: Connection) -> bool:
        if connection.msgdef.format.name != "MSG" or not _TYPE.fullmatch(connection.msgtype):
            return False
        if connection.topic == "/tf_static" and not is_latched(connection):
            return False
        first = next(self.messages({connection.topic}), None)
        return first is None or bytes(first[2][:2]) == LITTLE_ENDIAN

    def _livox_topics(self, scans: Collection[str] | None) -> set[str]:
        """Return the topics whose messages pass as PointCloud2."""
        found = {
            connection.topic
            for connection in self._reader.connections
            if (scans is None or connection.topic in scans) and is_livox(connection.msgtype, self.typestore)
        }
        if found:
            add_point_cloud(self.typestore, is_ros2=self.is_ros2)
        return found

    def _shown(self, connection: Connection) -> Connection:
        return connection._replace(msgtype=POINT_CLOUD) if connection.topic in self._livox else connection

    def _as_cloud(self, connection: Connection, time: int, raw: bytes) -> tuple[Connection, int, bytes]:
        try:
            cloud = livox_cloud(raw, self.typestore, is_ros2=self.is_ros2)
        except DataError as error:
            raise DataError(f"{self.label}: {connection.topic}: {error}") from None
        return self._shown(connection), time, cloud

    def _formats(self) -> Iterator[Notice]:
        """Yield notices of LiDAR scans in messages of their makers."""
        for name in sorted(self._livox):
            yield Notice(
                "points.format",
                f"{name} has scans as Livox's CustomMsg; they are read, and given to algorithms, as "
                "PointCloud2 with the time of points in offset_time",
            )
        for topic in self.topics.values():
            text = packets_text(topic.name, topic.message_type)
            if text is not None:
                yield Notice("points.format", text, topic.count)

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

    def _order(self, listed: Sequence[PieceSpan], ordered: Sequence[PieceSpan]) -> Iterator[Notice]:
        """Yield notices of the order of files, and of their overlap."""
        if [piece.start for piece in listed] != [piece.start for piece in ordered]:
            names = ", ".join(piece.name for piece in ordered)
            yield Notice(
                "files.order", f"the files are listed in another order than their times; read as {names}"
            )
        for before, after in self._overlaps:
            seconds = (min(before.end, after.end) - after.start) / 1e9
            yield Notice(
                "files.overlap",
                f"{before.name} and {after.name} overlap by {seconds:.3f} s; messages that are in both count "
                "once",
            )

    def _neighbours(self) -> Iterator[Notice]:
        """Yield notices of pieces that lie beside, and of a lone one without static transforms."""
        given = {path.resolve() for path in self.paths}
        beside: dict[str, None] = {}
        for path in self.paths:
            stem = _PIECE.fullmatch(path.name)
            if stem is None or path.is_dir():
                continue
            for other in sorted(path.resolve().parent.iterdir()):
                match = _PIECE.fullmatch(other.name)
                if match and match[1] == stem[1] and match[3] == stem[3] and other.resolve() not in given:
                    beside[other.name] = None
        if beside:
            yield Notice(
                "files.missing",
                f"{', '.join(beside)} beside {'it' if len(given) == 1 else 'them'} may be pieces of the same "
                "recording, and aren't read: name all of them in recording.files",
                len(beside),
            )
        alone = [path.name for path in self.paths if path.is_file() and path.suffix in {".db3", ".mcap"}]
        if "/tf_static" not in self.topics and len(alone) == 1 and _LATER.search(alone[0]):
            yield Notice(
                "files.piece",
                f"{alone[0]} is a piece of a recording, without /tf_static: extrinsics may be in the first "
                "piece",
            )

    def _unreadable(self, error: Exception, *, indexed: bool) -> DataError:
        if isinstance(error, NotDamagedError):
            return DataError(f"{self.label}: {error}")
        hints = dict.fromkeys(remedy(path, indexed=indexed) for path in self.paths)
        return DataError(f"{self.label}: can't be read as {self.format} ({_said(error)}): {'; '.join(hints)}")


def is_latched(connection: Connection) -> bool:
    """Tell whether a topic was recorded as one whose last message who comes later gets too."""
    offered = getattr(connection.ext, "offered_qos_profiles", None)
    if offered is None:  # of ROS 1
        return bool(connection.ext.latching)  # type: ignore[union-attr]
    return any(one.durability.value == _TRANSIENT_LOCAL for one in offered)


def recording_paths(dataset: Dataset, root: Path) -> list[Path]:
    """Return the files of a dataset's recording.

    Raises:
        DataError: The dataset is a synthetic one that was not made yet.
    """
    files = dataset.spec.recording.files
    if not files:
        raise DataError(f"dataset {dataset.name!r}: its synthetic recording was not made yet")
    return [root / file.path for file in files]


def guess_format(path: Path) -> RecordingFormat:
    """Tell the format of a recording by what lies at its path.

    Raises:
        DataError: There is nothing, or nothing known.
    """
    if not path.exists():
        raise DataError(f"{path}: no such file or folder")
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return RecordingFormat.ROSBAG2
        if any(path.glob("*.db3")) or any(path.glob("*.mcap")):
            raise DataError(
                f"{path}: a ROS 2 bag without metadata.yaml, as a recorder leaves it that was killed: "
                f"`ros2 bag reindex {path.name}` on a copy writes it; a file in it can be added by itself"
            )
    if path.suffix == ".db3":
        return RecordingFormat.ROSBAG2
    if path.suffix == ".bag":
        return RecordingFormat.ROSBAG1
    if path.suffix == ".mcap":
        return RecordingFormat.MCAP
    helps = next((help_ for ending, help_ in _OTHERS.items() if path.name.endswith(ending)), None)
    if helps:
        raise DataError(f"{path}: {helps.format(path.name)}")
    raise DataError(
        f"{path}: not a recording: a ROS 1 bag ends in .bag, an MCAP file in .mcap, a ROS 2 bag is a folder "
        "with metadata.yaml, or a .db3 file of one"
    )


def _check_path(path: Path, recording_format: RecordingFormat) -> None:
    found = guess_format(path)
    if found is not recording_format:
        raise DataError(f"{path}: recording.format says {recording_format}, but this is {found}")
    if path.is_file() and path.stat().st_size == 0:
        raise DataError(f"{path}: an empty file of 0 bytes; copy or record it again")


def _each_once(messages: Iterable[tuple[Connection, int, bytes]]) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield messages, one that is in several files once: they are at the same time then."""
    now: int | None = None
    seen: set[tuple[str, bytes]] = set()
    for connection, time, raw in messages:
        if time != now:
            now, seen = time, set()
        if (connection.topic, raw) not in seen:
            seen.add((connection.topic, raw))
            yield connection, time, raw


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
