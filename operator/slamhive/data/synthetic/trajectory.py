# SPDX-License-Identifier: Apache-2.0
"""The platform's motion, known exactly at every instant.

Each channel (x, y, z, roll, pitch, yaw) is a line plus a few sines of the progress, and progress is a C4
polynomial ramp of time. A vibration adds sines of time, which swell and fade as the speed does. Poses, rates
and accelerations are therefore closed formulas: ground truth and IMU need neither interpolation nor numerical
differentiation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.synthetic.spectra import SPECTRA
from slamhive.data.synthetic.streams import stream
from slamhive.model.synthetic import REST_SECONDS, SyntheticScene

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive.model.synthetic import SyntheticRecording, SyntheticVibration

    Array = npt.NDArray[np.float64]

SEMI_AXES = (5.9, 3.6)
"""Semi-axes of the lap's ellipse, m."""
CORRIDOR_AXES = (7.5, 0.5)
"""The same in a corridor, of the same length."""
HEIGHT = 1.3
"""Mean height of the body above the floor, m."""
RAMP_SECONDS = 2.0
"""Time from rest to full speed, s; shorter when there is less than two of it to move."""

# Coefficients of x^4..x^7 in the step of degree 7, whose first three derivatives vanish at 0 and 1.
_STEP = np.array([35.0, -84.0, 70.0, -20.0])
_POWERS = np.arange(4, 8, dtype=np.float64)


@dataclass(frozen=True)
class Motion:
    """State of the body frame at n instants, all in SI units.

    Attributes:
        position: `(n, 3)`, of the body's origin in the world.
        rotation: `(n, 3, 3)`, body to world.
        velocity: `(n, 3)`, in the world.
        acceleration: `(n, 3)`, in the world, without gravity.
        angular_rate: `(n, 3)`, in the body frame.
        angular_acceleration: `(n, 3)`, in the body frame.
    """

    position: Array
    rotation: Array
    velocity: Array
    acceleration: Array
    angular_rate: Array
    angular_acceleration: Array


@dataclass(frozen=True)
class Channel:
    """One coordinate: offset + slope·s + Σ amplitude·sin(frequency·s + phase), with progress s in [0, 1]."""

    offset: float
    slope: float
    amplitude: Array
    frequency: Array
    phase: Array

    def derivatives(self, s: Array) -> tuple[Array, Array, Array]:
        """Give value, first and second derivative by progress, each `(n,)`."""
        angle = self.frequency * s[:, None] + self.phase
        sine, cosine = np.sin(angle) * self.amplitude, np.cos(angle) * self.amplitude
        value = self.offset + self.slope * s + sine.sum(1)
        return value, self.slope + (cosine * self.frequency).sum(1), -(sine * self.frequency**2).sum(1)


class Vibration:
    """Vibration by engines or steps: sines of time, added to the six coordinates from rest to rest.

    Args:
        spec: The specification.
        asked: Its vibration.
    """

    SINES = 6

    def __init__(self, spec: SyntheticRecording, asked: SyntheticVibration) -> None:
        self._moving, self._ramp = spec.moving_seconds, _ramp_seconds(spec)
        rng = stream(spec.seed, "vibration")
        deviation = np.repeat([asked.amplitude_metres, np.radians(asked.amplitude_degrees)], 3)
        if asked.spectrum is not None:
            lines = np.array(SPECTRA[asked.spectrum])
            # Carriers differ, and harmonics of one remain what they are.
            self._frequency = 2.0 * np.pi * lines[..., 0] * rng.uniform(0.95, 1.05)
            self._phase = rng.uniform(0.0, 2.0 * np.pi, lines.shape[:2])
            self._amplitude = lines[..., 1] * deviation[:, None] * np.sqrt(2.0)
            return
        shape = (6, self.SINES)
        edges = np.linspace(asked.min_frequency, asked.max_frequency, self.SINES + 1)
        # One frequency in each part of the band, so that none of the six coordinates has all at one end.
        self._frequency = 2.0 * np.pi * rng.uniform(edges[:-1], edges[1:], shape)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, shape)
        # A sine has 1/√2 of its amplitude as standard deviation.
        self._amplitude = (deviation * np.sqrt(2.0 / self.SINES))[:, None]

    def derivatives(self, t: Array) -> tuple[Array, Array, Array]:
        """Give value, first and second derivative by time of the six coordinates, each `(n, 6)`."""
        value, slope, bend = self._sines(t)
        late = t - REST_SECONDS > self._moving / 2.0
        since = np.clip(t - REST_SECONDS, 0.0, self._moving)
        u = np.minimum(np.where(late, self._moving - since, since) / self._ramp, 1.0)[:, None]
        inward = np.where(late, -1.0, 1.0)[:, None] / self._ramp
        swell = (_STEP * u**_POWERS).sum(1, keepdims=True)
        first = (_STEP * _POWERS * u ** (_POWERS - 1.0)).sum(1, keepdims=True) * inward
        second = (_STEP * _POWERS * (_POWERS - 1.0) * u ** (_POWERS - 2.0)).sum(1, keepdims=True) * inward**2
        return (
            swell * value,
            first * value + swell * slope,
            second * value + 2.0 * first * slope + swell * bend,
        )

    def _sines(self, t: Array) -> tuple[Array, Array, Array]:
        angle = self._frequency * t[:, None, None] + self._phase
        sine, cosine = self._amplitude * np.sin(angle), self._amplitude * np.cos(angle)
        value, slope = sine.sum(2), (cosine * self._frequency).sum(2)
        return value, slope, -(sine * self._frequency**2).sum(2)


