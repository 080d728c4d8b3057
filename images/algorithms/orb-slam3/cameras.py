# SPDX-License-Identifier: Apache-2.0
"""Cameras for ORB-SLAM3: rectification of a stereo pair, undistortion and registration of RGB-D."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from adapter_support import AdapterError

if TYPE_CHECKING:
    from adapter_support import Sensor


@dataclass(frozen=True)
class Pinhole:
    """A pinhole camera with radial-tangential distortion.

    Attributes:
        size: Width and height in pixels.
        K: `(3, 3)`, intrinsics.
        distortion: `(5,)`, k1 k2 p1 p2 k3.
        T_body_camera: `(4, 4)`.
    """

    size: tuple[int, int]
    K: np.ndarray
    distortion: np.ndarray
    T_body_camera: np.ndarray

    @classmethod
    def of(cls, sensor: Sensor) -> Pinhole:
        """Take a camera from its calibration.

        Raises:
            AdapterError: Its model isn't a pinhole with radial-tangential distortion.
        """
        model = sensor.details.get("model") or "Pinhole"
        kind = sensor.details.get("distortion") or "None"
        coefficients = [float(value) for value in sensor.details.get("coefficients") or []]
        if model != "Pinhole" or kind not in {"None", "RadialTangential"} or len(coefficients) > 5:
            found = f"{model} with {kind} distortion of {len(coefficients)} coefficients"
            raise AdapterError(
                f"the camera {sensor.role} is {found}; this adapter takes Pinhole cameras with None or "
                "RadialTangential distortion of up to 5 coefficients"
            )
        K = np.eye(3)
        K[0, 0], K[1, 1] = sensor.detail("fx"), sensor.detail("fy")
        K[0, 2], K[1, 2] = sensor.detail("cx"), sensor.detail("cy")
        distortion = np.zeros(5)
        if kind != "None":
            distortion[: len(coefficients)] = coefficients
        size = int(sensor.detail("width")), int(sensor.detail("height"))
        return cls(size, K, distortion, sensor.T_body_sensor)


class Rectification:
    """Turns a stereo pair into one with parallel axes and no distortion (Bouguet's method, by OpenCV).

    ORB-SLAM3 1.0 could do it, but takes the distortion of the left camera for that of the right one too: the
    scale of its map is then wrong by a percent, where the two differ as lenses do.

    Attributes:
        K: `(3, 3)`, intrinsics of both rectified images.
        baseline: m.
        T_left_rectified: `(4, 4)`, pose of the rectified left camera in the left camera's frame.
        camera: The rectified left camera.

    Raises:
        AdapterError: The right camera isn't to the right of the left one.
    """

    def __init__(self, left: Pinhole, right: Pinhole) -> None:
        T_right_left = np.linalg.inv(right.T_body_camera) @ left.T_body_camera
        R, t = T_right_left[:3, :3], T_right_left[:3, 3:]
        R_left, R_right, P_left, P_right, *_ = cv2.stereoRectify(
            left.K, left.distortion, right.K, right.distortion, left.size, R, t, alpha=0
        )
        self.K = P_left[:, :3]
        self.baseline = -P_right[0, 3] / P_right[0, 0]
        if not self.baseline > 0:
            raise AdapterError("the camera right must be to the right of the camera left: see T_body_sensor")
        self.T_left_rectified = np.eye(4)
        self.T_left_rectified[:3, :3] = R_left.T
        self.camera = Pinhole(left.size, self.K, np.zeros(5), left.T_body_camera @ self.T_left_rectified)
        self._maps = [
            cv2.initUndistortRectifyMap(camera.K, camera.distortion, R, self.K, left.size, cv2.CV_16SC2)
            for camera, R in ((left, R_left), (right, R_right))
        ]

    def __call__(self, left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rectify a pair of images; of a grey one and one in colour both come out grey.

        ORB-SLAM3 takes the right one for what the left one is.
        """
        pair = [left, right]
        if left.ndim != right.ndim:
            pair = [cv2.cvtColor(one, cv2.COLOR_RGB2GRAY) if one.ndim > 2 else one for one in pair]
        first, second = (
            cv2.remap(image, *maps, cv2.INTER_LINEAR) for image, maps in zip(pair, self._maps, strict=True)
        )
        return first, second


class Undistortion:
    """Makes a colour and a depth image those of one camera without distortion.

    ORB-SLAM3 1.0 takes distortion into account for a single camera alone, although its settings hold it for
    RGB-D too: it is silently taken for zero there.

    Args:
        color: The colour camera.
        depth: The depth camera.
        scale: Units of a depth image per metre.

    Attributes:
        camera: The colour camera without its distortion.
    """

    def __init__(self, color: Pinhole, depth: Pinhole, scale: float) -> None:
        self._scale = scale
        self.camera = Pinhole(color.size, color.K, np.zeros(5), color.T_body_camera)
        self._distorted = bool(color.distortion.any())
        self._maps = cv2.initUndistortRectifyMap(
            color.K, color.distortion, np.eye(3), color.K, color.size, cv2.CV_32FC1
        )
        registered = (
            depth.size == color.size
            and np.allclose(depth.K, color.K, atol=1e-6)
            and np.allclose(depth.distortion, color.distortion, atol=1e-9)
            and np.allclose(depth.T_body_camera, color.T_body_camera, atol=1e-6)
        )
        self._registration = None if registered else DepthRegistration(depth, self.camera)

    def __call__(self, color: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Undistort a pair of images.

        Args:
            color: `(height, width)` or `(height, width, 3)`.
            depth: `(height, width)`, z along the axis of the camera that took it.
        """
        if self._distorted:
            color = cv2.remap(color, *self._maps, cv2.INTER_LINEAR)
        if self._registration is not None:
            return color, self._registration(depth, self._scale)
        # Nearest, since a mean of near and far is the depth of nothing.
        return color, cv2.remap(depth, *self._maps, cv2.INTER_NEAREST) if self._distorted else depth


class DepthRegistration:
    """Moves depth images into another camera's pixels."""

    def __init__(self, depth: Pinhole, target: Pinhole) -> None:
        self._target = target
        self._T_target_depth = np.linalg.inv(target.T_body_camera) @ depth.T_body_camera
        columns, rows = np.meshgrid(np.arange(depth.size[0]), np.arange(depth.size[1]))
        pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(float)
        rays = cv2.undistortPoints(pixels, depth.K, depth.distortion).reshape(-1, 2)
        self._rays = np.column_stack([rays, np.ones(len(rays))])

    def __call__(self, depth: np.ndarray, scale: float) -> np.ndarray:
        """Register a depth image.

        Args:
            depth: `(height, width)`, z along the depth camera's axis.
            scale: Its units per metre.

        Returns:
            `(height, width)` of the other camera, float32 in the same units, 0 where nothing is known. Where
            two depths fall on a pixel the nearer one counts.
        """
        z = depth.reshape(-1) / scale
        seen = np.isfinite(z) & (z > 0)
        points = self._rays[seen] * z[seen, None]
        points = points @ self._T_target_depth[:3, :3].T + self._T_target_depth[:3, 3]
        points = points[points[:, 2] > 0]
        width, height = self._target.size
        registered = np.full(width * height, np.inf, np.float32)
        if len(points):
            projected, _ = cv2.projectPoints(
                points, np.zeros(3), np.zeros(3), self._target.K, self._target.distortion
            )
            u, v = np.rint(projected.reshape(-1, 2)).astype(int).T
            inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
            depths = (points[inside, 2] * scale).astype(np.float32)
            np.minimum.at(registered, v[inside] * width + u[inside], depths)
        registered[np.isinf(registered)] = 0
        return registered.reshape(height, width)
