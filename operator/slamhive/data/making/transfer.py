# SPDX-License-Identifier: Apache-2.0
"""Copying the chosen messages of a recording into a variant, changed as the options say."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from slamhive.data.files.workers import Workers
from slamhive.data.making.delivering import in_order
from slamhive.data.recordings import kinds
from slamhive.data.recordings.clouds import cloud_filter, filter_cloud
from slamhive.data.recordings.images import is_rvl, scale_camera_info, scale_compressed, scale_image
from slamhive.data.recordings.streams import TopicKind
from slamhive.data.recordings.writing import RecordingWriter
from slamhive.model.errors import DataError
from slamhive.model.sensors import SensorType

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from rosbags.interfaces import Connection

    from slamhive.data.making.selection import MessageChange, MessageSelection
    from slamhive.data.recordings.reading import Recording
    from slamhive.data.recordings.streams import Stream
    from slamhive.model.algorithm import RecordingFormat
    from slamhive.model.run import LidarInput, Perturbation

    Change = Callable[[bytes], bytes | memoryview]


class Changes(Protocol):
    """The options that change messages."""

    @property
    def resolution(self) -> float:
        """Scale of images."""

    @property
    def lidar(self) -> LidarInput | None:
        """Ranges and rings of LiDAR scans that are kept; None where all points are."""

    @property
    def perturb(self) -> Perturbation | None:
        """Perturbation of the messages, and of what a folder says of its sensors."""


def transfer(
    recording: Recording,
    selection: MessageSelection,
    changes: Changes,
    *,
    target: Path,
    target_format: RecordingFormat,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write the chosen messages into a new recording.

    Args:
        recording: Where they come from.
        selection: The messages chosen.
        changes: What is done to them.
        target: The recording to make.
        target_format: How to store it.
        progress: Called with the share done, 0 to 1.

    Raises:
        DataError: A message can't be changed as asked.
    """
    by_topic = {stream.topic: stream for stream in selection.streams}
    rules = {topic: _rule(recording, stream, changes) for topic, stream in by_topic.items()}
    first, last = selection.record_window
    once = [stream.topic for stream in selection.streams if stream.kind is TopicKind.STATIC]
    with RecordingWriter(recording, target, target_format, once) as writer:
        for connection, time, raw in chosen_messages(recording, selection, progress):
            topic = connection.topic
            change = rules[topic]
            # What is said once stays, however much is cut off before it.
            lasting = by_topic[topic].kind in (TopicKind.STATIC, TopicKind.INFO)
            at = min(max(time, first), last) if lasting else time
            writer.write(connection, at, raw if change is None else change(raw))


def chosen_messages(
    recording: Recording, selection: MessageSelection, progress: Callable[[float], None] | None = None
) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield the messages that were chosen, in the order of their times of recording.

    What is perturbed is so here, before anything else is done to a message.

    Args:
        recording: Where they come from.
        selection: The messages chosen.
        progress: Called with the share done, 0 to 1.
    """
    changed = _changed_messages(recording, selection, progress)
    if not selection.later:
        return ((connection, time, raw) for connection, time, _, raw in changed)
    return in_order(changed, min(0, *(int(added.min()) for added in selection.later.values())))


def _changed_messages(
    recording: Recording, selection: MessageSelection, progress: Callable[[float], None] | None
) -> Iterator[tuple[Connection, int, int, bytes]]:
    """Yield connection, time of recording, what is added to it (ns), and bytes of what was chosen."""
    with Workers() as workers:
        chosen = _begun(recording, selection, progress)
        for (connection, time, index, raw), changed in workers.ahead(chosen):
            finish = selection.finishes.get(connection.topic)
            later = selection.later.get(connection.topic)
            found = raw if changed is None else changed
            if finish is not None:
                found = bytes(finish(index, found))
            yield connection, time, 0 if later is None else int(later[index]), found


def _begun(
    recording: Recording, selection: MessageSelection, progress: Callable[[float], None] | None
) -> Iterator[tuple[tuple[Connection, int, int, bytes], Callable[[], bytes] | None]]:
    """Yield connection, time of recording, number and bytes of what was chosen, and how it is changed."""
    seen = {stream.topic: 0 for stream in selection.streams}
    total, done = max(selection.size_bytes, 1), 0
    for number, (connection, time, raw) in enumerate(recording.messages(set(seen))):
        index = seen[connection.topic]
        seen[connection.topic] = index + 1
        done += len(raw)
        if progress and number % 64 == 0:
            progress(done / total)
        if selection.masks[connection.topic][index]:
            change = selection.changes.get(connection.topic)
            yield (connection, time, index, raw), change and partial(_changed, change, index, raw)


def _changed(change: MessageChange, index: int, raw: bytes) -> bytes:
    return bytes(change(index, raw))


def _rule(recording: Recording, stream: Stream, changes: Changes) -> Change | None:
    """Return the change of a stream's messages, None when they stay as they are."""
    where = f"{stream.topic} in {recording.label}"
    kind, scale = stream.message_type, changes.resolution

    def changed(change: Callable[[Any], Any]) -> Change:
        return lambda raw: recording.encode(change(recording.decode(raw, kind)), kind)

    if changes.lidar is not None and stream.declared and stream.declared.type is SensorType.LIDAR:
        kept, _ = cloud_filter(changes.lidar, stream.declared.lidar, stream.sensor or "")
        return None if kept.is_idle else changed(lambda message: filter_cloud(message, kept, where))
    if scale == 1.0 and not is_decoded(recording, stream):
        return None
    match kind:
        case kinds.IMAGE:
            return changed(lambda message: _image(stream, message, scale, where))
        case kinds.COMPRESSED_IMAGE:
            return changed(lambda message: scale_compressed(message, scale, depth=stream.depth, where=where))
        case kinds.CAMERA_INFO:
            return changed(lambda message: scale_camera_info(message, scale, where))
    return None


def is_decoded(recording: Recording, stream: Stream) -> bool:
    """Tell whether the images of a stream are written anew at any scale, as algorithms can't read them."""
    is_depth = stream.kind is not TopicKind.INFO and stream.depth
    compressed = is_depth and stream.message_type == kinds.COMPRESSED_IMAGE
    return compressed and is_rvl(recording.first(stream.topic))


def _image(stream: Stream, message: Any, scale: float, where: str) -> Any:
    camera = stream.declared.camera if stream.declared else None
    if camera is not None and (message.width, message.height) != (camera.width, camera.height):
        raise DataError(
            f"sensors.{stream.sensor}.camera: states {camera.width}×{camera.height} pixels, but the images "
            f"on {where} have {message.width}×{message.height}"
        )
    return scale_image(message, scale, depth=stream.depth, where=where)
