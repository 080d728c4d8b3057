# SPDX-License-Identifier: Apache-2.0
"""A first manifest for a recording that someone has: what can be read from it, and what can't."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from slamhive.data import kinds
from slamhive.data.clouds import cloud_points
from slamhive.data.posetopics import POSE_TYPES, relative_pose, static_tree
from slamhive.data.recordings import Recording, guess_format
from slamhive.data.streams import camera_info_topic
from slamhive.data.thinning import rate_of
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from slamhive.data.recordings import Scan

_SIDES = (("left", "right"), ("cam0", "cam1"), ("infra1", "infra2"), ("image_00", "image_01"))
_TRUTH = re.compile(r"ground_?truth|(^|/)gt(/|_|$)|vicon|mocap|optitrack|vrpn", re.IGNORECASE)
_TIMES, _RINGS = ("time", "t", "timestamp", "time_offset", "offset_time"), ("ring", "line", "channel")
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
    """

    manifest: dict[str, Any]
    missing: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """Return the manifest as YAML, what is missing as comments above it."""
        notes = "".join(f"# - {sentence}\n" for sentence in self.missing)
        head = f"# To check and complete:\n{notes}" if notes else ""
        return head + yaml.safe_dump(
            self.manifest, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100
        )


def suggest_dataset(path: Path, name: str, base: Path | None = None) -> Suggestion:
    """Look into a recording and write down what it says of itself.

    Args:
        path: A ROS 1 bag, a ROS 2 bag's folder or an MCAP file.
        name: Name of the dataset.
        base: Folder that the manifest will lie in; default: the working directory.

    Raises:
        DataError: It can't be read, or holds no sensor that is known.
    """
    with Recording([path], guess_format(path)) as recording:
        look = _Look(recording, name)
        found = look.suggestion()
    base = base or Path.cwd()
    there = Path(os.path.abspath(path))  # noqa: PTH100 - a link below the folder is in it
    if there.is_relative_to(base):
        file = str(there.relative_to(base))
    else:
        file = path.name
        found.missing.append(
            f"recording.files: paths start from the manifest's folder: move it to {path.parent}"
        )
    found.manifest["spec"]["recording"]["files"] = [{"path": file}]
    return found


