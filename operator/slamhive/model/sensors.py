# SPDX-License-Identifier: Apache-2.0
"""Sensors: the modes that algorithms ask for, the roles in them, and the calibration of each device."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from slamhive.model.base import Choice, Model, optional

Matrix4 = list[list[float]]


class SensorMode(Choice):
    """The combination of sensors that an algorithm works on."""

    MONO = "mono"
    MONO_INERTIAL = "mono-inertial"
    STEREO = "stereo"
    STEREO_INERTIAL = "stereo-inertial"
    RGBD = "rgbd"
    RGBD_INERTIAL = "rgbd-inertial"
    LIDAR = "lidar"
    LIDAR_INERTIAL = "lidar-inertial"
    SCAN = "scan"
    SCAN_INERTIAL = "scan-inertial"
    SCAN_ODOMETRY = "scan-odometry"
    SCAN_ODOMETRY_INERTIAL = "scan-odometry-inertial"
    CLOUD = "cloud"
    ODOMETRY = "odometry"
    ODOMETRY_INERTIAL = "odometry-inertial"
    GNSS = "gnss"
    GNSS_INERTIAL = "gnss-inertial"
    INERTIAL = "inertial"

    @property
    def has_scale(self) -> bool:
        """Tell whether the mode observes metric scale."""
        return self is not SensorMode.MONO

    @property
    def has_cameras(self) -> bool:
        """Tell whether the mode takes images."""
        return any(ROLE_TYPES[role] is SensorType.CAMERA for role in ROLES[self])


class Role(Choice):
    """Roles of sensors in an algorithm's sensor modes, such as left camera, LiDAR or IMU."""

    CAMERA = "camera"
    LEFT = "left"
    RIGHT = "right"
    COLOR = "color"
    DEPTH = "depth"
    LIDAR = "lidar"
    IMU = "imu"
    SCAN = "scan"
    CLOUD = "cloud"
    ODOMETRY = "odometry"
    GNSS = "gnss"
    MAGNETOMETER = "magnetometer"
    BAROMETER = "barometer"
    # Further ones of a kind.
    CAMERA2 = "camera2"
    CAMERA3 = "camera3"
    CAMERA4 = "camera4"
    LIDAR2 = "lidar2"
    LIDAR3 = "lidar3"
    LIDAR4 = "lidar4"
    IMU2 = "imu2"
    IMU3 = "imu3"
    IMU4 = "imu4"
    SCAN2 = "scan2"
    SCAN3 = "scan3"
    SCAN4 = "scan4"
    CLOUD2 = "cloud2"
    CLOUD3 = "cloud3"
    CLOUD4 = "cloud4"
    ODOMETRY2 = "odometry2"
    ODOMETRY3 = "odometry3"
    ODOMETRY4 = "odometry4"
    GNSS2 = "gnss2"
    GNSS3 = "gnss3"
    GNSS4 = "gnss4"
    MAGNETOMETER2 = "magnetometer2"
    MAGNETOMETER3 = "magnetometer3"
    MAGNETOMETER4 = "magnetometer4"
    BAROMETER2 = "barometer2"
    BAROMETER3 = "barometer3"
    BAROMETER4 = "barometer4"


FrameOwner = Literal[
    "body",
    "camera",
    "left",
    "right",
    "color",
    "depth",
    "lidar",
    "imu",
    "scan",
    "cloud",
    "odometry",
    "gnss",
    "magnetometer",
    "barometer",
]
"""Owner of the pose that an algorithm writes: the body's, or that of the sensor of a role."""

ROLES: dict[SensorMode, tuple[Role, ...]] = {
    SensorMode.MONO: (Role.CAMERA,),
    SensorMode.MONO_INERTIAL: (Role.CAMERA, Role.IMU),
    SensorMode.STEREO: (Role.LEFT, Role.RIGHT),
    SensorMode.STEREO_INERTIAL: (Role.LEFT, Role.RIGHT, Role.IMU),
    SensorMode.RGBD: (Role.COLOR, Role.DEPTH),
    SensorMode.RGBD_INERTIAL: (Role.COLOR, Role.DEPTH, Role.IMU),
    SensorMode.LIDAR: (Role.LIDAR,),
    SensorMode.LIDAR_INERTIAL: (Role.LIDAR, Role.IMU),
    SensorMode.SCAN: (Role.SCAN,),
    SensorMode.SCAN_INERTIAL: (Role.SCAN, Role.IMU),
    SensorMode.SCAN_ODOMETRY: (Role.SCAN, Role.ODOMETRY),
    SensorMode.SCAN_ODOMETRY_INERTIAL: (Role.SCAN, Role.ODOMETRY, Role.IMU),
    SensorMode.CLOUD: (Role.CLOUD,),
    SensorMode.ODOMETRY: (Role.ODOMETRY,),
    SensorMode.ODOMETRY_INERTIAL: (Role.ODOMETRY, Role.IMU),
    SensorMode.GNSS: (Role.GNSS,),
    SensorMode.GNSS_INERTIAL: (Role.GNSS, Role.IMU),
    SensorMode.INERTIAL: (Role.IMU,),
}
"""The roles that each mode needs."""

