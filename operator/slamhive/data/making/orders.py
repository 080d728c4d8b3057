# SPDX-License-Identifier: Apache-2.0
"""Making of recordings of a dataset: the chosen sensors, at the rate, size and length asked for.

What is asked is an `Order`, checked before anything is read. Variants (`preparation`) and exports
(`exporting`) are made here.
"""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.contract.posefiles import FRAMES
from slamhive.data.making.selection import complete_frames, select
from slamhive.data.recordings.checks import check_content
from slamhive.data.recordings.clouds import cloud_filter
from slamhive.data.recordings.posetopics import truth_topic
from slamhive.data.recordings.reading import recording_paths
from slamhive.data.recordings.repairing import open_recording
from slamhive.data.recordings.streams import streams_of
from slamhive.model.base import seconds
from slamhive.model.configuration import SensorView
from slamhive.model.errors import InputError
from slamhive.model.formats import FILE_NAMES, DataFormat, RecordingFormat, holds, misfit
from slamhive.model.run import DELIVERY, STAMPS, TOLD, Perturbation, without_idle
from slamhive.model.sensors import ROLE_TYPES, Role, SensorType
from slamhive.plan.perturbable import perturbation_problems

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    import numpy as np
    import numpy.typing as npt

    from slamhive.data.making.folders import FolderPlan
    from slamhive.data.making.selection import MessageSelection
    from slamhive.data.recordings.entries import DatasetEntry
    from slamhive.model.run import InputOptions, LidarInput


@dataclass(frozen=True)
class RecordingOptions:
    """The options that matter for the sensors chosen, in plain numbers.

    Attributes:
        frame_rate: Hz; None: as recorded.
        resolution: Scale of images.
        start: Seconds left out at the beginning.
        duration: Seconds kept; None: all.
        lidar: What is kept of scans.
        perturb: What is made worse on purpose; None: nothing.
    """

    frame_rate: float | None
    resolution: float
    start: float
    duration: float | None
    lidar: LidarInput | None
    perturb: Perturbation | None = None

    @property
    def is_idle(self) -> bool:
        """Tell whether messages stay as they are."""
        return self == RecordingOptions(None, 1.0, 0.0, None, None)

    @property
    def blurs_by_motion(self) -> bool:
        """Tell whether images are blurred by how the platform turns."""
        return bool(self.perturb and self.perturb.images and self.perturb.images.motion_blur)


def _sensor_for(entry: DatasetEntry, role: Role, options: InputOptions) -> SensorView:
    name = entry.dataset.spec.sensor_for(role, options.remap)
    sensor = entry.dataset.spec.told_sensors[name]
    expected = ROLE_TYPES[role]
    if sensor.type is not expected:
        raise InputError(
            f"input.remap.{role}: sensor {name!r} is of type {sensor.type}, only {expected} is allowed"
        )
    return SensorView.model_validate(sensor.as_json() | {"name": name})


def _wish(options: InputOptions, sensors: dict[Role, SensorView], target: DataFormat) -> RecordingOptions:
    types = {sensor.type for sensor in sensors.values()}
    cameras = types & {SensorType.CAMERA, SensorType.DEPTH_CAMERA}
    lidar = options.lidar if SensorType.LIDAR in types else None
    return RecordingOptions(
        frame_rate=options.frame_rate if any(kind.has_frames for kind in types) else None,
        resolution=options.resolution if cameras else 1.0,
        start=seconds(options.start) if options.start else 0.0,
        duration=seconds(options.duration) if options.duration else None,
        lidar=lidar if lidar and lidar.as_json() else None,
        perturb=_perturbation(options, sensors, target),
    )


_PERTURBED = {"lidar": SensorType.LIDAR, "images": SensorType.CAMERA, "imu": SensorType.IMU}


