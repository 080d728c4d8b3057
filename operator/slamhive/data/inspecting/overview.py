# SPDX-License-Identifier: Apache-2.0
"""Overview of a recording: what is drawn of it, computed once and kept by the dataset's content.

`slamhive dataset show --html` and the dashboard's dataset page draw the same one. It is small whatever the
recording is: images are few and small, numbers are summed up over parts of the time. Of a recording beyond
`LARGE_BYTES` short spans are read alone, evenly over its length.
"""

from __future__ import annotations

import base64
import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.inspecting.overviews import VERSION
from slamhive.data.recordings import kinds
from slamhive.data.recordings.entries import dataset_sha256
from slamhive.data.recordings.pictures import from_above, jpeg
from slamhive.data.recordings.repairing import open_recording
from slamhive.data.recordings.streams import sound_sensors
from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.errors import DataError
from slamhive_eval import Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.recordings.entries import DatasetEntry
    from slamhive.data.recordings.reading import Recording
    from slamhive.model.sensors import Sensor

BINS = 240
"""Parts of the time over which rates and IMU samples are summed up."""
LARGE_BYTES = 2 * 2**30
_SPAN_NS = 500_000_000
"""Length of the spans that are read of a large recording, one a part."""
_FRAMES, _CLOUDS, _MOST_POINTS, _MOST_POSES = 12, 4, 1500, 1500
_WIDEST, _QUALITY = 320, 70
_GAP_PERIODS = 3.0
_SHOWN_GAPS = 50
_IMU_NUMBERS = 37
_BATCH = 4096
_CLOUD_TYPES = {kinds.POINT_CLOUD, kinds.LASER_SCAN}
_IMAGE_TYPES = {kinds.IMAGE, kinds.COMPRESSED_IMAGE}


@dataclass
class SensorOverview:
    """Overview of one sensor: rates, gaps, images, clouds, IMU. Times are s since the recording's start.

    Attributes:
        name, type, topic: As declared.
        messages: Their number.
        first, last: Times of the first message and the last; None where there is none.
        rates: Messages a second in each of `BINS` parts of the time.
        gaps: Spans of more than three periods without messages: begin and end, longest first.
        pictures: Images: time and JPEG in base64.
        clouds: Clouds or scans from above: time, x and y in the sensor's frame, m.
        imu: Least and greatest numbers in each part, by ``gyro`` (rad/s) and ``accel`` (m/s²) and axis:
            ``{"gyro": {"x": [low, high]}}`` with lists of `BINS` numbers, None where there is none.
    """

    name: str
    type: str
    topic: str
    messages: int = 0
    first: float | None = None
    last: float | None = None
    rates: list[float] = field(default_factory=list)
    gaps: list[list[float]] = field(default_factory=list)
    pictures: list[dict[str, Any]] = field(default_factory=list)
    clouds: list[dict[str, Any]] = field(default_factory=list)
    imu: dict[str, dict[str, list[list[float | None]]]] = field(default_factory=dict)


@dataclass
class Overview:
    """Overview of a dataset that its HTML page and the dashboard draw: sensors and ground truth.

    Attributes:
        name: The dataset's name.
        start: Sensor time of the start, s.
        seconds: Length, s.
        sensors: By sensor.
        truth: Ground truth: ``t``, ``x``, ``y``, ``z`` of at most 1,500 poses, ``count``, ``first``,
            ``last``; None where there is none that is a path.
        notes: What is left out or can't be read, a sentence each.
        version: Of this form.
    """

    name: str
    start: float
    seconds: float
    sensors: list[SensorOverview]
    truth: dict[str, Any] | None
    notes: list[str]
    version: int = VERSION

    def as_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return asdict(self)