STAND_INS: dict[Role, tuple[Role, ...]] = {
    Role.CAMERA: (Role.CAMERA, Role.LEFT, Role.COLOR),
    Role.LEFT: (Role.LEFT, Role.CAMERA),
}
"""Sensors that may fill a role when a dataset has none of the role's own name, in this order."""


FOLLOWS: dict[Role, Role] = {Role.RIGHT: Role.LEFT, Role.DEPTH: Role.COLOR}
"""Roles whose frames are kept together with those of another."""

SAME_RATE = 1.02
"""A rate within 2 % of the recorded one is the recorded one: drivers are that far off."""


class SensorType(Choice):
    """Kinds of devices that a dataset's sensors can be."""

    CAMERA = "Camera"
    DEPTH_CAMERA = "DepthCamera"
    LIDAR = "Lidar"
    IMU = "Imu"
    LASER_SCAN = "LaserScan"
    POINT_CLOUD = "PointCloud"
    ODOMETRY = "Odometry"
    GNSS = "Gnss"
    MAGNETOMETER = "Magnetometer"
    BAROMETER = "Barometer"

    @property
    def has_frames(self) -> bool:
        """Tell whether its messages are frames, which a frame rate thins, and not samples."""
        return self in _FRAMED

    @property
    def block(self) -> str | None:
        """Return the field of a sensor that holds its calibration; None where messages say all of it."""
        return _BLOCKS.get(self)


_FRAMED = {
    SensorType.CAMERA,
    SensorType.DEPTH_CAMERA,
    SensorType.LIDAR,
    SensorType.LASER_SCAN,
    SensorType.POINT_CLOUD,
}
_BLOCKS = {
    SensorType.CAMERA: "camera",
    SensorType.DEPTH_CAMERA: "camera",
    SensorType.LIDAR: "lidar",
    SensorType.IMU: "imu",
}

_FIRST: dict[Role, SensorType] = {
    Role.CAMERA: SensorType.CAMERA,
    Role.LIDAR: SensorType.LIDAR,
    Role.IMU: SensorType.IMU,
    Role.SCAN: SensorType.LASER_SCAN,
    Role.CLOUD: SensorType.POINT_CLOUD,
    Role.ODOMETRY: SensorType.ODOMETRY,
    Role.GNSS: SensorType.GNSS,
    Role.MAGNETOMETER: SensorType.MAGNETOMETER,
    Role.BAROMETER: SensorType.BAROMETER,
}
"""Roles of which there may be several, and the kind of device that each takes."""

OF_A_KIND: dict[Role, tuple[Role, ...]] = {
    first: (first, *(Role(f"{first}{number}") for number in (2, 3, 4))) for first in _FIRST
}
"""Roles of several sensors of a kind, by the first of them."""

ROLE_TYPES: dict[Role, SensorType] = {
    Role.LEFT: SensorType.CAMERA,
    Role.RIGHT: SensorType.CAMERA,
    Role.COLOR: SensorType.CAMERA,
    Role.DEPTH: SensorType.DEPTH_CAMERA,
} | {role: _FIRST[first] for first, roles in OF_A_KIND.items() for role in roles}
"""The kind of device that each role takes."""


class Stamp(Choice):
    """The instant that a message's header stamp means."""

    SAMPLE = "Sample"
    SCAN_START = "ScanStart"
    SCAN_MID = "ScanMid"
    SCAN_END = "ScanEnd"

    @property
    def share(self) -> float | None:
        """Return the share of a scan that lies before it; None where it is no instant of a scan."""
        return {Stamp.SCAN_START: 0.0, Stamp.SCAN_MID: 0.5, Stamp.SCAN_END: 1.0}.get(self)


class TimesSince(Choice):
    """The instant that the times of a scan's points count from."""

    HEADER = "Header"
    SCAN_START = "ScanStart"
    SCAN_END = "ScanEnd"


