# SPDX-License-Identifier: Apache-2.0
"""Plausibility of what scanners, wheels, GNSS receivers, magnetometers and barometers say, in all messages.

Units are the usual fault: drivers write degrees for radians, gauss for teslas, hectopascals for pascals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.recordings.kinds import ODOMETRY
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy.typing as npt

    from slamhive.data.recordings.reading import Recording
    from slamhive.model.sensors import Sensor

    Array = npt.NDArray[np.float64]

_TURN = 2.0 * np.pi
_FAST, _SPINNING = 60.0, 10.0
"""Speeds that no robot's wheels have, m/s and rad/s."""
_SAME_PATH = 1.25
_EARTH_RADIUS = 6_371_000.0
_HEIGHTS = (-500.0, 10_000.0)
_FIELD = (15e-6, 100e-6)
"""Strength of a magnetic field near the ground, 22 to 67 µT, with what a platform adds to it, T."""
_PRESSURE = (30_000.0, 110_000.0)
"""Pressure of air from 9 km above the sea to 700 m below it, Pa."""
_FIELD_UNITS = {"gauss": 1e-4, "milligauss": 1e-7, "microteslas": 1e-6, "nanoteslas": 1e-9}
_PRESSURE_UNITS = {"hectopascals (millibars)": 1e2, "kilopascals": 1e3, "atmospheres": 101_325.0}


@dataclass(frozen=True)
class SensorLook:
    """A look at the messages of one sensor.

    Attributes:
        recording: What they are in.
        sensor: The sensor as it is declared.
        where: Its field, for sentences.
        errors: Takes what can't be.
        warnings: Takes what is suspicious.
    """

    recording: Recording
    sensor: Sensor
    where: str
    errors: list[str]
    warnings: list[str]

    @property
    def message_type(self) -> str:
        """Return the type of the messages."""
        return self.recording.topics[self.sensor.topic].message_type

    def messages(self) -> Iterator[Any]:
        """Yield all messages.

        Raises:
            DataError: The recording is damaged.
        """
        for connection, _, raw in self.recording.messages({self.sensor.topic}):
            yield self.recording.decode(raw, connection.msgtype)

    def first(self) -> Any:
        """Return the first message.

        Raises:
            DataError: There is none.
        """
        return self.recording.first(self.sensor.topic)

    def table(self, row: Callable[[Any], list[float]]) -> Array:
        """Return a row of numbers for each message; its stamp in s comes first."""
        rows = [(_stamp(message), *row(message)) for message in self.messages()]
        if not rows:
            raise DataError(f"{self.sensor.topic} in {self.recording.label}: no messages")
        return np.array(rows, dtype=np.float64)

    def warn(self, sentence: str) -> None:
        """Note what is suspicious."""
        self.warnings.append(f"{self.where}: {sentence}")

    def refuse(self, sentence: str) -> None:
        """Note what can't be."""
        self.errors.append(f"{self.where}: {sentence}")

    def all_finite(self, values: Array, what: str) -> bool:
        """Refuse numbers that are none; tell whether all are."""
        wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if wrong.size:
            self.refuse(
                f"message {wrong[0] + 1} of {len(values)} on {self.sensor.topic} has {what} that is not a "
                f"finite number ({wrong.size} in all)"
            )
        return not wrong.size

    def variances(self, diagonals: Array, what: str) -> str:
        """Warn of variances that can't be; return in words what they say of a typical message.

        Args:
            diagonals: Variances of each message, shape (n, m).
            what: Field that they are in.
        """
        if not diagonals.size:
            return ""
        wrong = np.flatnonzero(~np.isfinite(diagonals).all(axis=1) | (diagonals < 0).any(axis=1))
        if wrong.size:
            self.warn(
                f"{what} has variances below zero or no numbers in {wrong.size} of {len(diagonals)} "
                f"messages, first in message {wrong[0] + 1}"
            )
            return ""
        return "" if diagonals.any() else f"{what} is 0: not known"


def scans(look: SensorLook) -> str:
    """Look at planar scans."""
    first, rays, changed, returns, metres = None, 0, 0, 0, []
    for message in look.messages():
        first = first or message
        changed += _geometry(message) != _geometry(first)
        found = message.ranges[(message.ranges >= message.range_min) & (message.ranges <= message.range_max)]
        rays, returns = rays + len(message.ranges), returns + len(found)
        if found.size:
            metres.append(float(np.median(found)))
    if first is None:
        raise DataError(f"{look.sensor.topic} in {look.recording.label}: no messages")
    _scan_geometry(look, first)
    if changed:
        look.warn(
            f"{changed} scans on {look.sensor.topic} have other angles or numbers of rays than the first"
        )
    share = returns / rays if rays else 0.0
    if share < 0.05:
        look.warn(f"only {share:.1%} of the rays on {look.sensor.topic} are within rangeMin and rangeMax")
    if metres and np.median(metres) > 200.0:
        look.warn(
            f"ranges are {np.median(metres):.0f} m typically: they look like millimetres or centimetres"
        )
    sides = f"{np.degrees(first.angle_min):.4g}° to {np.degrees(first.angle_max):.4g}°"
    limits = f"{first.range_min:g} to {first.range_max:g} m"
    return f"{len(first.ranges)} rays, {sides}, {limits}, {share:.0%} with return"