class SyntheticMotion:
    """The motion that a specification asks for."""

    def __init__(self, spec: SyntheticRecording) -> None:
        self._moving = spec.moving_seconds
        self._ramp = _ramp_seconds(spec)
        self._channels = _channels(spec)
        self._vibration = Vibration(spec, spec.vibration) if spec.vibration else None

    def progress(self, t: Array) -> tuple[Array, Array, Array]:
        """Give the share of the way done and its first two derivatives by time.

        Args:
            t: `(n,)`, s since the start of the recording.

        Returns:
            Three arrays `(n,)`: progress in [0, 1], its rate in 1/s, its acceleration in 1/s².
        """
        top = 1.0 / (self._moving - self._ramp)
        since = np.clip(t - REST_SECONDS, 0.0, self._moving)
        late = since > self._moving / 2.0
        x = np.where(late, self._moving - since, since)
        u = np.minimum(x / self._ramp, 1.0)[:, None]
        step = (_STEP * u**_POWERS).sum(1)
        slope = (_STEP * _POWERS * u ** (_POWERS - 1.0)).sum(1) / self._ramp
        area = (_STEP / (_POWERS + 1.0) * u ** (_POWERS + 1.0)).sum(1) * self._ramp
        done = top * (area + np.maximum(x - self._ramp, 0.0))
        return np.where(late, 1.0 - done, done), top * step, top * np.where(late, -slope, slope)

    def at(self, t: npt.ArrayLike) -> Motion:
        """Evaluate the motion.

        Args:
            t: `(n,)`, s since the start of the recording.
        """
        t = np.atleast_1d(np.asarray(t, dtype=np.float64))
        s, rate, acceleration = self.progress(t)
        value, first, second = (
            np.stack(x, 1) for x in zip(*(c.derivatives(s) for c in self._channels), strict=True)
        )
        velocity = first * rate[:, None]
        accel = second * rate[:, None] ** 2 + first * acceleration[:, None]
        if self._vibration is not None:
            value, velocity, accel = (
                path + shaken
                for path, shaken in zip((value, velocity, accel), self._vibration.derivatives(t), strict=True)
            )
        omega, alpha = _body_rates(value[:, 3:], velocity[:, 3:], accel[:, 3:])
        return Motion(
            position=value[:, :3],
            rotation=rotation_from_euler(value[:, 3:]),
            velocity=velocity[:, :3],
            acceleration=accel[:, :3],
            angular_rate=omega,
            angular_acceleration=alpha,
        )

    def length(self, start: float, end: float) -> float:
        """Measure the body's path between two instants, m."""
        points = self.at(np.arange(start, end, 0.002)).position
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _ramp_seconds(spec: SyntheticRecording) -> float:
    return min(RAMP_SECONDS, spec.moving_seconds / 2.0)


