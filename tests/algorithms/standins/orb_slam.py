# SPDX-License-Identifier: Apache-2.0
"""Stand-in of the programs of ORB-SLAM2 and ORB-SLAM3: reads settings and data, and writes, as they do.

It is started under the name of a program, such as ``stereo_kitti``. Its poses are those of the file that
``ORB_POSES`` names, one a frame: ns, and T_world_frame by rows, of the frame whose poses the real program
writes. What it read of the settings goes to ``seen.json``.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

EXTRACTOR = {"nFeatures": int, "scaleFactor": float, "nLevels": int, "iniThFAST": int, "minThFAST": int}
VIEWER = ("KeyFrameSize", "KeyFrameLineWidth", "GraphLineWidth", "PointSize", "CameraSize", "CameraLineWidth")
VIEWER += ("ViewpointX", "ViewpointY", "ViewpointZ", "ViewpointF")


class Settings:
    """A settings file; a key that is missing, or of another type, ends the program."""

    def __init__(self, path: str) -> None:
        self._file = cv2.FileStorage(path, cv2.FILE_STORAGE_READ)
        if not self._file.isOpened():
            sys.exit(f"Failed to open settings file at: {path}")
        self.seen: dict[str, Any] = {}

    def has(self, key: str) -> bool:
        return not self._file.getNode(key).empty()

    def read(self, key: str, kind: type) -> Any:
        node = self._file.getNode(key)
        if node.empty():
            sys.exit(f"{key} required parameter does not exist, aborting...")
        if kind is int and not node.isInt():
            sys.exit(f"{key} parameter must be an integer number, aborting...")
        # The old form takes no whole number for a real one, and some versions not in the new form either.
        if kind is float and not node.isReal():
            sys.exit(f"{key} parameter must be a real number, aborting...")
        if kind is str and not node.isString():
            sys.exit(f"{key} parameter must be a string, aborting...")
        if kind is np.ndarray:
            # The real one reads single precision whatever the type is said to be.
            value = node.mat()
            if value.dtype != np.float32:
                sys.exit(f"{key}: {value.dtype} would be read as float32")
            self.seen[key] = value.tolist()
        else:
            self.seen[key] = node.string() if kind is str else kind(node.real())
        return self.seen[key]

    def number(self, key: str) -> None:
        """Take a number of either kind, as OpenCV's conversion does; what isn't there would be 0."""
        node = self._file.getNode(key)
        if not (node.isReal() or node.isInt()):
            sys.exit(f"{key} is no number")
        self.seen[key] = node.real()

    def camera(self, name: str) -> None:
        for key in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"):
            self.read(f"{name}.{key}", float)
        if self.has(f"{name}.k3"):
            self.read(f"{name}.k3", float)


def read_settings(path: str, program: str) -> Settings:
    """Read what a program reads: ORB-SLAM3's new form where the file says so, else the one of both."""
    settings = Settings(path)
    kind = program.rsplit("_", 1)[0]
    if settings.has("File.version") and settings.read("File.version", str) == "1.0":
        _read_new(settings, kind)
    else:
        settings.camera("Camera")
        reals = ["Camera.bf", "ThDepth"] if kind in {"stereo", "rgbd"} else []
        for key in reals + (["DepthMapFactor"] if kind == "rgbd" else []):
            settings.read(key, float)
        settings.number("Camera.fps")
        settings.read("Camera.RGB", int)
    for key, type_ in EXTRACTOR.items():
        settings.read(f"ORBextractor.{key}", type_)
    if settings.has("loopClosing"):
        settings.read("loopClosing", int)
    return settings


def _read_new(settings: Settings, kind: str) -> None:
    if settings.read("Camera.type", str) != "PinHole":
        sys.exit("Error: the stand-in knows no other camera")
    settings.camera("Camera1")
    if kind.startswith("stereo"):
        settings.camera("Camera2")
        settings.read("Stereo.T_c1_c2", np.ndarray)
        settings.read("Stereo.ThDepth", float)
    for key in ("Camera.width", "Camera.height", "Camera.fps", "Camera.RGB"):
        settings.read(key, int)
    for key in ("Camera.newWidth", "Camera.newHeight"):
        if settings.has(key):
            settings.read(key, int)
    if kind.endswith("inertial"):
        for key in ("NoiseGyro", "NoiseAcc", "GyroWalk", "AccWalk", "Frequency"):
            settings.read(f"IMU.{key}", float)
        settings.read("IMU.T_b_c1", np.ndarray)
    for key in VIEWER:
        settings.read(f"Viewer.{key}", float)


