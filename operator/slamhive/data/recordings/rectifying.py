# SPDX-License-Identifier: Apache-2.0
"""Rectification of cameras: no distortion, rows of a pair aligned, as folders in KITTI's form have them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from slamhive.model.errors import InputError
from slamhive.model.sensors import Role

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt

    from slamhive.model.configuration import SensorView
    from slamhive.model.sensors import Camera

    Array = npt.NDArray[np.float64]
    Maps = tuple[npt.NDArray[Any], npt.NDArray[Any]]

_FISHEYE = "Equidistant"
_ALIGNED = 1e-9
"""Angles (rad) and offsets (shares of the baseline) below which a pair is a rectified one."""
_COEFFICIENTS = 8


def rectify(views: Mapping[Role, SensorView]) -> tuple[dict[Role, SensorView], dict[Role, Maps]]:
    """Return the cameras of a folder as rectified ones.

    Rectified by OpenCV's stereoRectify (Bouguet) with all pixels valid; one camera alone keeps its axes.

    Args:
        views: The sensors by role; others than cameras stay as they are.

    Returns:
        The sensors by role, and for those whose images change, OpenCV's maps to remap them with.

    Raises:
        InputError: They can't be rectified.
    """
    cameras = {role: _camera(view) for role, view in views.items() if role is not Role.LIDAR}
    right = cameras.pop(Role.RIGHT, None)
    if not cameras:
        return dict(views), {}
    ((first, left),) = cameras.items()
    if right is None:
        if _is_undistorted(left):
            return dict(views), {}
        matrix = _undistorted_matrix(left)
        return _changed(views, {first: (left, np.eye(3), matrix)})
    to_right = np.linalg.inv(_pose(views[Role.RIGHT])) @ _pose(views[first])
    if _is_rectified(left, right, to_right):
        return dict(views), {}
    r1, r2, p1, p2 = _stereo(views[Role.RIGHT].name, left, right, to_right)
    return _changed(views, {first: (left, r1, p1[:, :3]), Role.RIGHT: (right, r2, p2[:, :3])})


def baseline(views: Mapping[Role, SensorView], first: Role) -> float:
    """Return the distance of the right camera of a rectified pair to the right of the first, m."""
    apart = np.linalg.inv(_pose(views[first])) @ _pose(views[Role.RIGHT])
    return float(apart[0, 3])


def _camera(view: SensorView) -> Camera:
    where = f"sensors.{view.name}.camera"
    if view.camera is None:
        raise InputError(f"{where}: intrinsics are needed to rectify its images, as Kitti's form has them")
    if view.camera.model != "Pinhole":
        raise InputError(
            f"{where}.model: images of {view.camera.model} can't be rectified, as Kitti's form needs; "
            "allowed: Pinhole"
        )
    return view.camera


def _pose(view: SensorView) -> Array:
    return np.array(view.T_body_sensor, dtype=np.float64)


def _matrix(camera: Camera) -> Array:
    return np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])


def _coefficients(camera: Camera) -> Array:
    count = 4 if camera.distortion == _FISHEYE else _COEFFICIENTS
    given = [] if camera.distortion == "None" else camera.coefficients[:count]
    return np.array([*given, *[0.0] * (count - len(given))])


def _is_undistorted(camera: Camera) -> bool:
    return camera.distortion != _FISHEYE and not _coefficients(camera).any()


def _is_rectified(left: Camera, right: Camera, to_right: Array) -> bool:
    shift = to_right[:3, 3]
    return (
        _is_undistorted(left)
        and _is_undistorted(right)
        and (left.width, left.height) == (right.width, right.height)
        and np.allclose(_matrix(left), _matrix(right), rtol=0, atol=1e-6)
        and np.allclose(to_right[:3, :3], np.eye(3), rtol=0, atol=_ALIGNED)
        and shift[0] < 0
        and bool(np.abs(shift[1:]).max() <= _ALIGNED * abs(shift[0]))
    )


def _undistorted_matrix(camera: Camera) -> Array:
    size, matrix, coefficients = (camera.width, camera.height), _matrix(camera), _coefficients(camera)
    if camera.distortion == _FISHEYE:
        found = cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(
            matrix, coefficients, size, np.eye(3), balance=0.0
        )
    else:
        found, _ = cv2.getOptimalNewCameraMatrix(matrix, coefficients, size, 0.0)
    return np.asarray(found, dtype=np.float64)


def _stereo(name: str, left: Camera, right: Camera, to_right: Array) -> tuple[Array, Array, Array, Array]:
    """Return rotations (3, 3) and projections (3, 4) of a rectified pair."""
    size = (left.width, left.height)
    if size != (right.width, right.height):
        raise InputError(
            f"sensors.{name}.camera: a pair is rectified for Kitti's form only where both images have "
            f"one size; found {left.width}×{left.height} and {right.width}×{right.height}"
        )
    if (left.distortion == _FISHEYE) != (right.distortion == _FISHEYE):
        raise InputError(
            f"sensors.{name}.camera.distortion: {left.distortion} and {right.distortion} can't be rectified "
            "together, as Kitti's form needs; allowed: both Equidistant, or none of them"
        )
    given = (
        _matrix(left), _coefficients(left), _matrix(right), _coefficients(right), size,
        np.ascontiguousarray(to_right[:3, :3]), np.ascontiguousarray(to_right[:3, 3:]),
    )  # fmt: skip
    found: tuple[Any, ...]
    if left.distortion == _FISHEYE:
        found = cv2.fisheye.stereoRectify(*given, flags=cv2.CALIB_ZERO_DISPARITY, balance=0.0)
    else:
        found = cv2.stereoRectify(*given, flags=cv2.CALIB_ZERO_DISPARITY, alpha=0)
    r1, r2, p1, p2 = (np.asarray(item, dtype=np.float64) for item in found[:4])
    if p2[0, 3] >= 0:
        place = np.round(np.linalg.inv(to_right)[:3, 3], 4).tolist()
        raise InputError(
            f"sensors.{name}: the right camera of a pair must lie to the right of the left one for Kitti's "
            f"form; found it at {place} m in the left one's axes"
        )
    return r1, r2, p1, p2


def _changed(
    views: Mapping[Role, SensorView], cameras: Mapping[Role, tuple[Camera, Array, Array]]
) -> tuple[dict[Role, SensorView], dict[Role, Maps]]:
    """Return the sensors with cameras turned by a rotation, with another matrix, and the maps to that."""
    found, maps = dict(views), {}
    for role, (camera, turn, matrix) in cameras.items():
        size = (camera.width, camera.height)
        make: Any = cv2.initUndistortRectifyMap
        if camera.distortion == _FISHEYE:
            make = cv2.fisheye.initUndistortRectifyMap
        maps[role] = make(_matrix(camera), _coefficients(camera), turn, matrix, size, cv2.CV_16SC2)
        pose = _pose(views[role])
        pose[:3, :3] = pose[:3, :3] @ turn.T
        found[role] = views[role].replace(
            T_body_sensor=pose.tolist(),
            camera=camera.replace(
                fx=float(matrix[0, 0]),
                fy=float(matrix[1, 1]),
                cx=float(matrix[0, 2]),
                cy=float(matrix[1, 2]),
                distortion="None",
                coefficients=[],
            ),
        )
    return found, maps
