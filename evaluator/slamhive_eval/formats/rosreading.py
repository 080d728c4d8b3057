# SPDX-License-Identifier: Apache-2.0
"""Recordings of ROS 1 and ROS 2 by rosbags, with readers of our own for the files of ROS 2.

What lies in the files counts, not what metadata.yaml says of it: pieces of a folder are read together in the
order of their times, each also by itself, and of SQLite all that it has, its -wal among it.
"""

from __future__ import annotations

import shutil
import sqlite3
import sys
from contextlib import closing, suppress
from heapq import merge
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from rosbags.highlevel import AnyReader
from rosbags.interfaces import MessageDefinitionFormat, Nodetype
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import Stores, get_typestore

from slamhive_eval.formats.mcapfiles import McapFile
from slamhive_eval.formats.notices import NotDamagedError, Notice

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

if TYPE_CHECKING:
    from collections.abc import Collection, Generator, Iterator, Sequence

    from rosbags.interfaces import Connection

_COMPRESSED = b"\x28\xb5\x2f\xfd"
"""First bytes of a zstd frame; a message of ROS 2 begins with 0 (its encapsulation, OMG RTPS 10.2)."""


class PieceSpan(NamedTuple):
    """A file of a recording: its name, and the times (ns) of its first message and after its last."""

    name: str
    start: int
    end: int


class RosReader(AnyReader):
    """Reader of ROS 1 bags, or of folders and files of ROS 2."""

    def __init__(self, paths: Sequence[Path], *, is_ros1: bool) -> None:
        store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
        super().__init__(paths, default_typestore=store)
        if self.is2:
            self.readers = [_Ros2Path(path) for path in paths]

    @property
    def notices(self) -> list[Notice]:
        """Return the notices of the files, made when they were opened."""
        return [notice for reader in self.readers for notice in getattr(reader, "notices", ())]

    @property
    def foreign(self) -> dict[str, str]:
        """Return the topics of an MCAP file's channels that aren't ROS 2's, and what they are."""
        found: dict[str, str] = {}
        for one in self._files():
            found |= getattr(getattr(one, "storage", one), "foreign", {})
        return found

    @property
    def is_compressed(self) -> bool:
        """Tell whether files or messages are, as metadata.yaml has it; chunks within a file don't count."""
        told = [getattr(one, "metadata", None) for one in self.readers]
        return any(getattr(one, "compression_mode", None) for one in told)

    def _open(self) -> None:
        """Open the files; types of theirs without a definition have the standard one, where there is one."""
        super()._open()
        known, standard = self.typestore.fielddefs, self.default_typestore
        waiting = [one.msgtype for one in self.connections if one.msgtype not in known]
        added: dict[str, Any] = {}
        while waiting and standard is not None:
            name = waiting.pop()
            if name in standard.fielddefs and name not in known and name not in added:
                added[name] = standard.fielddefs[name]
                waiting += parts_of(added[name])
        self.typestore.register(added)

    def _files(self) -> list[Any]:
        """Return the readers of single files, in the order as they are listed."""
        readers: list[Any] = []
        for one in self.readers:
            storage = getattr(one, "storage", None)
            readers += storage.storages if isinstance(storage, _Folder) else [one]
        return readers

    @property
    def pieces(self) -> list[PieceSpan]:
        """Return the files with messages in the order as they are listed."""
        found = []
        for one in self._files():
            times = getattr(one, "metadata", one)
            if times.message_count:
                found.append(PieceSpan(Path(one.path).name, times.start_time, times.end_time))
        return found


def parts_of(definition: Any) -> list[str]:
    """Return the types that a message's fields have, as a type store defines it."""
    fields = [kind for _, kind in definition[1]]
    whole = [kind[1][0] if kind[0] in {Nodetype.ARRAY, Nodetype.SEQUENCE} else kind for kind in fields]
    return [kind[1] for kind in whole if kind[0] == Nodetype.NAME]


class _Database(Sqlite3Reader):
    """Reader of a SQLite file; what is still in its -wal is read from a copy, as reading may write there."""

    def __init__(self, path: Any) -> None:
        super().__init__(path)
        self.notices: list[Notice] = []
        self._copy: TemporaryDirectory[str] | None = None

    def open(self) -> None:
        """Open the file.

        Raises:
            ReaderError: It is damaged.
            NotDamagedError: There is no room for the copy.
        """
        original = Path(str(self.path))
        wal = original.resolve().with_name(f"{original.resolve().name}-wal")
        if not wal.is_file() or not wal.stat().st_size:
            super().open()
            return
        before = 0
        with suppress(ReaderError):  # Its tables may be in the -wal, too.
            super().open()
            before = self.metadata.message_count
            super().close()
        try:
            self._copy = TemporaryDirectory(prefix="slamhive-wal-")
            self.path = Path(self._copy.name, original.name)
            shutil.copyfile(original, self.path)
            shutil.copyfile(wal, self.path.with_name(f"{original.name}-wal"))
            with suppress(sqlite3.Error), closing(sqlite3.connect(self.path)) as database:
                database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            super().open()
        except OSError as error:
            self._forget()
            raise NotDamagedError(
                f"messages of {original.name} are in {wal.name}, and it can't be copied to read both "
                f"({error.strerror}); on a copy of your own, "
                f'`sqlite3 {original.name} "PRAGMA wal_checkpoint(TRUNCATE)"` puts them into one file'
            ) from None
        except BaseException:
            self._forget()
            raise
        finally:
            self.path = original
        late = self.metadata.message_count - before
        if late:
            text = (
                f"{late} of {self.metadata.message_count} messages of {original.name} are in {wal.name}, as "
                "a recorder leaves them that was killed; both are read"
            )
            self.notices.append(Notice("files.wal", text, late))

    def close(self) -> None:
        """Close the file."""
        super().close()
        self._forget()

    def _forget(self) -> None:
        if self._copy is not None:
            self._copy.cleanup()
            self._copy = None