class _Look:
    """One look into a recording."""

    def __init__(self, recording: Recording, name: str) -> None:
        self.recording = recording
        self.name = name
        self.notes: list[str] = []
        self.tree = static_tree(recording)
        self.body: str | None = None

    def suggestion(self) -> Suggestion:
        roles = self._roles()
        if not roles:
            listed = ", ".join(
                f"{item.name} ({item.message_type})" for item in self.recording.topics.values()
            )
            raise DataError(f"{self.recording.label}: no camera, LiDAR or IMU topic among: {listed}")
        scans = self.recording.scan(set(roles.values()))
        first = {role: self._first(topic) for role, topic in roles.items()}
        frames = {role: str(message.header.frame_id).lstrip("/") for role, message in first.items()}
        self.body = self._body(frames)
        sensors = {
            role: self._sensor(role, topic, first[role], scans[topic]) for role, topic in roles.items()
        }
        spec: dict[str, Any] = {
            "description": "",
            "recording": {"format": str(self.recording.format)} | _length(scans.values()),
            "sensors": sensors,
        }
        truth = self._truth()
        if truth:
            spec["groundTruth"] = truth
        manifest = {
            "apiVersion": "slamhive.io/v1alpha1",
            "kind": "Dataset",
            "metadata": {"name": self.name},
            "spec": spec,
        }
        return Suggestion(manifest, self.notes)

    def _roles(self) -> dict[str, str]:
        roles: dict[str, str] = {}
        for role, kind in (("lidar", kinds.POINT_CLOUD), ("imu", kinds.IMU)):
            topics = self._of_type(kind)
            if topics:
                roles[role] = topics[0]
                if len(topics) > 1:
                    self.notes.append(
                        f"sensors.{role}.topic: {topics[0]} taken; also there: {', '.join(topics[1:])}"
                    )
        return roles | self._cameras()

    def _of_type(self, *kinds: str) -> list[str]:
        found = [
            topic for topic in self.recording.topics.values() if topic.message_type in kinds and topic.count
        ]
        return [topic.name for topic in sorted(found, key=lambda topic: (-topic.count, topic.name))]

    def _cameras(self) -> dict[str, str]:
        images = self._of_type(kinds.IMAGE) or self._of_type(kinds.COMPRESSED_IMAGE)
        depth = [topic for topic in images if self._is_depth(topic)]
        others = [topic for topic in images if topic not in depth]
        roles: dict[str, str] = {}
        if depth and others:
            color = next((topic for topic in others if re.search("color|rgb", topic)), others[0])
            roles = {"color": color, "depth": depth[0]}
            others.remove(color)
        for left, right in _SIDES:
            for topic in others:
                partner = topic.replace(left, right)
                if left in topic and partner in others:
                    return {"left": topic, "right": partner} | roles
        if roles:
            return roles
        if len(others) > 1:
            self.notes.append(f"sensors.camera.topic: {others[0]} taken; also there: {', '.join(others[1:])}")
        return {"camera": others[0]} if others else {}

    def _is_depth(self, topic: str) -> bool:
        if self.recording.topics[topic].message_type == kinds.IMAGE:
            return self._first(topic).encoding in ("16UC1", "32FC1")
        return "depth" in topic

    def _first(self, topic: str) -> Any:
        for connection, _, raw in self.recording.messages({topic}):
            return self.recording.decode(raw, connection.msgtype)
        raise DataError(f"{topic} in {self.recording.label}: no messages")

    def _body(self, frames: dict[str, str]) -> str | None:
        """Choose the body frame: the base of the static transforms, or a sensor's frame."""
        parents = {parent for parent, _ in self.tree}
        children = {child for _, child in self.tree}
        known = parents | children
        for candidate in ("base_link", "body", "base_footprint", *sorted(parents - children)):
            if candidate in known:
                self.notes.append(f"the body frame is {candidate!r}, by /tf_static")
                return candidate
        role = next((role for role in ("imu", "lidar", "left", "camera", "color") if role in frames), None)
        return frames[role] if role else None

    def _sensor(self, role: str, topic: str, message: Any, scan: Scan) -> dict[str, Any]:
        kinds = {"lidar": "Lidar", "imu": "Imu", "depth": "DepthCamera"}
        frame = str(message.header.frame_id).lstrip("/")
        rate = rate_of(np.sort(scan.stamps))
        result: dict[str, Any] = {"type": kinds.get(role, "Camera"), "topic": topic}
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
        match role:
            case "lidar":
                result |= self._lidar(topic, message)
            case "imu":
                self.notes.append(
                    "sensors.imu.imu: noise isn't in the recording; the defaults stand in for it"
                )
                result["imu"] = {}
            case _:
                result |= self._camera(role, topic, message)
        return result

    def _lidar(self, topic: str, message: Any) -> dict[str, Any]:
        names = [item.name for item in message.fields]
        lidar: dict[str, Any] = {}
        time = next((name for name in _TIMES if name in names), None)
        ring = next((name for name in _RINGS if name in names), None)
        if time:
            lidar["timeField"] = time
        else:
            self.notes.append(
                f"sensors.lidar.lidar.timeField: points have no time; they have {', '.join(names)}"
            )
        if ring:
            lidar["ringField"] = ring
            rings = cloud_points(message, topic)[ring]
            if rings.size:
                lidar["rings"] = int(rings.max()) + 1
        self.notes.append("sensors.lidar.stamp: ScanStart is a guess; say what the header stamp means")
        return {"stamp": "ScanStart", "lidar": lidar}

    def _camera(self, role: str, topic: str, message: Any) -> dict[str, Any]:
        where = f"sensors.{role}.camera"
        info = camera_info_topic(self.recording, topic)
        if info is None:
            self.notes.append(f"{where}: no camera_info beside {topic}; write down its intrinsics")
            return {}
        stated = self._first(info)
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
        if hasattr(message, "encoding"):
            camera["encoding"] = str(message.encoding)
        if len(d) and np.any(d):
            if stated.distortion_model not in _MODELS:
                self.notes.append(f"{where}.distortion: {stated.distortion_model!r} is not known here")
            camera["distortion"] = _MODELS.get(stated.distortion_model, "RadialTangential")
            camera["coefficients"] = [float(number) for number in d[:8]]
        if role == "depth":
            self.notes.append(f"{where}.depthScale: 1000 (millimetres) is a guess; TUM RGB-D has 5000")
            camera["depthScale"] = 1 if message.encoding == "32FC1" else 1000
        return {"camera": camera}

    def _truth(self) -> dict[str, Any] | None:
        poses = self._of_type(*POSE_TYPES)
        named = [topic for topic in poses if _TRUTH.search(topic)]
        if named:
            self.notes.append(f"groundTruth: {named[0]} taken by its name; say whose pose it is (frame)")
            return {"topic": named[0], "frame": "body"}
        also = f"; topics with poses: {', '.join(poses)}" if poses else ""
        self.notes.append(
            f"groundTruth: none found, so runs can't be evaluated; name a file or a topic{also}"
        )
        return None


def _length(scans: Iterable[Scan]) -> dict[str, float]:
    """Return the time from the first message of any sensor to the last, as a field of the recording."""
    stamps = np.concatenate([scan.stamps for scan in scans])
    length = int(stamps.max() - stamps.min()) / 1e9
    return {"durationSeconds": round(length, 3)} if length >= 0.001 else {}
