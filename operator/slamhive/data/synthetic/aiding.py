# SPDX-License-Identifier: Apache-2.0
"""Measurements of what robots have beside cameras, LiDARs and IMUs: wheels, GNSS, magnetometer, barometer.

Each sensor is at its own place on the platform. Noise is white, at noise 1 that of cheap devices.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.synthetic import rig
from slamhive.data.synthetic.streams import stream
from slamhive.model.synthetic import FIXED_RATES, SyntheticSensor

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive.data.synthetic.trajectory import SyntheticMotion
    from slamhive.data.synthetic.world import World
    from slamhive.model.synthetic import SyntheticRecording

    Array = npt.NDArray[np.float64]

SCAN_RATE = FIXED_RATES[SyntheticSensor.LASER_SCAN]
SCAN_RAYS = 720
"""Rays of a planar scan, a whole turn."""
SCAN_LIMITS = (0.2, 30.0)
"""Shortest and longest range of a planar scan, m."""
_RANGE_NOISE = 0.01

SPEED_NOISE, TURN_NOISE = 0.02, 0.01
"""Standard deviations of wheel odometry's speeds at noise 1, m/s and rad/s."""

ORIGIN = (49.0, 8.4, 110.0)
"""Latitude and longitude in degrees and height above the ellipsoid in m of the world's origin."""
GNSS_NOISE = (0.3, 0.3, 0.6)
"""Standard deviations of a fix to the east, the north and up at noise 1, m."""
_EQUATOR, _ECCENTRICITY2 = 6_378_137.0, 6.694379990141e-3  # WGS 84

FIELD = (0.9e-6, 20.9e-6, -43.5e-6)
"""The Earth's magnetic field to the east, the north and up, T."""
FIELD_NOISE = 0.3e-6
"""Standard deviation of each axis at noise 1, T."""

PRESSURE_NOISE = 3.0
"""Standard deviation at noise 1, Pa."""


def scan(
    spec: SyntheticRecording, world: World, trajectory: SyntheticMotion, start: float, index: int
) -> Array:
    """Take one planar scan, each ray at its own time and pose.

    Args:
        spec: The recording.
        world: What is measured.
        trajectory: The motion.
        start: When the first ray is taken, s since the start of the recording.
        index: Number of the scan, for its noise.

    Returns:
        Ranges of the rays from -180 degrees counterclockwise, m, shape (SCAN_RAYS,); infinite without return.
    """
    bearing = scan_bearings()
    times = start + np.arange(SCAN_RAYS) / (SCAN_RAYS * SCAN_RATE)
    motion = trajectory.at(times)
    mounting = rig.MOUNTINGS["scan"]
    local = np.stack([np.cos(bearing), np.sin(bearing), np.zeros(SCAN_RAYS)], axis=1)
    directions = np.einsum("nij,nj->in", motion.rotation @ mounting[:3, :3], local)
    origins = (motion.position + motion.rotation @ mounting[:3, 3]).T
    distance, _ = world.cast(origins.astype(np.float32), directions.astype(np.float32), times)
    noise = stream(spec.seed, "scan", index).standard_normal(SCAN_RAYS) * (_RANGE_NOISE * spec.noise)
    measured = distance + noise
    inside = (measured >= SCAN_LIMITS[0]) & (measured <= SCAN_LIMITS[1])
    return np.where(inside, measured, np.inf)


def scan_bearings() -> Array:
    """Give the directions of a scan's rays, rad, shape (SCAN_RAYS,)."""
    return -np.pi + 2.0 * np.pi * np.arange(SCAN_RAYS) / SCAN_RAYS