class _Folder(DirectoryReader):
    """Reader of a folder with metadata.yaml, of which only the list of files and their kind is believed."""

    STORAGE_PLUGINS = {"mcap": McapFile, "sqlite3": _Database}  # noqa: RUF012 - as in rosbags

    def __init__(self, path: Any) -> None:
        super().__init__(path)
        self.notices: list[Notice] = []

    def open(self) -> None:
        """Open the files.

        Raises:
            ReaderError: metadata.yaml or a file is damaged.
            NotDamagedError: A file is missing.
        """
        try:
            super().open()
        except ReaderError as error:
            if not str(error).startswith("Some database files are missing"):
                raise
            lost = ", ".join(Path(one).name for one in str(error).split("'")[1::2])
            raise NotDamagedError(
                f"its metadata.yaml lists {lost}, which isn't there: copy it too; if it is lost, "
                f"`ros2 bag reindex {Path(str(self.path)).name}` on a copy of the folder lists what is left"
            ) from None
        stated, listed = self.metadata.message_count, {one.topic for one in self.connections}
        self.notices = [notice for one in self.storages for notice in one.notices]  # type: ignore[attr-defined]
        self._connect()
        found = sum(one.metadata.message_count for one in self.storages)
        spans = [one.metadata for one in self.storages if one.metadata.message_count]
        start = min((one.start_time for one in spans), default=2**63 - 1)
        end = max((one.end_time for one in spans), default=0)
        self.metadata = self.metadata._replace(
            duration=end - start if spans else 0, start_time=start, end_time=end, message_count=found
        )
        unlisted = sorted({one.topic for one in self.connections} - listed)
        if found < stated:
            text = f"metadata.yaml states {stated} messages, its files hold {found}"
            self.notices.append(Notice("files.count", text, stated - found))
        elif found > stated or unlisted:
            also = f" and no {', '.join(unlisted)}" if unlisted else ""
            text = f"metadata.yaml states {stated} messages{also}, its files hold {found}, which are read"
            self.notices.append(Notice("files.metadata", text, max(1, found - stated)))

    def _connect(self) -> None:
        """Make one connection of a topic and type of what the files hold."""
        merged: dict[tuple[str, str], Connection] = {}
        definitions = {
            one.msgtype: one.msgdef
            for storage in self.storages
            for one in storage.connections
            if one.msgdef.format != MessageDefinitionFormat.NONE
        }
        for storage in self.storages:
            for one in storage.connections:
                key = (one.topic, one.msgtype)
                before = merged.get(key)
                merged[key] = one._replace(
                    id=before.id if before else len(merged) + 1,
                    msgdef=definitions.get(one.msgtype, one.msgdef),
                    msgcount=one.msgcount + (before.msgcount if before else 0),
                    owner=self,
                )
        there = {topic for topic, _ in merged}
        empty = [one._replace(id=-one.id, msgcount=0) for one in self.connections if one.topic not in there]
        self.connections = [*merged.values(), *empty]

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Read messages of some connections between two times (ns), in the order of their times."""
        wanted = {(one.topic, one.msgtype): one for one in connections}

        def of(storage: Any) -> Iterator[tuple[Connection | None, int, bytes]]:
            chosen = [one for one in storage.connections if (one.topic, one.msgtype) in wanted]
            if chosen:
                # Reading begins when its time has come: all files at once would be held at once.
                yield None, storage.metadata.start_time, b""
                for one, time, raw in storage.messages(chosen, start, stop):
                    yield wanted[one.topic, one.msgtype], time, raw

        for one, time, raw in merge(*map(of, self.storages), key=lambda item: item[1]):
            if one is not None:
                yield one, time, raw


class _Ros2Path(Reader):
    """Reader of a folder, or of one of its files by itself."""

    STORAGE_PLUGINS = {"dir": _Folder, ".mcap": McapFile, ".db3": _Database}  # noqa: RUF012 - as in rosbags

    @property
    def connections(self) -> list[Connection]:
        """Return the topics; their messages are asked for here, not of the file's own reader."""
        return [one._replace(owner=self) for one in super().connections]

    @property
    def notices(self) -> list[Notice]:
        """Return the notices of the files, made when they were opened."""
        return self.storage.notices  # type: ignore[attr-defined,no-any-return]

    def messages(
        self, connections: Collection[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Read messages; compressed ones, of which metadata.yaml alone knows in ROS 2, are unpacked."""
        for one, time, raw in super().messages(connections, start, stop):
            yield one, time, zstd.decompress(raw) if raw[:4] == _COMPRESSED else raw
