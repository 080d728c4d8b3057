# SPDX-License-Identifier: Apache-2.0
"""Checks of a stream of messages. Each raises one sentence that says why the stream can't be used."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.recordings import kinds, samples
from slamhive.data.recordings.clouds import cloud_points, point_times
from slamhive.data.recordings.samples import SensorLook
from slamhive.model.errors import DataError, suggestion
from slamhive.model.sensors import TimesSince

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy.typing as npt

    from slamhive.data.recordings.reading import Recording, Scan
    from slamhive.model.sensors import Lidar, Sensor

_DAY = 86_400 * 10**9
SAME_INSTANT = 0.3
"""Share of a scan by which its points' times may lie elsewhere than they are said to."""
LEAST_SCAN_SECONDS = 1e-3
"""Seconds below which points are all of one instant."""


def check_stamps(scan: Scan, where: str) -> None:
    """Check that a sensor's stamps can be those of a sensor.

    Args:
        scan: Times of its messages.
        where: What they are, for the message.

    Raises:
        DataError: A stamp is zero, goes back, or is more than a day from the one before it.
    """
    stamps = scan.stamps
    if not len(stamps):
        raise DataError(f"{where}: no messages")
    wrong = np.flatnonzero(stamps <= 0)
    if wrong.size:
        which = "all stamps are" if wrong.size == len(stamps) else f"the stamp of message {wrong[0] + 1} is"
        raise DataError(
            f"{where}: {which} {stamps[wrong[0]] / 1e9:g} s; the driver did not stamp the messages"
        )
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0)
    if back.size:
        k = int(back[0])
        raise DataError(
            f"{where}: stamps must not decrease, but message {k + 2} of {len(stamps)} is stamped "
            f"{seconds_text(stamps[k + 1])}, after {seconds_text(stamps[k])}"
            + (f" ({back.size} times in all)" if back.size > 1 else "")
        )
    jump = np.flatnonzero(steps > _DAY)
    if jump.size:
        k = int(jump[0])
        raise DataError(
            f"{where}: message {k + 2} of {len(stamps)} is stamped {seconds_text(stamps[k + 1])}, "
            f"{steps[k] / _DAY:.0f} days after the one before it"
        )


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
    if not missing and lidar is not None and lidar.time_field in names:
        _check_times(look, cloud_points(message, where), lidar)
    size = f"{message.width}×{message.height}" if message.height > 1 else f"{message.width}"
    return f"{size} points with {', '.join(names)}"


def _check_times(look: SensorLook, points: npt.NDArray[np.void], lidar: Lidar) -> None:
    """Warn where the times of a scan's points lie elsewhere than its stamp, as declared, lets them."""
    header = look.first().header.stamp
    found = point_times(points, str(lidar.time_field), header.sec * 10**9 + header.nanosec)
    if found is None or look.sensor.stamp.share is None:
        return
    times, is_absolute = found
    low, high = float(times.min()), float(times.max())
    since = TimesSince.HEADER if is_absolute else lidar.times_since or TimesSince.HEADER
    zero = look.sensor.stamp.share if since is TimesSince.HEADER else float(since is TimesSince.SCAN_END)
    if high - low > LEAST_SCAN_SECONDS and abs(-low / (high - low) - zero) > SAME_INSTANT:
        look.warnings.append(
            f"{look.where}: the times of points run from {low:.3g} to {high:.3g} s"
            f"{' after the header stamp' if since is TimesSince.HEADER else ''}, but stamp is "
            f"{look.sensor.stamp} and lidar.timesSince is {since}: correct the one that is wrong"
        )


_IMU_NUMBERS = 37
"""float64 at the end of a sensor_msgs/Imu: orientation, rate and force, each with its covariance."""
_STANDARD_GRAVITY = 9.80665


def _imu(look: SensorLook) -> str:
    sensor, where, errors, warnings = look.sensor, look.where, look.errors, look.warnings
    tails = [raw[-8 * _IMU_NUMBERS :] for _, _, raw in look.recording.messages({sensor.topic})]
    table = np.frombuffer(b"".join(tails), dtype="<f8").reshape(-1, _IMU_NUMBERS)
    rate, force = table[:, 13:16], table[:, 25:28]
    wrong = np.flatnonzero(~np.isfinite(np.hstack([rate, force])).all(axis=1))
    if wrong.size:
        errors.append(
            f"{where}: message {wrong[0] + 1} of {len(table)} on {sensor.topic} has a rate or force that "
            f"is not a "
            f"finite number ({wrong.size} in all)"
        )
        return ""
    typical = float(np.median(np.linalg.norm(force, axis=1)))
    if not 0.8 < typical / _STANDARD_GRAVITY < 1.25:
        hint = "; it looks like units of g" if 0.8 < typical < 1.25 else ""
        warnings.append(
            f"{where}: the specific force is {typical:.3g} m/s² typically, about 9.8 is expected{hint}"
        )
    return f"{typical:.2f} m/s² typically"


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
