# SPDX-License-Identifier: Apache-2.0
"""Reading a recording for an adapter: ROS 1 bag, ROS 2 bag or MCAP, decoded to numpy arrays.

Reading happens on a thread of its own whose processor time is reported apart, because a benchmark
measures the algorithm and not the reader of its input.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from adapter_support import (
    NANOSECONDS,
    AdapterError,
    HealthLog,
    Run,
    Sensor,
    Stopwatch,
    Trajectory,
    write_results,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

QUEUE_LENGTH = 4
"""Decoded messages that wait at most: enough to keep the algorithm busy, few enough to cost no memory."""

POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""sensor_msgs/PointField datatypes as numpy names them."""

SHARES = {"ScanStart": 0.0, "ScanMid": 0.5, "ScanEnd": 1.0}
"""Share of a scan that lies before its header stamp, by what the stamp means."""
TIME_FIELDS = ("time", "t", "timestamp", "timestamps", "time_offset", "offset_time", "time_stamp")
RING_FIELDS = ("ring", "line", "channel")

IMAGE_TYPES = {
    "mono8": ("u1", 1),
    "8UC1": ("u1", 1),
    "mono16": ("u2", 1),
    "16UC1": ("u2", 1),
    "32FC1": ("f4", 1),
    "rgb8": ("u1", 3),
    "bgr8": ("u1", 3),
    "8UC3": ("u1", 3),
    "rgba8": ("u1", 4),
    "bgra8": ("u1", 4),
}
"""Encoding to numpy type and channels."""
BAYER = {"bayer_rggb": "BG", "bayer_bggr": "RG", "bayer_gbrg": "GR", "bayer_grbg": "GB"}
"""Patterns of colour filters, and OpenCV's names of them: by the second pixels of the second row."""
IMAGE_TYPES |= {f"{pattern}{8 * size}": (f"u{size}", 1) for pattern in BAYER for size in (1, 2)}


@dataclass(frozen=True)
class Item:
    """One decoded message.

    Attributes:
        role: The sensor's role.
        stamp: Header stamp plus the sensor's time offset, ns.
        data: What the role's decoder made of the message.
    """

    role: str
    stamp: int
    data: Any


@dataclass(frozen=True)
class Cloud:
    """The finite points of a scan.

    Attributes:
        points: `(n, 3)`, m, in the sensor's frame.
        times: `(n,)`, seconds after the header stamp, None if the recording has no such field.
        rings: `(n,)`, None if the recording has no such field.
        intensities: `(n,)`, None if the recording has no such field.
    """

    points: np.ndarray
    times: np.ndarray | None
    rings: np.ndarray | None
    intensities: np.ndarray | None


@dataclass(frozen=True)
class ImuSample:
    """Angular rate in rad/s and specific force in m/s², both `(3,)` in the sensor's frame."""

    gyroscope: np.ndarray
    accelerometer: np.ndarray


