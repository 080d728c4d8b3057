# SPDX-License-Identifier: Apache-2.0
"""Selection of the messages that go into a variant: by time window, by rate, and in pairs."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from slamhive.data.recordings.checks import check_stamps
from slamhive.data.recordings.streams import Stream, TopicKind
from slamhive.data.recordings.thinning import partners, rate_of, thin
from slamhive.model.errors import DataError, InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy.typing as npt

    from slamhive.data.recordings.reading import Recording, Scan

    MessageChange = Callable[[int, bytes], bytes | bytearray | memoryview]
    Mask = npt.NDArray[np.bool_]

MARGIN_SECONDS = 0.25
"""Samples kept before and after a cut: a scan's last points are taken after its stamp."""
_SPARSE = 0.5
"""A camera_info with fewer messages than this share of its images is a latched one, kept whole."""


class MessageOptions(Protocol):
    """The options that decide about messages."""

    @property
    def frame_rate(self) -> float | None:
        """Wanted rate, Hz."""

    @property
    def start(self) -> float:
        """Seconds left out at the beginning."""

    @property
    def duration(self) -> float | None:
        """Seconds kept."""


@dataclass(frozen=True, eq=False)
class MessageSelection:
    """The messages chosen.

    Attributes:
        streams: The topics, those that set the pace first.
        masks: By topic, which messages are kept, in the order of the recording, shape (n,).
        scans: By topic, the times of all messages.
        primary: The stream whose frames are counted.
        first: Header stamp of its first frame kept, ns.
        last: Header stamp of its last frame kept, ns.
        record_window: Record times of the first and last message kept of any sensor, ns.
        changes: By topic, what becomes of a message of a number in the recording, as serialised; of several
            at once, on threads.
        finishes: The same of what comes after that, of one message after the other.
        later: By topic, what is added to the time of recording of each message, ns, shape (n,).
    """

    streams: list[Stream]
    masks: Mapping[str, Mask]
    scans: Mapping[str, Scan]
    primary: Stream
    first: int
    last: int
    record_window: tuple[int, int]
    changes: Mapping[str, MessageChange] = field(default_factory=dict)
    finishes: Mapping[str, MessageChange] = field(default_factory=dict)
    later: Mapping[str, npt.NDArray[np.int64]] = field(default_factory=dict)

    def frames(self, stream: Stream) -> int:
        """Return the number of messages of a stream that are kept."""
        return int(np.count_nonzero(self.masks[stream.topic]))

    @property
    def stamps(self) -> npt.NDArray[np.int64]:
        """Return the header stamps of the primary stream's kept messages, ns, shape (n,)."""
        return self.scans[self.primary.topic].stamps[self.masks[self.primary.topic]]

    def rate(self, stream: Stream) -> float | None:
        """Return the rate of a stream's kept messages in Hz, None for fewer than two."""
        rate = rate_of(self.scans[stream.topic].stamps[self.masks[stream.topic]])
        return None if rate is None else round(rate, 3)

    @property
    def recorded_rate(self) -> float | None:
        """Return the rate of the fastest stream of frames before any was left out, Hz."""
        leaders = [stream for stream in self.streams if stream.kind is TopicKind.FRAMES]
        rates = [rate for stream in leaders if (rate := rate_of(self.scans[stream.topic].stamps))]
        return round(max(rates), 3) if rates else None

    @property
    def recorded_seconds(self) -> float:
        """Return the time from the first frame of the primary stream to its last, kept or not, s."""
        stamps = self.scans[self.primary.topic].stamps
        return int(stamps[-1] - stamps[0]) / 1e9

    @property
    def size_bytes(self) -> int:
        """Size of all messages of the topics, kept or not."""
        return sum(scan.size_bytes for scan in self.scans.values())