def _geometry(message: Any) -> tuple[float, ...]:
    return (len(message.ranges), message.angle_min, message.angle_max, message.angle_increment)


def _scan_geometry(look: SensorLook, message: Any) -> None:
    angles = np.array([message.angle_min, message.angle_max, message.angle_increment])
    if not np.isfinite(angles).all() or len(message.ranges) < 2 or message.angle_increment == 0:
        look.refuse(f"scans on {look.sensor.topic} have no rays or no angles")
        return
    if abs(message.angle_max - message.angle_min) > 1.01 * _TURN:
        look.warn(
            f"angles are {message.angle_min:g} to {message.angle_max:g}, more than a turn in radians: they "
            "look like degrees"
        )
        return
    # Drivers leave out one step of a whole turn, or count it.
    last = message.angle_min + (len(message.ranges) - 1) * message.angle_increment
    if abs(last - message.angle_max) > 1.5 * abs(message.angle_increment):
        look.warn(
            f"{len(message.ranges)} rays every {np.degrees(message.angle_increment):.3g}° end at "
            f"{np.degrees(last):.1f}°, but angle_max says {np.degrees(message.angle_max):.1f}°"
        )


def odometry(look: SensorLook) -> str:
    """Look at wheel odometry: speeds, and poses where it has some."""
    with_poses = look.message_type == ODOMETRY
    table = look.table(_pose_and_speeds if with_poses else _speeds)
    stamps, values = table[:, 0], table[:, 1:14]
    if not look.all_finite(values, "a pose or speed" if with_poses else "a speed"):
        return ""
    speed, turning = np.linalg.norm(values[:, 7:10], axis=1), np.abs(values[:, 12])
    if speed.max() > _FAST:
        look.warn(f"speeds reach {speed.max():.3g} m/s; are they m/s?")
    if turning.max() > _SPINNING:
        look.warn(f"speeds of turning reach {turning.max():.3g} rad/s: they look like degrees per second")
    text = [f"up to {speed.max():.2f} m/s"]
    if with_poses:
        text = [_paths(look, stamps, values, speed), *text]
    text.append(look.variances(table[:, 14:], "twist.covariance" if table.shape[1] > 14 else ""))
    return ", ".join(part for part in text if part)


def _paths(look: SensorLook, stamps: Array, values: Array, speed: Array) -> str:
    """Compare the path by the poses with the one by the speeds; return the former in words."""
    norms = np.linalg.norm(values[:, 3:7], axis=1)
    if (np.abs(norms - 1.0) > 0.05).any():
        look.warn(f"orientations are no unit quaternions (norm {norms[np.argmax(np.abs(norms - 1.0))]:.3g})")
    steps = np.linalg.norm(np.diff(values[:, :3], axis=0), axis=1)
    by_poses = float(steps.sum())
    by_speeds = float((np.diff(stamps) * 0.5 * (speed[1:] + speed[:-1])).sum())
    if by_poses > 1.0 and not speed.any():
        look.warn(f"poses move by {by_poses:.1f} m, but all speeds are 0: twist isn't filled in")
    elif max(by_poses, by_speeds) > 1.0 and not (
        by_poses <= _SAME_PATH * by_speeds and by_speeds <= _SAME_PATH * by_poses
    ):
        look.warn(f"the path is {by_poses:.1f} m by the poses and {by_speeds:.1f} m by the speeds")
    return f"path {by_poses:.1f} m"


def _pose_and_speeds(message: Any) -> list[float]:
    place, turned = message.pose.pose.position, message.pose.pose.orientation
    pose = [place.x, place.y, place.z, turned.x, turned.y, turned.z, turned.w]
    return pose + _speeds(message)[7:]


def _speeds(message: Any) -> list[float]:
    inner = message.twist
    twist = getattr(inner, "twist", inner)
    covariance = getattr(inner, "covariance", None)
    variances = [] if covariance is None else np.reshape(covariance, (6, 6)).diagonal().tolist()
    speeds = [getattr(part, axis) for part in (twist.linear, twist.angular) for axis in "xyz"]
    return [0.0] * 7 + speeds + variances


