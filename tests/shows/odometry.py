# SPDX-License-Identifier: Apache-2.0
"""Visual odometry of folders of images: rectified pairs in KITTI's form, colour and depth in TUM's.

Each frame is located by points of the frame before it, whose depth comes from the pair or the depth image.
Points are followed by optical flow, or matched by their descriptors: two systems of one program.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

RUN = Path(os.environ["SLAMHIVE_RUN"])
FLOW = {"winSize": (15, 15), "maxLevel": 3}
LEAST = 8
"""Points that a pose takes at least."""


class Frame:
    """An image with the depth of its points."""

    def __init__(self, image: Any, other: Any, camera: dict[str, Any], baseline: float) -> None:
        self.image = image
        # No calibration is known better; the last bits would decide which points are outliers.
        fx, fy, cx, cy = (round(camera[key], 6) for key in ("fx", "fy", "cx", "cy"))
        self.matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        self.lens = np.array(camera.get("coefficients") or [0.0] * 4)
        self._other, self._baseline, self._scale = other, baseline, camera.get("depthScale")

    def depths(self, points: Any) -> Any:
        """Return the depth of pixels `(n, 2)` in m, 0 where it isn't known."""
        if self._scale:
            columns, rows = np.rint(points).astype(int).T
            return self._other[rows, columns] / self._scale
        found, status, _ = cv2.calcOpticalFlowPyrLK(self.image, self._other, points, None, **FLOW)
        disparity = points[:, 0] - found[:, 0]
        is_row = np.abs(points[:, 1] - found[:, 1]) < 1
        known = (status[:, 0] > 0) & is_row & (disparity > 0.5)
        depth = self.matrix[0, 0] * self._baseline / np.where(known, disparity, 1.0)
        return np.where(known, depth, 0.0)

    def places(self, points: Any) -> tuple[Any, Any]:
        """Return the places of points, `(n, 3)` m, and a mask of those that are known."""
        depths = self.depths(points)
        rays = cv2.undistortPoints(points[:, None].astype(float), self.matrix, self.lens)[:, 0]
        return np.column_stack([rays, np.ones(len(rays))]) * depths[:, None], (depths > 0.2) & (depths < 30)


def followed(before: Frame, now: Frame) -> tuple[Any, Any]:
    """Return pixels of the frame before and where they are now, by optical flow."""
    corners = cv2.goodFeaturesToTrack(before.image, 300, 0.01, 8)[:, 0]
    found, status, _ = cv2.calcOpticalFlowPyrLK(before.image, now.image, corners, None, **FLOW)
    return corners[status[:, 0] > 0], found[status[:, 0] > 0]


def matched(before: Frame, now: Frame) -> tuple[Any, Any]:
    """Return pixels of the frame before and where they are now, by ORB's descriptors."""
    detector = cv2.ORB_create(1000)
    (old, first), (new, second) = (detector.detectAndCompute(one.image, None) for one in (before, now))
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(first, second)
    return tuple(
        np.array([points[getattr(pair, key)].pt for pair in pairs], np.float32)
        for points, key in ((old, "queryIdx"), (new, "trainIdx"))
    )


def step(before: Frame, now: Frame, find: Any) -> Any:
    """Return the pose of the frame before in the frame now, `(4, 4)`."""
    old, new = find(before, now)
    places, known = before.places(old)
    pose = np.eye(4)
    if known.sum() < LEAST:
        return pose
    good, turn, shift, _ = cv2.solvePnPRansac(
        places[known], new[known].astype(float), now.matrix, now.lens, reprojectionError=1.5
    )
    if good:
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
    return pose


def frames(config: dict[str, Any]) -> Any:
    """Yield the frames."""
    recording, sensors = config["dataset"]["recording"], config["sensors"]
    folder, files = RUN / recording["path"], recording["files"]
    if recording["format"] == "Tum":
        camera = sensors["color"]["camera"] | {"depthScale": sensors["depth"]["camera"]["depthScale"]}
        rows = [line.split() for line in (folder / files["associations"]).read_text().splitlines()]
        pairs, baseline = [(folder / row[1], folder / row[3]) for row in rows], 0.0
    else:
        left, right = (np.array(sensors[role]["T_body_sensor"]) for role in ("left", "right"))
        baseline = round(float(np.linalg.norm(right[:3, 3] - left[:3, 3])), 6)
        camera = sensors["left"]["camera"]
        pairs = [
            (path, folder / files["right"] / path.name)
            for path in sorted((folder / files["left"]).glob("*.png"))
        ]
    for first, second in pairs:
        grey = cv2.imread(str(first), cv2.IMREAD_GRAYSCALE)
        yield Frame(grey, cv2.imread(str(second), cv2.IMREAD_UNCHANGED), camera, baseline)


def main() -> None:
    """Locate every frame, and write poses as KITTI's are."""
    cv2.setNumThreads(1)
    config = yaml.safe_load((RUN / "config.yaml").read_text())
    find = {"flow": followed, "descriptors": matched}[config["parameters"]["points"]]
    pose, before, lines = np.eye(4), None, []
    for now in frames(config):
        if before is not None:
            pose = pose @ np.linalg.inv(step(before, now, find))
        lines.append(" ".join(f"{number:.12f}" for number in pose[:3].reshape(-1)))
        before = now
    (RUN / "output" / "poses.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    sys.exit(main())
