# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording in a foreign layout: what each importer finds, and the streams of its sensors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import cv2

from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import numpy as np
    import numpy.typing as npt

    from slamhive.data.rosmessages import BagWriter
    from slamhive.model.base import Scalar
    from slamhive.model.dataset import GroundTruth
    from slamhive.model.sensors import Camera, Sensor
    from slamhive_eval import Trajectory

    Array = npt.NDArray[np.float64]
    Stamps = npt.NDArray[np.int64]
    Pixels = npt.NDArray[Any]

_ENCODINGS = {("uint8", 2): "mono8", ("uint16", 2): "mono16", ("uint8", 3): "bgr8", ("uint16", 3): "bgr16"}


@dataclass(frozen=True, eq=False)
class Stream:
    """The messages of one sensor.

    Attributes:
        name: Of the sensor in the dataset: a role, if it fills one.
        sensor: The sensor as the manifest has it, with topic, frame, pose and calibration.
        stamps: Header stamps, ns, ascending, shape (n,).
        write: Writes message k into a bag; raises DataError where its file is missing or damaged.
    """

    name: str
    sensor: Sensor
    stamps: Stamps
    write: Callable[[BagWriter, int], None]

    @property
    def frame(self) -> str:
        """Return the name of the sensor's frame."""
        return self.sensor.frame_id or self.name


@dataclass(frozen=True, eq=False)
class Truth:
    """The ground truth of a recording: poses, or a file to be kept as it is.

    Attributes:
        manifest: What the manifest says of it; its file is the one that is written.
        source: The poses, or the file to copy.
    """

    manifest: GroundTruth
    source: Trajectory | Path


@dataclass(frozen=True, eq=False)
class Contents:
    """What is found in a folder or file in a foreign layout.

    Attributes:
        description: A sentence for the manifest.
        streams: The sensors, in the order of the manifest.
        truth: Ground truth, if there is any.
        body: Name of the body frame, in which the poses of the sensors are.
        gravity_aligned: Whether the ground truth's z axis points up.
        attributes: To select and plot by.
        notes: Sentences for the user: what was assumed, what was left out.
    """

    description: str
    streams: list[Stream]
    truth: Truth | None = None
    body: str = "body"
    gravity_aligned: bool = False
    attributes: dict[str, Scalar] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def read_pixels(path: Path) -> Pixels:
    """Return the pixels of an image file as they are, (height, width[, channels]), blue first.

    Raises:
        DataError: It is missing, or no image.
    """
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        known = "can't be decoded as an image" if path.is_file() else "does not exist"
        raise DataError(f"{path}: {known}")
    return pixels


def encoding_of(pixels: Pixels) -> str:
    """Return the encoding of an image's pixels, as sensor_msgs/Image has it."""
    return _ENCODINGS.get((pixels.dtype.name, pixels.ndim), "mono8")


def camera_stream(name: str, sensor: Sensor, stamps: Stamps, files: list[Path], source: Path) -> Stream:
    """Return a camera's stream of image files.

    Args:
        name: Of the sensor.
        sensor: With its `camera` block.
        stamps: ns, shape (n,).
        files: The image of each, n.
        source: The file that states the calibration, for messages.
    """
    known = sensor.camera
    if known is None:
        raise ValueError(f"{name}: a camera without intrinsics")
    frame = sensor.frame_id or name

    def write(bag: BagWriter, k: int) -> None:
        pixels = read_pixels(files[k])
        _require_fit(pixels, known, files[k], source)
        stamp = int(stamps[k])
        bag.camera_info(f"/{frame}/camera_info", stamp, frame, known)
        bag.image(sensor.topic, stamp, frame, known.encoding, pixels)

    return Stream(name, sensor, stamps, write)


def imu_stream(name: str, sensor: Sensor, stamps: Stamps, rates: Array, forces: Array) -> Stream:
    """Return an IMU's stream.

    Args:
        name: Of the sensor.
        sensor: With its `imu` block.
        stamps: ns, shape (n,).
        rates: Angular velocity, rad/s, shape (n, 3).
        forces: Specific force, m/s², shape (n, 3).
    """
    frame = sensor.frame_id or name
    return Stream(
        name,
        sensor,
        stamps,
        lambda bag, k: bag.imu(sensor.topic, int(stamps[k]), frame, rates[k], forces[k]),
    )


def cloud_stream(
    name: str, sensor: Sensor, stamps: Stamps, load: Callable[[int], npt.NDArray[np.void]]
) -> Stream:
    """Return a LiDAR's stream.

    Args:
        name: Of the sensor.
        sensor: With its `lidar` block.
        stamps: ns, shape (n,).
        load: Returns the points of message k, of a structured type with x, y, z in m, shape (m,).
    """
    frame = sensor.frame_id or name
    return Stream(
        name, sensor, stamps, lambda bag, k: bag.points(sensor.topic, int(stamps[k]), frame, load(k))
    )


def _require_fit(pixels: Pixels, known: Camera, path: Path, source: Path) -> None:
    if pixels.shape[:2] != (known.height, known.width) or encoding_of(pixels) != known.encoding:
        raise DataError(
            f"{path}: {pixels.shape[1]}×{pixels.shape[0]} {encoding_of(pixels)}, but {source} and the first "
            f"image say {known.width}×{known.height} {known.encoding}"
        )