def images_of(program: str, arguments: list[str]) -> list[list[Path]]:
    """Return the images of each frame, as the program looks for them."""
    folder = Path(arguments[0])
    if program.endswith("_euroc"):
        names = Path(arguments[1]).read_text().split()
        places = ["mav0/cam0/data"] + (["mav0/cam1/data"] if program.startswith("stereo") else [])
        rows = [line for line in (folder / "mav0/imu0/data.csv").read_text().split("\n")[1:] if line]
        first = [float(row.split(",")[0]) for row in rows if len(row.split(",")) == 7]
        if not first or first[0] > float(names[0]):
            sys.exit("no inertial measurement before the first image")
        return [[folder / place / f"{name}.png" for place in places] for name in names]
    if program == "stereo_kitti":
        count = len((folder / "times.txt").read_text().split())
        return [[folder / place / f"{k:06}.png" for place in ("image_0", "image_1")] for k in range(count)]
    if program == "mono_tum":
        rows = (folder / "rgb.txt").read_text().splitlines()[3:]
        return [[folder / row.split()[1]] for row in rows]
    pairs = [line.split() for line in Path(arguments[1]).read_text().splitlines()]
    return [[folder / rgb, folder / depth] for _, rgb, _, depth in pairs]


def main() -> None:
    """Do as the program does under whose name this was started."""
    program, (vocabulary, path, *rest) = Path(sys.argv[0]).name, sys.argv[1:]
    if not Path(vocabulary).is_file():
        sys.exit("Wrong path to vocabulary.")
    settings = read_settings(path, program)
    frames = images_of(program, rest)
    sizes = set()
    for images in frames:
        for image in images:
            pixels = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
            if pixels is None:
                sys.exit(f"Failed to load image at: {image}")
            sizes.add(pixels.shape[1::-1])
        if program == "rgbd_tum" and pixels.dtype != np.uint16:
            sys.exit(f"the depth image {image} is no 16-bit PNG")
    settings.seen["sizes"] = sorted(sizes)
    Path("seen.json").write_text(json.dumps(settings.seen))
    rows = np.loadtxt(os.environ["ORB_POSES"], dtype=str)[: -int(os.environ.get("ORB_LATE", "0")) or None]
    stamps, poses = rows[:, 0].astype(np.int64), rows[:, 1:].astype(float).reshape(-1, 3, 4)
    whole = np.concatenate([poses, np.tile([[[0, 0, 0, 1.0]]], (len(poses), 1, 1))], axis=1)
    relative = np.linalg.inv(whole[0]) @ whole
    write(program, stamps, relative)


def write(program: str, stamps: np.ndarray, poses: np.ndarray) -> None:
    """Write the poses, and every fifth as a keyframe, in the program's own forms."""
    if program == "stereo_kitti":
        lines = [" ".join(f"{value:.9f}" for value in pose[:3].reshape(-1)) for pose in poses]
        Path("CameraTrajectory.txt").write_text("".join(f"{line}\n" for line in lines))
        return
    factor = 1e9 if program.endswith("_euroc") else 1.0
    lines = []
    for stamp, pose in zip(stamps.tolist(), poses, strict=True):
        vector = cv2.Rodrigues(pose[:3, :3])[0].reshape(3)
        angle = float(np.linalg.norm(vector))
        axis = vector / angle if angle else vector
        numbers = (*pose[:3, 3], *(axis * np.sin(angle / 2)), np.cos(angle / 2))
        lines.append(f"{stamp / 1e9 * factor:.6f} " + " ".join(f"{number:.9f}" for number in numbers) + "\n")
    if program != "mono_tum":
        Path("CameraTrajectory.txt").write_text("".join(lines))
    Path("KeyFrameTrajectory.txt").write_text("".join(lines[::5]))


if __name__ == "__main__":
    main()
