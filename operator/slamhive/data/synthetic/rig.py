# SPDX-License-Identifier: Apache-2.0
"""The platform's sensors: where they sit, their lenses, and the calibration a Dataset states.

Mounting angles are those of hands, not of drawings: an adapter that forgets an extrinsic shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from slamhive.data.synthetic.optics import Lens, scale_matrix
from slamhive.data.synthetic.trajectory import rotation_from_euler
from slamhive.model.synthetic import FIXED_RATES, SyntheticRig, SyntheticSensor

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive.model.synthetic import SyntheticCamera, SyntheticRecording

    Array = npt.NDArray[np.float64]

BODY_FRAME = "base_link"
DEPTH_SCALE = 1000.0
"""Units of a depth image per metre."""

ACCELEROMETER_NOISE = 0.01
"""White noise density, m/s²/√Hz, at noise 1; the others alike."""
GYROSCOPE_NOISE = 0.001
ACCELEROMETER_RANDOM_WALK = 1e-4
GYROSCOPE_RANDOM_WALK = 1e-5
GRAVITY = 9.81

# Columns: camera x (right), y (down), z (forward) in axes x forward, y left, z up.
_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class RigCamera:
    """One camera.

    Attributes:
        role: left, right or color.
        pose: `(4, 4)`, T_body_camera of the optical frame: z forward, x right, y down.
        lens: Its lens at the size rendered.
        rectification: `(3, 3)`, R of CameraInfo.
        projection: `(3, 4)`, P of CameraInfo.
    """

    role: str
    pose: Array
    lens: Lens
    rectification: Array
    projection: Array


def pose(degrees: tuple[float, float, float], position: tuple[float, float, float]) -> Array:
    """Compose `(4, 4)` from roll, pitch, yaw in degrees and a position in m."""
    result = np.eye(4)
    result[:3, :3] = rotation_from_euler(np.radians([degrees]))[0]
    result[:3, 3] = position
    return result


MOUNTINGS: dict[str, Array] = {
    "scan": pose((0.8, -0.6, -7.3), (0.12, -0.05, 0.22)),
    # Wheels stand on the ground: they are turned and moved in its plane alone.
    "odometry": pose((0.0, 0.0, 4.0), (-0.21, 0.03, -0.28)),
    "gnss": pose((0.0, 0.0, 0.0), (-0.11, 0.07, 0.52)),
    "magnetometer": pose((2.2, -1.4, 17.6), (-0.09, -0.06, 0.41)),
    "barometer": pose((0.0, 0.0, 0.0), (0.02, 0.01, 0.09)),
}
"""T_body_sensor `(4, 4)` of sensors whose place is the same on all rigs."""

_AIDING = {
    SyntheticSensor.LASER_SCAN: ("scan", "/scan", "ScanStart"),
    SyntheticSensor.ODOMETRY: ("odometry", "/odom", "Sample"),
    SyntheticSensor.GNSS: ("gnss", "/fix", "Sample"),
    SyntheticSensor.MAGNETOMETER: ("magnetometer", "/mag", "Sample"),
    SyntheticSensor.BAROMETER: ("barometer", "/pressure", "Sample"),
}
"""Name, topic and meaning of the stamp of sensors whose rate can't be chosen."""

LIDAR_POSE = pose((1.3, -2.1, 5.2), (0.09, 0.04, 0.31))


def imu_pose(spec: SyntheticRecording) -> Array:
    """Give T_body_imu `(4, 4)` of a specification's rig."""
    if spec.rig is SyntheticRig.EUROC:
        return np.asarray(_LEFT_POSE @ _IMU_IN_LEFT)
    if spec.rig is SyntheticRig.MAV:
        return np.asarray(_MAV_LEFT_POSE @ np.linalg.inv(_MAV_LEFT_IN_IMU))
    return pose((-2.4, 1.7, 11.3), (-0.06, 0.05, 0.07))