def select(
    recording: Recording,
    streams: list[Stream],
    window: MessageOptions,
    progress: Callable[[float], None] | None = None,
) -> MessageSelection:
    """Choose the messages of a variant.

    Args:
        recording: The recording.
        streams: Its topics.
        window: Rate and cut.
        progress: Called with the share done, 0 to 1.

    Raises:
        DataError: Stamps are unsorted or absurd, or cameras of a pair share no frames.
        InputError: The cut leaves nothing.
    """
    scans = recording.scan([stream.topic for stream in streams], progress)
    for stream in streams:
        if stream.sensor is not None:
            check_stamps(scans[stream.topic], f"sensors.{stream.sensor}: {stream.topic} in {recording.label}")
    leaders = [stream for stream in streams if stream.kind is TopicKind.FRAMES]
    bounds = _bounds(scans[leaders[0].topic], window, leaders[0])
    masks: dict[str, Mask] = {}
    for leader in leaders:
        followers = [
            item for item in streams if item.kind is TopicKind.PARTNER and item.follows == leader.topic
        ]
        masks |= _frames(leader, followers, scans, window, bounds)
    begin, end = bounds
    for stream in streams:
        if stream.kind is TopicKind.INFO:
            masks[stream.topic] = _info(
                scans[stream.topic], scans[stream.follows or ""], masks[stream.follows or ""]
            )
        elif stream.kind is TopicKind.SAMPLES:
            margin = round(MARGIN_SECONDS * 1e9)
            stamps = scans[stream.topic].stamps
            masks[stream.topic] = (stamps >= begin - margin) & (stamps <= end + margin)
        elif stream.kind is TopicKind.STATIC:
            masks[stream.topic] = np.ones(len(scans[stream.topic].times), dtype=np.bool_)
    primary = leaders[0]
    kept = scans[primary.topic].stamps[masks[primary.topic]]
    times = [scans[stream.topic].times[masks[stream.topic]] for stream in streams if stream.sensor]
    joined = np.concatenate(times)
    recorded = (int(joined.min()), int(joined.max()))
    for stream in streams:
        if stream.kind is TopicKind.TOPIC:
            masks[stream.topic] = _asked_for(scans[stream.topic], bounds, recorded)
    return MessageSelection(streams, masks, scans, primary, int(kept[0]), int(kept[-1]), recorded)


def _asked_for(scan: Scan, bounds: tuple[int, int], recorded: tuple[int, int]) -> Mask:
    """Choose the messages of a topic that is no sensor's; without stamps the times of recording decide."""
    if bounds == (-_FOREVER, _FOREVER):
        return np.ones(len(scan.times), dtype=np.bool_)
    stamped = scan.has_header and bool((scan.stamps > 0).all())
    times, (begin, end) = (scan.stamps, bounds) if stamped else (scan.times, recorded)
    margin = round(MARGIN_SECONDS * 1e9)
    return np.asarray((times >= begin - margin) & (times <= end + margin))


def with_masks(selection: MessageSelection, masks: Mapping[str, Mask]) -> MessageSelection:
    """Return a selection with other messages of some topics; camera_info goes with its images.

    Args:
        selection: What was chosen.
        masks: By topic, what is kept of it, shape (n,); some of each.
    """
    masks = {**selection.masks, **masks}
    for stream in selection.streams:
        images = stream.follows or ""
        if stream.kind is TopicKind.INFO and not np.array_equal(masks[images], selection.masks[images]):
            kept = _info(selection.scans[stream.topic], selection.scans[images], masks[images])
            masks[stream.topic] = selection.masks[stream.topic] & kept
    leading = selection.scans[selection.primary.topic].stamps[masks[selection.primary.topic]]
    return replace(selection, masks=masks, first=int(leading[0]), last=int(leading[-1]))


def partners_of(selection: MessageSelection, leader: Stream, follower: Stream) -> npt.NDArray[np.intp]:
    """Return the number of the follower's message that goes with each of a leader's, -1 where none does."""
    stamps = selection.scans[leader.topic].stamps
    return partners(stamps, selection.scans[follower.topic].stamps, _half_period(stamps))


def complete_frames(selection: MessageSelection) -> MessageSelection:
    """Leave only frames that all cameras and LiDARs have: frame k of one is then frame k of all.

    Other topics than those of sensors go, and so do frames that are stamped as the one before them.

    Raises:
        DataError: No frame is complete.
    """
    streams = [stream for stream in selection.streams if stream.sensor is not None]
    framed = [stream for stream in streams if stream.kind is not TopicKind.SAMPLES]
    index = {stream.topic: _distinct(selection, stream) for stream in framed}
    stamps = {topic: selection.scans[topic].stamps[kept] for topic, kept in index.items()}
    primary = selection.primary
    leading = stamps[primary.topic]
    whole = np.ones(len(leading), dtype=np.bool_)
    pairs = {}
    for stream in framed:
        if stream.topic == primary.topic:
            continue
        limit = max(_half_period(selection.scans[one.topic].stamps) for one in (primary, stream))
        pairs[stream.topic] = partners(leading, stamps[stream.topic], limit)
        whole &= pairs[stream.topic] >= 0
        if not whole.any():
            raise DataError(
                f"sensors.{stream.sensor}: no message of {stream.topic} is within {limit / 1e6:.0f} ms of a "
                f"whole frame of {primary.topic}; frames of a folder need all of its sensors"
            )
    chosen = {primary.topic: index[primary.topic][whole]}
    chosen |= {topic: index[topic][pair[whole]] for topic, pair in pairs.items()}
    masks = {topic: _mask(len(selection.masks[topic]), kept) for topic, kept in chosen.items()}
    kept = leading[whole]
    return replace(
        selection,
        streams=streams,
        masks={stream.topic: selection.masks[stream.topic] for stream in streams} | masks,
        scans={stream.topic: selection.scans[stream.topic] for stream in streams},
        first=int(kept[0]),
        last=int(kept[-1]),
    )


