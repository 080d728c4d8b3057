# SPDX-License-Identifier: Apache-2.0
"""MCAP files by rosbags' reader, with an opening of our own: of any profile, summary and mix of channels.

The format allows more than a file that ROS 2 recorded itself has: channels of other encodings, a free text
as profile, and a summary that lacks any of its records (https://mcap.dev/spec). What isn't ROS 2's is left
out and noted.
"""

from __future__ import annotations

import os
from array import array
from collections import Counter
from io import BytesIO
from struct import Struct
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.metadata import ReaderMetadata
from rosbags.rosbag2.storage_mcap import (
    ChunkInfo,
    McapReader,
    Schema,
    decompress,
    get_msgdef,
    get_qos,
    read_bytes,
    read_exact,
    read_sized,
    read_string,
    skip_exact,
)

from slamhive_eval.formats.notices import NotDamagedError, Notice

if TYPE_CHECKING:
    from collections.abc import Collection, Generator, Iterator

_MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _CHUNK_INDEX, _STATISTICS = 2, 3, 4, 5, 6, 8, 11
_FOOTER_BYTES = 37
_RECORD, _MESSAGE_HEAD, _LATEST = Struct("<BQ"), Struct("<HIQQ"), 2**63 - 1
_SCHEMAS = ("ros2msg", "ros2idl", "omgidl", "")
"""Encodings of the definitions of ROS 2 messages; the empty one states none."""


class _Counted:
    """Number of messages by channel, and their first and last time (ns)."""

    def __init__(self) -> None:
        self.channels: Counter[int] = Counter()
        self.first, self.last = _LATEST, 0

    def add(self, channel: int, time: int) -> None:
        self.channels[channel] += 1
        self.first, self.last = min(self.first, time), max(self.last, time)

    def join(self, other: _Counted) -> None:
        self.channels.update(other.channels)
        self.first, self.last = min(self.first, other.first), max(self.last, other.last)


