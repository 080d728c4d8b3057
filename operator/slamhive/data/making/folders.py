# SPDX-License-Identifier: Apache-2.0
"""Writing of folders as programs of the field read them: EuRoC's ASL folder, TUM RGB-D's, KITTI odometry's.

All times in them are sensor time: each sensor's ``timeOffset`` is added to its stamps, and is 0 afterwards.
Frame k of one sensor belongs to frame k of all others. `layouts` says where things are in each form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

import cv2
import numpy as np

from slamhive.data.files.workers import Workers
from slamhive.data.making.layouts import DEPTH_FACTOR, LAYOUTS
from slamhive.data.making.transfer import chosen_messages
from slamhive.data.recordings.clouds import cloud_filter, cloud_points, filter_cloud
from slamhive.data.recordings.images import compressed_pixels, image_pixels, resize
from slamhive.data.recordings.kinds import COMPRESSED_IMAGE, IMAGE, IMU, POINT_CLOUD
from slamhive.data.recordings.rectifying import rectify
from slamhive.model.errors import DataError, InputError
from slamhive.model.formats import DataFormat
from slamhive.model.sensors import Role, SensorType
from slamhive.plan.misleading import misled

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path
    from types import TracebackType

    import numpy.typing as npt

    from slamhive.data.making.layouts import Layout
    from slamhive.data.making.selection import MessageSelection
    from slamhive.data.making.transfer import Changes
    from slamhive.data.recordings.reading import Recording
    from slamhive.data.recordings.rectifying import Maps
    from slamhive.data.recordings.streams import Stream
    from slamhive.model.configuration import SensorView

    Pixels = npt.NDArray[Any]

PNG = [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
PNG += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB]
"""Differences of neighbours, and runs of them: on EuRoC's images as small as zlib's level 6, in a quarter of
the time."""

_BGR = {"rgb8": cv2.COLOR_RGB2BGR, "rgb16": cv2.COLOR_RGB2BGR, "rgba8": cv2.COLOR_RGBA2BGR}
_BGR |= dict.fromkeys(("bgra8", "8UC4"), cv2.COLOR_BGRA2BGR)
_ENCODINGS = {("u1", 2): "mono8", ("u2", 2): "mono16", ("u1", 3): "bgr8", ("u2", 3): "bgr16"}
_DEPTH_ENCODING = "16UC1"


@dataclass(frozen=True, eq=False)
class FolderPlan:
    """Plan of a folder that a recording is written into as files: form, sensors, rectification.

    Attributes:
        form: Its form.
        name: Of the dataset, for remarks in the files.
        views: The sensors by role, as the folder has them.
        maps: How the images of cameras are rectified, where they are.
    """

    form: DataFormat
    name: str
    views: Mapping[Role, SensorView]
    maps: Mapping[Role, Maps]

    def timed(self, views: Mapping[Role, SensorView]) -> FolderPlan:
        """Return the plan with the sensors' rates known."""
        return replace(self, views=views)


def plan_folder(form: DataFormat, name: str, views: Mapping[Role, SensorView]) -> FolderPlan:
    """Say what a folder is to hold.

    Args:
        form: Its form.
        name: Of the dataset.
        views: The sensors by role, scaled and filtered as the options say; times as recorded.

    Raises:
        InputError: A sensor lacks what the form needs, or can't be rectified.
    """
    topics = [view.topic for view in views.values()]
    if len({*topics}) < len(topics):
        raise InputError(
            f"input.remap: {', '.join(views)} of a folder in {form}'s form must be different sensors; "
            f"found {', '.join(view.name for view in views.values())}"
        )
    for role, view in views.items():
        if form is DataFormat.EUROC and role is not Role.IMU and view.camera is None:
            raise InputError(
                f"sensors.{view.name}.camera: intrinsics are needed for the sensor.yaml of Euroc"
            )
        if role is Role.DEPTH and (view.camera is None or view.camera.depth_scale is None):
            raise InputError(
                f"sensors.{view.name}.camera.depthScale: needed for depth images in {form}'s form: their "
                "units per metre, such as 1000 or 5000"
            )
    plain = {role: _without_lost(view) for role, view in views.items()}
    found, maps = rectify(plain) if form is DataFormat.KITTI else (plain, {})
    return FolderPlan(form, name, found, maps)


