# SPDX-License-Identifier: Apache-2.0
"""Variants of a dataset: what an algorithm is given, and nothing else.

A variant holds the chosen sensors' topics with their camera_info, and /tf_static; never ground truth. It is a
folder ``KEY`` of the cache with the recording, ``frames.txt`` (stamps of the primary sensor's frames in ns of
sensor time, a line a frame) and ``variant.json``, made once, and whole when it exists. Its key hashes the
recording, the sensors' calibration, the options that matter and `VERSION`.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.contract.posefiles import FRAMES
from slamhive.data.checks import check_content
from slamhive.data.clouds import cloud_filter
from slamhive.data.entries import recording_sha256
from slamhive.data.images import scale_camera
from slamhive.data.once import evict, flush, in_use, make_once
from slamhive.data.posetopics import truth_topic
from slamhive.data.recordings import Recording, guess_format, open_recording, recording_paths
from slamhive.data.selection import select
from slamhive.data.streams import streams_of
from slamhive.data.transfer import transfer
from slamhive.data.version import VERSION
from slamhive.data.writing import FILE_NAMES
from slamhive.model.algorithm import RecordingFormat
from slamhive.model.base import seconds
from slamhive.model.canonical import digest
from slamhive.model.configuration import SensorView
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.results import Prepared
from slamhive.model.sensors import FOLLOWS, ROLE_TYPES, Role, SensorType

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    import numpy as np
    import numpy.typing as npt

    from slamhive.data.entries import DatasetEntry
    from slamhive.data.selection import Selection
    from slamhive.model.run import InputOptions, LidarInput

DESCRIPTION = "variant.json"
PRIMARY = (Role.CAMERA, Role.LEFT, Role.COLOR, Role.LIDAR)
"""Roles whose frames count as frames and set the window; the first that is there is the primary one."""


@dataclass(frozen=True)
class Variant:
    """A prepared recording.

    Attributes:
        path: The recording: a file, or a folder for Rosbag2.
        format: How it is stored.
        sensors: The sensors by role as they are after preparation.
        start_time: Sensor time of the first frame of the primary sensor, s.
        duration_seconds: Time from its first frame to its last, s.
        frame_rate: Its rate after preparation, Hz; None for a single frame.
        resolution: Scale of images in each direction.
        frames: Its number of frames.
        recorded_frame_rate: Rate of the fastest sensor that a frame rate thins, as recorded, Hz.
        recorded_seconds: Time from the first frame to the last of the whole recording, s. Both are None of a
            variant made before they were noted.
        key: Hash that identifies the variant; its folder's name.
        source_sha256: Hash of the recording that it was made from.
    """

    path: Path
    format: RecordingFormat
    sensors: dict[Role, SensorView]
    start_time: float
    duration_seconds: float
    frame_rate: float | None
    resolution: float
    frames: int
    key: str
    source_sha256: str
    recorded_frame_rate: float | None = None
    recorded_seconds: float | None = None

    @property
    def told(self) -> Prepared:
        """Return what is recorded of a run that was given the variant."""
        return Prepared(
            frame_rate=self.frame_rate,
            resolution=self.resolution,
            duration_seconds=self.duration_seconds,
            frames=self.frames,
            recorded_frame_rate=self.recorded_frame_rate,
            recorded_seconds=self.recorded_seconds,
        )

    @property
    def folder(self) -> Path:
        """Return the variant's folder in the cache."""
        return self.path.parent

    def in_use(self) -> AbstractContextManager[None]:
        """Keep the variant from being evicted while the context lasts.

        Raises:
            SystemFault: on entering, when it is gone already.
        """
        return in_use(self.folder)


@dataclass(frozen=True)
class Wish:
    """The options that matter for the sensors chosen, in plain numbers.

    Attributes:
        frame_rate: Hz; None: as recorded.
        resolution: Scale of images.
        start: Seconds left out at the beginning.
        duration: Seconds kept; None: all.
        lidar: What is kept of scans.
    """

    frame_rate: float | None
    resolution: float
    start: float
    duration: float | None
    lidar: LidarInput | None

    @property
    def is_idle(self) -> bool:
        """Tell whether messages stay as they are."""
        return self == Wish(None, 1.0, 0.0, None, None)