class Recording:
    """A recording, read once.

    Args:
        run: The run.
        decoders: Role to a function of a message and its sensor that returns the decoded data.

    Attributes:
        cpu_seconds: Processor time of the reading thread, known when the items are at their end.
        offered: Messages met, by role.
        dropped: Messages left out because their stamp wasn't later than the one before, by role.

    Raises:
        AdapterError: A sensor isn't configured, or the recording isn't there.
    """

    def __init__(self, run: Run, decoders: Mapping[str, Callable[[Any, Sensor], Any]]) -> None:
        self.name, self._path = run.recording()
        self._decoders = decoders
        self._sensors = {role: run.sensor(role) for role in decoders}
        self.cpu_seconds = 0.0
        self.offered = dict.fromkeys(decoders, 0)
        self.dropped = dict.fromkeys(decoders, 0)

    def items(self) -> Iterator[Item]:
        """Read the sensors' messages, in the order of the recording.

        Raises:
            AdapterError: The recording can't be read, lacks a topic or has no message on one.
        """
        waiting: queue.Queue[Item | BaseException | None] = queue.Queue(QUEUE_LENGTH)
        stop = threading.Event()
        thread = threading.Thread(target=self._read, args=(waiting, stop), name="reader", daemon=True)
        thread.start()
        item: Item | BaseException | None = None
        try:
            while isinstance(item := waiting.get(), Item):
                yield item
        finally:
            stop.set()
            thread.join()
        if item is not None:
            raise item

    def _read(self, waiting: queue.Queue[Any], stop: threading.Event) -> None:
        def put(value: Item | BaseException | None) -> None:
            while not stop.is_set():
                with contextlib.suppress(queue.Full):
                    waiting.put(value, timeout=0.5)
                    return

        # By this name the monitor knows whose clock to hold against what we report.
        with contextlib.suppress(OSError):
            Path(f"/proc/self/task/{threading.get_native_id()}/comm").write_text("slamhive-reader")
        end: BaseException | None = None
        try:
            for item in self._messages():
                put(item)
                if stop.is_set():
                    break
        except Exception as error:  # noqa: BLE001 - it is raised again by the thread that asks for items
            end = error
        self.cpu_seconds = time.thread_time()
        put(end)

    def _messages(self) -> Iterator[Item]:
        # Imported here so that the time it takes counts as the reader's.
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        try:
            # A ROS 2 bag may lack its message definitions; those needed here haven't changed since Foxy.
            with AnyReader([self._path], default_typestore=get_typestore(Stores.ROS2_FOXY)) as reader:
                yield from self._decode(reader)
        except AdapterError:
            raise
        except Exception as error:
            # rosbags raises whatever its parsers meet in a damaged file.
            reason = " ".join(str(error).split()) or type(error).__name__
            raise AdapterError(f"{self.name} can't be read: {reason}") from error
        for role, count in self.offered.items():
            if not count:
                raise AdapterError(f"{self.name} has no message on {self._sensors[role].topic} ({role})")

    def _decode(self, reader: Any) -> Iterator[Item]:
        roles = {sensor.topic: role for role, sensor in self._sensors.items()}
        present = sorted({connection.topic for connection in reader.connections})
        for topic, role in roles.items():
            if topic not in present:
                known = ", ".join(present) or "no topic at all"
                raise AdapterError(f"{self.name} has no topic {topic} for the sensor {role}; it has {known}")
        latest: dict[str, int] = {}
        chosen = [connection for connection in reader.connections if connection.topic in roles]
        for connection, _, raw in reader.messages(connections=chosen):
            role = roles[connection.topic]
            message = reader.deserialize(raw, connection.msgtype)
            header = message.header.stamp
            stamp = header.sec * NANOSECONDS + header.nanosec + self._sensors[role].offset
            self.offered[role] += 1
            if stamp <= latest.get(role, stamp - 1):
                self.dropped[role] += 1
                continue
            latest[role] = stamp
            yield Item(role, stamp, self._decoders[role](message, self._sensors[role]))


def decode_cloud(message: Any, sensor: Sensor) -> Cloud:
    """Decode a sensor_msgs/PointCloud2, leaving out points that aren't finite.

    Where some points have a time, those without one (NaN) go, too. A scan whose points all have one time is
    given as without times: they tell nothing, and programs that divide by their length fail.

    Args:
        message: The message.
        sensor: Its sensor; `timeField` and `ringField` of its details name the fields, or else the usual
            names are looked for.

    Raises:
        AdapterError: The message is no point cloud with x, y and z.
    """
    fields = {f.name: f for f in getattr(message, "fields", ())}
    if not {"x", "y", "z"} <= fields.keys():
        raise AdapterError(f"{sensor.topic} isn't a sensor_msgs/PointCloud2 with the fields x, y, z")
    order = ">" if message.is_bigendian else "<"
    layout = np.dtype(
        {
            "names": list(fields),
            "formats": [order + POINT_TYPES[f.datatype] for f in fields.values()],
            "offsets": [f.offset for f in fields.values()],
            "itemsize": message.point_step,
        }
    )
    # Some drivers state rows of 0 bytes where they aren't padded.
    step = message.row_step or message.width * message.point_step
    rows = np.ndarray((message.height, message.width), layout, message.data, 0, (step, message.point_step))
    records = rows.reshape(-1)
    points = np.column_stack([records["x"], records["y"], records["z"]]).astype(float)
    finite = np.isfinite(points).all(axis=1)

    def column(setting: str, usual: tuple[str, ...]) -> np.ndarray | None:
        wanted = sensor.details.get(setting)
        name = next((n for n in ((wanted,) if wanted else usual) if n in fields), None)
        return None if name is None else records[name]

    header = message.header.stamp
    times = column("timeField", TIME_FIELDS)
    if times is not None:
        timed = np.isfinite(times)
        known = times[timed]
        if not known.size or (len(known) > 1 and known.min() == known.max()):
            times = None
        else:
            finite &= timed
            times = _seconds_after(times, header.sec * NANOSECONDS + header.nanosec, sensor)[finite]
    rings = column("ringField", RING_FIELDS)
    intensities = column("intensityField", ("intensity", "i", "reflectivity"))
    return Cloud(
        points=points[finite],
        times=times,
        rings=None if rings is None else rings[finite],
        intensities=None if intensities is None else intensities[finite],
    )