def _perturbation(
    options: InputOptions, sensors: dict[Role, SensorView], target: DataFormat
) -> Perturbation | None:
    """Return the perturbation as far as it changes something of the sensors' recording.

    What an algorithm is told wrongly of its sensors is part of a folder's files, and of no bag; in what order
    messages are delivered, of a bag alone.
    """
    if options.perturb is None:
        return None
    types = {sensor.type for sensor in sensors.values()}
    body = options.perturb.as_json()
    for block, kind in _PERTURBED.items():
        if kind not in types:
            body.pop(block, None)
    of_target = TOLD if target.is_folder else DELIVERY
    for block in (*STAMPS, *DELIVERY, *TOLD):
        matters = block in {*STAMPS, *of_target}
        by_role = body.pop(block, {})
        body[block] = {role: by_role[role] for role in map(str, sensors) if matters and role in by_role}
    found = without_idle(body)
    return Perturbation.model_validate(found) if found else None


def _views(sensors: dict[Role, SensorView], wish: RecordingOptions) -> dict[Role, SensorView]:
    """Return the sensors as the options leave them; rates follow from the frames kept."""
    views = {}
    for role, sensor in sensors.items():
        view = sensor
        if sensor.type is SensorType.LIDAR:
            view = sensor.replace(lidar=cloud_filter(wish.lidar, sensor.lidar, sensor.name)[1])
        elif sensor.camera is not None and wish.resolution != 1.0:
            from slamhive.data.recordings.images import scale_camera  # noqa: PLC0415 - as in `make_recording`

            view = sensor.replace(camera=scale_camera(sensor.camera, wish.resolution))
        views[role] = view
    return views


@dataclass(frozen=True)
class Order:
    """Order to make a recording from a dataset, checked as far as possible before the dataset is read.

    Attributes:
        entry: The dataset, materialised.
        sensors: The sensors by role as the dataset declares them, under its repair.
        wish: The options that matter.
        target: How it is stored.
        views: The sensors as the options and a folder's form leave them; rates follow from the frames kept.
        folder: What a folder of files is to hold; None for a bag.
        topics: Topics that are given beside the sensors', as they are.
    """

    entry: DatasetEntry
    sensors: dict[Role, SensorView]
    wish: RecordingOptions
    target: DataFormat
    views: Mapping[Role, SensorView]
    folder: FolderPlan | None
    topics: tuple[str, ...] = ()


@dataclass(frozen=True)
class MadeRecording:
    """Result of making a recording: the messages chosen, and the sensors as they are in it.

    Attributes:
        selection: The messages chosen.
        views: The sensors as they are in the recording, their rates included.
    """

    selection: MessageSelection
    views: dict[Role, SensorView]


def order_of(
    entry: DatasetEntry,
    roles: Sequence[Role],
    options: InputOptions,
    target: DataFormat,
    topics: Sequence[str] = (),
) -> Order:
    """Return an order of a recording.

    Raises:
        InputError: The options, or the form asked for, don't fit the dataset.
    """
    if not holds(target, roles):
        raise InputError(misfit([target], roles, f"these sensors of {entry.name}"))
    if topics and target.is_folder:
        raise InputError(f"modes.topics: {target} holds no topics; recording: a bag does")
    sensors = {role: _sensor_for(entry, role, options) for role in roles}
    for problem in perturbation_problems(options.as_json(), entry.dataset, roles, target):
        raise InputError(problem)
    wish = _wish(options, sensors, target)
    views = _views(sensors, wish)
    folder = None
    if target.is_folder:
        from slamhive.data.making.folders import plan_folder  # noqa: PLC0415 - as in `make_recording`

        folder = plan_folder(target, entry.name, views)
    return Order(entry, sensors, wish, target, folder.views if folder else views, folder, (*topics,))