def rotation_from_euler(angles: Array) -> Array:
    """Compose R = Rz(yaw) Ry(pitch) Rx(roll).

    Args:
        angles: `(n, 3)`, roll, pitch, yaw in rad.

    Returns:
        `(n, 3, 3)`.
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles).T, np.sin(angles).T
    rows: list[list[Array]] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.array(rows).transpose(2, 0, 1)


def quaternion_from_rotation(rotation: Array) -> Array:
    """Convert rotations to quaternions `(n, 4)` in the order x, y, z, w, with w not negative.

    Shepperd's method: the largest of the four components is found first, so that nothing cancels.
    """
    r = rotation
    trace = np.trace(r, axis1=1, axis2=2)
    squares = np.stack([1 + 2 * r[:, i, i] - trace for i in range(3)] + [1 + trace], axis=1)
    products = np.empty((len(r), 4, 4))
    products[:, np.arange(4), np.arange(4)] = squares
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        products[:, i, j] = products[:, j, i] = r[:, i, j] + r[:, j, i]
        products[:, k, 3] = products[:, 3, k] = r[:, j, i] - r[:, i, j]
    q = products[np.arange(len(r)), np.argmax(squares, axis=1)]
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return np.asarray(np.where(q[:, 3:] < 0.0, -q, q))


def _body_rates(angles: Array, rates: Array, accelerations: Array) -> tuple[Array, Array]:
    """Turn Euler angles, their rates and accelerations into angular rate and acceleration in the body frame.

    With R = Rz(y) Ry(p) Rx(r): ω = [r' - y' sin p, p' cos r + y' cos p sin r, -p' sin r + y' cos p cos r];
    the acceleration is its derivative.
    """
    (roll, pitch, _), (dr, dp, dy), (ddr, ddp, ddy) = angles.T, rates.T, accelerations.T
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    omega = [dr - dy * sp, dp * cr + dy * cp * sr, -dp * sr + dy * cp * cr]
    alpha = [
        ddr - ddy * sp - dy * dp * cp,
        ddp * cr - dp * dr * sr + ddy * cp * sr - dy * dp * sp * sr + dy * dr * cp * cr,
        -ddp * sr - dp * dr * cr + ddy * cp * cr - dy * dp * sp * cr - dy * dr * cp * sr,
    ]
    return np.stack(omega, 1), np.stack(alpha, 1)


def _channels(spec: SyntheticRecording) -> list[Channel]:
    """Lay out the six coordinates. Whole numbers of periods over the run return the body to its start."""
    rng = stream(spec.seed, "trajectory")
    laps, m = spec.loops, spec.motion
    phases = rng.uniform(0.0, 2.0 * np.pi, 16)

    def cycles(per_lap: float) -> float:
        return 2.0 * np.pi * max(1, round(per_lap * laps))

    def channel(offset: float, slope: float, *sines: tuple[float, float, float]) -> Channel:
        a, f, p = np.array(sines, dtype=np.float64).T
        return Channel(offset, slope, a, f, p)

    lap = 2.0 * np.pi * laps
    degree = np.pi / 180.0
    axes = CORRIDOR_AXES if spec.scene is SyntheticScene.CORRIDOR else SEMI_AXES
    return [
        channel(0.0, 0.0, (axes[0], lap, np.pi / 2), (0.10 * m, cycles(4.3), phases[0])),
        channel(0.0, 0.0, (axes[1], lap, 0.0), (0.10 * m, cycles(5.2), phases[1])),
        channel(HEIGHT, 0.0, (0.22 * m, cycles(2.0), phases[2]), (0.05 * m, cycles(7.3), phases[3])),
        channel(
            0.0, 0.0, (3.5 * degree * m, cycles(4.0), phases[4]), (1.5 * degree * m, cycles(9.2), phases[5])
        ),
        channel(
            0.0, 0.0, (3.5 * degree * m, cycles(3.3), phases[6]), (1.5 * degree * m, cycles(8.1), phases[7])
        ),
        channel(
            np.pi / 2,
            lap,
            (7.0 * degree * m, cycles(2.3), phases[8]),
            (2.0 * degree * m, cycles(6.4), phases[9]),
        ),
    ]