def _seconds_after(times: np.ndarray, header: int, sensor: Sensor) -> np.ndarray:
    """Times of points as seconds after the header stamp, from the conventions that drivers use.

    Integers are nanoseconds (Ouster), floating-point numbers seconds (Velodyne) or, beyond what a scan can
    last, absolute seconds (Hesai) or nanoseconds (Livox). Those that count from the start or end of a scan
    that is stamped with another instant (`timesSince`) are moved by what lies between.
    """
    largest = np.nanmax(np.abs(times.astype(float)), initial=0)
    if times.dtype.kind in "iu":
        after = times.astype(np.int64)
        if largest > 1e15:
            return np.asarray((after - header) / NANOSECONDS)
        return _since_header(after / NANOSECONDS, sensor)
    if largest > 1e15:
        return np.asarray((times - float(header)) / NANOSECONDS)
    if largest > 1e6:
        return np.asarray((times - header // NANOSECONDS) - header % NANOSECONDS / NANOSECONDS)
    return _since_header(times.astype(float), sensor)


def _since_header(times: np.ndarray, sensor: Sensor) -> np.ndarray:
    share = SHARES.get(sensor.stamp)
    if share is None or not times.size:
        return times
    match sensor.details.get("timesSince"):
        case "ScanStart":
            return np.asarray(times - share * np.nanmax(times))
        case "ScanEnd":
            return np.asarray(times + (share - 1) * np.nanmin(times))
    return times


def scan_window(item: Item, sensor: Sensor) -> tuple[int, int]:
    """Sensor time of a scan's first and last point.

    Args:
        item: A scan, its data a Cloud.
        sensor: Its sensor, whose stamp convention and rate stand in for missing point times.

    Returns:
        Start and end, ns.
    """
    times = item.data.times
    if times is not None and len(times):
        return (
            item.stamp + round(float(times.min()) * NANOSECONDS),
            item.stamp + round(float(times.max()) * NANOSECONDS),
        )
    duration = round(NANOSECONDS / sensor.rate) if sensor.rate else 0
    share = SHARES.get(sensor.stamp)
    if share is None:
        return item.stamp, item.stamp
    start = item.stamp - round(share * duration)
    return start, start + duration


def pose_stamp(item: Item, sensor: Sensor, deskew: bool) -> int:
    """Sensor time in ns that the pose of a scan belongs to.

    Args:
        item: The scan.
        sensor: The lidar.
        deskew: Whether the algorithm moves the points to where they would be at the scan's end. The pose of
            a scan that is left as it is, or has no point times, belongs best to its middle.
    """
    start, end = scan_window(item, sensor)
    return end if deskew and item.data.times is not None else (start + end) // 2


def decode_imu(message: Any, sensor: Sensor) -> ImuSample:
    """Decode a sensor_msgs/Imu.

    Raises:
        AdapterError: It is another type.
    """
    if not hasattr(message, "angular_velocity"):
        raise AdapterError(f"{sensor.topic} isn't a sensor_msgs/Imu")
    w, a = message.angular_velocity, message.linear_acceleration
    return ImuSample(np.array([w.x, w.y, w.z]), np.array([a.x, a.y, a.z]))


def decode_image(message: Any, sensor: Sensor) -> np.ndarray:
    """Decode a sensor_msgs/Image or sensor_msgs/CompressedImage.

    Returns:
        `(height, width)` as it is, or `(height, width, 3)` in the order red, green, blue. Of 16 bits those of
        a camera keep the upper 8, as OpenCV does it, since visual algorithms take no more; depth keeps all.

    Raises:
        AdapterError: It is another type, or its encoding isn't known.
    """
    image = (
        _decode_raw(message, sensor) if hasattr(message, "encoding") else _decode_compressed(message, sensor)
    )
    return (image >> 8).astype(np.uint8) if image.dtype == np.uint16 and sensor.role != "depth" else image


def _decode_raw(message: Any, sensor: Sensor) -> np.ndarray:
    if message.encoding not in IMAGE_TYPES:
        known = ", ".join(IMAGE_TYPES)
        raise AdapterError(f"{sensor.topic} has images encoded {message.encoding}; known are {known}")
    name, channels = IMAGE_TYPES[message.encoding]
    kind = np.dtype((">" if message.is_bigendian else "<") + name)
    shape = (message.height, message.width, channels)
    # Some drivers state rows of 0 bytes where they aren't padded.
    step = message.step or message.width * channels * kind.itemsize
    strides = (step, channels * kind.itemsize, kind.itemsize)
    image = np.ndarray(shape, kind, message.data, 0, strides)
    if channels > 1:
        image = image[:, :, 2::-1] if message.encoding in {"bgr8", "bgra8", "8UC3"} else image[:, :, :3]
    else:
        image = image[:, :, 0]
    image = np.ascontiguousarray(image, kind.newbyteorder("="))
    pattern = BAYER.get(message.encoding[: len("bayer_rggb")])
    if pattern is None:
        return image
    cv2 = _opencv(f"{sensor.topic} is {message.encoding}")
    return np.asarray(cv2.cvtColor(image, getattr(cv2, f"COLOR_Bayer{pattern}2RGB")))


def _opencv(what: str) -> Any:
    try:
        import cv2
    except ImportError:
        raise AdapterError(f"{what}, which takes OpenCV to read") from None
    return cv2


def _decode_compressed(message: Any, sensor: Sensor) -> np.ndarray:
    if not hasattr(message, "format"):
        raise AdapterError(f"{sensor.topic} isn't a sensor_msgs/Image or CompressedImage")
    cv2 = _opencv(f"{sensor.topic} is compressed")
    # compressedDepth has 12 bytes before the PNG: a number of its form, A and B of the quantisation of 32FC1.
    is_depth = "compressedDepth" in message.format
    data = np.asarray(message.data, np.uint8)
    image = cv2.imdecode(data[12 if is_depth else 0 :], cv2.IMREAD_UNCHANGED)
    if image is None:
        raise AdapterError(f"{sensor.topic} has a compressed image that OpenCV can't read ({message.format})")
    if is_depth and message.format.startswith("32FC1"):
        a, b = np.frombuffer(data[4:12].tobytes(), "<f4").astype(float)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(image > 0, a / (image - b), 0).astype(np.float32)
    return image if image.ndim == 2 else np.ascontiguousarray(image[:, :, 2::-1])


def register_scans(
    run: Run,
    register: Callable[[Cloud], np.ndarray],
    deskew: bool,
    confidence: Callable[[], float] | None = None,
) -> None:
    """Run an odometry that takes scan after scan.

    Args:
        run: The run; its results are written.
        register: Takes a scan and returns the pose of the lidar `(4, 4)`.
        deskew: Whether it moves the points to the end of the scan.
        confidence: Returns how sure it is of the last pose, larger is surer; None: it doesn't say.

    Raises:
        AdapterError: The recording can't be read, or no scan has a point.
    """
    lidar = run.sensor("lidar")
    recording = Recording(run, {"lidar": decode_cloud})
    trajectory, watch, health, empty = Trajectory(), Stopwatch(), HealthLog(), 0
    for item in recording.items():
        if not len(item.data.points):
            empty += 1
            continue
        with watch.frame():
            pose = register(item.data)
        stamp = pose_stamp(item, lidar, deskew)
        trajectory.add(stamp, pose)
        if confidence is not None:
            health.add(stamp, confidence())
    health.write(run.output / "health.csv")
    write_results(run, trajectory, watch, recording.cpu_seconds, recording.dropped["lidar"] + empty)


def inertial_order(items: Iterable[Item], lidar: Sensor) -> Iterator[Item]:
    """Put every scan behind the inertial samples of its time, however late the recording has either.

    Args:
        items: Scans (role lidar) and inertial samples (role imu), each in order of time.
        lidar: The lidar.

    Yields:
        Each scan once a sample later than its end is known, after all samples up to its end; the scans left
        at the end of the recording too.
    """
    scans: deque[tuple[int, Item]] = deque()
    samples: deque[Item] = deque()
    for item in items:
        if item.role == "lidar":
            scans.append((scan_window(item, lidar)[1], item))
        else:
            samples.append(item)
        while scans and samples and samples[-1].stamp > scans[0][0]:
            while samples[0].stamp <= scans[0][0]:
                yield samples.popleft()
            yield scans.popleft()[1]
    for _, scan in scans:
        yield from samples
        samples.clear()
        yield scan
