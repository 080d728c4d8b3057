# SPDX-License-Identifier: Apache-2.0
"""Values and functions that templates have: what config.yaml tells, and its calibration as programs want it.

Lengths in metres, angles in radians, times in seconds, frequencies in Hz. T_a_b takes points of frame b to
frame a: p_a = T_a_b p_b. A frame is a role of the run's mode, such as ``left`` or ``imu``, or ``body``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from slamhive.model.errors import UnknownNameError
from slamhive.templating import cameras, geometry
from slamhive.templating.numbers import HelperProblem, Matrix, opencv_matrix, plain, quoted, row_major, shown

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_BODY = "body"
# Written out, as the models would take this bounded process a second to load.
_ALONE = ("camera", "left", "right", "color", "depth", "lidar", "imu")
_MORE = ("scan", "cloud", "odometry", "gnss", "magnetometer", "barometer")
_SEVERAL = ("camera", "lidar", "imu", *_MORE)
ROLES = (*_ALONE, *_MORE, *(f"{kind}{number}" for kind in _SEVERAL for number in (2, 3, 4)))
"""All roles, in the order of the models'."""
_CAMERAS = (*_ALONE[:4], "camera2", "camera3", "camera4")


class Helpers:
    """Values and functions that a template can use, made from one run's configuration.

    Args:
        told: the run's configuration, as config.yaml has it.
        run: the run folder, as the program sees it.
        files: the folder of settings files, as the program sees it.
    """

    def __init__(self, told: Mapping[str, Any], run: str, files: str) -> None:
        self._told = told
        # In one order everywhere: an API server sorts keys.
        self._sensors = {role: told["sensors"][role] for role in ROLES if role in told["sensors"]}
        self._run, self._files = run, files

    def values(self) -> dict[str, Any]:
        """Return the values by name: fields of config.yaml, and ``paths``, absolute for the program."""
        told, run = self._told, self._run
        names = ("algorithm", "cores", "dataset", "input", "mode", "run", "seed")
        recording = f"{run}/{told['dataset']['recording']['path']}"
        paths = {
            "run": run,
            "files": self._files,
            "dataset": f"{run}/dataset",
            "recording": recording,
            "assets": f"{run}/assets",
            "output": f"{run}/output",
        }
        parameters = dict(sorted(told.get("parameters", {}).items()))
        own = {"parameters": parameters, "paths": paths, "sensors": self._sensors}
        return {name: told[name] for name in names} | own

    def functions(self) -> dict[str, Callable[..., Any]]:
        """Return the functions by name."""
        return {
            "transform": self.transform,
            "inverse": geometry.inverse,
            "rotation": geometry.rotation,
            "translation": geometry.translation,
            "quaternion": geometry.quaternion,
            "row_major": row_major,
            "opencv_matrix": opencv_matrix,
            "camera": self.camera,
            "camodocal": self.camodocal,
            "orb_slam_camera": self.orb_slam_camera,
            "kalibr_camchain": self.kalibr_camchain,
            "baseline": self.baseline,
            "baseline_fx": self.baseline_fx,
            "time_shift": self.time_shift,
            "discrete_noise": discrete_noise,
            "fail": fail,
        }

    def transform(self, to: str, of: str) -> Matrix:
        """Return T_to_of, 4×4 by rows: the pose of frame ``of`` in frame ``to``.

        T_to_of = (T_body_to)⁻¹ · T_body_of. ``transform('imu', 'left')`` is VINS' ``body_T_cam0``,
        ``transform('left', 'imu')`` Kalibr's ``T_cam_imu``.
        """
        return geometry.product(geometry.inverse(self._pose(to)), self._pose(of))

    def camera(self, role: str, scale: float = 1.0) -> dict[str, Any]:
        """Return a camera's intrinsics by name, as `cameras.camera_fields` says.

        They are those of the images that the run is given: after ``input.resolution``.
        """
        return cameras.camera_fields(self._sensor(role), role, scale)

    def camodocal(self, role: str, scale: float = 1.0) -> str:
        """Return a camera as camodocal's lines, as `cameras.camodocal` says."""
        return cameras.camodocal(self.camera(role, scale), role)

    def orb_slam_camera(self, role: str, name: str = "Camera1", scale: float = 1.0) -> str:
        """Return a camera as ORB-SLAM's lines, as `cameras.orb_slam_camera` says."""
        return cameras.orb_slam_camera(self.camera(role, scale), role, name)

    def kalibr_camchain(self, scale: float = 1.0) -> str:
        """Return the mode's cameras as a Kalibr camchain: cam0, then cam1 of a stereo pair.

        ``T_cam_imu`` takes points of the IMU to the camera, ``T_cn_cnm1`` those of the camera before it;
        ``timeshift_cam_imu`` is added to a camera's stamp to get the IMU's.
        """
        roles = [role for role in _CAMERAS if role in self._sensors]
        if not roles:
            raise HelperProblem(f"kalibr_camchain: the mode has no camera; it has {', '.join(self._sensors)}")
        lines = []
        for index, role in enumerate(roles):
            lines.append(f"cam{index}:")
            known = cameras.kalibr_camera(self.camera(role, scale), role)
            known["rostopic"] = self._sensors[role]["topic"]
            if "imu" in self._sensors:
                known["timeshift_cam_imu"] = self.time_shift(role, "imu")
            lines += [
                f"  {name}: {quoted(item) if name == 'rostopic' else plain(item)}"
                for name, item in known.items()
            ]
            if "imu" in self._sensors:
                lines += _rows("T_cam_imu", self.transform(role, "imu"))
            if index:
                lines += _rows("T_cn_cnm1", self.transform(role, roles[index - 1]))
        return "\n".join(lines)

    def baseline(self, left: str = "left", right: str = "right") -> float:
        """Return the distance of two sensors in metres: |t| of T_left_right."""
        return math.hypot(*geometry.translation(self.transform(left, right)))

    def baseline_fx(self, left: str = "left", right: str = "right", scale: float = 1.0) -> float:
        """Return baseline · fx of the left camera, in m·pixels: ORB-SLAM's ``bf`` of a rectified pair."""
        return self.baseline(left, right) * float(self.camera(left, scale)["fx"])

    def time_shift(self, of: str, to: str) -> float:
        """Return the seconds that are added to a stamp of ``of`` to get that of ``to`` of the same instant.

        The difference of their ``timeOffset``; ``time_shift('left', 'imu')`` is VINS' ``td``.
        """
        return float(self._sensor(of).get("timeOffset", 0.0)) - float(self._sensor(to).get("timeOffset", 0.0))

    def _sensor(self, role: str) -> Mapping[str, Any]:
        if not isinstance(role, str) or role not in self._sensors:
            raise HelperProblem(str(UnknownNameError("sensor", str(role), self._sensors)))
        view: Mapping[str, Any] = self._sensors[role]
        return view

    def _pose(self, frame: str) -> Any:
        if frame == _BODY:
            return [[float(row == column) for column in range(4)] for row in range(4)]
        if not isinstance(frame, str) or frame not in self._sensors:
            raise HelperProblem(str(UnknownNameError("frame", str(frame), [*self._sensors, _BODY])))
        return self._sensors[frame]["T_body_sensor"]


def discrete_noise(density: float, rate: float) -> float:
    """Return the standard deviation of a sample: density · √rate.

    Of a continuous-time density (such as rad/s/√Hz) and the rate of the samples in Hz.
    """
    for name, value in (("density", density), ("rate", rate)):
        if isinstance(value, bool) or not isinstance(value, int | float) or value < 0:
            raise HelperProblem(f"discrete_noise: {name} must be a number of at least 0, not {shown(value)}")
    return density * math.sqrt(rate)


def fail(sentence: str) -> None:
    """End the rendering: the run fails with this sentence."""
    raise HelperProblem(str(sentence))


def _rows(name: str, matrix: Matrix) -> list[str]:
    return [f"  {name}:", *(f"  - {plain(row)}" for row in matrix)]
