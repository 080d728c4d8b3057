# SPDX-License-Identifier: Apache-2.0
"""A first manifest for a recording that someone has: what can be read from it, and what can't."""

from __future__ import annotations

import itertools
import os
import re
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from pydantic import ValidationError

from slamhive.data.doctor.examining import examine
from slamhive.data.doctor.files import static_contradictions
from slamhive.data.doctor.imus import first_samples, forces_alone, has_halves, other_half
from slamhive.data.doctor.points import LOOKED_AT
from slamhive.data.doctor.pointtimes import LEAST_SCAN_SECONDS, SAME_INSTANT
from slamhive.data.recordings import kinds
from slamhive.data.recordings.clouds import TIME_FIELDS, cloud_points, point_times
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.kinds import KINDS
from slamhive.data.recordings.posetopics import POSE_TYPES, TRUTH_NAME, relative_pose, static_tree
from slamhive.data.recordings.reading import TF_TYPES, Recording, guess_format
from slamhive.data.recordings.streams import STATIC_TRANSFORMS, camera_info_topic
from slamhive.data.recordings.thinning import rate_of
from slamhive.model.dataset import Dataset, fills
from slamhive.model.errors import DataError, InputError
from slamhive.model.sensors import ROLES, Role, SensorType
from slamhive_eval.formats.posemessages import add_transforms
from slamhive_eval.formats.transforms import Frames

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence

    import numpy.typing as npt

    from slamhive.data.recordings.reading import Scan

_SIDES = (("left", "right"), ("cam0", "cam1"), ("infra1", "infra2"), ("image_00", "image_01"))
_REGISTERED = re.compile("registered|aligned")
_DEPTHS = ("16UC1", "32FC1")
_DEPTH_CLOUD = re.compile("depth|camera|color|rgb|registered", re.IGNORECASE)
_WHEELS = re.compile("odom|wheel|encoder", re.IGNORECASE)
_LOOKED_AT, _SHOWN_FRAMES = 1000, 20
"""Messages of /tf to look at, and frames of it to name."""
_PIECE, _SHOWN_PIECES = re.compile(r"(.*_)(\d+)(\.bag|\.mcap|\.db3)"), 4
"""Name of a piece of a recording, as `rosbag record --split` and `ros2 bag record` number them."""
_RINGS, _MOST_RINGS = ("ring", "line", "channel"), 1024
_MODELS = {
    "plumb_bob": "RadialTangential",
    "rational_polynomial": "RadialTangential",
    "equidistant": "Equidistant",
    "fisheye": "Equidistant",
}


@dataclass
class Suggestion:
    """A manifest to start from.

    Attributes:
        manifest: A Dataset as plain values.
        missing: What isn't known or was guessed, a sentence each with the field it is about.
        elsewhere: Files of the recording that aren't below the manifest's folder, by the name of the link
            to each in that folder, which has to be made.
    """

    manifest: dict[str, Any]
    missing: list[str] = field(default_factory=list)
    elsewhere: dict[str, Path] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """Return the manifest as YAML, what is missing as comments above it."""
        notes = "".join(f"# - {sentence}\n" for sentence in self.missing)
        head = f"# To check and complete:\n{notes}" if notes else ""
        return head + yaml.safe_dump(
            self.manifest, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100
        )