def write_folder(  # noqa: PLR0917 - progress comes last everywhere
    recording: Recording,
    selection: MessageSelection,
    changes: Changes,
    plan: FolderPlan,
    target: Path,
    progress: Callable[[float], None] | None = None,
) -> dict[Role, SensorView]:
    """Write the chosen messages into a folder of files.

    Args:
        recording: Where they come from.
        selection: The messages chosen, whole frames alone.
        changes: What is done to them.
        plan: What the folder is to hold.
        target: The folder; made if need be.
        progress: Called with the share done, 0 to 1.

    Returns:
        The sensors as they are in the folder, with the encoding of their images.

    Raises:
        DataError: A message can't be read, or has no place in this form.
        OSError: The disk refuses.
    """
    roles = {view.topic: role for role, view in plan.views.items()}
    streams = {stream.topic: stream for stream in selection.streams}
    stamps = {
        roles[topic]: selection.scans[topic].stamps[selection.masks[topic]] + _offset(stream)
        for topic, stream in streams.items()
    }
    target.mkdir(exist_ok=True)
    primary = roles[selection.primary.topic]
    layout = LAYOUTS[plan.form](target, plan.name, stamps, primary)
    kept = dict.fromkeys(streams, 0)
    with layout, _FrameWriter(recording, changes, plan, layout) as frames:
        for connection, _, raw in chosen_messages(recording, selection, progress):
            topic = connection.topic
            frames.take(roles[topic], streams[topic], kept[topic], raw)
            kept[topic] += 1
    views = frames.views()
    layout.finish(misled(views, changes.perturb))
    return views


def _without_lost(view: SensorView) -> SensorView:
    """Return a sensor without what a folder leaves out: an offset of its stamps, points' times and rings."""
    lidar = view.lidar.replace(time_field=None, ring_field=None) if view.lidar else None
    return view.replace(time_offset=0.0, lidar=lidar)


def _offset(stream: Stream) -> int:
    return round(stream.time_offset * 10**9)


class _FrameWriter:
    """Writes messages as files, images on threads of their own with few of them waiting."""

    def __init__(self, recording: Recording, changes: Changes, plan: FolderPlan, layout: Layout) -> None:
        self._recording = recording
        self._changes = changes
        self._plan = plan
        self._layout = layout
        self._encodings: dict[Role, str] = {}
        self._is_real: set[Role] = set()
        self._workers = Workers()

    def __enter__(self) -> Self:
        self._workers.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._workers.__exit__(kind, error, trace)

    def take(self, role: Role, stream: Stream, index: int, raw: bytes) -> None:
        """Write one message: frame number `index` of a sensor, or a sample."""
        message = self._recording.decode(raw, stream.message_type)
        where = f"{stream.topic} in {self._recording.label}"
        match stream.message_type:
            case kind if kind == IMU:
                self._sample(stream, index, message, where)
            case kind if kind == POINT_CLOUD:
                self._scan(role, stream, index, message, where)
            case kind if kind in {IMAGE, COMPRESSED_IMAGE}:
                self._image(role, stream, index, message, where)

    def views(self) -> dict[Role, SensorView]:
        """Return the sensors as they are in the folder."""
        found = dict(self._plan.views)
        for role, encoding in self._encodings.items():
            camera = found[role].camera
            if camera is not None:
                scale = DEPTH_FACTOR if role in self._is_real else camera.depth_scale
                changed = camera.replace(encoding=encoding, depth_scale=scale)
                found[role] = found[role].replace(camera=changed)
        return found

    def _sample(self, stream: Stream, index: int, message: Any, where: str) -> None:
        w, a, stamp = message.angular_velocity, message.linear_acceleration, message.header.stamp
        rate, force = (w.x, w.y, w.z), (a.x, a.y, a.z)
        if not all(map(math.isfinite, (*rate, *force))):
            raise DataError(f"{where}: sample {index + 1} has a rate or force that is not a finite number")
        self._layout.sample(stamp.sec * 10**9 + stamp.nanosec + _offset(stream), rate, force)

    def _scan(self, role: Role, stream: Stream, index: int, message: Any, where: str) -> None:
        declared = stream.declared.lidar if stream.declared else None
        kept, _ = cloud_filter(self._changes.lidar, declared, stream.sensor or "")
        if not kept.is_idle:
            message = filter_cloud(message, kept, where)
        table = _points(cloud_points(message, where), where)
        self._layout.place(role, index).write_bytes(table.tobytes())

    def _image(self, role: Role, stream: Stream, index: int, message: Any, where: str) -> None:
        if stream.message_type == IMAGE:
            pixels, encoding = image_pixels(message, where), message.encoding
        else:
            pixels, encoding = compressed_pixels(message, where), ""
        declared = stream.declared.camera if stream.declared else None
        if declared is not None and pixels.shape[:2] != (declared.height, declared.width):
            raise DataError(
                f"sensors.{stream.sensor}.camera: states {declared.width}×{declared.height} pixels, but the "
                f"images on {where} have {pixels.shape[1]}×{pixels.shape[0]}"
            )
        is_depth = stream.declared is not None and stream.declared.type is SensorType.DEPTH_CAMERA
        if is_depth and pixels.dtype == np.float32:
            self._is_real.add(role)
        written = _DEPTH_ENCODING if is_depth else _encoding(pixels, encoding, where)
        if self._encodings.setdefault(role, written) != written:
            raise DataError(
                f"{where}: image {index + 1} is {encoding or written}, those before it are "
                f"{self._encodings[role]}; the images of a folder must be alike"
            )
        scale = declared.depth_scale if is_depth and declared is not None else None
        path = self._layout.place(role, index, color=pixels.ndim == 3)
        self._workers.later(lambda: self._write(path, role, _plain(pixels, encoding), scale, where))

    def _write(self, path: Path, role: Role, pixels: Pixels, depth_scale: float | None, where: str) -> None:
        if self._changes.resolution != 1.0:
            pixels = resize(pixels, self._changes.resolution, nearest=depth_scale is not None)
        if depth_scale is not None:
            pixels = _depth(pixels, depth_scale, where)
        if role in self._plan.maps:
            pixels = cv2.remap(pixels, *self._plan.maps[role], cv2.INTER_LINEAR)
        path.write_bytes(cv2.imencode(".png", pixels, PNG)[1].tobytes())


