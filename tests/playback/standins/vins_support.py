# SPDX-License-Identifier: Apache-2.0
"""Support that the stand-ins of both VINS share: cameras, frames that wait for the IMU, poses."""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING

import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image, Imu
from standin import EXPECTED, SENSORS, Storage, agree, quaternion_of, refuse

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import numpy as np

PAIR_SECONDS = 0.003


def scaled(role: str) -> dict[str, float]:
    """Return a camera's size, focal lengths and centre after the run's resolution."""
    camera, asked = SENSORS[role]["camera"], EXPECTED["resolution"]
    width, height = round(camera["width"] * asked), round(camera["height"] * asked)
    x, y = width / camera["width"], height / camera["height"]
    return {
        "width": width,
        "height": height,
        "fx": camera["fx"] * x,
        "fy": camera["fy"] * y,
        "cx": (camera["cx"] + 0.5) * x - 0.5,
        "cy": (camera["cy"] + 0.5) * y - 0.5,
    }


def check_camera(file: Storage, role: str) -> None:
    """Compare a camera's block with the calibration, as camodocal's factory reads it."""
    camera, size = SENSORS[role]["camera"], scaled(role)
    model = file.text("model_type")
    file.text("camera_name")
    agree("image_width", file.integer("image_width"), size["width"])
    agree("image_height", file.integer("image_height"), size["height"])
    k = [*camera["coefficients"], *[0.0] * 8]
    if camera["distortion"] == "Equidistant":
        agree("model_type", model, "KANNALA_BRANDT")
        wanted = dict(zip(("k2", "k3", "k4", "k5"), k, strict=False))
        wanted |= {"mu": size["fx"], "mv": size["fy"], "u0": size["cx"], "v0": size["cy"]}
        names = {"projection_parameters": wanted}
    else:
        if any(k[4:]):
            refuse(f"no model of camodocal has the distortion of {role}")
        lens = dict(zip(("k1", "k2", "p1", "p2"), k, strict=False))
        if camera["model"] == "Mei":
            agree("model_type", model, "MEI")
            agree("mirror_parameters.xi", file.real("mirror_parameters.xi"), camera["xi"])
            view = {"gamma1": size["fx"], "gamma2": size["fy"], "u0": size["cx"], "v0": size["cy"]}
        else:
            agree("model_type", model, "PINHOLE")
            view = {name: size[name] for name in ("fx", "fy", "cx", "cy")}
        names = {"distortion_parameters": lens, "projection_parameters": view}
    for block, values in names.items():
        for name, value in values.items():
            agree(f"{role}: {block}.{name}", file.real(f"{block}.{name}"), value)


def check_numbers(file: Storage, reals: tuple[str, ...], integers: tuple[str, ...]) -> None:
    """Read what each VINS reads of numbers, and compare what the run's parameters ask for."""
    wanted = EXPECTED["settings"]
    for key in integers:
        agree(key, file.integer(key), wanted.get(key, file.integer(key)))
    for key in reals:
        agree(key, file.real(key), wanted.get(key, file.real(key)))
    unknown = set(wanted) - set(reals) - set(integers)
    if unknown:
        refuse(f"nothing reads {', '.join(sorted(unknown))}")


class Frames:
    """Images, or pairs of them, that wait until the IMU has gone beyond them.

    Args:
        topics: of the images; two are a pair when their stamps are within 3 ms.
        imu: topic of the IMU, None without one.
        take: called with the stamp of each.
        kind: what the topics carry; images are compared with the settings.
    """

    def __init__(
        self, topics: list[str], imu: str | None, take: Callable[[rospy.Time], None], kind: type = Image
    ) -> None:
        self._lock = threading.Lock()
        self._images: list[deque[rospy.Time]] = [deque() for _ in topics]
        self._last = None if imu is not None else float("inf")
        self._take = take
        for index, topic in enumerate(topics):
            rospy.Subscriber(topic, kind, self._image, index, queue_size=100, buff_size=1 << 24)
        if imu is not None:
            rospy.Subscriber(imu, Imu, self._imu, queue_size=2000)

    def _image(self, image: Image, index: int) -> None:
        size = scaled(EXPECTED["cameras"][index])
        if isinstance(image, Image) and (image.width, image.height, image.encoding) != (
            size["width"],
            size["height"],
            "mono8",
        ):
            rospy.logfatal("an image of %d x %d, %s", image.width, image.height, image.encoding)
            rospy.signal_shutdown("another image than the settings say")
            return
        with self._lock:
            self._images[index].append(image.header.stamp)
            self._go_on()

    def _imu(self, sample: Imu) -> None:
        with self._lock:
            self._last = sample.header.stamp.to_sec()
            self._go_on()

    def _go_on(self) -> None:
        while all(self._images):
            stamps = [queue[0].to_sec() for queue in self._images]
            late = max(stamps)
            if late - min(stamps) > PAIR_SECONDS:
                for queue, stamp in zip(self._images, stamps, strict=True):
                    if stamp < late - PAIR_SECONDS:
                        queue.popleft()
            elif self._last is not None and self._last >= late:
                taken = [queue.popleft() for queue in self._images]
                self._take(taken[0])
            else:
                return


def odometry(stamp: rospy.Time, pose: np.ndarray) -> Odometry:
    """Return a pose as both publish it: its stamp has been through a double."""
    message = Odometry()
    message.header.stamp = rospy.Time.from_sec(stamp.to_sec())
    message.header.frame_id = message.child_frame_id = "world"
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    place.x, place.y, place.z = pose[:3, 3]
    turn.x, turn.y, turn.z, turn.w = quaternion_of(pose[:3, :3])
    return message


def append_row(path: Path, message: Odometry) -> None:
    """Append a pose to a CSV of theirs: ns, x y z, qw qx qy qz, velocity, and a comma more."""
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    row = [f"{message.header.stamp.to_sec() * 1e9:.0f}"]
    row += [f"{value:.5f}" for value in (place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z, 0, 0, 0)]
    with path.open("a") as file:
        file.write(",".join(row) + ",\n")