def suggest_dataset(paths: Sequence[Path], name: str, base: Path | None = None) -> Suggestion:
    """Look into a recording and write down what it says of itself.

    Args:
        paths: A ROS 1 bag, a ROS 2 bag's folder or an MCAP file; or the pieces of one recording.
        name: Name of the dataset.
        base: Folder that the manifest will lie in; default: the working directory.

    Raises:
        DataError: It can't be read, or there is no message in it.
        InputError: A piece is named twice.
    """
    twice = next(
        (path for at, path in enumerate(paths) if path.resolve() in map(Path.resolve, paths[:at])), None
    )
    if twice is not None:
        raise InputError(f"{twice}: named twice; each piece of a recording is named once")
    with Recording(paths, guess_format(paths[0])) as recording:
        look = _Look(recording, name)
        found = look.suggestion()
    if len(paths) == 1:
        found.missing += _pieces_beside(paths[0])
    base = base or Path.cwd()
    files = []
    for path in paths:
        there = Path(os.path.abspath(path))  # noqa: PTH100 - a link below the folder is in it
        if there.is_relative_to(base):
            files.append(str(there.relative_to(base)))
        else:
            link = path.resolve().name
            if link in found.elsewhere:
                raise InputError(
                    f"{path}: another piece is called {link}, too; name links to them that differ"
                )
            found.elsewhere[link] = path.resolve()
            files.append(link)
    found.manifest["spec"]["recording"]["files"] = [{"path": file} for file in files]
    return found


def _pieces_beside(path: Path) -> Iterator[str]:
    """Yield a sentence on files beside one that recorders name so where they split a recording."""
    match = _PIECE.fullmatch(path.name)
    if match is None or path.is_dir():
        return
    before, _, ending = match.groups()
    others = sorted(
        (int(other[2]), entry)
        for entry in path.parent.iterdir()
        if entry.name != path.name
        and (other := _PIECE.fullmatch(entry.name))
        and other.group(1, 3) == (before, ending)
    )
    if others:
        names = ", ".join(entry.name for _, entry in others[:_SHOWN_PIECES])
        more = f" and {len(others) - _SHOWN_PIECES} more" if len(others) > _SHOWN_PIECES else ""
        yield (
            f"recording.files: {names}{more} beside {path.name} may be pieces of one recording: "
            f"name all, as slamhive dataset add {before}*{ending}"
        )


