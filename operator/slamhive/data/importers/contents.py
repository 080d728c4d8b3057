# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording in a foreign layout: what each importer finds, and the streams of its sensors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from slamhive.data.recordings.thinning import rate_of
from slamhive.model.errors import DataError
from slamhive.model.sensors import SensorType

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.recordings.rosmessages import BagWriter
    from slamhive.model.base import Scalar
    from slamhive.model.dataset import GroundTruth
    from slamhive.model.sensors import Camera, Sensor
    from slamhive_eval import Trajectory

    Array = npt.NDArray[np.float64]
    Stamps = npt.NDArray[np.int64]
    Pixels = npt.NDArray[Any]

_ENCODINGS = {("uint8", 2): "mono8", ("uint16", 2): "mono16", ("uint8", 3): "bgr8", ("uint16", 3): "bgr16"}


@dataclass(frozen=True, eq=False)
class SensorStream:
    """The messages of one sensor.

    Attributes:
        name: Of the sensor in the dataset: a role, if it fills one.
        sensor: The sensor as the manifest has it, with topic, frame, pose and calibration.
        stamps: Header stamps, ns, ascending, shape (n,).
        write: Writes message k into a bag; raises DataError where its file is missing or damaged.
        load: Reads message k and returns what writes it, to be called ahead on a thread of its own; None
            where there is nothing to be read.
    """

    name: str
    sensor: Sensor
    stamps: Stamps
    write: Callable[[BagWriter, int], None]
    load: Callable[[int], Callable[[BagWriter], None]] | None = None

    @property
    def frame(self) -> str:
        """Return the name of the sensor's frame."""
        return self.sensor.frame_id or self.name


@dataclass(frozen=True, eq=False)
class ImportedTruth:
    """The ground truth of a recording: poses, or a file to be kept as it is.

    Attributes:
        manifest: What the manifest says of it; its file is the one that is written.
        source: The poses, or the file to copy.
    """

    manifest: GroundTruth
    source: Trajectory | Path


@dataclass(frozen=True, eq=False)
class Contents:
    """Contents of a folder or file in a foreign layout, as an importer reads them.

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
    streams: list[SensorStream]
    truth: ImportedTruth | None = None
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


def camera_pixels(path: Path) -> Pixels:
    """Return a camera's image in 8 bits, (height, width[, 3]), blue first.

    Of 16 bits the upper 8 are taken, as OpenCV does for programs that read such files: few programs take
    more. Transparency is left out.

    Raises:
        DataError: It is missing, or no image.
    """
    pixels = read_pixels(path)
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    return pixels[..., :3] if pixels.ndim == 3 and pixels.shape[2] == 4 else pixels


def depth_pixels(path: Path) -> Pixels:
    """Return a depth image, whole units of 16 bits, (height, width).

    Raises:
        DataError: It is missing, no image, or not of one channel of 16 bits.
    """
    pixels = read_pixels(path)
    if pixels.ndim != 2 or pixels.dtype != np.uint16:
        raise DataError(
            f"{path}: a depth image must have one channel of 16 bits, not {encoding_of(pixels)}; a picture "
            "of depths can't be measured in"
        )
    return pixels


def encoding_of(pixels: Pixels) -> str:
    """Return the encoding of an image's pixels, as sensor_msgs/Image has it."""
    return _ENCODINGS.get((pixels.dtype.name, pixels.ndim), "mono8")


def camera_encoding(first: Path, what: str, notes: list[str]) -> str:
    """Return the encoding that a camera's images have in the dataset, by the first of them.

    Args:
        first: The image.
        what: Whose images they are, for the note that 16 bits become 8.
        notes: To which that is added.

    Raises:
        DataError: It is missing, or no image.
    """
    if read_pixels(first).dtype == np.uint16:
        notes.append(f"{what}: images of 16 bits become images of 8, by the upper 8 bits")
    return encoding_of(camera_pixels(first))