def overview(
    entry: DatasetEntry,
    folder: Path,
    hashes: Path | None = None,
    truths: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Return the overview of a dataset as plain values: the kept one, or one that is made and kept.

    Args:
        entry: The dataset, materialised.
        folder: Where overviews are kept, as ``NAME-HASH.json``.
        hashes: Folder in which hashes of files are remembered.
        truths: Folder for converted ground truth.
        progress: Called with the share that is done, 0 to 1.

    Raises:
        DataError: The recording can't be read.
    """
    kept = folder / f"{entry.name}-{dataset_sha256(entry, hashes)[:16]}.json"
    with suppress(OSError, ValueError, AttributeError):
        found: dict[str, Any] = json.loads(kept.read_bytes())
        if found.get("version") == VERSION:
            return found
    made = look_over(entry, truths, progress).as_json()
    aside = kept.with_name(f".{kept.name}.{os.getpid()}")
    # A cache does without where the disk refuses.
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        aside.write_text(json.dumps(made, allow_nan=False), encoding="utf-8")
        aside.replace(kept)
    return made


def look_over(
    entry: DatasetEntry, truths: Path | None = None, progress: Callable[[float], None] | None = None
) -> Overview:
    """Read a dataset for its overview.

    Raises:
        DataError: The recording can't be read.
    """
    notes: list[str] = []
    with open_recording(entry.dataset, entry.root) as recording:
        sound = sound_sensors(recording, entry.dataset.spec.told_sensors, notes)
        times = _Times(recording, sound, notes)
        times.read(progress)
        start, end = times.extent()
        truth = _truth(entry, truths, notes)
        if truth is not None and not times.stamps_of:
            start, end = truth.stamps[0], truth.stamps[-1]
        views = [_sensor(times, name, sensor, (start, end)) for name, sensor in sound.items()]
    return Overview(
        name=entry.name,
        start=float(start),
        seconds=float(end - start),
        sensors=views,
        truth=None if truth is None else _path(truth, start),
        notes=notes,
    )


class _Times:
    """Stamps of all sensors, and the IMUs' samples, in one pass over the recording."""

    def __init__(self, recording: Recording, sensors: dict[str, Sensor], notes: list[str]) -> None:
        self.recording = recording
        self.sensors = sensors
        self.notes = notes
        self.is_sampled = sum(_size(path) for path in recording.paths) > LARGE_BYTES
        self.stamps: dict[str, list[npt.NDArray[np.int64]]] = {one.topic: [] for one in sensors.values()}
        self.samples: dict[str, list[npt.NDArray[np.float32]]] = {
            one.topic: [] for one in sensors.values() if one.type == "Imu"
        }
        self.stamps_of: dict[str, npt.NDArray[np.float64]] = {}
        if self.is_sampled:
            notes.append(
                f"the recording is large: {BINS} spans of {_SPAN_NS / 1e9:g} s were read, evenly over its "
                "length; gaps within them alone are seen"
            )

    def read(self, progress: Callable[[float], None] | None) -> None:
        """Read all messages, or those of short spans."""
        readers = {
            topic: self.recording.stamp_reader(self.recording.topics[topic].message_type)
            for topic in self.stamps
        }
        total = max(1, sum(self.recording.topics[topic].count for topic in self.stamps))
        held: dict[str, list[int]] = {topic: [] for topic in self.stamps}
        tails: dict[str, list[bytes]] = {topic: [] for topic in self.samples}

        def settle() -> None:
            for topic, stamps in held.items():
                self.stamps[topic].append(np.array(stamps, dtype=np.int64))
                stamps.clear()
            for topic, raws in tails.items():
                table = np.frombuffer(b"".join(raws), dtype="<f8").reshape(-1, _IMU_NUMBERS)
                self.samples[topic].append(table[:, [13, 14, 15, 25, 26, 27]].astype(np.float32))
                raws.clear()

        count = 0
        for begin, end in self._spans():
            for connection, time, raw in self.recording.messages(set(self.stamps), begin, end):
                reader = readers[connection.topic]
                held[connection.topic].append(time if reader is None else reader(raw))
                if connection.topic in tails:
                    tails[connection.topic].append(bytes(raw[-8 * _IMU_NUMBERS :]))
                count += 1
                if count % _BATCH == 0:
                    settle()
                    if progress is not None:
                        progress(min(0.9, 0.9 * count / total))
        settle()
        for name, sensor in self.sensors.items():
            self.stamps_of[name] = np.concatenate(self.stamps[sensor.topic]) / 1e9 + sensor.time_offset
        self.stamps_of = {name: stamps for name, stamps in self.stamps_of.items() if len(stamps)}

    def _spans(self) -> list[tuple[int | None, int | None]]:
        if not self.is_sampled:
            return [(None, None)]
        begin, end = self.recording.start_ns, self.recording.start_ns + round(self.recording.seconds * 1e9)
        edges = np.linspace(begin, end, BINS + 1).astype(np.int64)
        return [(int(low), int(min(low + _SPAN_NS, high))) for low, high in pairwise(edges)]

    def extent(self) -> tuple[float, float]:
        """Return the first and last stamp of any sensor, s; 0 and the length where there is none."""
        if not self.stamps_of:
            return 0.0, self.recording.seconds
        return (
            min(float(one.min()) for one in self.stamps_of.values()),
            max(float(one.max()) for one in self.stamps_of.values()),
        )


def _size(path: Path) -> int:
    if path.is_dir():
        return sum(one.stat().st_size for one in path.iterdir() if one.is_file())
    return path.stat().st_size


def _sensor(times: _Times, name: str, sensor: Sensor, extent: tuple[float, float]) -> SensorOverview:
    start, end = extent
    recording = times.recording
    topic = recording.topics[sensor.topic]
    view = SensorOverview(name, str(sensor.type), sensor.topic, topic.count)
    stamps = times.stamps_of.get(name)
    if stamps is None:
        return view
    order = np.argsort(stamps, kind="stable")
    relative = stamps[order] - start
    view.first, view.last = round(float(relative[0]), 6), round(float(relative[-1]), 6)
    edges = np.linspace(0.0, max(end - start, 1e-9), BINS + 1)
    width = min(edges[1], _SPAN_NS / 1e9) if times.is_sampled else edges[1]
    counts = np.histogram(relative, edges)[0]
    view.rates = np.round(counts / width, 3).tolist()
    if not times.is_sampled:
        view.gaps = _gaps(relative)
    if sensor.topic in times.samples:
        view.imu = _envelopes(np.concatenate(times.samples[sensor.topic])[order], relative, edges)
    if topic.message_type in _IMAGE_TYPES | _CLOUD_TYPES:
        _add_pictures(recording, sensor, view, start, times.notes)
    return view


def _gaps(relative: npt.NDArray[np.float64]) -> list[list[float]]:
    steps = np.diff(relative)
    if len(steps) < 2:
        return []
    wide = np.flatnonzero(steps > _GAP_PERIODS * float(np.median(steps)))
    longest = wide[np.argsort(-steps[wide], kind="stable")][:_SHOWN_GAPS]
    return [[round(float(relative[k]), 6), round(float(relative[k + 1]), 6)] for k in longest]


def _envelopes(
    samples: npt.NDArray[np.float32], relative: npt.NDArray[np.float64], edges: npt.NDArray[np.float64]
) -> dict[str, dict[str, list[list[float | None]]]]:
    places = np.clip(np.searchsorted(edges, relative, side="right") - 1, 0, BINS - 1)
    low, high = np.full((BINS, 6), np.inf), np.full((BINS, 6), -np.inf)
    known = np.isfinite(samples).all(axis=1)
    np.minimum.at(low, places[known], samples[known])
    np.maximum.at(high, places[known], samples[known])

    def column(table: npt.NDArray[np.float64], k: int) -> list[float | None]:
        return [round(number, 4) if np.isfinite(number) else None for number in table[:, k].tolist()]

    return {
        what: {axis: [column(low, at + k), column(high, at + k)] for k, axis in enumerate("xyz")}
        for what, at in (("gyro", 0), ("accel", 3))
    }


def _add_pictures(
    recording: Recording, sensor: Sensor, view: SensorOverview, start: float, notes: list[str]
) -> None:
    """Add images or clouds at even spaces over the sensor's time."""
    is_image = recording.topics[sensor.topic].message_type in _IMAGE_TYPES
    reader = recording.stamp_reader(recording.topics[sensor.topic].message_type)
    begin, length = recording.start_ns, recording.seconds * 1e9
    # Times of recording and stamps may differ: by how much, the first message says.
    _, first, raw = next(iter(recording.messages({sensor.topic})))
    shift = first - (reader(raw) if reader is not None else first)
    low = max(begin, round((start + (view.first or 0.0) - sensor.time_offset) * 1e9) + shift)
    high = min(begin + length, (start + (view.last or 0.0) - sensor.time_offset) * 1e9 + shift)
    taken = set()
    for at in np.linspace(low, max(low, high - 1), _FRAMES if is_image else _CLOUDS):
        for connection, time, data in recording.messages({sensor.topic}, int(at)):
            if time in taken:
                break
            taken.add(time)
            stamp = (reader(data) if reader is not None else time) / 1e9 + sensor.time_offset - start
            try:
                message = recording.decode(data, connection.msgtype)
                _add(view, message, round(stamp, 3), is_image=is_image)
            except DataError as error:
                notes.append(f"sensors.{view.name}: {error}")
                return
            break


def _add(view: SensorOverview, message: Any, stamp: float, *, is_image: bool) -> None:
    if is_image:
        data = jpeg(message, view.topic, widest=_WIDEST, quality=_QUALITY)
        view.pictures.append({"t": stamp, "data": base64.b64encode(data).decode("ascii")})
        return
    points = np.round(from_above(message, view.topic, _MOST_POINTS), 2)
    view.clouds.append({"t": stamp, "x": points[:, 0].tolist(), "y": points[:, 1].tolist()})


def _truth(entry: DatasetEntry, cache: Path | None, notes: list[str]) -> Trajectory | None:
    try:
        found = ground_truth(entry, cache)
    except DataError as error:
        notes.append(str(error))
        return None
    if found is not None and not isinstance(found.poses, Trajectory):
        notes.append("the ground truth is relative poses, which are no path")
    return found.poses if found is not None and isinstance(found.poses, Trajectory) else None


def _path(truth: Trajectory, start: float) -> dict[str, Any]:
    chosen = slice(None, None, max(1, -(-len(truth) // _MOST_POSES)))
    positions = np.round(truth.positions[chosen], 4)
    return {
        "count": len(truth),
        "first": round(float(truth.stamps[0]) - start, 6),
        "last": round(float(truth.stamps[-1]) - start, 6),
        "t": np.round(truth.stamps[chosen] - start, 3).tolist(),
        **{axis: positions[:, k].tolist() for k, axis in enumerate("xyz")},
    }