class _Look:
    """One look into a recording."""

    def __init__(self, recording: Recording, name: str) -> None:
        self.recording = recording
        self.name = name
        self.notes = [f"recording.files: {notice.text}" for notice in recording.notices]
        self.notes += [finding.message for finding in static_contradictions(recording)]
        self.tree = static_tree(recording)
        self.body: str | None = None
        self.forces: dict[str, str] = {}

    def suggestion(self) -> Suggestion:
        found = self._sensors()
        scans = self.recording.scan({topic for _, topic in found.values()})
        first = {name: self.recording.first(topic) for name, (_, topic) in found.items()}
        frames = {name: _frame_of(message) for name, message in first.items()}
        self.body = self._body(frames)
        sensors = {
            name: self._sensor(name, kind, topic, first[name], scans[topic])
            for name, (kind, topic) in found.items()
        }
        spec: dict[str, Any] = {
            "description": "",
            "recording": {"format": str(self.recording.format)} | _length(scans.values()),
            "sensors": sensors,
        }
        repairs = {
            name: {"forces": self.forces[topic]} for name, (_, topic) in found.items() if topic in self.forces
        }
        if repairs:
            spec["repair"] = {"sensors": repairs}
        self._findings(sensors, repairs)
        truth = self._truth()
        if truth:
            spec["groundTruth"] = truth
        self._modes({name: kind for name, (kind, _) in found.items()})
        self._others({topic for _, topic in found.values()} | {*self.forces.values()}, truth)
        manifest = {
            "apiVersion": "slamhive.io/v1alpha1",
            "kind": "Dataset",
            "metadata": {"name": self.name},
            "spec": spec,
        }
        return Suggestion(manifest, self.notes)

    def _sensors(self) -> dict[str, tuple[SensorType, str]]:
        """Return kind and topic of each sensor by the name that is proposed for it."""
        found: dict[str, tuple[SensorType, str]] = {}
        for sensor_type, kind in KINDS.items():
            if kind.role is None:
                continue
            topics = [topic for topic in self._of_type(*kind.messages) if self._kind(topic) is sensor_type]
            if sensor_type is SensorType.IMU:
                topics = self._joined(topics)
            names = _names(kind.role, len(topics))
            found |= {name: (sensor_type, topic) for name, topic in zip(names, topics, strict=True)}
            if sensor_type is SensorType.ODOMETRY and topics:
                self.notes.append(
                    f"sensors.odometry: taken for what wheels measure: {', '.join(topics)}; leave out what "
                    "another program estimated"
                )
        return found | self._cameras()

    def _findings(self, sensors: dict[str, dict[str, Any]], joined: Collection[str]) -> None:
        """Note what a sample of the messages of LiDARs and IMUs tells; of cameras is said what is missing."""
        known = {
            name: one
            for name, one in sensors.items()
            if one["type"] in {"Lidar", "Imu"} and name not in joined
        }
        recording = {"format": str(self.recording.format), "files": [{"path": "recording"}]}
        try:
            dataset = Dataset.model_validate(
                {"metadata": {"name": "recording"}, "spec": {"recording": recording, "sensors": known}}
            )
        except ValidationError:  # Such as extrinsics of NaN, which are refused when the manifest is added.
            return
        entry = DatasetEntry(dataset, Path())
        for finding in examine(entry, self.recording, dataset.spec.sensors, None, quick=True)[1]:
            if finding.message not in self.notes:
                line = f"; in spec: {finding.repair_line}" if finding.repair_line else ""
                self.notes.append(f"{finding.message}{line}")

    def _joined(self, topics: list[str]) -> list[str]:
        """Return the topics of IMUs; those of forces alone go with topics of rates alone."""
        has = {topic: has_halves(*first_samples(self.recording, topic)) for topic in topics}
        # Those of other types than Imu are no sensor by themselves.
        forces = [*forces_alone(self.recording, [one for one in topics if has[one] != (False, True)])]
        for topic in topics:
            other = other_half(topic, forces) if has[topic] == (True, False) else None
            if other is not None:
                forces.remove(other)
                self.forces[topic] = other
        return [topic for topic in topics if topic not in self.forces.values()]

    def _kind(self, topic: str) -> SensorType | None:
        """Tell which kind of sensor a topic of a kind's messages belongs to, None for none."""
        match self.recording.topics[topic].message_type:
            case kinds.POINT_CLOUD:
                message = self.recording.first(topic)
                frame = str(message.header.frame_id)
                coloured = any(item.name in {"rgb", "rgba"} for item in message.fields)
                is_depth = coloured or _DEPTH_CLOUD.search(topic) or "optical" in frame
                return SensorType.POINT_CLOUD if is_depth else SensorType.LIDAR
            case kinds.ODOMETRY | kinds.GNSS_FIX if TRUTH_NAME.search(topic):
                return None
            case kinds.TWIST | kinds.TWIST_WITH_COVARIANCE:
                # What a robot is told to do has the same type as what it did.
                return SensorType.ODOMETRY if _WHEELS.search(topic) else None
            case message_type:
                return next((one for one, kind in KINDS.items() if message_type in kind.messages), None)

    def _of_type(self, *kinds: str) -> list[str]:
        found = [
            topic for topic in self.recording.topics.values() if topic.message_type in kinds and topic.count
        ]
        return [topic.name for topic in sorted(found, key=lambda topic: (-topic.count, topic.name))]

    def _cameras(self) -> dict[str, tuple[SensorType, str]]:
        # A topic that was recorded raw and compressed is one camera's; lossless is better than JPEG.
        images, seen = [], set()
        for topic in (
            *self._of_type(kinds.IMAGE),
            *sorted(self._of_type(kinds.COMPRESSED_IMAGE), key=_is_lossy),
        ):
            if _plain(topic) not in seen:
                seen.add(_plain(topic))
                images.append(topic)
        # Depth that was brought to the colour camera's pixels comes first.
        depth = sorted(filter(self._is_depth, images), key=lambda topic: not _REGISTERED.search(topic))
        others = [topic for topic in images if topic not in depth]
        roles: dict[str, str] = {}
        if depth and others:
            color = next((topic for topic in others if re.search("color|rgb", topic)), others[0])
            roles = {"color": color, "depth": depth[0]}
            others.remove(color)
        elif depth:
            roles = {"depth": depth[0]}
        pair = _pair(others)
        if pair is not None:
            roles = {"left": pair[0], "right": pair[1]} | roles
            others = [topic for topic in others if topic not in pair]
        # A sensor of the name camera would be taken in the place of left and color.
        further = _names(Role.CAMERA, len(others) + bool(roles))[bool(roles) :]
        roles |= dict(zip(further, others, strict=True))
        return {
            role: (SensorType.DEPTH_CAMERA if role == "depth" else SensorType.CAMERA, topic)
            for role, topic in roles.items()
        }

    def _is_depth(self, topic: str) -> bool:
        message = self.recording.first(topic)
        if self.recording.topics[topic].message_type == kinds.IMAGE:
            return message.encoding in _DEPTHS
        is_png = "jp" not in message.format.lower()
        return message.format.startswith(_DEPTHS) or (is_png and "depth" in topic)

    def _modes(self, types: dict[str, SensorType]) -> None:
        """Note which modes the sensors serve, and what the others lack."""
        served: list[str] = []
        lacking: dict[str, None] = {}
        for mode, roles in ROLES.items():
            missing = [str(role) for role in roles if not fills(role, types)]
            lacking |= dict.fromkeys(missing)
            served += [] if missing else [str(mode)]
        if not types:
            self.notes.append("sensors: no topic is a sensor's that is known here, so no mode is served")
            return
        self.notes.append(
            f"modes that it serves: {', '.join(served) or 'none'}"
            + (f"; the others lack one of {', '.join(lacking)}" if lacking else "")
        )

    def _others(self, used: set[str], truth: dict[str, Any] | None) -> None:
        """Note the topics that are no sensor's."""
        used = used | {STATIC_TRANSFORMS, truth["topic"] if truth else ""}
        used |= {camera_info_topic(self.recording, topic) or "" for topic in used}
        left = [topic for name, topic in sorted(self.recording.topics.items()) if name not in used]
        if left:
            listed = ", ".join(f"{topic.name} ({topic.message_type}, {topic.count})" for topic in left)
            self.notes.append(f"kept for algorithms that ask for them by topic (modes[].topics): {listed}")

    def _body(self, frames: dict[str, str]) -> str | None:
        """Choose the body frame: the base of the static transforms, or a sensor's frame."""
        parents = {parent for parent, _ in self.tree}
        children = {child for _, child in self.tree}
        known = parents | children
        for candidate in ("base_link", "body", "base_footprint", *sorted(parents - children)):
            if candidate in known:
                self.notes.append(f"the body frame is {candidate!r}, by /tf_static")
                return candidate
        first = ("imu", "lidar", "left", "camera", "color", *frames)
        return next((frames[name] for name in first if frames.get(name)), None)

    def _sensor(self, role: str, kind: SensorType, topic: str, message: Any, scan: Scan) -> dict[str, Any]:
        frame = _frame_of(message)
        rate = rate_of(np.sort(scan.stamps))
        result: dict[str, Any] = {"type": str(kind), "topic": topic}
        if frame:
            result["frameId"] = frame
        if rate:
            result["rate"] = round(rate, 3)
        pose = relative_pose(self.tree, self.body, frame) if self.body else None
        if pose is None:
            self.notes.append(
                f"sensors.{role}.T_body_sensor: not in the recording (no /tf_static from {self.body!r} to "
                f"{frame!r}); "
                "the identity stands in for it"
            )
            pose = np.eye(4)
        result["T_body_sensor"] = [[float(number) for number in row] for row in pose]
        match kind:
            case SensorType.LIDAR:
                result |= self._lidar(role, topic, self.recording.some(topic, LOOKED_AT))
            case SensorType.IMU:
                self.notes.append(
                    f"sensors.{role}.imu: noise isn't in the recording; the defaults stand in for it"
                )
                forces = self.forces.get(topic)
                if forces is not None:
                    self.notes.append(
                        f"repair.sensors.{role}.forces: {topic} has turning rates alone, {forces} specific "
                        "forces alone, so they are taken for halves of one IMU, whose axes and place they "
                        "share; forces are interpolated at the stamps of the rates"
                    )
                result["imu"] = {}
            case SensorType.LASER_SCAN:
                result["stamp"] = "ScanStart"  # sensor_msgs/LaserScan: when the first ray was taken
            case SensorType.CAMERA | SensorType.DEPTH_CAMERA:
                result |= self._camera(role, topic, message)
        return result

    def _lidar(self, role: str, topic: str, scans: list[Any]) -> dict[str, Any]:
        names = [item.name for item in scans[0].fields]
        lidar: dict[str, Any] = {}
        read = []
        for scan in scans:
            with suppress(DataError):  # A finding says which scans can't be read.
                read.append((scan, cloud_points(scan, topic)))
        time = next((name for name in TIME_FIELDS if name in names), None)
        ring = next((name for name in _RINGS if name in names), None)
        stamp = None
        if time:
            lidar["timeField"] = time
            # Of most scans: the first of a recording may be half a one.
            told = Counter(_told_by_times(scan, points, time) for scan, points in read)
            stamp = told.most_common(1)[0][0] if told else None
        else:
            self.notes.append(
                f"sensors.{role}.lidar.timeField: points have no time; they have {', '.join(names)}"
            )
        if ring:
            lidar["ringField"] = ring
            numbers = [points[ring] for _, points in read if ring in (points.dtype.names or ())]
            rings = 1 + max((int(np.nan_to_num(one).max()) for one in numbers if len(one)), default=-1)
            if 0 < rings <= _MOST_RINGS:
                lidar["rings"] = rings
        if stamp is None:
            self.notes.append(f"sensors.{role}.stamp: ScanStart is a guess; say what the header stamp means")
        else:
            self.notes.append(f"sensors.{role}.stamp: {stamp}, as the times of the points in {time} tell")
        return {"stamp": stamp or "ScanStart", "lidar": lidar}

    def _camera(self, role: str, topic: str, message: Any) -> dict[str, Any]:
        where = f"sensors.{role}.camera"
        info = camera_info_topic(self.recording, topic)
        if info is None:
            self.notes.append(f"{where}: no camera_info beside {topic}; write down its intrinsics")
            return {}
        stated = self.recording.first(info)
        k, d = (stated.K, stated.D) if hasattr(stated, "K") else (stated.k, stated.d)
        if not k[0]:
            self.notes.append(f"{where}: {info} is uncalibrated (K is 0); write down its intrinsics")
            return {}
        camera: dict[str, Any] = {
            "width": int(stated.width),
            "height": int(stated.height),
            "fx": float(k[0]),
            "fy": float(k[4]),
            "cx": float(k[2]),
            "cy": float(k[5]),
        }
        found = _encoding_of(message)
        if found:
            camera["encoding"] = found
        if len(d) and np.any(d):
            if stated.distortion_model not in _MODELS:
                self.notes.append(f"{where}.distortion: {stated.distortion_model!r} is not known here")
            camera["distortion"] = _MODELS.get(stated.distortion_model, "RadialTangential")
            camera["coefficients"] = [float(number) for number in d[:8]]
        if role == "depth":
            self.notes.append(f"{where}.depthScale: 1000 (millimetres) is a guess; TUM RGB-D has 5000")
            camera["depthScale"] = 1 if found == "32FC1" else 1000
        return {"camera": camera}

    def _truth(self) -> dict[str, Any] | None:
        poses = self._of_type(*POSE_TYPES)
        named = [topic for topic in poses if TRUTH_NAME.search(topic)]
        if named:
            also = f"; there is {', '.join(named[1:])}, too" if named[1:] else ""
            self.notes.append(
                f"groundTruth: {named[0]} taken by its name{also}; say whose pose it is (frame)"
            )
            return {"topic": named[0], "frame": "body"}
        known = [*poses, *self._moving_frames()]
        also = f"; topics with poses: {', '.join(known)}" if known else ""
        self.notes.append(
            f"groundTruth: none found, so runs can't be evaluated; name a file or a topic{also}"
        )
        return None

    def _moving_frames(self) -> list[str]:
        """Return frames of /tf as groundTruth.topic names them, by its first messages."""
        found = Frames()
        for topic in self._of_type(*TF_TYPES):
            if topic != STATIC_TRANSFORMS:
                for connection, _, raw in itertools.islice(self.recording.messages({topic}), _LOOKED_AT):
                    add_transforms(found, self.recording.decode(raw, connection.msgtype), topic)
        return [f"/tf:{parent}.{child}" for parent, child in found][:_SHOWN_FRAMES]


