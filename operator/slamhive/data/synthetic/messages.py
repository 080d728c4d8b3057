# SPDX-License-Identifier: Apache-2.0
"""ROS 1 messages of what the sensors measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slamhive.data.recordings.kinds import (
    CAMERA_INFO,
    FLUID_PRESSURE,
    GNSS_FIX,
    IMAGE,
    IMU,
    LASER_SCAN,
    MAGNETIC_FIELD,
    ODOMETRY,
    POINT_CLOUD,
)
from slamhive.data.synthetic.aiding import (
    FIELD_NOISE,
    GNSS_NOISE,
    PRESSURE_NOISE,
    SCAN_LIMITS,
    SPEED_NOISE,
    TURN_NOISE,
)
from slamhive.data.synthetic.rig import BODY_FRAME
from slamhive.data.synthetic.trajectory import quaternion_from_rotation

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt
    from rosbags.typesys.store import Typestore

    from slamhive.data.synthetic.rig import RigCamera

    Array = npt.NDArray[np.float64]

TF = "tf2_msgs/msg/TFMessage"

_DATATYPES = {"<f4": 7, "<u2": 4}


def typestore() -> Typestore:
    """Open the message types of ROS Noetic, with tf2's."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    return store


class MessageMaker:
    """Builds messages; sequence numbers count by frame, as a driver's do."""

    def __init__(self, store: Typestore) -> None:
        self._types: dict[str, Any] = store.types
        self._sequence: dict[str, int] = {}

    def points(self, stamp: int, frame: str, points: npt.NDArray[np.void]) -> Any:
        """Build a PointCloud2 of points of any structured type of f4 and u2 fields."""
        field = self._types["sensor_msgs/msg/PointField"]
        layout: Mapping[str, Any] = points.dtype.fields or {}
        return self._types[POINT_CLOUD](
            header=self._header(stamp, frame, "points"),
            height=1,
            width=len(points),
            fields=[field(name, int(at[1]), _DATATYPES[at[0].str], 1) for name, at in layout.items()],
            is_bigendian=False,
            point_step=points.dtype.itemsize,
            row_step=points.dtype.itemsize * len(points),
            data=points.view(np.uint8).reshape(-1),
            is_dense=True,
        )

    def imu(
        self, stamp: int, frame: str, force: npt.NDArray[np.float64], rate: npt.NDArray[np.float64]
    ) -> Any:
        """Build an Imu message without orientation, which its covariance of -1 says."""
        vector, quaternion = (
            self._types["geometry_msgs/msg/Vector3"],
            self._types["geometry_msgs/msg/Quaternion"],
        )
        return self._types[IMU](
            header=self._header(stamp, frame, "imu"),
            orientation=quaternion(0.0, 0.0, 0.0, 1.0),
            orientation_covariance=np.array([-1.0] + [0.0] * 8),
            angular_velocity=vector(*rate.tolist()),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(*force.tolist()),
            linear_acceleration_covariance=np.zeros(9),
        )

    def image(self, stamp: int, frame: str, role: str, encoding: str, pixels: npt.NDArray[Any]) -> Any:
        """Build an Image from pixels `(height, width[, channels])`."""
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
        return self._types[IMAGE](
            header=self._header(stamp, frame, role),
            height=len(pixels),
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=rows.shape[1],
            data=rows.reshape(-1),
        )

    def camera_info(self, stamp: int, frame: str, role: str, camera: RigCamera) -> Any:
        """Build the CameraInfo of an image."""
        roi = self._types["sensor_msgs/msg/RegionOfInterest"]
        return self._types[CAMERA_INFO](
            header=self._header(stamp, frame, f"{role}/info"),
            height=camera.lens.height,
            width=camera.lens.width,
            distortion_model="plumb_bob",
            D=camera.lens.coefficients,
            K=camera.lens.matrix.reshape(-1),
            R=camera.rectification.reshape(-1),
            P=camera.projection.reshape(-1),
            binning_x=0,
            binning_y=0,
            roi=roi(0, 0, 0, 0, False),
        )

    def transforms(self, stamp: int, poses: dict[str, npt.NDArray[np.float64]]) -> Any:
        """Build the static transforms from the body to each frame, from poses `(4, 4)` by frame."""
        types = self._types
        transform, stamped = types["geometry_msgs/msg/Transform"], types["geometry_msgs/msg/TransformStamped"]
        vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
        return types[TF](
            transforms=[
                stamped(
                    header=self._header(stamp, BODY_FRAME, "tf"),
                    child_frame_id=frame,
                    transform=transform(
                        translation=vector(*pose[:3, 3].tolist()),
                        rotation=quaternion(*quaternion_from_rotation(pose[None, :3, :3])[0].tolist()),
                    ),
                )
                for frame, pose in poses.items()
            ]
        )

    def laser_scan(self, stamp: int, frame: str, ranges: Array, period: float) -> Any:
        """Build a LaserScan from ranges `(n,)` in m of a whole turn from -180 degrees, in so many s."""
        count = len(ranges)
        return self._types[LASER_SCAN](
            header=self._header(stamp, frame, "scan"),
            angle_min=-np.pi,
            angle_max=np.pi - 2.0 * np.pi / count,
            angle_increment=2.0 * np.pi / count,
            time_increment=period / count,
            scan_time=period,
            range_min=SCAN_LIMITS[0],
            range_max=SCAN_LIMITS[1],
            ranges=ranges.astype(np.float32),
            intensities=np.zeros(0, dtype=np.float32),
        )

    def odometry(self, stamp: int, frame: str, measured: Array) -> Any:
        """Build an Odometry from speeds (forward, left, turning) and a pose (x, y, heading), `(6,)`."""
        types = self._types
        vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
        ahead, aside, turning, x, y, heading = measured.tolist()
        turned = quaternion(0.0, 0.0, float(np.sin(0.5 * heading)), float(np.cos(0.5 * heading)))
        variances = np.zeros(36)
        variances[[0, 7, 35]] = np.square([SPEED_NOISE, SPEED_NOISE, TURN_NOISE])
        return types[ODOMETRY](
            header=self._header(stamp, "odom", "odometry"),
            child_frame_id=frame,
            pose=types["geometry_msgs/msg/PoseWithCovariance"](
                types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](x, y, 0.0), turned),
                np.zeros(36),
            ),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](
                types["geometry_msgs/msg/Twist"](vector(ahead, aside, 0.0), vector(0.0, 0.0, turning)),
                variances,
            ),
        )

    def fix(self, stamp: int, frame: str, fix: Array) -> Any:
        """Build a NavSatFix from latitude, longitude (degrees) and height (m), with its known variances."""
        status = self._types["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
        return self._types[GNSS_FIX](
            header=self._header(stamp, frame, "gnss"),
            status=status,
            latitude=float(fix[0]),
            longitude=float(fix[1]),
            altitude=float(fix[2]),
            position_covariance=np.diag(np.square(GNSS_NOISE)).reshape(-1),
            position_covariance_type=2,
        )

    def field(self, stamp: int, frame: str, field: Array) -> Any:
        """Build a MagneticField from `(3,)` in T."""
        return self._types[MAGNETIC_FIELD](
            header=self._header(stamp, frame, "magnetometer"),
            magnetic_field=self._types["geometry_msgs/msg/Vector3"](*field.tolist()),
            magnetic_field_covariance=np.diag([FIELD_NOISE**2] * 3).reshape(-1),
        )

    def pressure(self, stamp: int, frame: str, pascals: float) -> Any:
        """Build a FluidPressure."""
        return self._types[FLUID_PRESSURE](
            header=self._header(stamp, frame, "barometer"),
            fluid_pressure=float(pascals),
            variance=PRESSURE_NOISE**2,
        )

    def _header(self, stamp: int, frame: str, counter: str) -> Any:
        sequence = self._sequence.get(counter, 0)
        self._sequence[counter] = sequence + 1
        time = self._types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        return self._types["std_msgs/msg/Header"](seq=sequence, stamp=time, frame_id=frame)