def measured_rate(stamps: Stamps) -> float | None:
    """Return the rate of messages by their stamps, Hz; None of fewer than two."""
    rate = rate_of(stamps)
    return round(rate, 3) if rate else None


def depth_encoding(pixels: Pixels) -> str:
    """Return the encoding of a depth image: whole units of 16 bits, or float32."""
    return {"uint16": "16UC1", "float32": "32FC1"}[pixels.dtype.name]


def loaded_stream(
    name: str, sensor: Sensor, stamps: Stamps, load: Callable[[int], Callable[[BagWriter], None]]
) -> SensorStream:
    """Return a stream whose messages are read from files.

    Args:
        name: Of the sensor.
        sensor: As the manifest has it.
        stamps: ns, shape (n,).
        load: Reads message k, on any thread, and returns what writes it.
    """
    return SensorStream(name, sensor, stamps, lambda bag, k: load(k)(bag), load)


def camera_stream(
    name: str,
    sensor: Sensor,
    stamps: Stamps,
    files: list[Path],
    source: Path | str,
    *,
    read_depth: Callable[[Path], Pixels] | None = None,
) -> SensorStream:
    """Return the stream of image files of a camera, in 8 bits, or of a depth camera.

    Args:
        name: Of the sensor.
        sensor: With its `camera` block.
        stamps: ns, shape (n,).
        files: The image of each, n.
        source: What states the calibration, for messages.
        read_depth: Reads a depth image, uint16 or float32, (height, width); None: as `depth_pixels`.
    """
    known = sensor.camera
    if known is None:
        raise ValueError(f"{name}: a camera without intrinsics")
    frame = sensor.frame_id or name
    is_depth = sensor.type is SensorType.DEPTH_CAMERA

    def load(k: int) -> Callable[[BagWriter], None]:
        pixels = (read_depth or depth_pixels)(files[k]) if is_depth else camera_pixels(files[k])
        encoding = depth_encoding(pixels) if is_depth else encoding_of(pixels)
        _require_fit(pixels, encoding, known, files[k], source)
        stamp = int(stamps[k])

        def write(bag: BagWriter) -> None:
            bag.camera_info(f"/{frame}/camera_info", stamp, frame, known)
            bag.image(sensor.topic, stamp, frame, encoding, pixels)

        return write

    return loaded_stream(name, sensor, stamps, load)


def imu_stream(name: str, sensor: Sensor, stamps: Stamps, rates: Array, forces: Array) -> SensorStream:
    """Return an IMU's stream.

    Args:
        name: Of the sensor.
        sensor: With its `imu` block.
        stamps: ns, shape (n,).
        rates: Angular velocity, rad/s, shape (n, 3).
        forces: Specific force, m/s², shape (n, 3).
    """
    frame = sensor.frame_id or name
    return SensorStream(
        name, sensor, stamps, lambda bag, k: bag.imu(sensor.topic, int(stamps[k]), frame, rates[k], forces[k])
    )


def cloud_stream(
    name: str, sensor: Sensor, stamps: Stamps, load: Callable[[int], npt.NDArray[np.void]]
) -> SensorStream:
    """Return a LiDAR's stream.

    Args:
        name: Of the sensor.
        sensor: With its `lidar` block.
        stamps: ns, shape (n,).
        load: Returns the points of message k, of a structured type with x, y, z in m, shape (m,).
    """
    frame = sensor.frame_id or name

    def read(k: int) -> Callable[[BagWriter], None]:
        points = load(k)
        return lambda bag: bag.points(sensor.topic, int(stamps[k]), frame, points)

    return loaded_stream(name, sensor, stamps, read)


def _require_fit(pixels: Pixels, encoding: str, known: Camera, path: Path, source: Path | str) -> None:
    if pixels.shape[:2] != (known.height, known.width) or encoding != known.encoding:
        raise DataError(
            f"{path}: {pixels.shape[1]}×{pixels.shape[0]} {encoding}, but {source} and the first "
            f"image say {known.width}×{known.height} {known.encoding}"
        )