def cameras(spec: SyntheticRecording) -> dict[str, RigCamera]:
    """Give the cameras of a specification by role, at the size rendered."""
    result: dict[str, RigCamera] = {}
    if SyntheticSensor.STEREO in spec.sensors:
        result |= _stereo(spec.camera, *_pair(spec))
    if SyntheticSensor.RGBD in spec.sensors:
        mounting = _mount((1.9, 5.3, 27.4), (0.19, -0.07, 0.16))
        result["color"] = _camera(
            "color", mounting, _lens(spec.camera, 0.655, (0.494, 0.507), (-0.16, 0.05, 6e-4, -4e-4))
        )
    for role, camera in result.items():
        lens = camera.lens.scaled(spec.camera.scale)
        shares = lens.width / camera.lens.width, lens.height / camera.lens.height
        projection = scale_matrix(camera.projection, *shares)
        result[role] = RigCamera(role, camera.pose, lens, camera.rectification, projection)
    return result


def _mount(degrees: tuple[float, float, float], position: tuple[float, float, float]) -> Array:
    """Mount a camera looking along the axis that the angles turn x (forward) to."""
    result = pose(degrees, position)
    result[:3, :3] = result[:3, :3] @ _OPTICAL
    return result


_LEFT_POSE = _mount((-1.6, 4.1, 33.7), (0.21, 0.08, 0.11))


def _rigid(rows: list[list[float]]) -> Array:
    """Return the pose nearest to published numbers (3, 4), whose last digits are rounded."""
    result = np.eye(4)
    result[:3] = rows
    u, _, v = np.linalg.svd(result[:3, :3])
    result[:3, :3] = u @ v
    return result


# T_BS of cam0 and cam1, body and IMU being one, from the sensor.yaml of EuRoC's vicon rooms (Burri et al.,
# The EuRoC micro aerial vehicle datasets, IJRR 2016).
_MAV_LEFT_IN_IMU = _rigid(
    [
        [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975],
        [0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768],
        [-0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949],
    ]
)
_MAV_RIGHT_IN_IMU = _rigid(
    [
        [0.0125552670891, -0.999755099723, 0.0182237714554, -0.0198435579556],
        [0.999598781151, 0.0130119051815, 0.0251588363115, 0.0453689425024],
        [-0.0253898008918, 0.0179005838253, 0.999517347078, 0.00786212447038],
    ]
)
# It looks down as far as at the start of V1_01, where gravity is 22 degrees off the IMU's x axis.
_MAV_LEFT_POSE = _mount((-1.6, 21.9, 33.7), (0.21, 0.08, 0.11))

# T_left_imu: the sign is the one with which the other cameras are turned by less than 90 degrees too.
_IMU_IN_LEFT = np.linalg.inv(pose((0.2, -1.5, -89.1), (-0.02, 0.06, 0.01)))


def _lens(
    camera: SyntheticCamera, focal: float, centre: tuple[float, float], coefficients: tuple[float, ...]
) -> Lens:
    """Make a lens from shares of the image's width and size."""
    f = focal * camera.width
    matrix = np.array(
        [[f, 0.0, centre[0] * camera.width], [0.0, 1.004 * f, centre[1] * camera.height], [0, 0, 1.0]]
    )
    return Lens(camera.width, camera.height, matrix, np.array([*coefficients, 0.0]))


def _camera(role: str, mounting: Array, lens: Lens) -> RigCamera:
    projection = np.hstack([lens.matrix, np.zeros((3, 1))])
    return RigCamera(role, mounting, lens, np.eye(3), projection)


def _pair(spec: SyntheticRecording) -> tuple[Array, Array]:
    """Return T_body_left and T_left_right: 0.11 to 0.12 m apart, turned by a degree or less."""
    if spec.rig is SyntheticRig.MAV:
        return _MAV_LEFT_POSE, np.linalg.inv(_MAV_LEFT_IN_IMU) @ _MAV_RIGHT_IN_IMU
    turn = np.eye(4)
    turn[:3, :3] = rotation_from_euler(np.radians([[0.35, -0.8, 0.5]]))[0]
    turn[:3, 3] = 0.12, 0.0013, -0.0008
    return _LEFT_POSE, turn