def make_recording(
    order: Order, folder: Path, progress: Callable[[float], None] | None = None, *, link: bool = True
) -> MadeRecording:
    """Make the recording of an order in a folder, and ``frames.txt``.

    Args:
        order: The order.
        folder: Where to; there is nothing of these names in it.
        progress: Called with the share done, 0 to 1.
        link: Whether a recording that stays as it is may be linked to the original.

    Raises:
        DataError: The recording can't be used.
        OSError: The disk refuses.
    """
    # With OpenCV and writers of bags, half a second: for those alone who make a recording.
    from slamhive.data.making.folders import write_folder  # noqa: PLC0415
    from slamhive.data.making.perturbing import perturbed  # noqa: PLC0415
    from slamhive.data.making.smearing import ImageMotion  # noqa: PLC0415
    from slamhive.data.making.transfer import is_decoded, transfer  # noqa: PLC0415

    entry, wish, target = order.entry, order.wish, order.target
    path = folder / FILE_NAMES[target]
    truth = entry.dataset.spec.ground_truth
    with open_recording(entry.dataset, entry.root) as recording:
        hidden = truth_topic(truth.topic) if truth else None
        streams = streams_of(recording, order.sensors, hidden, order.topics)
        check_content(recording, {view.name: view for view in order.sensors.values()})
        selection = select(recording, streams, wish, _share(progress, 0.0, 0.3))
        original = recording_paths(entry.dataset, entry.root)
        whole = {stream.topic for stream in streams} == set(recording.topics)
        whole = whole and not entry.dataset.spec.topic_repairs and not recording.is_converted
        whole = whole and (target is DataFormat.ROSBAG1 or recording.is_playable)
        whole = whole and not any(is_decoded(recording, stream) for stream in streams)
        report = _share(progress, 0.3, 1.0)
        if order.folder is not None:
            selection = complete_frames(selection)
        if wish.perturb is not None:
            is_whole = order.folder is not None
            motion = ImageMotion(entry, recording) if wish.blurs_by_motion else None
            selection = perturbed(
                recording, selection, wish.perturb, order.sensors, motion, is_whole=is_whole
            )
        views = _timed(order.views, selection)
        if order.folder is not None:
            views = write_folder(recording, selection, wish, order.folder.timed(views), path, report)
        elif whole and wish.is_idle and target == DataFormat(recording.format) and len(original) == 1:
            _link(original[0], path, hard=link)
        else:
            stored = RecordingFormat(target)
            transfer(recording, selection, wish, target=path, target_format=stored, progress=report)
    (folder / FRAMES).write_bytes(frames_text(selection.stamps, selection.primary.time_offset))
    if progress:
        progress(1.0)
    return MadeRecording(selection, views)


def _timed(views: Mapping[Role, SensorView], selection: MessageSelection) -> dict[Role, SensorView]:
    """Return the sensors with the rates of what is kept of them."""
    rates = {stream.sensor: selection.rate(stream) for stream in selection.streams if stream.sensor}
    return {role: view.replace(rate=rates[view.name] or view.rate) for role, view in views.items()}


def _share(
    progress: Callable[[float], None] | None, low: float, high: float
) -> Callable[[float], None] | None:
    if progress is None:
        return None
    return lambda share: progress(low + (high - low) * min(share, 1.0))


def _link(original: Path, path: Path, *, hard: bool) -> None:
    """Put a recording into the variant so that nothing leads to what lies beside it, as a symlink would.

    Only a read-only file is linked: an algorithm must not be able to write into someone's data.
    """
    original = original.resolve()
    if original.is_dir():
        shutil.copytree(original, path)
        return
    if hard and not original.stat().st_mode & 0o222:
        with suppress(OSError):  # another file system, or one without hard links
            os.link(original, path)
            return
    shutil.copyfile(original, path)


def frames_text(stamps: npt.NDArray[np.int64], time_offset: float) -> bytes:
    """Return header stamps (ns) as sensor time, a line a frame."""
    offset = round(time_offset * 10**9)
    return "".join(f"{stamp + offset}\n" for stamp in stamps.tolist()).encode()