class Camera(Model):
    """Intrinsics of a camera, in pixels of the image as recorded."""

    width: int = Field(gt=0, le=32768, description="Width in pixels.")
    height: int = Field(gt=0, le=32768, description="Height in pixels.")
    encoding: str = Field(default="mono8", description="Pixel encoding, as in sensor_msgs/Image.")
    model: Literal["Pinhole", "Mei"] = Field(default="Pinhole", description="Projection model.")
    fx: float = Field(gt=0, description="Focal length along x in pixels.")
    fy: float = Field(gt=0, description="Focal length along y in pixels.")
    cx: float = Field(description="Principal point x in pixels; the centre of the first pixel is 0.")
    cy: float = Field(description="Principal point y in pixels; the centre of the first pixel is 0.")
    xi: float | None = Field(default=None, description="Mirror parameter of the Mei model.")
    distortion: Literal["None", "RadialTangential", "Equidistant"] = Field(
        default="None", description="Distortion model."
    )
    coefficients: list[float] = Field(
        default_factory=list,
        max_length=8,
        description="Distortion coefficients: k1 k2 p1 p2 k3, or k1 to k4 of the equidistant model.",
    )
    depth_scale: float | None = Field(
        default=None, gt=0, description="Units of a depth image per metre, such as 1000 or 5000."
    )


class Lidar(Model):
    """Properties of a LiDAR: rings, columns, valid range, and names of its point fields."""

    rings: int | None = Field(default=None, gt=0, le=1024, description="Number of rings.")
    columns: int | None = Field(default=None, gt=0, le=65536, description="Firings per turn.")
    min_range: float = Field(default=0.0, ge=0, description="Shortest valid range in m.")
    max_range: float = Field(default=1000.0, gt=0, description="Longest valid range in m.")
    time_field: str | None = Field(
        default=None, description="Point field with the time since the header stamp, or absolute."
    )
    times_since: TimesSince | None = optional(
        "What relative times of points count from, where it isn't the header stamp."
    )
    ring_field: str | None = Field(default=None, description="Point field with the ring's number.")


class Imu(Model):
    """Noise of an IMU as continuous-time densities, in SI units."""

    accelerometer_noise: float = Field(default=0.01, ge=0, description="m/s²/√Hz.")
    gyroscope_noise: float = Field(default=0.001, ge=0, description="rad/s/√Hz.")
    accelerometer_random_walk: float = Field(default=1e-4, ge=0, description="m/s³/√Hz.")
    gyroscope_random_walk: float = Field(default=1e-5, ge=0, description="rad/s²/√Hz.")
    gravity: float = Field(default=9.81, gt=0, description="m/s².")


Extrinsics = Annotated[
    list[Annotated[list[float], Field(min_length=4, max_length=4)]],
    Field(
        min_length=4,
        max_length=4,
        description="Pose of the sensor in the body frame as a 4×4 matrix by rows: p_body = T p_sensor.",
    ),
]


def _identity() -> Matrix4:
    return [[float(row == column) for column in range(4)] for row in range(4)]


class Sensor(Model):
    """One device of a recording."""

    type: SensorType = Field(description="Kind of device.")
    topic: str = Field(min_length=1, description="Topic in the recording.")
    frame_id: str | None = Field(default=None, description="Name of the sensor's frame.")
    rate: float | None = Field(default=None, gt=0, description="Messages per second.")
    stamp: Stamp = Field(default=Stamp.SAMPLE, description="The instant that the header stamp means.")
    time_offset: float = Field(
        default=0.0, description="Seconds to add to the header stamp to get the sensor's time."
    )
    T_body_sensor: Extrinsics = Field(default_factory=_identity, alias="T_body_sensor")
    camera: Camera | None = Field(default=None, description="Intrinsics, for cameras.")
    lidar: Lidar | None = Field(default=None, description="Properties, for LiDARs.")
    imu: Imu | None = Field(default=None, description="Noise, for IMUs.")

    @model_validator(mode="after")
    def _fits_type(self) -> Sensor:
        for block in sorted(set(_BLOCKS.values())):
            if block != self.type.block and getattr(self, block) is not None:
                raise ValueError(f"a sensor of type {self.type} takes no block {block!r}")
        bottom = self.T_body_sensor[3]
        if bottom != [0, 0, 0, 1]:
            raise ValueError(f"T_body_sensor: the last row must be 0 0 0 1, not {bottom}")
        since = self.lidar.times_since if self.lidar else None
        if since not in {None, TimesSince.HEADER} and self.stamp is Stamp.SAMPLE:
            raise ValueError(
                f"lidar.timesSince: {since} needs to know what the header stamp means: give stamp as "
                "ScanStart, ScanMid or ScanEnd"
            )
        return self