def _stereo(spec: SyntheticCamera, left_pose: Array, turn: Array) -> dict[str, RigCamera]:
    """Make the stereo pair.

    Args:
        spec: The cameras.
        left_pose: T_body_left.
        turn: T_left_right.
    """
    right_pose = left_pose @ turn
    left = _lens(spec, 0.645, (0.507, 0.491), (-0.21, 0.07, 5e-4, -3e-4))
    right = _lens(spec, 0.649, (0.496, 0.503), (-0.20, 0.06, -4e-4, 5e-4))
    to_right = np.linalg.inv(turn)
    size = (spec.width, spec.height)
    r1, r2, p1, p2, *_ = cv2.stereoRectify(
        left.matrix, left.coefficients, right.matrix, right.coefficients, size,
        to_right[:3, :3], to_right[:3, 3:], flags=cv2.CALIB_ZERO_DISPARITY, alpha=0,
    )  # fmt: skip
    return {
        "left": RigCamera("left", left_pose, left, np.asarray(r1, np.float64), np.asarray(p1, np.float64)),
        "right": RigCamera(
            "right", right_pose, right, np.asarray(r2, np.float64), np.asarray(p2, np.float64)
        ),
    }


def sensors(spec: SyntheticRecording) -> dict[str, dict[str, Any]]:
    """Describe the sensors by role, as the unified configuration's `sensors` has them."""
    result: dict[str, dict[str, Any]] = {}
    if SyntheticSensor.LIDAR in spec.sensors:
        lidar = spec.lidar
        result["lidar"] = _entry(
            "lidar", "Lidar", "/points", rate=lidar.rate, mounting=LIDAR_POSE, stamp="ScanStart"
        ) | {
            "lidar": {
                "rings": lidar.rings,
                "columns": lidar.columns,
                "minRange": lidar.min_range,
                "maxRange": lidar.max_range,
                "timeField": "time",
                "ringField": "ring",
            }
        }
    if SyntheticSensor.IMU in spec.sensors:
        # An estimator divides by these: even a perfect IMU is stated with a little noise.
        scale = max(spec.noise, 0.01)
        result["imu"] = _entry(
            "imu", "Imu", "/imu", rate=spec.imu.rate, mounting=imu_pose(spec), stamp="Sample"
        ) | {
            "imu": {
                "accelerometerNoise": ACCELEROMETER_NOISE * scale,
                "gyroscopeNoise": GYROSCOPE_NOISE * scale,
                "accelerometerRandomWalk": ACCELEROMETER_RANDOM_WALK * scale,
                "gyroscopeRandomWalk": GYROSCOPE_RANDOM_WALK * scale,
                "gravity": GRAVITY,
            }
        }
    for role, camera in cameras(spec).items():
        result[role] = _camera_entry(role, camera, spec.camera.rate)
    if "color" in result:
        depth = _camera_entry("color", cameras(spec)["color"], spec.camera.rate)
        depth |= {"name": "depth", "type": "DepthCamera", "topic": "/camera/depth/image_raw"}
        depth["camera"] |= {"encoding": "16UC1", "depthScale": DEPTH_SCALE}
        result["depth"] = depth
    for sensor, (name, topic, stamp) in _AIDING.items():
        if sensor in spec.sensors:
            rate = FIXED_RATES[sensor]
            result[name] = _entry(name, sensor.value, topic, rate=rate, mounting=MOUNTINGS[name], stamp=stamp)
    return result


def _entry(name: str, kind: str, topic: str, *, rate: float, mounting: Array, stamp: str) -> dict[str, Any]:
    return {
        "name": name,
        "type": kind,
        "topic": topic,
        "frameId": name,
        "rate": rate,
        "stamp": stamp,
        "timeOffset": 0.0,
        "T_body_sensor": mounting.tolist(),
    }


def _camera_entry(role: str, camera: RigCamera, rate: float) -> dict[str, Any]:
    lens = camera.lens
    return _entry(
        role, "Camera", f"/camera/{role}/image_raw", rate=rate, mounting=camera.pose, stamp="Sample"
    ) | {
        "camera": {
            "width": lens.width,
            "height": lens.height,
            "encoding": "rgb8" if role == "color" else "mono8",
            "model": "Pinhole",
            "fx": float(lens.matrix[0, 0]),
            "fy": float(lens.matrix[1, 1]),
            "cx": float(lens.matrix[0, 2]),
            "cy": float(lens.matrix[1, 2]),
            "distortion": "RadialTangential",
            "coefficients": lens.coefficients.tolist(),
        }
    }