def wheels(spec: SyntheticRecording, trajectory: SyntheticMotion, t: Array) -> Array:
    """Measure the speeds of wheels that also roll sideways, and add them up to poses in a plane.

    Args:
        spec: The recording.
        trajectory: The motion.
        t: Evenly spaced, s since the start of the recording, shape (n,).

    Returns:
        Speeds forward and to the left (m/s) and of turning (rad/s), then poses x, y (m) and heading (rad),
        shape (n, 6).
    """
    motion = trajectory.at(t)
    mounting = rig.MOUNTINGS["odometry"]
    body = np.einsum("nji,nj->ni", motion.rotation, motion.velocity)
    velocity = (body + np.cross(motion.angular_rate, mounting[:3, 3])) @ mounting[:3, :3]
    turning = motion.angular_rate @ mounting[:3, :3]
    speeds = np.column_stack([velocity[:, :2], turning[:, 2]])
    noise = stream(spec.seed, "odometry").standard_normal(speeds.shape)
    speeds += noise * (np.array([SPEED_NOISE, SPEED_NOISE, TURN_NOISE]) * spec.noise)
    return np.hstack([speeds, _added_up(speeds, t)])


def _added_up(speeds: Array, t: Array) -> Array:
    steps = np.diff(t)[:, None] * 0.5 * (speeds[1:] + speeds[:-1])
    heading = np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    middle = 0.5 * (heading[1:] + heading[:-1])
    cosine, sine = np.cos(middle), np.sin(middle)
    ahead, aside = steps[:, 0], steps[:, 1]
    moved = np.stack([cosine * ahead - sine * aside, sine * ahead + cosine * aside], axis=1)
    return np.column_stack([np.vstack([np.zeros((1, 2)), np.cumsum(moved, axis=0)]), heading])


def fixes(spec: SyntheticRecording, trajectory: SyntheticMotion, t: Array) -> Array:
    """Measure latitude and longitude (degrees) and height (m) of the antenna, shape (n, 3).

    The world's x points east and its y north of ORIGIN, on the tangent plane of WGS 84's ellipsoid.
    """
    place = _place(trajectory, "gnss", t)
    place += stream(spec.seed, "gnss").standard_normal(place.shape) * (np.array(GNSS_NOISE) * spec.noise)
    latitude = np.radians(ORIGIN[0])
    bulge = 1.0 - _ECCENTRICITY2 * np.sin(latitude) ** 2
    across = _EQUATOR / np.sqrt(bulge) + ORIGIN[2]
    along = _EQUATOR * (1.0 - _ECCENTRICITY2) / bulge**1.5 + ORIGIN[2]
    east, north, up = place.T
    return np.column_stack(
        [
            ORIGIN[0] + np.degrees(north / along),
            ORIGIN[1] + np.degrees(east / (across * np.cos(latitude))),
            ORIGIN[2] + up,
        ]
    )


def fields(spec: SyntheticRecording, trajectory: SyntheticMotion, t: Array) -> Array:
    """Measure the magnetic field in the magnetometer's own axes, T, shape (n, 3)."""
    motion = trajectory.at(t)
    measured = np.einsum("nji,j->ni", motion.rotation, np.array(FIELD))
    measured = measured @ rig.MOUNTINGS["magnetometer"][:3, :3]
    noise = stream(spec.seed, "magnetometer").standard_normal(measured.shape)
    return np.asarray(measured + noise * (FIELD_NOISE * spec.noise))


def pressures(spec: SyntheticRecording, trajectory: SyntheticMotion, t: Array) -> Array:
    """Measure the pressure of air by the standard atmosphere, Pa, shape (n,)."""
    height = ORIGIN[2] + _place(trajectory, "barometer", t)[:, 2]
    noise = stream(spec.seed, "barometer").standard_normal(len(t)) * (PRESSURE_NOISE * spec.noise)
    return np.asarray(101_325.0 * (1.0 - 2.25577e-5 * height) ** 5.25588 + noise)


def _place(trajectory: SyntheticMotion, name: str, t: Array) -> Array:
    """Return the positions of a sensor in the world, m, shape (n, 3)."""
    motion = trajectory.at(t)
    return np.asarray(motion.position + motion.rotation @ rig.MOUNTINGS[name][:3, 3])
