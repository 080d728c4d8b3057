# SPDX-License-Identifier: Apache-2.0
"""Generator of synthetic recordings: from a specification to a bag, its ground truth and its calibration."""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rosbags.rosbag1 import Writer

from slamhive.data.recordings import kinds
from slamhive.data.synthetic import aiding, messages, rig
from slamhive.data.synthetic.camera import CameraModel
from slamhive.data.synthetic.inertial import sample_imu
from slamhive.data.synthetic.lidar import LidarModel
from slamhive.data.synthetic.scenes import build_scene
from slamhive.data.synthetic.texture import build_atlas
from slamhive.data.synthetic.trajectory import SyntheticMotion, quaternion_from_rotation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import numpy.typing as npt

    from slamhive.model.synthetic import SyntheticRecording

    Array = npt.NDArray[np.float64]
    Measure = Callable[[SyntheticRecording, SyntheticMotion, Array], Array]

START = 1_600_000_000 * 10**9
"""Sensor time of the start of every recording, ns."""

RECORDING, GROUND_TRUTH, SENSORS = "recording.bag", "groundtruth.txt", "sensors.json"


@dataclass(frozen=True)
class SyntheticOutput:
    """Result of generating a synthetic recording: its files, calibration and figures.

    Attributes:
        recording: The ROS 1 bag.
        groundtruth: TUM file: poses of the body frame in the world at every sensor stamp.
        calibration: JSON file that holds `sensors`.
        sensors: By role, as the unified configuration's `sensors` has them.
        start_time: First instant of the recording, s of sensor time.
        duration_seconds: Length of the recording, s.
        path_metres: Length of the body's path, m.
        messages: Number of messages by topic.
    """

    recording: Path
    groundtruth: Path
    calibration: Path
    sensors: dict[str, dict[str, Any]]
    start_time: float
    duration_seconds: float
    path_metres: float
    messages: dict[str, int]


@dataclass(frozen=True)
class Event:
    """One message to come: when it is stamped, where it goes and how it is made."""

    stamp: int
    topic: str
    message_type: str
    make: Callable[[], Any]


def generate(
    spec: SyntheticRecording, directory: Path, progress: Callable[[float], None] | None = None
) -> SyntheticOutput:
    """Make a recording with ground truth and calibration.

    Everything is written aside first and moved into place at the end, the bag last: where there is a bag, it
    is whole and the other two files belong to it. The same specification gives the same bytes.

    Args:
        spec: What to record.
        directory: Where recording.bag, groundtruth.txt and sensors.json go; made if absent.
        progress: Called now and then with the share done, from 0 to 1.

    Returns:
        Paths, calibration and figures of what was made.
    """
    scene = _Scene(spec)
    events = sorted(scene.events(), key=lambda event: event.stamp)
    directory.mkdir(parents=True, exist_ok=True)
    (directory / RECORDING).unlink(missing_ok=True)
    with tempfile.TemporaryDirectory(prefix=".making-", dir=directory) as temporary:
        aside = Path(temporary)
        counts = _write_bag(aside / RECORDING, events, spec, progress)
        _write_ground_truth(aside / GROUND_TRUTH, scene.trajectory, scene.truth_stamps())
        (aside / SENSORS).write_text(
            json.dumps({"sensors": scene.sensors}, indent=2) + "\n", encoding="utf-8"
        )
        for name in (SENSORS, GROUND_TRUTH, RECORDING):
            (aside / name).replace(directory / name)
    return SyntheticOutput(
        recording=directory / RECORDING,
        groundtruth=directory / GROUND_TRUTH,
        calibration=directory / SENSORS,
        sensors=scene.sensors,
        start_time=START / 1e9,
        duration_seconds=spec.total_seconds,
        path_metres=scene.trajectory.length(0.0, spec.total_seconds),
        messages=counts,
    )


