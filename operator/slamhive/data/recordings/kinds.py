# SPDX-License-Identifier: Apache-2.0
"""Kinds of sensors: the messages that each has, and what it is called where a recording is looked into.

What else depends on the kind: whether its messages are frames (`SensorType.has_frames`), the calibration that
it takes (`SensorType.block`), the roles that it fills (`ROLE_TYPES`), and what is looked at in its messages
(`contents`), which goes by their type.
"""

from __future__ import annotations

from dataclasses import dataclass

from slamhive.model.sensors import Role, SensorType

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
IMU = "sensor_msgs/msg/Imu"
LASER_SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TWIST = "geometry_msgs/msg/TwistStamped"
TWIST_WITH_COVARIANCE = "geometry_msgs/msg/TwistWithCovarianceStamped"
GNSS_FIX = "sensor_msgs/msg/NavSatFix"
MAGNETIC_FIELD = "sensor_msgs/msg/MagneticField"
FLUID_PRESSURE = "sensor_msgs/msg/FluidPressure"


@dataclass(frozen=True)
class SensorKind:
    """Properties of a kind of sensor: its title, the types of its messages, and its default role.

    Attributes:
        title: What people call it.
        messages: Types of its messages.
        role: Role that the first one in a recording is named after; None where that takes a look at several
            topics together, as cameras do.
    """

    title: str
    messages: tuple[str, ...]
    role: Role | None = None


KINDS: dict[SensorType, SensorKind] = {
    SensorType.CAMERA: SensorKind("camera", (IMAGE, COMPRESSED_IMAGE)),
    SensorType.DEPTH_CAMERA: SensorKind("depth camera", (IMAGE, COMPRESSED_IMAGE)),
    SensorType.LIDAR: SensorKind("LiDAR", (POINT_CLOUD,), Role.LIDAR),
    SensorType.POINT_CLOUD: SensorKind("point clouds of a depth camera", (POINT_CLOUD,), Role.CLOUD),
    SensorType.LASER_SCAN: SensorKind("planar laser scanner", (LASER_SCAN,), Role.SCAN),
    SensorType.IMU: SensorKind("IMU", (IMU,), Role.IMU),
    SensorType.ODOMETRY: SensorKind(
        "wheel odometry", (ODOMETRY, TWIST, TWIST_WITH_COVARIANCE), Role.ODOMETRY
    ),
    SensorType.GNSS: SensorKind("GNSS receiver", (GNSS_FIX,), Role.GNSS),
    SensorType.MAGNETOMETER: SensorKind("magnetometer", (MAGNETIC_FIELD,), Role.MAGNETOMETER),
    SensorType.BAROMETER: SensorKind("barometer", (FLUID_PRESSURE,), Role.BAROMETER),
}
"""All kinds of sensors."""
