# SPDX-License-Identifier: Apache-2.0
"""ROS 1 messages that importers write."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slamhive.data.recordings.kinds import CAMERA_INFO, IMAGE, IMU, ODOMETRY, POINT_CLOUD
from slamhive.data.recordings.reading import TF_TYPES
from slamhive_eval.rotation import from_matrix

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import numpy.typing as npt
    from rosbags.interfaces import Connection

    from slamhive.model.sensors import Camera

    Array = npt.NDArray[np.float64]

TRANSFORMS = TF_TYPES[0]
_DATATYPES = {"u1": 2, "u2": 4, "u4": 6, "f4": 7, "f8": 8}


class BagWriter:
    """Writes a ROS 1 bag of messages made from arrays; record times are the header stamps.

    Args:
        path: The bag to make.
    """

    def __init__(self, path: Path) -> None:
        self._store = get_typestore(Stores.ROS1_NOETIC)
        self._store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS))
        self._types: dict[str, Any] = self._store.types
        self._writer = Writer(path)
        self._connections: dict[str, Connection] = {}
        self._sequence: dict[str, int] = {}

    def __enter__(self) -> Self:
        self._writer.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._writer.close()
        else:
            self._writer.abort()

    def image(self, topic: str, stamp: int, frame: str, encoding: str, pixels: npt.NDArray[Any]) -> None:
        """Write an Image.

        Args:
            topic: Where to.
            stamp: ns.
            frame: Frame of the camera.
            encoding: Of the pixels.
            pixels: (height, width[, channels]).
        """
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
        message = self._types[IMAGE](
            header=self._header(topic, stamp, frame),
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=rows.shape[1],
            data=rows.reshape(-1),
        )
        self._write(topic, IMAGE, stamp, message)

    def camera_info(self, topic: str, stamp: int, frame: str, camera: Camera) -> None:
        """Write the CameraInfo of an unrectified camera."""
        k = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
        models = {"None": "plumb_bob", "RadialTangential": "plumb_bob", "Equidistant": "equidistant"}
        message = self._types[CAMERA_INFO](
            header=self._header(topic, stamp, frame),
            height=camera.height,
            width=camera.width,
            distortion_model=models[camera.distortion],
            D=np.array(camera.coefficients, dtype=np.float64),
            K=k.reshape(-1),
            R=np.eye(3).reshape(-1),
            P=np.hstack([k, np.zeros((3, 1))]).reshape(-1),
            binning_x=0,
            binning_y=0,
            roi=self._types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, do_rectify=False),
        )
        self._write(topic, CAMERA_INFO, stamp, message)

    def imu(self, topic: str, stamp: int, frame: str, rate: Array, force: Array) -> None:
        """Write an Imu without orientation: rate (3,) in rad/s, specific force (3,) in m/s²."""
        vector = self._types["geometry_msgs/msg/Vector3"]
        message = self._types[IMU](
            header=self._header(topic, stamp, frame),
            orientation=self._types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            orientation_covariance=np.array([-1.0] + [0.0] * 8),
            angular_velocity=vector(*rate.tolist()),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(*force.tolist()),
            linear_acceleration_covariance=np.zeros(9),
        )
        self._write(topic, IMU, stamp, message)

    def points(self, topic: str, stamp: int, frame: str, points: npt.NDArray[np.void]) -> None:
        """Write a PointCloud2 of points of a structured type, shape (n,)."""
        field = self._types["sensor_msgs/msg/PointField"]
        layout: Mapping[str, Any] = points.dtype.fields or {}
        message = self._types[POINT_CLOUD](
            header=self._header(topic, stamp, frame),
            height=1,
            width=len(points),
            fields=[
                field(name, int(at[1]), _DATATYPES[at[0].str.lstrip("<|")], 1) for name, at in layout.items()
            ],
            is_bigendian=False,
            point_step=points.dtype.itemsize,
            row_step=points.dtype.itemsize * len(points),
            data=points.view(np.uint8).reshape(-1),
            is_dense=True,
        )
        self._write(topic, POINT_CLOUD, stamp, message)

    def planar_odometry(self, topic: str, stamp: int, pose: Array, velocity: Array) -> None:
        """Write an Odometry of base_link in odom: pose (x, y, heading), velocity (forward, turning)."""
        types = self._types
        vector = types["geometry_msgs/msg/Vector3"]
        x, y, heading = pose.tolist()
        half = 0.5 * heading
        orientation = types["geometry_msgs/msg/Quaternion"](
            0.0, 0.0, float(np.sin(half)), float(np.cos(half))
        )
        pose_message = types["geometry_msgs/msg/Pose"](
            types["geometry_msgs/msg/Point"](x, y, 0.0), orientation
        )
        twist = types["geometry_msgs/msg/Twist"](
            vector(float(velocity[0]), 0.0, 0.0), vector(0.0, 0.0, float(velocity[1]))
        )
        message = types[ODOMETRY](
            header=self._header(topic, stamp, "odom"),
            child_frame_id="base_link",
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose_message, np.zeros(36)),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
        )
        self._write(topic, ODOMETRY, stamp, message)

    def static_transforms(self, stamp: int, parent: str, poses: dict[str, Array]) -> None:
        """Write /tf_static: poses (4, 4) of frames in a parent frame."""
        types = self._types
        vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
        transforms = [
            types["geometry_msgs/msg/TransformStamped"](
                header=self._header("/tf_static", stamp, parent),
                child_frame_id=frame,
                transform=types["geometry_msgs/msg/Transform"](
                    vector(*pose[:3, 3].tolist()), quaternion(*from_matrix(pose[None, :3, :3])[0].tolist())
                ),
            )
            for frame, pose in poses.items()
        ]
        self._write("/tf_static", TRANSFORMS, stamp, types[TRANSFORMS](transforms=transforms))

    def _header(self, topic: str, stamp: int, frame: str) -> Any:
        number = self._sequence.get(topic, 0)
        self._sequence[topic] = number + 1
        time = self._types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        return self._types["std_msgs/msg/Header"](seq=number, stamp=time, frame_id=frame)

    def _write(self, topic: str, kind: str, stamp: int, message: Any) -> None:
        if topic not in self._connections:
            latching = int(topic == "/tf_static")
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store, latching=latching
            )
        self._writer.write(self._connections[topic], stamp, self._store.serialize_ros1(message, kind))