def prepare(  # noqa: PLR0917 - progress comes last everywhere
    entry: DatasetEntry,
    roles: Sequence[Role],
    options: InputOptions,
    formats: Sequence[RecordingFormat],
    cache: Path,
    progress: Callable[[float], None] | None = None,
) -> Variant:
    """Make the variant of a dataset that a run needs, or find it in the cache.

    Args:
        entry: The dataset, materialised.
        roles: The sensors that the algorithm takes.
        options: The run's input options.
        formats: Formats that the algorithm reads, the preferred first.
        cache: Folder of the variants. Hashes of files are remembered in ``.hashes`` in it.
        progress: Called with the share done, 0 to 1, while it is made.

    Returns:
        The variant. Hold `Variant.in_use` while a run works with it.

    Raises:
        InputError: The options don't fit the dataset.
        DataError: The recording can't be used.
        SystemFault: The disk refuses.
    """
    spec = entry.dataset.spec
    sensors = {role: _sensor_for(entry, role, options) for role in roles}
    wish = _wish(options, sensors)
    _views(sensors, wish)  # what the options ask of the sensors is refused before anything is made
    target = spec.recording.format if spec.recording.format in formats else formats[0]
    source = recording_sha256(entry, cache / ".hashes")
    key = digest(
        {
            "version": VERSION,
            "recording": source,
            "sensors": {role: sensor.as_json() for role, sensor in sensors.items()},
            "groundTruthTopic": spec.ground_truth.topic if spec.ground_truth else None,
            "frameRate": wish.frame_rate,
            "resolution": wish.resolution,
            "start": wish.start,
            "duration": wish.duration,
            "lidar": wish.lidar.as_json() if wish.lidar else None,
            "format": target,
        }
    )
    folder = cache / key[:32]

    def make(aside: Path) -> None:
        _make(_Request(entry, sensors, wish, target), aside, progress)

    make_once(folder, make, _is_sound)
    _add_frames(folder)
    return _load(folder, key, source)


def evict_variants(cache: Path, limit_bytes: int) -> list[str]:
    """Remove variants that no run works with, least recently used first, until the rest fits.

    Args:
        cache: Folder of the variants.
        limit_bytes: Size allowed.

    Returns:
        Keys of what was removed.
    """
    return evict(cache, limit_bytes) if cache.is_dir() else []


def _sensor_for(entry: DatasetEntry, role: Role, options: InputOptions) -> SensorView:
    name = entry.dataset.spec.sensor_for(role, options.remap)
    sensor = entry.dataset.spec.sensors[name]
    expected = ROLE_TYPES[role]
    if sensor.type is not expected:
        raise InputError(
            f"input.remap.{role}: sensor {name!r} is of type {sensor.type}, only {expected} is allowed"
        )
    return SensorView.model_validate(sensor.as_json() | {"name": name})


def _wish(options: InputOptions, sensors: dict[Role, SensorView]) -> Wish:
    types = {sensor.type for sensor in sensors.values()}
    cameras = types & {SensorType.CAMERA, SensorType.DEPTH_CAMERA}
    lidar = options.lidar if SensorType.LIDAR in types else None
    return Wish(
        frame_rate=options.frame_rate,
        resolution=options.resolution if cameras else 1.0,
        start=seconds(options.start) if options.start else 0.0,
        duration=seconds(options.duration) if options.duration else None,
        lidar=lidar if lidar and lidar.as_json() else None,
    )


def _views(sensors: dict[Role, SensorView], wish: Wish) -> dict[Role, SensorView]:
    """Return the sensors as the options leave them; rates follow from the frames kept."""
    views = {}
    for role, sensor in sensors.items():
        view = sensor
        if sensor.type is SensorType.LIDAR:
            view = sensor.replace(lidar=cloud_filter(wish.lidar, sensor.lidar, sensor.name)[1])
        elif sensor.camera is not None and wish.resolution != 1.0:
            view = sensor.replace(camera=scale_camera(sensor.camera, wish.resolution))
        views[role] = view
    return views


@dataclass(frozen=True)
class _Request:
    """What a variant is made from."""

    entry: DatasetEntry
    sensors: dict[Role, SensorView]
    wish: Wish
    target: RecordingFormat


def _make(request: _Request, aside: Path, progress: Callable[[float], None] | None) -> None:
    """Fill the folder of a variant."""
    entry, wish, target = request.entry, request.wish, request.target
    path = aside / FILE_NAMES[target]
    truth = entry.dataset.spec.ground_truth
    with open_recording(entry.dataset, entry.root) as recording:
        streams = streams_of(recording, request.sensors, truth_topic(truth.topic) if truth else None)
        check_content(recording, {view.name: view for view in request.sensors.values()})
        selection = select(recording, streams, wish, _share(progress, 0.0, 0.3))
        original = recording_paths(entry.dataset, entry.root)
        whole = {stream.topic for stream in streams} == set(recording.topics)
        if whole and wish.is_idle and target is recording.format and len(original) == 1:
            _link(original[0], path)
        else:
            report = _share(progress, 0.3, 1.0)
            transfer(recording, selection, wish, target=path, target_format=target, progress=report)
    (aside / FRAMES).write_bytes(_frames_text(selection.stamps, selection.primary.time_offset))
    _describe(request, selection, aside)
    if progress:
        progress(1.0)


def _share(
    progress: Callable[[float], None] | None, low: float, high: float
) -> Callable[[float], None] | None:
    if progress is None:
        return None
    return lambda share: progress(low + (high - low) * min(share, 1.0))


