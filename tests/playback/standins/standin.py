# SPDX-License-Identifier: Apache-2.0
"""Support that all stand-ins share: what they are to find in their settings, and poses of the ground truth.

expected.json is written by the test from the dataset's own manifest, not by what renders settings:
``sensors`` by role as they were recorded, ``resolution`` of the images, ``settings`` that parameters of the
run ask for by the keys of the program, and the file of the ground truth.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any, NoReturn

import cv2
import numpy as np

EXPECTED: dict[str, Any] = json.loads(Path(os.environ["STANDIN_EXPECTED"]).read_text())
SENSORS: dict[str, Any] = EXPECTED["sensors"]
CAMERAS = [role for role in ("left", "right", "camera") if role in SENSORS]


def refuse(sentence: str) -> NoReturn:
    """End with a sentence, as a program does whose settings are wrong."""
    sys.exit(f"settings: {sentence}")


def agree(what: str, found: Any, wanted: Any, within: float = 1e-9) -> None:
    """Make sure that a setting is what the dataset says."""
    if isinstance(wanted, str) or isinstance(found, str):
        same = found == wanted
    else:
        same = np.shape(found) == np.shape(wanted) and np.allclose(found, wanted, rtol=1e-9, atol=within)
    if not same:
        refuse(f"{what} is {np.asarray(found).tolist()}, expected {np.asarray(wanted).tolist()}")


def pose_of(role: str) -> np.ndarray:
    """Return T_body_sensor of a role, or that of the body itself."""
    return np.eye(4) if role == "body" else np.array(SENSORS[role]["T_body_sensor"], float)


def between(to: str, of: str) -> np.ndarray:
    """Return T_to_of."""
    return np.linalg.inv(pose_of(to)) @ pose_of(of)


def per_sample(name: str) -> float:
    """Return a noise of the IMU as the standard deviation of a sample."""
    imu = SENSORS["imu"]
    return float(imu["imu"][name] * imu["rate"] ** 0.5)


class Storage:
    """A settings file as OpenCV reads it; a key that isn't there is refused, as OpenCV would make it 0."""

    def __init__(self, path: str) -> None:
        self._path = Path(path)
        if not self._path.read_text().startswith("%YAML:1.0"):
            refuse(f"{path} does not begin with %YAML:1.0")
        self._file = cv2.FileStorage(path, cv2.FILE_STORAGE_READ)
        self._read: set[str] = set()

    def _node(self, key: str) -> Any:
        node: Any = self._file
        for part in key.split("."):
            node = node.getNode(part)
        self._read.add(key.partition(".")[0])
        if node.empty():
            refuse(f"{self._path.name} has no {key}")
        return node

    def integer(self, key: str) -> int:
        node = self._node(key)
        if not node.isInt():
            refuse(f"{key} is no whole number")
        return int(node.real())

    def real(self, key: str) -> float:
        node = self._node(key)
        if not (node.isReal() or node.isInt()):
            refuse(f"{key} is no number")
        return float(node.real())

    def text(self, key: str) -> str:
        node = self._node(key)
        if not node.isString():
            refuse(f"{key} is no text")
        return str(node.string())

    def matrix(self, key: str) -> np.ndarray:
        return np.array(self._node(key).mat())

    def beside(self, key: str) -> Storage:
        """Return the file that a key names, beside this one."""
        return Storage(str(self._path.parent / self.text(key)))

    def all_read(self, *others: str) -> None:
        """Make sure that nothing stands there that no program reads."""
        unread = set(self._file.root().keys()) - self._read - set(others)
        if unread:
            refuse(f"{self._path.name}: nothing reads {', '.join(sorted(unread))}")


class Truth:
    """Poses of a sensor in the world of the ground truth."""

    def __init__(self, role: str) -> None:
        self._table = np.loadtxt(EXPECTED["truth"])
        self._sensor = pose_of(role)

    def at(self, stamp: float) -> np.ndarray:
        """Return T_world_sensor at a time, between two poses of the body."""
        stamps = self._table[:, 0]
        place = int(np.clip(np.searchsorted(stamps, stamp), 1, len(stamps) - 1))
        before, after = self._table[place - 1], self._table[place]
        share = np.clip((stamp - before[0]) / (after[0] - before[0]), 0, 1)
        second = after[4:] if before[4:] @ after[4:] > 0 else -after[4:]
        body = np.eye(4)
        body[:3, :3] = matrix_of((1 - share) * before[4:] + share * second)
        body[:3, 3] = (1 - share) * before[1:4] + share * after[1:4]
        return body @ self._sensor


def matrix_of(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation of a quaternion x, y, z, w."""
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(R: np.ndarray) -> np.ndarray:
    """Return a rotation as a quaternion x, y, z, w: the eigenvector of Bar-Itzhack (2000)."""
    K = np.array(
        [
            [R[0, 0] - R[1, 1] - R[2, 2], R[1, 0] + R[0, 1], R[2, 0] + R[0, 2], R[2, 1] - R[1, 2]],
            [R[1, 0] + R[0, 1], R[1, 1] - R[0, 0] - R[2, 2], R[2, 1] + R[1, 2], R[0, 2] - R[2, 0]],
            [R[2, 0] + R[0, 2], R[2, 1] + R[1, 2], R[2, 2] - R[0, 0] - R[1, 1], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], R[0, 0] + R[1, 1] + R[2, 2]],
        ]
    )
    return np.linalg.eigh(K / 3)[1][:, -1]


def upright(pose: np.ndarray) -> np.ndarray:
    """Return a pose's position and heading alone: where a world begins whose z points up."""
    heading = np.arctan2(pose[1, 0], pose[0, 0])
    start = np.eye(4)
    start[:2, :2] = [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]
    start[:3, 3] = pose[:3, 3]
    return start
