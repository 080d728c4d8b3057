# SPDX-License-Identifier: Apache-2.0
"""Turning of a body as its gyro, its ground truth and its other sensors tell of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from slamhive_eval import rotation

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive_eval import Trajectory

    Array = npt.NDArray[np.float64]
    Numbers = npt.NDArray[np.floating[Any]]
    Mask = npt.NDArray[np.bool_]

SPAN = 0.1
"""Seconds over which rates are taken: truth of 20 Hz has two poses in it, noise of 1 kHz averages out."""
_GAP_PERIODS, _GAP_SECONDS = 5.0, 0.05
"""Periods, and seconds at least, without a sample over which nobody knows how the body turned."""


@dataclass(frozen=True, eq=False)
class Turns:
    """Mean turning rates of a frame over spans of time.

    Attributes:
        begin: Begins of the spans, s, shape (n,).
        end: Their ends, s, shape (n,).
        rates: Mean turning rates over them in the frame itself, rad/s, shape (n, 3).
    """

    begin: Array
    end: Array
    rates: Array

    def __len__(self) -> int:
        """Return the number of spans."""
        return len(self.begin)

    @property
    def middle(self) -> Array:
        """Return the middles of the spans, s, shape (n,)."""
        return (self.begin + self.end) / 2.0

    def select(self, chosen: Mask | npt.NDArray[np.intp] | slice) -> Turns:
        """Return some of the spans."""
        return Turns(self.begin[chosen], self.end[chosen], self.rates[chosen])


@dataclass(frozen=True, eq=False)
class Turning:
    """Turning of a frame that is known all the time.

    Attributes:
        stamps: Increasing times, s, shape (n,).
        angles: Integral of the turning rate in the frame itself up to each, rad, shape (n, 3).
        is_integrated: Whether it is that of measured rates, whose noise is white, and not of orientations.
    """

    stamps: Array
    angles: Array
    is_integrated: bool = True

    def over(self, begin: Array, end: Array) -> tuple[Mask, Array]:
        """Return a mask of the spans (s) that are known, shape (m,), and mean rates, rad/s, shape (m, 3)."""
        # What is in a gap, or outside, is in no piece: no number equals it.
        known = self.piece(begin) == self.piece(end)
        return known, (self.angle(end) - self.angle(begin)) / (end - begin)[:, np.newaxis]

    def angle(self, times: Array) -> Array:
        """Return the integral of the rate up to some times (s), rad, shape (m, 3)."""
        return np.stack([np.interp(times, self.stamps, k) for k in self.angles.T], axis=1)

    def piece(self, times: Array) -> Array:
        """Return a number of the stretch without a gap that some times (s) lie in; NaN where they don't."""
        first, last = self._pieces
        number = np.searchsorted(first, times, side="right") - 1
        within = (number >= 0) & (times <= last[number])
        return np.where(within, number, np.nan)

    @cached_property
    def _pieces(self) -> tuple[Array, Array]:
        steps = np.diff(self.stamps)
        wide = np.flatnonzero(steps > max(_GAP_PERIODS * float(np.median(steps)), _GAP_SECONDS))
        return (
            np.concatenate((self.stamps[:1], self.stamps[wide + 1])),
            np.concatenate((self.stamps[wide], self.stamps[-1:])),
        )

    def knows(self, times: Array) -> bool:
        """Tell whether half of some times (s) or more lie between the first one here and the last."""
        return bool(np.mean((times >= self.stamps[0]) & (times <= self.stamps[-1])) >= 0.5)

    def noise(self, seconds: float) -> float:
        """Return the variance of mean rates over so many s, of all axes together, that is white noise's."""
        if not self.is_integrated or len(self.stamps) < 8:
            return 0.0
        steps = np.diff(self.stamps)
        # Third differences leave nothing of a motion; neighbours share a sample, hence 2.5 instead of 20.
        bends = np.diff(np.diff(self.angles, axis=0) / steps[:, np.newaxis], 3, axis=0)
        return float(np.median(np.sum(bends**2, axis=1)) / 2.5 * np.median(steps) / seconds)

    def turns(self) -> Turns:
        """Return the mean rates from sample to sample that are about `SPAN` apart, four of them in a span."""
        stamps = self.stamps
        kept = np.flatnonzero(np.diff(np.floor((stamps - stamps[0]) / (SPAN / 4.0)), prepend=-1.0))
        ends = np.searchsorted(stamps, stamps[kept] + SPAN * 0.999)
        kept, ends = kept[ends < len(stamps)], ends[ends < len(stamps)]
        known, rates = self.over(stamps[kept], stamps[ends])
        return Turns(stamps[kept], stamps[ends], rates).select(known & np.isfinite(rates).all(axis=1))


def gyro_turning(stamps: npt.NDArray[np.int64], rates: Numbers, offset: float) -> Turning | None:
    """Return the turning of an IMU; None where its samples don't tell of any.

    Args:
        stamps: Header stamps, ns, in any order, shape (n,).
        rates: Turning rates, rad/s, shape (n, 3).
        offset: Seconds added to a stamp to get sensor time.
    """
    order = np.argsort(stamps, kind="stable")
    order = order[np.isfinite(rates[order]).all(axis=1)]
    order = order[np.diff(stamps[order], prepend=np.iinfo(np.int64).min // 2) > 0]
    if len(order) < 10 or not np.ptp(rates[order], axis=0).any():
        return None
    seconds, known = stamps[order] / 1e9 + offset, rates[order].astype(np.float64)
    steps = (known[1:] + known[:-1]) / 2.0 * np.diff(seconds)[:, np.newaxis]
    return Turning(seconds, np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0))))


def turning_of(trajectory: Trajectory | None) -> Turning | None:
    """Return the turning of a trajectory's frame; None where it has no orientations."""
    if trajectory is None or not trajectory.oriented:
        return None
    kept = np.diff(trajectory.stamps, prepend=-np.inf) > 0
    stamps, q = trajectory.stamps[kept], trajectory.quaternions[kept]
    if len(stamps) < 10:
        return None
    steps = vector_of(rotation.multiply(rotation.conjugate(q[:-1]), q[1:]))
    if not steps.any():
        return None
    angles = np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0)))
    return Turning(stamps, angles, is_integrated=False)


def vector_of(quaternions: Array) -> Array:
    """Return rotation vectors (rad, shape (n, 3)) of unit quaternions (x, y, z, w), shape (n, 4)."""
    q = np.where(quaternions[:, 3:] < 0, -quaternions, quaternions)
    sine = np.linalg.norm(q[:, :3], axis=1, keepdims=True)
    half = np.arctan2(sine, q[:, 3:])
    return np.asarray(q[:, :3] * np.where(sine > 1e-9, 2.0 * half / np.maximum(sine, 1e-9), 2.0))


def log_of(matrix: Array) -> Array:
    """Return the rotation vector (rad, shape (3,)) of a rotation matrix, shape (3, 3)."""
    return np.asarray(cv2.Rodrigues(matrix)[0], dtype=np.float64).ravel()


def exp_of(vector: Array) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector, rad."""
    return np.asarray(cv2.Rodrigues(vector)[0], dtype=np.float64)


def cross_of(vectors: Array) -> Array:
    """Return the matrices [v]× of vectors, shape (n, 3) or (3,)."""
    x, y, z = vectors.T
    o = np.zeros_like(x)
    return np.asarray(np.stack((o, -z, y, z, o, -x, -y, x, o), axis=-1).reshape(*vectors.shape, 3))