def _distinct(selection: MessageSelection, stream: Stream) -> npt.NDArray[np.intp]:
    """Return the indices of a stream's messages that are kept, of those with one stamp the first."""
    kept = np.flatnonzero(selection.masks[stream.topic])
    _, first = np.unique(selection.scans[stream.topic].stamps[kept], return_index=True)
    return kept[first]


_FOREVER = 2**62


def _bounds(scan: Scan, window: MessageOptions, primary: Stream) -> tuple[int, int]:
    """Return the first and last header stamp (ns) of the window."""
    if window.start == 0.0 and window.duration is None:
        return -_FOREVER, _FOREVER
    begin = int(scan.stamps[0]) + round(window.start * 1e9)
    end = begin + round(window.duration * 1e9) if window.duration is not None else _FOREVER
    # Half open: two variants that follow each other share no frame.
    if not np.any((scan.stamps >= begin) & (scan.stamps < end)):
        length = (scan.stamps[-1] - scan.stamps[0]) / 1e9
        raise InputError(
            f"input.start: nothing is left of {primary.topic} after {window.start:g} s; "
            f"it lasts {length:.3f} s"
        )
    return begin, end - 1


def _frames(
    leader: Stream,
    followers: list[Stream],
    scans: Mapping[str, Scan],
    window: MessageOptions,
    bounds: tuple[int, int],
) -> dict[str, Mask]:
    """Choose the frames of a sensor and of those that go with it."""
    stamps = scans[leader.topic].stamps
    limit = _half_period(stamps)
    pairs = {item.topic: partners(stamps, scans[item.topic].stamps, limit) for item in followers}
    inside = (stamps >= bounds[0]) & (stamps <= bounds[1])
    complete = inside.copy()
    for item in followers:
        complete &= pairs[item.topic] >= 0
        if not complete.any():
            raise DataError(
                f"sensors.{item.sensor}: no message of {item.topic} is within {limit / 1e6:.0f} ms of one of "
                f"{leader.topic}; the stamps of a pair must belong together"
            )
    if window.frame_rate is None:
        others = {item.topic: scans[item.topic].stamps for item in followers}
        return {leader.topic: inside} | {
            topic: _companions(other, pairs[topic], inside, bounds) for topic, other in others.items()
        }
    chosen = np.flatnonzero(complete)
    chosen = chosen[thin(stamps[chosen], window.frame_rate)]
    result = {leader.topic: _mask(len(stamps), chosen)}
    for item in followers:
        result[item.topic] = _mask(len(scans[item.topic].stamps), pairs[item.topic][chosen])
    return result


def _companions(
    others: npt.NDArray[np.int64], pair: npt.NDArray[np.intp], inside: Mask, bounds: tuple[int, int]
) -> Mask:
    """Choose all of a follower's frames in the window; at its edges the leader's frames decide."""
    mask = (others >= bounds[0]) & (others <= bounds[1])
    mask &= ~_mask(len(others), pair[~inside & (pair >= 0)])
    return mask | _mask(len(others), pair[inside & (pair >= 0)])


def _mask(length: int, index: npt.NDArray[np.intp]) -> Mask:
    mask = np.zeros(length, dtype=np.bool_)
    mask[index] = True
    return mask


def _half_period(stamps: npt.NDArray[np.int64]) -> float:
    """Return the most that stamps of a pair's frames may differ, ns."""
    rate = rate_of(stamps)
    return 0.5e9 / rate if rate else 0.5e9


def _info(scan: Scan, images: Scan, kept: Mask) -> Mask:
    """Choose the camera_info messages that belong to kept images; a latched one stays whole."""
    if kept.all() or len(scan.stamps) < _SPARSE * len(images.stamps):
        return np.ones(len(scan.stamps), dtype=np.bool_)
    pair = partners(images.stamps[kept], np.sort(scan.stamps), _half_period(images.stamps))
    return _mask(len(scan.stamps), np.argsort(scan.stamps, kind="stable")[pair[pair >= 0]])