class _Scene:
    """A specification turned into a world, a motion, and the messages they give."""

    def __init__(self, spec: SyntheticRecording) -> None:
        self.spec = spec
        self.trajectory = SyntheticMotion(spec)
        self.world = build_scene(spec)
        self.sensors = rig.sensors(spec)
        self.maker = messages.MessageMaker(messages.typestore())

    def events(self) -> Iterable[Event]:
        """List the messages to come, sensor by sensor."""
        poses = {entry["frameId"]: np.array(entry["T_body_sensor"]) for entry in self.sensors.values()}
        yield Event(START, "/tf_static", messages.TF, lambda: self.maker.transforms(START, poses))
        if "lidar" in self.sensors:
            yield from self._lidar()
        if "imu" in self.sensors:
            yield from self._imu()
        yield from self._cameras()
        if "scan" in self.sensors:
            yield from self._scans()
        yield from self._aiding()

    def stamps(self, rate: float, room: float = 0.0, offset: float = 0.0) -> list[int]:
        """Give a sensor's stamps since the start, ns, each with `room` s of recording after it."""
        last = self.spec.total_seconds - room - offset
        count = int(np.floor(last * rate + 1e-9)) + 1
        return [round((k / rate + offset) * 1e9) for k in range(count)]

    def truth_stamps(self) -> npt.NDArray[np.int64]:
        """Give every instant at which a pose may be asked for, ns since the start, sorted."""
        result: list[int] = []
        for role, entry in self.sensors.items():
            if role in {"lidar", "scan"}:
                starts = self._scan_starts(entry["rate"])
                period = 1e9 / entry["rate"]
                result += [at + round(share * period) for at in starts for share in (0.0, 0.5, 1.0)]
            else:
                result += self.stamps(entry["rate"], offset=self._offset(role))
        return np.unique(np.array(result, dtype=np.int64))

    def _offset(self, role: str) -> float:
        return self.spec.depth_offset_seconds if role == "depth" else 0.0

    def _scan_starts(self, rate: float) -> list[int]:
        return self.stamps(rate, room=1.0 / rate)

    def _lidar(self) -> Iterable[Event]:
        entry = self.sensors["lidar"]
        model = LidarModel(self.spec, self.world, self.trajectory)

        def make(index: int, at: int) -> Any:
            return self.maker.points(START + at, entry["frameId"], model.scan(at / 1e9, index))

        for index, at in enumerate(self._scan_starts(entry["rate"])):
            yield Event(START + at, entry["topic"], kinds.POINT_CLOUD, _bind(make, index, at))

    def _imu(self) -> Iterable[Event]:
        entry = self.sensors["imu"]
        stamps = self.stamps(entry["rate"])
        samples = sample_imu(self.spec, self.trajectory, np.array(stamps) / 1e9)

        def make(index: int, at: int) -> Any:
            force, rate = samples.specific_force[index], samples.angular_rate[index]
            return self.maker.imu(START + at, entry["frameId"], force, rate)

        for index, at in enumerate(stamps):
            yield Event(START + at, entry["topic"], kinds.IMU, _bind(make, index, at))

    def _scans(self) -> Iterable[Event]:
        entry = self.sensors["scan"]
        period = 1.0 / entry["rate"]

        def make(index: int, at: int) -> Any:
            ranges = aiding.scan(self.spec, self.world, self.trajectory, at / 1e9, index)
            return self.maker.laser_scan(START + at, entry["frameId"], ranges, period)

        for index, at in enumerate(self._scan_starts(entry["rate"])):
            yield Event(START + at, entry["topic"], kinds.LASER_SCAN, _bind(make, index, at))

    def _aiding(self) -> Iterable[Event]:
        """List the messages of sensors that measure everything at once."""
        measured_by: dict[str, tuple[str, Measure, Callable[..., Any]]] = {
            "odometry": (kinds.ODOMETRY, aiding.wheels, self.maker.odometry),
            "gnss": (kinds.GNSS_FIX, aiding.fixes, self.maker.fix),
            "magnetometer": (kinds.MAGNETIC_FIELD, aiding.fields, self.maker.field),
            "barometer": (kinds.FLUID_PRESSURE, aiding.pressures, self.maker.pressure),
        }
        for name, (message_type, measure, build) in measured_by.items():
            if name in self.sensors:
                yield from self._samples(self.sensors[name], message_type, measure, build)

    def _samples(
        self, entry: dict[str, Any], message_type: str, measure: Measure, build: Callable[..., Any]
    ) -> Iterable[Event]:
        stamps = self.stamps(entry["rate"])
        measured = measure(self.spec, self.trajectory, np.array(stamps) / 1e9)

        def make(index: int, at: int) -> Any:
            return build(START + at, entry["frameId"], measured[index])

        for index, at in enumerate(stamps):
            yield Event(START + at, entry["topic"], message_type, _bind(make, index, at))

    def _cameras(self) -> Iterable[Event]:
        cameras = rig.cameras(self.spec)
        if not cameras:
            return
        atlas = build_atlas(self.world, self.spec.seed)
        grey = atlas.grey()
        for role, camera in cameras.items():
            texture = atlas if role == "color" else grey
            model = CameraModel(self.spec, camera, self.world, texture, self.trajectory)
            yield from self._images(role, camera, model.image)
            if role == "color":
                yield from self._images("depth", camera, model.depth)

    def _images(
        self, role: str, camera: rig.RigCamera, take: Callable[[float, int], npt.NDArray[Any]]
    ) -> Iterable[Event]:
        entry = self.sensors[role]
        frame, topic = entry["frameId"], entry["topic"]
        encoding = entry["camera"]["encoding"]

        def make(index: int, at: int) -> Any:
            return self.maker.image(START + at, frame, role, encoding, take(at / 1e9, index))

        def describe(_: int, at: int) -> Any:
            return self.maker.camera_info(START + at, frame, role, camera)

        for index, at in enumerate(self.stamps(entry["rate"], offset=self._offset(role))):
            info = topic.replace("image_raw", "camera_info")
            yield Event(START + at, info, kinds.CAMERA_INFO, _bind(describe, index, at))
            yield Event(START + at, topic, kinds.IMAGE, _bind(make, index, at))