class McapFile(McapReader):
    """Reader of an MCAP file.

    Attributes:
        notices: What was noticed when it was opened.
        foreign: Topics of channels that aren't ROS 2's, and what they are.
    """

    def __init__(self, path: Any) -> None:
        super().__init__(path)
        self.notices: list[Notice] = []
        self.foreign: dict[str, str] = {}
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, tuple[int, str, str, bytes]] = {}

    def _open(self) -> None:
        """Read what the summary says, and all records where it doesn't say enough.

        Raises:
            ReaderError: The file is damaged.
            NotDamagedError: No channel is one of ROS 2.
        """
        bio = self._file
        if bio.read(len(_MAGIC)) != _MAGIC:
            raise ReaderError("File magic is invalid.")
        if bio.read(1) != b"\x01":
            raise ReaderError("Unexpected record.")
        read_sized(bio)
        self.data_start = bio.tell()
        footer = bio.seek(-_FOOTER_BYTES, os.SEEK_END)
        end = read_exact(bio, _FOOTER_BYTES)
        if not end.endswith(_MAGIC):
            raise ReaderError("File end magic is invalid.")
        if _RECORD.unpack_from(end) != (_FOOTER, 20):
            raise ReaderError("Invalid MCAP footer.")
        summary = int.from_bytes(end[9:17], "little")
        if summary and not self.data_start <= summary <= footer:
            raise ReaderError("Invalid MCAP summary offset.")
        self.data_end = summary or footer
        found = self._summary(footer) if summary else None
        if found is None or not self._is_known(found):
            found = self._scan()
            if summary:
                text = "its summary doesn't list all channels and counts: all of it is read to open it"
                self.notices.append(Notice("files.summary", text))
        for chunk in self.chunks:
            if not chunk.channel_count:  # Without an index it may hold messages of any channel.
                chunk.channel_count.update(dict.fromkeys(self._channels, 1))
        self._connect(found)

    @property
    def _file(self) -> BinaryIO:
        if self.bio is None:
            raise ReaderError("The file is closed.")
        return self.bio

    def _summary(self, end: int) -> _Counted | None:
        """Take in the summary's records; return what its statistics count, None where it has none."""
        bio, found = self._file, None
        bio.seek(self.data_end)
        while bio.tell() < end:
            code, size = _RECORD.unpack(read_exact(bio, _RECORD.size))
            record = BytesIO(read_exact(bio, size))
            self._take(code, record)
            if code == _CHUNK_INDEX:
                self.chunks.append(_chunk_of(record))
            elif code == _STATISTICS:
                total = int.from_bytes(read_exact(record, 8), "little")
                record.seek(26)
                found = _Counted()
                found.first, found.last = Struct("<QQ").unpack(read_exact(record, 16))
                found.channels.update(dict(Struct("<HQ").iter_unpack(read_bytes(record))))
                if found.channels.total() != total:
                    return None
        return found

    def _is_known(self, found: _Counted) -> bool:
        """Tell whether each channel with messages is known, and its schema."""
        used = {channel for channel, count in found.channels.items() if count}
        used.update(channel for chunk in self.chunks for channel in chunk.message_index_offsets)
        schemas = {self._channels[channel][0] for channel in used & self._channels.keys()}
        return used <= self._channels.keys() and schemas <= {0, *self._schemas}

    def _scan(self) -> _Counted:
        """Take in all records of the data section, chunks among them, and count its messages."""
        self.chunks.clear()
        found = _Counted()
        for code, size, begin in self._records():
            bio = self._file
            if code == _MESSAGE:
                channel, _, time, _ = _MESSAGE_HEAD.unpack(read_exact(bio, _MESSAGE_HEAD.size))
                found.add(channel, time)
            elif code == _CHUNK:
                inside = self._scan_chunk(size, begin)
                found.join(inside)
            elif code in {_SCHEMA, _CHANNEL}:
                self._take(code, BytesIO(read_exact(bio, size)))
        return found

    def _scan_chunk(self, size: int, begin: int) -> _Counted:
        record = BytesIO(read_exact(self._file, size))
        start, end, uncompressed, check = Struct("<QQQI").unpack(read_exact(record, 28))
        compression = read_string(record)
        packed = read_sized(record)
        inside, found = BytesIO(decompress(packed, compression, uncompressed, check)), _Counted()
        while inside.tell() < uncompressed:
            code, length = _RECORD.unpack(read_exact(inside, _RECORD.size))
            if code == _MESSAGE:
                channel, _, time, _ = _MESSAGE_HEAD.unpack(read_exact(inside, _MESSAGE_HEAD.size))
                found.add(channel, time)
                skip_exact(inside, length - _MESSAGE_HEAD.size)
            else:
                self._take(code, BytesIO(read_exact(inside, length)))
        if found.channels:
            start, end = found.first, found.last
            counts = dict(found.channels)
            self.chunks.append(
                ChunkInfo(start, end, begin, size, {}, 0, compression, len(packed), uncompressed, counts)
            )
        return found

    def _records(self) -> Iterator[tuple[int, int, int]]:
        """Yield kind, size and place of each record of the data section; the file stands behind its head."""
        bio, at = self._file, self.data_start
        while at < self.data_end:
            bio.seek(at)
            code, size = _RECORD.unpack(read_exact(bio, _RECORD.size))
            if at + _RECORD.size + size > self.data_end:
                raise ReaderError(f"Truncated record at offset {at}.")
            yield code, size, at
            at += _RECORD.size + size

    def _take(self, code: int, record: BytesIO) -> None:
        if code == _SCHEMA:
            key = int.from_bytes(read_exact(record, 2), "little")
            name, encoding, text = read_string(record), read_string(record), read_bytes(record)
            # Definitions of others may be binary.
            self._schemas[key] = Schema(key, name, encoding, text.decode(errors="replace"))
        elif code == _CHANNEL:
            key, schema = Struct("<HH").unpack(read_exact(record, 4))
            topic, encoding, about = read_string(record), read_string(record), read_bytes(record)
            self._channels[key] = (schema, topic, encoding, about)

    def _connect(self, found: _Counted) -> None:
        """Make connections of the channels that are ROS 2's, and name the others.

        Raises:
            NotDamagedError: None is.
        """
        for key, (number, topic, encoding, about) in self._channels.items():
            schema = self._schemas.get(number)
            if encoding == "cdr" and schema is not None and schema.encoding in _SCHEMAS:
                ext = ConnectionExtRosbag2(encoding, get_qos(about))
                # A recorder that doesn't find a definition leaves it empty; only Empty has no fields.
                is_known = schema.data.strip() or schema.name.endswith("/Empty")
                definition, count = get_msgdef(schema if is_known else None), found.channels[key]
                self.connections.append(Connection(key, topic, schema.name, definition, "", count, ext, self))
            else:
                of = f"{encoding or 'no encoding'}, {schema.encoding if schema else 'no schema'}"
                self.foreign[topic] = of
        foreign = [f"{topic} ({of})" for topic, of in self.foreign.items()]
        shown = ", ".join(foreign[:10]) + (" and others" if len(foreign) > 10 else "")
        if foreign and not self.connections:
            if all(encoding == "ros1" for _, _, encoding, _ in self._channels.values()):
                raise NotDamagedError(
                    "it holds messages of ROS 1 in an MCAP file, which aren't read: take the .bag that it "
                    "was made from"
                )
            raise NotDamagedError(f"none of its channels is one of ROS 2: {shown}; record it as ROS 2 does")
        if foreign:
            text = f"channels that aren't ROS 2's are left out: {shown}"
            self.notices.append(Notice("files.foreign", text, len(foreign)))
        total = sum(one.msgcount for one in self.connections)
        span = (found.last - found.first + 1, found.first, found.last + 1) if total else (0, _LATEST, 0)
        self.metadata = ReaderMetadata(*span, total, None, None, None, None)

    def close(self) -> None:
        """Close the file."""
        self._schemas.clear()
        self._channels.clear()
        super().close()

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Read messages of some connections between two times (ns), in the order of their times."""
        if self.chunks:
            yield from super().messages(connections, start, stop)
            return
        by_id = {one.id: one for one in connections}
        low, high = start or 0, _LATEST if stop is None else stop
        times, places = array("Q"), array("Q")
        bio = self._file
        for code, _, begin in self._records():
            if code == _MESSAGE:
                channel, _, time, _ = _MESSAGE_HEAD.unpack(read_exact(bio, _MESSAGE_HEAD.size))
                if channel in by_id and low <= time < high:
                    times.append(time)
                    places.append(begin)
        for place in np.argsort(np.frombuffer(times, np.uint64), kind="stable").tolist():
            bio.seek(places[place] + 1)
            record = read_sized(bio)
            channel = int.from_bytes(record[:2], "little")
            yield by_id[channel], times[place], record[_MESSAGE_HEAD.size :]


def _chunk_of(record: BytesIO) -> ChunkInfo:
    start, end, begin, length = Struct("<QQQQ").unpack(read_exact(record, 32))
    offsets = dict(Struct("<HQ").iter_unpack(read_bytes(record)))
    index = int.from_bytes(read_exact(record, 8), "little")
    compression = read_string(record)
    packed, size = Struct("<QQ").unpack(read_exact(record, 16))
    counts = dict.fromkeys(offsets, 1)
    return ChunkInfo(start, end, begin, length, offsets, index, compression, packed, size, counts)
