# SPDX-License-Identifier: Apache-2.0
"""Writing recordings of any of the three formats, with messages translated between ROS 1 and ROS 2."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
from typing import TYPE_CHECKING, Any, Self

from rosbags.convert.converter import LATCH, is_same_wireformat, migrate_bytes
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slamhive.data.recordings.reading import BIG_ENDIAN, LITTLE_ENDIAN, TF_TYPES, is_latched
from slamhive.model.errors import DataError, SystemFault
from slamhive.model.formats import RecordingFormat

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from pathlib import Path
    from types import TracebackType

    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

    from slamhive.data.recordings.reading import Recording


class RecordingWriter:
    """Writes messages of one recording into another, as they are or changed.

    Args:
        source: Where the messages come from.
        target: Path of the recording to make.
        target_format: How to store it.
        lasting: Topics that are latched, beside those that the source has latched.
    """

    def __init__(
        self, source: Recording, target: Path, target_format: RecordingFormat, lasting: Collection[str] = ()
    ) -> None:
        self._source = source
        self._target = target
        self._is_ros2 = target_format is not RecordingFormat.ROSBAG1
        self._store = _target_store(source, is_ros2=self._is_ros2)
        self._latched = {*lasting, *(one.topic for one in source.connections if is_latched(one))}
        if self._is_ros2:  # tf2 asks for it, and gets nothing of a publisher that doesn't offer it
            self._latched.add("/tf_static")
        self._connections: dict[tuple[str, str], Connection] = {}
        self._translators: dict[str, Callable[[bytes | memoryview], bytes | memoryview]] = {}
        self._cache: dict[str, object] = {}
        self._folder: Path | None = None
        if target_format is RecordingFormat.ROSBAG1:
            self._writer: Writer1 | Writer2 = Writer1(target)
        elif target_format is RecordingFormat.ROSBAG2:
            self._writer = Writer2(target, version=8)
        else:
            # rosbags writes MCAP as a ROS 2 bag; the file in the folder is the recording.
            self._folder = target.with_name(f".{target.name}.folder")
            self._writer = Writer2(self._folder, version=8, storage_plugin=StoragePlugin.MCAP)

    def write(self, connection: Connection, time: int, raw: bytes | memoryview) -> None:
        """Write a message as the source serialises it.

        Args:
            connection: The source's connection.
            time: Record time, ns.
            raw: The message in the source's serialisation.

        Raises:
            OSError: The disk refuses.
            SystemFault: The same, as SQLite says it.
        """
        translate = self._translators.get(connection.msgtype)
        if translate is None:
            translate = self._translators[connection.msgtype] = self._translator(connection.msgtype)
        with _storing(self._target):
            self._writer.write(self._connection(connection), time, translate(raw))

    def announce(self, connection: Connection) -> None:
        """Have the recording name a connection of the source, whether a message of it follows or not."""
        with _storing(self._target):
            self._connection(connection)

    def __enter__(self) -> Self:
        with _storing(self._target):
            self._writer.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            with contextlib.suppress(Exception):
                self._writer.abort()
            return
        with _storing(self._target):
            self._writer.close()
        if self._folder is not None:
            next(self._folder.glob("*.mcap")).rename(self._target)
            shutil.rmtree(self._folder)

    def _connection(self, source: Connection) -> Connection:
        message_type = _TYPE_NAMES.get(source.msgtype, source.msgtype)
        key = (source.topic, message_type)
        if key not in self._connections:
            self._connections[key] = self._add(source, message_type)
        return self._connections[key]

    def _add(self, source: Connection, message_type: str) -> Connection:
        latched = source.topic in self._latched
        if isinstance(self._writer, Writer2):
            profiles = LATCH if latched else []
            return self._writer.add_connection(
                source.topic, message_type, typestore=self._store, offered_qos_profiles=profiles
            )
        return self._writer.add_connection(
            source.topic, message_type, typestore=self._store, latching=int(latched)
        )

    def _translator(self, message_type: str) -> Callable[[bytes | memoryview], bytes | memoryview]:
        source, target = self._source.typestore, self._store
        name = _TYPE_NAMES.get(message_type, message_type)
        if is_same_wireformat(source, target, message_type, name):
            if self._source.is_ros2 and self._is_ros2:
                return lambda raw: self._little(raw, message_type)
            if self._source.is_ros2 == self._is_ros2:
                return lambda raw: raw
            if self._source.is_ros2:
                return lambda raw: source.cdr_to_ros1(self._little(raw, message_type), message_type)
            return lambda raw: target.ros1_to_cdr(raw, name)

        def migrate(raw: bytes | memoryview) -> memoryview:
            return migrate_bytes(
                source, target, message_type, name, self._cache, raw,
                src_is2=self._source.is_ros2, dst_is2=self._is_ros2,
            )  # fmt: skip

        return migrate

    def _little(self, raw: bytes | memoryview, message_type: str) -> bytes | memoryview:
        """Return a message of ROS 2 in the order of bytes that this machine has.

        Raises:
            DataError: It isn't in CDR of XCDR version 1, which is what ROS 2 writes.
        """
        begin = bytes(raw[:2])
        if begin == LITTLE_ENDIAN:
            return raw
        if begin != BIG_ENDIAN:
            raise DataError(
                f"{self._source.label}: a message of type {message_type} begins with {begin.hex(' ')}; "
                "messages of ROS 2 begin with 00 01 or 00 00 (CDR)"
            )
        return self._source.encode(self._source.decode(bytes(raw), message_type), message_type)


class _storing:  # noqa: N801 - reads as a statement; entered for every message
    """Turns what SQLite, in which ROS 2 bags are kept, says of the disk into a fault of the machine."""

    def __init__(self, target: Path) -> None:
        self._target = target

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, sqlite3.Error):
            raise SystemFault(f"{self._target}: {error}") from error


_TYPE_NAMES = {TF_TYPES[1]: TF_TYPES[0]}


def _target_store(source: Recording, *, is_ros2: bool) -> Typestore:
    """Return the source's message types in the target's spelling.

    Within one ROS they stay as recorded. Across, the standard definitions are taken where there are any,
    because readers compare their checksums.
    """
    store = get_typestore(Stores.EMPTY)
    types: dict[str, Any] = dict(source.typestore.fielddefs)
    if source.is_ros2 != is_ros2:
        standard = get_typestore(Stores.ROS2_HUMBLE if is_ros2 else Stores.ROS1_NOETIC).fielddefs
        types |= {name: standard[name] for name in [*types, "std_msgs/msg/Header"] if name in standard}
    if TF_TYPES[1] in types or TF_TYPES[0] in types:
        types |= get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF_TYPES[0])
    store.register(types)
    return store
