# SPDX-License-Identifier: Apache-2.0
"""Variants of a dataset: what an algorithm is given, and nothing else.

A variant holds the chosen sensors' topics with their camera_info, and /tf_static, or the same data as a
folder of files (`folders`); never ground truth. It is a folder ``KEY`` of the cache with the recording,
``frames.txt`` (stamps of the primary sensor's frames in ns of sensor time, a line a frame) and
``variant.json``, made once, and whole when it exists. Its key hashes the recording, the sensors' calibration,
the options that matter, what their messages are repaired of, and `VERSION`.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.contract.posefiles import FRAMES
from slamhive.data.files.fetching import sha256_of
from slamhive.data.files.once import evict, flush, in_use, make_once
from slamhive.data.making.orders import frames_text, make_recording, order_of
from slamhive.data.recordings.entries import dataset_sha256, recording_sha256
from slamhive.data.recordings.reading import Recording, guess_format
from slamhive.data.recordings.version import VERSION
from slamhive.model.canonical import digest
from slamhive.model.configuration import SensorView
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.formats import FILE_NAMES, DataFormat, RecordingFormat
from slamhive.model.results import Prepared
from slamhive.model.run import without_idle
from slamhive.model.sensors import FOLLOWS, Role
from slamhive.model.variant import open_codes
from slamhive.plan.perturbable import chosen_form

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from slamhive.data.making.orders import MadeRecording, Order
    from slamhive.data.recordings.entries import DatasetEntry
    from slamhive.model.run import InputOptions
    from slamhive.model.variant import OpenFinding

DESCRIPTION = "variant.json"
_OF_ROS_2 = (DataFormat.ROSBAG2, DataFormat.MCAP)


@dataclass(frozen=True)
class Variant:
    """A prepared recording.

    Attributes:
        path: The recording: a file, or a folder for Rosbag2 and for folders of files.
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
        findings: What is known to be wrong with the dataset; it belongs to the dataset, not to the folder.
        key: Hash that identifies the variant; its folder's name.
        source_sha256: Hash of the recording that it was made from.
    """

    path: Path
    format: DataFormat
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
    findings: tuple[OpenFinding, ...] = ()

    @property
    def told(self) -> Prepared:
        """Return the record for a run that was given the variant."""
        return Prepared(
            frame_rate=self.frame_rate,
            resolution=self.resolution,
            duration_seconds=self.duration_seconds,
            frames=self.frames,
            recorded_frame_rate=self.recorded_frame_rate,
            recorded_seconds=self.recorded_seconds,
            findings=open_codes(self.findings, {sensor.name for sensor in self.sensors.values()}),
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


def prepare(  # noqa: PLR0917 - progress comes last everywhere
    entry: DatasetEntry,
    roles: Sequence[Role],
    options: InputOptions,
    formats: Sequence[DataFormat],
    cache: Path,
    progress: Callable[[float], None] | None = None,
    *,
    topics: Sequence[str] = (),
) -> Variant:
    """Make the variant of a dataset that a run needs, or find it in the cache.

    Args:
        entry: The dataset, materialised.
        roles: The sensors that the algorithm takes.
        options: The run's input options.
        formats: Formats that the algorithm reads, the preferred first.
        cache: Folder of the variants. Hashes of files are remembered in ``.hashes`` in it.
        progress: Called with the share done, 0 to 1, while it is made.
        topics: Topics that the algorithm is given beside its sensors', as they are.

    Returns:
        The variant. Hold `Variant.in_use` while a run works with it.

    Raises:
        InputError: The options don't fit the dataset.
        DataError: The recording can't be used.
        SystemFault: The disk refuses.
    """
    order, source, key = _identified(entry, roles, options, formats, cache, topics=topics)
    folder = cache / key[:32]

    def make(aside: Path) -> None:
        path = aside / FILE_NAMES[order.target]
        _describe(order, path, aside, make_recording(order, aside, progress))

    make_once(folder, make, _is_sound)
    _add_frames(folder)
    return _load(folder, key, source)


def variant_folder(
    entry: DatasetEntry,
    roles: Sequence[Role],
    options: InputOptions,
    formats: Sequence[DataFormat],
    cache: Path,
    *,
    topics: Sequence[str] = (),
) -> Path:
    """Return the folder of the variant that a run needs, made or not; arguments as for ``prepare``.

    Raises:
        InputError: The options don't fit the dataset.
        DataError: The recording can't be read.
    """
    return cache / variant_key(entry, roles, options, formats, cache, topics=topics)[:32]


def variant_key(
    entry: DatasetEntry,
    roles: Sequence[Role],
    options: InputOptions,
    formats: Sequence[DataFormat],
    cache: Path,
    *,
    topics: Sequence[str] = (),
) -> str:
    """Return the hash that identifies the variant that a run needs; arguments as for ``prepare``.

    Raises:
        InputError: The options don't fit the dataset.
        DataError: The recording can't be read.
    """
    return _identified(entry, roles, options, formats, cache, topics=topics)[-1]


def _identified(
    entry: DatasetEntry,
    roles: Sequence[Role],
    options: InputOptions,
    formats: Sequence[DataFormat],
    cache: Path,
    *,
    topics: Sequence[str],
) -> tuple[Order, str, str]:
    """Return the order that a variant is made from, the hash of its recording, and its key."""
    spec = entry.dataset.spec
    target = chosen_form(entry.dataset, formats)
    order = order_of(entry, roles, options, target, topics)
    sensors, wish = order.sensors, order.wish
    source = recording_sha256(entry, cache / ".hashes")
    repairs = {
        sensor.name: repair.model_dump(mode="json", by_alias=True, exclude_defaults=True)
        for sensor in sensors.values()
        if (repair := spec.topic_repairs.get(sensor.topic))
    }
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
        | ({"topics": sorted(order.topics)} if order.topics else {})
        | ({"repair": repairs} if repairs else {})
        | ({"perturb": without_idle(wish.perturb.as_json())} if wish.perturb else {})
        | ({"turning": dataset_sha256(entry, cache / ".hashes")} if wish.blurs_by_motion else {})
    )
    return order, source, key


def evict_variants(cache: Path, limit_bytes: int) -> list[str]:
    """Remove variants that no run works with, least recently used first, until the rest fits.

    Args:
        cache: Folder of the variants.
        limit_bytes: Size allowed.

    Returns:
        Keys of what was removed.
    """
    return evict(cache, limit_bytes) if cache.is_dir() else []


def _describe(order: Order, path: Path, aside: Path, made: MadeRecording) -> None:
    selection = made.selection
    primary = selection.primary
    offset = primary.time_offset
    description: dict[str, Any] = {
        "format": order.target,
        "playable": True,
        "recording": path.name,
        "state": recording_state(path),
        "framesSha256": sha256_of(aside / FRAMES),
        "sensors": {role: view.as_json() for role, view in made.views.items()},
        "startTime": selection.first / 10**9 + offset,
        "durationSeconds": (selection.last - selection.first) / 10**9,
        "frameRate": selection.rate(primary),
        "resolution": order.wish.resolution,
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
        _replace(folder / FRAMES, frames_text(stamps, primary.time_offset))
        described = description | {"framesSha256": sha256_of(folder / FRAMES)}
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


def recording_state(path: Path) -> list[int] | str:
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
        form, frames = DataFormat(description["format"]), description.get("framesSha256")
        # Earlier versions left ROS 2's bags as they were recorded, without types or latched as it happened.
        if form in _OF_ROS_2 and not description.get("playable"):
            return False
        changed = frames is not None and sha256_of(folder / FRAMES) != frames
        there = path.is_dir() if form.is_folder else bool(guess_format(path))
        return not changed and there and recording_state(path) == description["state"]
    except (OSError, ValueError, KeyError, InputError):
        return False


def _load(folder: Path, key: str, source: str) -> Variant:
    known = json.loads((folder / DESCRIPTION).read_text(encoding="utf-8"))
    return Variant(
        path=folder / known["recording"],
        format=DataFormat(known["format"]),
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