def _plain(pixels: Pixels, encoding: str) -> Pixels:
    """Return an image in the order of channels that OpenCV writes, without transparency."""
    if encoding in _BGR:
        return cv2.cvtColor(pixels, _BGR[encoding])
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        return cv2.cvtColor(pixels, cv2.COLOR_BGRA2BGR)
    return pixels


def _encoding(pixels: Pixels, encoding: str, where: str) -> str:
    """Return OpenCV's encoding of an image's PNG."""
    found = _ENCODINGS.get((pixels.dtype.str.lstrip("<>|="), pixels.ndim))
    if found is None:
        raise DataError(
            f"{where}: images of {encoding or pixels.dtype.name} have no place in a folder's PNG files; "
            "allowed: 8 or 16 bits, grey or in colours"
        )
    return found


def _depth(pixels: Pixels, scale: float, where: str) -> Pixels:
    """Return depth as 16 bits: whole units as they are, metres in floating point by the usual factor."""
    if pixels.ndim != 2 or pixels.dtype not in (np.uint8, np.uint16, np.float32):
        raise DataError(f"{where}: depth images must have one channel of 16 bits or of 32-bit floats")
    if pixels.dtype != np.float32:
        return pixels.astype(np.uint16)
    units = np.nan_to_num(np.rint(pixels * np.float32(DEPTH_FACTOR / scale)), nan=0.0, posinf=0.0, neginf=0.0)
    # What is farther than 16 bits reach is unknown, not at their end.
    units[(units < 0) | (units > np.iinfo(np.uint16).max)] = 0
    return units.astype(np.uint16)


def _points(points: npt.NDArray[np.void], where: str) -> npt.NDArray[np.float32]:
    """Return points as rows x, y, z, intensity; those without a position go."""
    names = points.dtype.names or ()
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise DataError(f"{where}: points have no field {missing[0]!r}; they have: {', '.join(names)}")
    table = np.zeros((len(points), 4), dtype="<f4")
    for column, name in enumerate(("x", "y", "z", "intensity")):
        if name in names:
            table[:, column] = points[name]
    return table[np.isfinite(table[:, :3]).all(axis=1)]
