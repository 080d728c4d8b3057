# SPDX-License-Identifier: Apache-2.0
"""Perturbation of what was selected: fewer messages, other stamps, other content, the same from equal seeds.

What is random goes by the number of a message in the recording, so that a cut or another rate changes none of
it, and a stronger perturbation does more of the same. `perturbed` is the one place for bags and folders: it
says what becomes of each message before anything else is done to it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.making.delivering import added_delay
from slamhive.data.making.disturbing import Shutter, Weather, disturbed_image, disturbed_scan
from slamhive.data.making.selection import complete_frames, partners_of, with_masks
from slamhive.data.recordings.clouds import move_point_times
from slamhive.data.recordings.kinds import COMPRESSED_IMAGE, IMAGE, IMU, POINT_CLOUD
from slamhive.data.recordings.repairing import END_OF_STAMPS, IMU_FORCE, IMU_RATE, changed_sample, restamped
from slamhive.data.recordings.streams import TopicKind
from slamhive.data.recordings.thinning import thin
from slamhive.data.synthetic.streams import stream as numbers_of
from slamhive.model.errors import DataError
from slamhive.model.run import DEFAULT_SEED
from slamhive.model.sensors import SensorType

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy.typing as npt

    from slamhive.data.making.selection import Mask, MessageChange, MessageSelection
    from slamhive.data.making.smearing import ImageMotion
    from slamhive.data.recordings.reading import Recording, Scan
    from slamhive.data.recordings.streams import Stream
    from slamhive.model.configuration import SensorView
    from slamhive.model.run import ImagesPerturbation, ImuPerturbation, Perturbation
    from slamhive.model.sensors import Role

    Times = npt.NDArray[np.int64]
    Ways = npt.NDArray[np.float64]
    Raw = bytes | bytearray | memoryview


def perturbed(
    recording: Recording,
    selection: MessageSelection,
    perturb: Perturbation,
    sensors: Mapping[Role, SensorView],
    motion: ImageMotion | None = None,
    *,
    is_whole: bool,
) -> MessageSelection:
    """Return a selection whose messages are perturbed.

    Args:
        recording: Where they come from.
        selection: The messages chosen.
        perturb: What is done.
        sensors: The sensors by role, as they are recorded.
        motion: Of images over their exposure, where it is to blur them.
        is_whole: Whether it has, and keeps, whole frames alone, as of a folder.

    Raises:
        DataError: A stamp would be one that no message can have.
    """
    return _Perturber(recording, selection, perturb, sensors, motion).result(is_whole=is_whole)


class _Perturber:
    def __init__(
        self,
        recording: Recording,
        selection: MessageSelection,
        perturb: Perturbation,
        sensors: Mapping[Role, SensorView],
        motion: ImageMotion | None,
    ) -> None:
        self._recording = recording
        self._motion = motion
        self._selection = selection
        self._perturb = perturb
        self._seed = DEFAULT_SEED if perturb.seed is None else perturb.seed
        self._roles: dict[str, list[Role]] = {}
        for role, view in sensors.items():
            self._roles.setdefault(view.topic, []).append(role)
        self._repeated: dict[str, Mask] = {}

    def result(self, *, is_whole: bool) -> MessageSelection:
        masks = self._kept()
        self._selection = with_masks(self._selection, masks)
        if masks and is_whole:
            self._selection = complete_frames(self._selection)
        stamps = self._stamps()
        changes: dict[str, MessageChange] = {}
        finishes: dict[str, MessageChange] = {}
        for stream in self._selection.streams:
            if (change := self._content(stream)) is not None:
                changes[stream.topic] = change
            steps = self._in_turn(stream)
            if stream.topic in stamps:
                steps += self._moved(stream, stamps[stream.topic])
            if steps:
                finishes[stream.topic] = partial(_all_of, steps)
        scans = dict(self._selection.scans)
        for topic, moved in stamps.items():
            scans[topic] = replace(scans[topic], stamps=moved)
        later = self._later_deliveries()
        first, last = self._selection.record_window
        window = first, last + max((int(added.max()) for added in later.values()), default=0)
        found = replace(self._selection, scans=scans, changes=changes, finishes=finishes)
        return with_masks(replace(found, later=later, record_window=window), {})

    def _numbers(self, purpose: str, stream: Stream, index: int = 0) -> np.random.Generator:
        return numbers_of(self._seed, f"{purpose} {stream.sensor}", index)

    # Which messages.

    def _kept(self) -> dict[str, Mask]:
        """Return the messages kept of the topics that lose some, and note the frames that stand still."""
        masks: dict[str, Mask] = {}
        images, imu, lidar = self._perturb.images, self._perturb.imu, self._perturb.lidar
        for stream in self._selection.streams:
            if imu is not None and imu.rate is not None and _is(stream, SensorType.IMU):
                masks[stream.topic] = self._thinned(stream, imu.rate)
            if stream.kind is not TopicKind.FRAMES:
                continue
            mask = self._selection.masks[stream.topic]
            if images is not None and _is(stream, SensorType.CAMERA):
                left_out = self._drawn("dropFrames", stream, mask, images.drop_frames)
                still = self._drawn("duplicateFrames", stream, mask & ~left_out, images.duplicate_frames)
            elif lidar is not None and _is(stream, SensorType.LIDAR):
                left_out = self._drawn("dropScans", stream, mask, lidar.drop_scans)
                still = np.zeros_like(mask)
            else:
                continue
            for one, lost, same in self._with_partners(stream, left_out, still):
                if lost.any():
                    masks[one.topic] = self._selection.masks[one.topic] & ~lost
                if same.any():
                    self._repeated[one.topic] = same
        return masks

    def _thinned(self, stream: Stream, rate: float) -> Mask:
        kept = np.flatnonzero(self._selection.masks[stream.topic])
        mask = np.zeros(len(self._selection.masks[stream.topic]), dtype=np.bool_)
        mask[kept[thin(self._selection.scans[stream.topic].stamps[kept], rate)]] = True
        return mask

    def _drawn(self, purpose: str, stream: Stream, mask: Mask, share: float | None) -> Mask:
        """Draw a share of some frames; the first, which others are counted from, is never one."""
        later = np.flatnonzero(mask)[1:]
        order = np.argsort(self._numbers(purpose, stream).random(len(mask))[later], kind="stable")
        drawn = np.zeros(len(mask), dtype=np.bool_)
        drawn[later[order[: round((share or 0.0) * (len(later) + 1))]]] = True
        return drawn

    def _with_partners(self, leader: Stream, *masks: Mask) -> list[tuple[Stream, Mask, Mask]]:
        """Return messages of a camera, and those of the cameras whose frames go with its own."""
        found = [(leader, masks[0], masks[1])]
        for stream in self._selection.streams:
            if stream.kind is TopicKind.PARTNER and stream.follows == leader.topic:
                pairs = partners_of(self._selection, leader, stream)
                theirs = []
                for mask in masks:
                    of_partner = np.zeros(len(self._selection.masks[stream.topic]), dtype=np.bool_)
                    of_partner[pairs[mask & (pairs >= 0)]] = True
                    theirs.append(of_partner)
                found.append((stream, theirs[0], theirs[1]))
        return found

    # When.

    def _stamps(self) -> dict[str, Times]:
        """Return the stamps of the topics whose stamps move, ns, shape (n,)."""
        found: dict[str, Times] = {}
        for stream in self._selection.streams:
            scan = self._selection.scans[stream.topic]
            if stream.kind is TopicKind.INFO and stream.follows in found:
                images = self._selection.scans[stream.follows].stamps
                found[stream.topic] = scan.stamps + _following(scan, images, found[stream.follows] - images)
            for role in self._roles.get(stream.topic, ()):
                later = self._later(str(role), stream, scan)
                if later is not None:
                    found[stream.topic] = self._possible(stream, scan.stamps + later)
        return found

    def _later(self, role: str, stream: Stream, scan: Scan) -> Times | None:
        """Return the time added to each stamp of a role's sensor, ns, shape (n,); None for none."""
        perturb, stamps = self._perturb, scan.stamps
        offset, drift, jitter = (
            one.get(role, 0.0) for one in (perturb.time_offset, perturb.drift, perturb.jitter)
        )
        if not (offset or drift or jitter):
            return None
        added = round(offset * 1e9) + np.rint((stamps - stamps[0]) * drift).astype(np.int64)
        if jitter:
            noise = self._numbers("jitter", stream).standard_normal(len(stamps)) * jitter
            # Drivers stamp late, not in another order.
            added = np.sort(stamps + added + np.rint(noise * 1e9).astype(np.int64)) - stamps
        return np.asarray(added)

    def _possible(self, stream: Stream, stamps: Times) -> Times:
        wrong = stamps[(stamps < 0) | (stamps >= END_OF_STAMPS)]
        if wrong.size:
            raise DataError(
                f"input.perturb: a stamp of {stream.topic} in {self._recording.label} would be "
                f"{wrong[0] / 1e9:g} s, which no message can have"
            )
        return stamps

    def _moved(self, stream: Stream, stamps: Times) -> list[MessageChange]:
        is_ros2 = self._recording.is_ros2
        changes: list[MessageChange] = []
        declared = stream.declared.lidar if stream.declared else None
        if stream.message_type == POINT_CLOUD and declared is not None and declared.time_field is not None:
            later = stamps - self._selection.scans[stream.topic].stamps
            field, where = declared.time_field, f"{stream.topic} in {self._recording.label}"
            changes.append(
                self._decoded(stream, lambda k, scan: move_point_times(scan, field, int(later[k]), where))
            )
        return [*changes, lambda k, raw: restamped(bytes(raw), int(stamps[k]), is_ros2=is_ros2)]

    def _later_deliveries(self) -> dict[str, Times]:
        """Return the delays added to the times of recording of the topics that are late, ns, shape (n,)."""
        found: dict[str, Times] = {}
        for stream in self._selection.streams:
            scan, kept = self._selection.scans[stream.topic], self._selection.masks[stream.topic]
            if stream.kind is TopicKind.INFO and stream.follows in found:
                images = self._selection.scans[stream.follows].stamps
                found[stream.topic] = _following(scan, images, found[stream.follows])
            for role in map(str, self._roles.get(stream.topic, ())):
                late, share = self._perturb.late.get(role, 0.0), self._perturb.swapped.get(role, 0.0)
                if late or share:
                    numbers = self._numbers("swapped", stream)
                    found[stream.topic] = added_delay(scan, kept, late, share, numbers)
        return found

    # What.

    def _content(self, stream: Stream) -> MessageChange | None:
        """Return the change of what an image or a scan shows."""
        perturb, where = self._perturb, f"{stream.topic} in {self._recording.label}"
        numbers = partial(self._numbers, stream=stream)
        if perturb.lidar is not None and stream.message_type == POINT_CLOUD and _is(stream, SensorType.LIDAR):
            declared = stream.declared.lidar if stream.declared else None
            weather = Weather(perturb.lidar, numbers, declared.min_range if declared else 0.0)
            if weather.is_idle:
                return None
            return self._decoded(stream, lambda k, scan: disturbed_scan(scan, weather, k, where))
        is_image = stream.message_type in {IMAGE, COMPRESSED_IMAGE}
        if perturb.images is None or not is_image or not _is(stream, SensorType.CAMERA):
            return None
        scan = self._selection.scans[stream.topic]
        first = int(scan.stamps[0])
        shutter = Shutter(perturb.images, numbers, self._ways(stream, scan, perturb.images))
        if shutter.is_idle:
            return None
        return self._decoded(
            stream, lambda k, image: disturbed_image(image, shutter, k, int(scan.stamps[k]) - first, where)
        )

    def _in_turn(self, stream: Stream) -> list[MessageChange]:
        """Return the changes that need the message before, or take next to nothing."""
        found: list[MessageChange] = []
        if self._perturb.imu is not None and stream.message_type == IMU:
            found += self._samples(stream, self._perturb.imu)
        if stream.topic in self._repeated:
            found.append(self._standing_still(stream))
        return found

    def _ways(self, stream: Stream, scan: Scan, images: ImagesPerturbation) -> Ways | None:
        """Return the way of each image's middle over the exposure, px, shape (n, 2)."""
        if self._motion is None or stream.declared is None or not images.motion_blur:
            return None
        return self._motion.over(stream.declared, scan.stamps, images.motion_blur / 1e3)

    def _decoded(self, stream: Stream, change: Callable[[int, Any], Any]) -> MessageChange:
        recording, kind = self._recording, stream.message_type

        def changed(index: int, raw: bytes) -> Raw:
            before = recording.decode(bytes(raw), kind)
            after = change(index, before)
            return raw if after is before else recording.encode(after, kind)

        return changed

    def _standing_still(self, stream: Stream) -> MessageChange:
        """Return a change that gives a frame the image of the one before it, and leaves its header."""
        held: list[Any] = []
        repeated = self._repeated[stream.topic]

        def change(index: int, message: Any) -> Any:
            found = replace(held[0], header=message.header) if repeated[index] and held else message
            held[:] = [found]
            return found

        return self._decoded(stream, change)

    def _samples(self, stream: Stream, imu: ImuPerturbation) -> list[MessageChange]:
        count = len(self._selection.masks[stream.topic])
        parts = (
            (
                "accelerometer",
                IMU_FORCE,
                imu.accelerometer_bias,
                imu.accelerometer_noise,
                imu.accelerometer_range,
            ),
            ("gyroscope", IMU_RATE, imu.gyroscope_bias, imu.gyroscope_noise, imu.gyroscope_range),
        )
        return [
            self._sample(stream, name, places, (bias or 0.0, noise or 0.0, limit), count)
            for name, places, bias, noise, limit in parts
            if bias or noise or limit
        ]

    def _sample(
        self, stream: Stream, name: str, places: slice, wanted: tuple[float, float, float | None], count: int
    ) -> MessageChange:
        bias, noise, limit = wanted
        added = np.full((count, 3), bias)
        if noise:
            added += self._numbers(f"{name}Noise", stream).standard_normal((count, 3)) * noise
        most = np.inf if limit is None else limit
        is_ros2 = self._recording.is_ros2
        return lambda k, raw: changed_sample(
            bytes(raw), places, lambda values: np.clip(values + added[k], -most, most), is_ros2=is_ros2
        )


def _is(stream: Stream, kind: SensorType) -> bool:
    return stream.declared is not None and stream.declared.type is kind


def _all_of(changes: list[MessageChange], index: int, raw: bytes) -> Raw:
    found: Any = raw
    for change in changes:
        found = change(index, found)
    return found  # type: ignore[no-any-return]


def _following(scan: Scan, images: Times, added: Times) -> Times:
    """Return the shifts of times of camera_info: those of the images of the same stamp; of others zero."""
    known = dict(zip(images.tolist(), added.tolist(), strict=True))
    return np.array([known.get(stamp, 0) for stamp in scan.stamps.tolist()], dtype=np.int64)