def _bind(make: Callable[[int, int], Any], index: int, at: int) -> Callable[[], Any]:
    return lambda: make(index, at)


def _write_bag(
    path: Path, events: list[Event], spec: SyntheticRecording, progress: Callable[[float], None] | None
) -> dict[str, int]:
    store = messages.typestore()
    offset = round(spec.header_offset_seconds * 1e9)
    counts: dict[str, int] = {}
    with Writer(path) as writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=store, latching=int(topic == "/tf_static"))
            for topic, kind in {event.topic: event.message_type for event in events}.items()
        }
        for number, event in enumerate(events):
            data = store.serialize_ros1(event.make(), event.message_type)
            writer.write(connections[event.topic], event.stamp + offset, data)
            counts[event.topic] = counts.get(event.topic, 0) + 1
            if progress and number % 10 == 0:
                progress(number / len(events))
    if progress:
        progress(1.0)
    return counts


def _write_ground_truth(path: Path, trajectory: SyntheticMotion, stamps: npt.NDArray[np.int64]) -> None:
    motion = trajectory.at(stamps / 1e9)
    quaternions = quaternion_from_rotation(motion.rotation)
    with path.open("w", encoding="utf-8") as file:
        file.write("# timestamp tx ty tz qx qy qz qw: the body frame in the world\n")
        for at, p, q in zip((stamps + START).tolist(), motion.position, quaternions, strict=True):
            numbers = " ".join(f"{x:.12f}" for x in (*p, *q))
            file.write(f"{at // 10**9}.{at % 10**9:09d} {numbers}\n")