def fixes(look: SensorLook) -> str:
    """Look at fixes of a GNSS receiver."""
    table = look.table(
        lambda fix: [
            fix.latitude,
            fix.longitude,
            fix.altitude,
            fix.status.status,
            fix.position_covariance_type,
            *np.reshape(fix.position_covariance, (3, 3)).diagonal().tolist(),
        ]
    )
    lost = (table[:, 4] < 0) | ~np.isfinite(table[:, 1:3]).all(axis=1)
    if lost.all():
        return "no fix"
    found = table[~lost]
    latitude, longitude = found[:, 1], found[:, 2]
    outside = np.flatnonzero((np.abs(latitude) > 90.0) | (np.abs(longitude) > 180.0))
    if outside.size:
        k = outside[0]
        look.refuse(
            f"latitude {latitude[k]:g}, longitude {longitude[k]:g}: allowed are -90 to 90 and -180 to 180 "
            f"degrees ({outside.size} of {len(found)} fixes)"
        )
        return ""
    if not (latitude.any() or longitude.any()):
        look.warn("latitude and longitude are 0 throughout: the receiver was never told where it is")
    _heights(look, found[:, 3])
    north = _EARTH_RADIUS * np.radians(latitude - latitude[0])
    east = _EARTH_RADIUS * np.radians(longitude - longitude[0]) * np.cos(np.radians(latitude[0]))
    known = found[:, 5] > 0
    doubt = look.variances(found[known][:, 6:], "position_covariance") if known.any() else ""
    spread = float(np.hypot(north, east).max())
    side, other = "SN"[int(latitude[0] >= 0)], "WE"[int(longitude[0] >= 0)]
    where = f"{abs(latitude[0]):.4f}° {side}, {abs(longitude[0]):.4f}° {other}"
    accuracy = f"±{np.sqrt(np.median(found[known][:, 6])):.2g} m" if known.any() and not doubt else doubt
    return ", ".join(part for part in (where, accuracy, f"at most {spread:.0f} m from the first") if part)


def _heights(look: SensorLook, heights: Array) -> None:
    finite = heights[np.isfinite(heights)]
    if finite.size and not (_HEIGHTS[0] < float(np.median(finite)) < _HEIGHTS[1]):
        look.warn(
            f"the altitude is {np.median(finite):.0f} m typically, about {_HEIGHTS[0]:.0f} to "
            f"{_HEIGHTS[1]:.0f} m is expected: it looks like millimetres"
        )


def fields(look: SensorLook) -> str:
    """Look at magnetic fields."""
    table = look.table(
        lambda message: [
            message.magnetic_field.x,
            message.magnetic_field.y,
            message.magnetic_field.z,
            *np.reshape(message.magnetic_field_covariance, (3, 3)).diagonal().tolist(),
        ]
    )
    if not look.all_finite(table[:, 1:4], "a field"):
        return ""
    strengths = np.linalg.norm(table[:, 1:4], axis=1)
    typical = float(np.median(strengths))
    if not _FIELD[0] < typical < _FIELD[1]:
        look.warn(
            f"the magnetic field is {typical:.3g} T typically, 2.2e-05 to 6.7e-05 T is expected"
            + _unit(typical, _FIELD, _FIELD_UNITS)
        )
    elif np.ptp(np.percentile(strengths, [5, 95])) > 0.5 * typical:
        low, high = np.percentile(strengths, [5, 95]) * 1e6
        look.warn(
            f"the magnetic field's strength is {low:.0f} to {high:.0f} µT: hard and soft iron aren't "
            "calibrated, or there is iron about"
        )
    # The first variance is -1 where a driver says that it doesn't know (REP 145).
    known = table[:, 4] >= 0
    doubt = look.variances(table[known][:, 4:], "magnetic_field_covariance") if known.any() else ""
    return ", ".join(part for part in (f"{typical * 1e6:.1f} µT typically", doubt) if part)


def pressures(look: SensorLook) -> str:
    """Look at pressures of air."""
    table = look.table(lambda message: [message.fluid_pressure, message.variance])
    if not look.all_finite(table[:, 1:2], "a pressure"):
        return ""
    typical = float(np.median(table[:, 1]))
    if not _PRESSURE[0] < typical < _PRESSURE[1]:
        look.warn(
            f"the pressure is {typical:.5g} Pa typically, {_PRESSURE[0]:.0f} to {_PRESSURE[1]:.0f} Pa is "
            "expected in air" + _unit(typical, _PRESSURE, _PRESSURE_UNITS)
        )
    doubt = look.variances(table[:, 2:], "variance")
    return ", ".join(part for part in (f"{typical:.0f} Pa typically", doubt) if part)


def _unit(found: float, expected: tuple[float, float], units: dict[str, float]) -> str:
    """Say in which unit a number would be as expected."""
    fitting = [name for name, size in units.items() if expected[0] < found * size < expected[1]]
    return f"; it looks like {fitting[0]}" if fitting else ""


def _stamp(message: Any) -> float:
    stamp = message.header.stamp
    return float(stamp.sec) + float(stamp.nanosec) / 1e9