def _frame_of(message: Any) -> str:
    """Return the name of the frame whose measurement a message is."""
    # Odometry is the motion of the child in a world of its own.
    name = getattr(message, "child_frame_id", "") or message.header.frame_id
    return str(name).lstrip("/")


def _encoding_of(message: Any) -> str:
    """Return the encoding of images, of compressed depth that of what was compressed; empty if not known."""
    if hasattr(message, "encoding"):
        return str(message.encoding)
    stated = str(message.format.split(";")[0].strip())
    return stated if stated in _DEPTHS else ""


def _plain(topic: str) -> str:
    """Return the topic of raw images to which a topic of compressed ones belongs (image_transport)."""
    return topic.removesuffix("/compressedDepth").removesuffix("/compressed")


def _is_lossy(topic: str) -> bool:
    return not topic.endswith("/compressedDepth")


def _names(role: Role, count: int) -> list[str]:
    """Return names for several sensors of a kind; the first ones are roles."""
    return [str(role) if number == 1 else f"{role}{number}" for number in range(1, count + 1)]


def _pair(topics: list[str]) -> tuple[str, str] | None:
    """Return a stereo pair among topics of images, by their names."""
    plain = {_plain(topic): topic for topic in topics}
    for left, right in _SIDES:
        for name, topic in plain.items():
            partner = name.replace(left, right)
            if left in name and partner in plain:
                return topic, plain[partner]
    return None


def _length(scans: Iterable[Scan]) -> dict[str, float]:
    """Return the time from the first message of any sensor to the last, as a field of the recording."""
    found = [scan.stamps for scan in scans]
    if not found:
        return {}
    stamps = np.concatenate(found)
    length = int(stamps.max() - stamps.min()) / 1e9
    return {"durationSeconds": round(length, 3)} if length >= 0.001 else {}


def _told_by_times(message: Any, points: npt.NDArray[np.void], field: str) -> str | None:
    """Return the instant of a scan that its header means, where the times of its points tell.

    Times that run from 0 on don't: they may count from the scan's start whatever the header means.
    """
    header = message.header.stamp
    if field not in (points.dtype.names or ()):
        return None
    found = point_times(points, field, header.sec * 10**9 + header.nanosec)
    if found is None:
        return None
    times, is_absolute = found
    low, high = float(times.min()), float(times.max())
    if high - low < LEAST_SCAN_SECONDS or not -1 <= low <= high <= 1:
        return None
    share = -low / (high - low)
    if share > SAME_INSTANT:
        return "ScanEnd" if share > 1 - SAME_INSTANT else "ScanMid"
    return "ScanStart" if is_absolute else None
