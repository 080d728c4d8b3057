# SPDX-License-Identifier: Apache-2.0
"""Recordings of ROS 2 as bytes: a folder with metadata.yaml, an MCAP file or a database of SQLite."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rosbags.interfaces import MessageDefinitionFormat, QosDurability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slamhive.playback.player.wire import Message
from slamhive.playback.protocol import PlayError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from rosbags.interfaces import Connection

_SAMPLE = 500
"""Messages that are looked at for their size."""


class RecordedTopic(NamedTuple):
    """A topic as a recording describes it.

    Attributes:
        type: Such as sensor_msgs/msg/Imu.
        digest: Hash of the type as ROS 2 has it (RIHS01), empty if the recording has none.
        latched: Whether its last message was kept for who came later.
    """

    type: str
    digest: str
    latched: bool


class Ros2Bag:
    """A recording that is open.

    Args:
        path: Of the folder or file.
        names: The names under which topics are played, by those in the recording; others keep theirs.

    Attributes:
        topics: What the recording says of each topic, by the name under which it is played.
        begin: Time of the first message, ns.
        largest: Bytes of the largest of the first messages.

    Raises:
        PlayError: It can't be read.
    """

    def __init__(self, path: str, names: Mapping[str, str]) -> None:
        self._names = names
        self._path = path
        try:
            self._reader = Reader(Path(path))
            self._reader.open()
            self.topics = {
                names.get(one.topic, one.topic): RecordedTopic(one.msgtype, _digest(one), _is_latched(one))
                for one in self._reader.connections
            }
            self.begin = self._reader.start_time
            self.largest = max(
                (len(data) for _, _, data in islice(self._reader.messages(), _SAMPLE)), default=0
            )
        except Exception as error:  # noqa: BLE001 - the library raises whatever broken bytes lead to
            raise PlayError(f"{path} can't be read: {error}") from None

    def messages(self) -> Iterator[Message]:
        """Yield its messages in the order of their times.

        Raises:
            PlayError: It can't be read on.
        """
        try:
            for connection, time, data in self._reader.messages():
                yield Message(time, self._names.get(connection.topic, connection.topic), bytes(data))
        except Exception as error:  # noqa: BLE001 - as above
            raise PlayError(f"{self._path} can't be read: {error}") from None


def _digest(connection: Connection) -> str:
    """Return the hash of a topic's type; an MCAP file has none, but the definition that it is made from."""
    if connection.digest or connection.msgdef.format != MessageDefinitionFormat.MSG:
        return connection.digest
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
    return store.hash_rihs01(connection.msgtype)


def _is_latched(connection: object) -> bool:
    offered = getattr(getattr(connection, "ext", None), "offered_qos_profiles", None) or ()
    topic = getattr(connection, "topic", "")
    return topic == "/tf_static" or any(qos.durability == QosDurability.TRANSIENT_LOCAL for qos in offered)