def _link(original: Path, path: Path) -> None:
    """Put a recording into the variant so that nothing leads to what lies beside it, as a symlink would.

    Only a read-only file is linked: an algorithm must not be able to write into someone's data.
    """
    original = original.resolve()
    if original.is_dir():
        shutil.copytree(original, path)
        return
    if not original.stat().st_mode & 0o222:
        with suppress(OSError):  # another file system, or one without hard links
            os.link(original, path)
            return
    shutil.copyfile(original, path)


def _describe(request: _Request, selection: Selection, aside: Path) -> None:
    wish, target = request.wish, request.target
    views = _views(request.sensors, wish)
    rates = {stream.sensor: selection.rate(stream) for stream in selection.streams if stream.sensor}
    primary = selection.primary
    offset = primary.time_offset
    path = aside / FILE_NAMES[target]
    description: dict[str, Any] = {
        "format": target,
        "recording": FILE_NAMES[target],
        "state": _state(path),
        "framesSha256": _sha256(aside / FRAMES),
        "sensors": {
            role: view.replace(rate=rates[view.name] or view.rate).as_json() for role, view in views.items()
        },
        "startTime": selection.first / 10**9 + offset,
        "durationSeconds": (selection.last - selection.first) / 10**9,
        "frameRate": rates[primary.sensor or ""],
        "resolution": wish.resolution,
        "frames": selection.frames(primary),
        "recordedFrameRate": selection.recorded_rate,
        "recordedSeconds": selection.recorded_seconds,
    }
    (aside / DESCRIPTION).write_text(json.dumps(description, indent=2) + "\n", encoding="utf-8")


def _add_frames(folder: Path) -> None:
    """Add the stamps of frames to a variant of an earlier version; runs may be reading its recording.

    Raises:
        DataError: The recording can't be read.
        SystemFault: The disk refuses.
    """
    try:
        description = json.loads((folder / DESCRIPTION).read_text(encoding="utf-8"))
        if "framesSha256" in description:
            return
        path, form = folder / description["recording"], RecordingFormat(description["format"])
        views = [SensorView.model_validate(view) for view in description["sensors"].values()]
        roles = [Role(role) for role in description["sensors"]]
        primary = next(
            view
            for role, view in zip(roles, views, strict=True)
            if role is not Role.IMU and role not in FOLLOWS
        )
        with Recording([path], form) as recording:
            stamps = recording.scan([primary.topic])[primary.topic].stamps
        _replace(folder / FRAMES, _frames_text(stamps, primary.time_offset))
        described = description | {"framesSha256": _sha256(folder / FRAMES)}
        _replace(folder / DESCRIPTION, (json.dumps(described, indent=2) + "\n").encode())
    except OSError as error:
        raise SystemFault(f"{folder}: {error.strerror or error}") from error


def _replace(path: Path, data: bytes) -> None:
    """Put a file into a variant that others may be reading."""
    aside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        aside.write_bytes(data)
        aside.chmod(0o444)
        flush(aside)
        aside.replace(path)
        flush(path.parent)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise


def _frames_text(stamps: npt.NDArray[np.int64], time_offset: float) -> bytes:
    """Return header stamps (ns) as sensor time, a line a frame."""
    offset = round(time_offset * 10**9)
    return "".join(f"{stamp + offset}\n" for stamp in stamps.tolist()).encode()


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _state(path: Path) -> list[int] | str:
    """Return size and time of change of a file, or their hash for a folder: an algorithm may change it."""
    if path.is_file():
        return _changed(path)
    files = sorted(item for item in path.rglob("*") if item.is_file())
    return digest([[str(item.relative_to(path)), *map(str, _changed(item))] for item in files])


def _changed(path: Path) -> list[int]:
    status = path.stat()
    return [status.st_size, status.st_mtime_ns]


def _is_sound(folder: Path) -> bool:
    try:
        description = json.loads((folder / DESCRIPTION).read_text(encoding="utf-8"))
        path = folder / description["recording"]
        frames = description.get("framesSha256")
        changed = frames is not None and _sha256(folder / FRAMES) != frames
        return not changed and guess_format(path) is not None and _state(path) == description["state"]
    except (OSError, ValueError, KeyError, InputError):
        return False


def _load(folder: Path, key: str, source: str) -> Variant:
    known = json.loads((folder / DESCRIPTION).read_text(encoding="utf-8"))
    return Variant(
        path=folder / known["recording"],
        format=RecordingFormat(known["format"]),
        sensors={Role(role): SensorView.model_validate(view) for role, view in known["sensors"].items()},
        start_time=known["startTime"],
        duration_seconds=known["durationSeconds"],
        frame_rate=known["frameRate"],
        resolution=known["resolution"],
        frames=known["frames"],
        key=key,
        source_sha256=source,
        recorded_frame_rate=known.get("recordedFrameRate"),
        recorded_seconds=known.get("recordedSeconds"),
    )
