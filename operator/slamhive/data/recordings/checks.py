# SPDX-License-Identifier: Apache-2.0
"""Checks of a stream of messages. Each raises one sentence that says why the stream can't be used."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.recordings import kinds, samples
from slamhive.data.recordings.samples import SensorLook
from slamhive.model.errors import DataError, suggestion

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy.typing as npt

    from slamhive.data.recordings.reading import Recording, Scan
    from slamhive.model.sensors import Sensor

_DAY = 86_400 * 10**9
_SCANS = 5
"""Scans of a LiDAR that tell of its number of points."""
_FEW_SAMPLES = 100


@dataclass(frozen=True)
class StampFault:
    """A fault that no sensor's stamps can have.

    Attributes:
        kind: ``none`` (no messages), ``zero``, ``back`` or ``far``.
        text: A sentence.
        numbers: Messages that have it, from 0, shape (n,).
        seconds: How far the stamps leap at most, s.
    """

    kind: str
    text: str
    numbers: npt.NDArray[np.intp]
    seconds: float = 0.0


def stamp_fault(stamps: npt.NDArray[np.int64]) -> StampFault | None:
    """Return the fault of a sensor's stamps; None where they can be those of a sensor.

    Args:
        stamps: Of all messages, in the order of the recording, ns.
    """
    count = len(stamps)
    zero = np.flatnonzero(stamps <= 0)
    if not count:
        return StampFault("none", "no messages", zero)
    if zero.size:
        which = "all stamps are" if zero.size == count else f"the stamp of message {zero[0] + 1} is"
        what = f"{which} {stamps[zero[0]] / 1e9:g} s; the driver did not stamp the messages"
        return StampFault("zero", what, zero)
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0)
    if back.size:
        # Stamps that had gone on would be a step later.
        k, by = int(back[0]), float((np.median(steps) - steps.min()) / 1e9)
        many = f"{back.size} times in all, by {by:.3g} s at most" if back.size > 1 else f"back by {by:.3g} s"
        what = (
            f"stamps must not decrease, but message {k + 2} of {count} is stamped "
            f"{seconds_text(stamps[k + 1])}, after {seconds_text(stamps[k])} ({many})"
        )
        return StampFault("back", what, back + 1, by)
    far = np.flatnonzero(steps > _DAY)
    if far.size:
        k = int(far[0])
        what = (
            f"message {k + 2} of {count} is stamped {seconds_text(stamps[k + 1])}, "
            f"{steps[k] / _DAY:.0f} days after the one before it"
        )
        return StampFault("far", what, far + 1, float(steps[k] / 1e9))
    return None


def check_stamps(scan: Scan, where: str) -> None:
    """Check that a sensor's stamps can be those of a sensor.

    Args:
        scan: Times of its messages.
        where: What they are, for the message.

    Raises:
        DataError: A stamp is zero, goes back, or is more than a day from the one before it.
    """
    fault = stamp_fault(scan.stamps)
    if fault is not None:
        helps = "" if fault.kind == "none" else "; slamhive dataset check says which repair helps"
        raise DataError(f"{where}: {fault.text}{helps}")


def seconds_text(nanoseconds: int) -> str:
    """Write a stamp in s with every digit of its ns."""
    whole, rest = divmod(int(nanoseconds), 10**9)
    return f"{whole}.{rest:09d} s"


def check_content(recording: Recording, sensors: Mapping[str, Sensor]) -> list[str]:
    """Check that the first images and scans are what the dataset says of them.

    Args:
        recording: The recording.
        sensors: The sensors by name; their topics exist.

    Returns:
        What is suspicious, a sentence each.

    Raises:
        DataError: They aren't.
    """
    errors: list[str] = []
    warnings: list[str] = []
    quick = {name: sensor for name, sensor in sensors.items() if sensor.type.has_frames}
    content_findings(recording, quick, errors, warnings)
    if errors:
        raise DataError(errors[0])
    return warnings


def content_findings(
    recording: Recording, sensors: Mapping[str, Sensor], errors: list[str], warnings: list[str]
) -> dict[str, str]:
    """Compare the first messages of sensors with what the dataset says of them.

    Args:
        recording: The recording.
        sensors: The sensors by name; their topics exist.
        errors: Takes what can't be.
        warnings: Takes what is suspicious.

    Returns:
        What the first message of each is like, in words.
    """
    described = {}
    for name, sensor in sensors.items():
        look = SensorLook(recording, sensor, f"sensors.{name}", errors, warnings)
        try:
            described[name] = _CONTENTS[look.message_type](look)
        except DataError as error:
            errors.append(str(error))
    return described


def _image(look: SensorLook) -> str:
    sensor, where, errors = look.sensor, look.where, look.errors
    message = look.first()
    camera = sensor.camera
    if camera is not None and (message.width, message.height) != (camera.width, camera.height):
        errors.append(
            f"{where}.camera: states {camera.width}×{camera.height} pixels, but the images on "
            f"{sensor.topic} have "
            f"{message.width}×{message.height}"
        )
    return f"{message.width}×{message.height} {message.encoding}"


def _compressed(look: SensorLook) -> str:
    # With OpenCV: for those who look into recordings alone.
    from slamhive.data.recordings.images import compressed_pixels, is_compressed_depth  # noqa: PLC0415

    sensor, message = look.sensor, look.first()
    try:
        pixels = compressed_pixels(message, f"{look.where}: {sensor.topic} in {look.recording.label}")
    except DataError:
        if is_compressed_depth(message):
            raise
        # Other transports are the algorithm's own business at full resolution.
        return f"compressed as {message.format!r}"
    height, width = pixels.shape[:2]
    camera = sensor.camera
    if camera is not None and (width, height) != (camera.width, camera.height):
        look.errors.append(
            f"{look.where}.camera: states {camera.width}×{camera.height} pixels, but the images on "
            f"{sensor.topic} have {width}×{height}"
        )
    return f"{width}×{height} {message.format}"


def _cloud(look: SensorLook) -> str:
    sensor, where, errors = look.sensor, look.where, look.errors
    message = look.first()
    names = [item.name for item in message.fields]
    lidar = sensor.lidar
    wanted = {"timeField": lidar.time_field, "ringField": lidar.ring_field} if lidar else {}
    errors += [
        f"{where}.lidar.{key}: points on {sensor.topic} have no field {value!r}{suggestion(value, names)}"
        for key, value in wanted.items()
        if value is not None and value not in names
    ]
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        errors.append(
            f"{where}: points on {sensor.topic} have no field {missing[0]!r}{suggestion('', names)}"
        )
    # The first scan of a recording may be half a one.
    widths = [one.width for one in look.recording.some(sensor.topic, _SCANS) if one.height == message.height]
    width = sorted(widths)[len(widths) // 2]
    size = f"{width}×{message.height}" if message.height > 1 else f"{width}"
    return f"{size} points with {', '.join(names)}"


def _imu(look: SensorLook) -> str:
    messages = islice(look.messages(), _FEW_SAMPLES)
    forces = [(one.x, one.y, one.z) for one in (message.linear_acceleration for message in messages)]
    return f"{np.median(np.linalg.norm(forces, axis=1)):.2f} m/s² at the beginning"


_CONTENTS: dict[str, Callable[[SensorLook], str]] = {
    kinds.IMAGE: _image,
    kinds.COMPRESSED_IMAGE: _compressed,
    kinds.POINT_CLOUD: _cloud,
    kinds.IMU: _imu,
    kinds.LASER_SCAN: samples.scans,
    kinds.ODOMETRY: samples.odometry,
    kinds.TWIST: samples.odometry,
    kinds.TWIST_WITH_COVARIANCE: samples.odometry,
    kinds.GNSS_FIX: samples.fixes,
    kinds.MAGNETIC_FIELD: samples.fields,
    kinds.FLUID_PRESSURE: samples.pressures,
}
"""Descriptions of messages in words, by their type."""
