# SPDX-License-Identifier: Apache-2.0
"""The time between two clocks, by how fast the body turns.

The angular speed of a rigid body is the same for every frame fixed to it and in every world: it needs
neither alignment nor extrinsics (Olson 2010 for clocks; Furrer et al. 2017 for trajectories). Both speeds are
taken over the same span around each time, so that they are smoothed alike whatever the rates; their
normalised correlation over all shifts gives the offset to a sample, Gauss-Newton on the difference the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.association import interpolate
from slamhive_eval.errors import AssociationError

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive_eval.rotation import FloatArray
    from slamhive_eval.trajectory import Trajectory

SMALLEST_CORRELATION = 0.5
"""Below this the two don't turn alike."""
_SPAN_SECONDS = 0.1
_SAMPLES_IN_SPAN = 4
_LONGEST_GRID = 1 << 22
_OVERLAP = 0.3
"""Share of the shorter trajectory's samples that must overlap at a shift for it to count."""
_STEPS = 12
_WINDOWS = 8


@dataclass(frozen=True)
class TimeOffset:
    """stamp_reference = stamp_estimate + offset + drift · (stamp_estimate − origin).

    Attributes:
        offset_seconds: To add to the estimate's stamps at the origin.
        drift: Growth of the offset in s per s; 0 unless asked for.
        origin: Time of the estimate's clock that the offset is for, in s: the middle of the estimate.
        correlation: Of the angular speeds after the correction, within −1 and 1.
    """

    offset_seconds: float
    drift: float
    origin: float
    correlation: float

    def as_dict(self) -> dict[str, float]:
        """Plain JSON data."""
        return {
            "offsetSeconds": self.offset_seconds,
            "drift": self.drift,
            "origin": self.origin,
            "correlation": self.correlation,
        }

    def apply(self, estimate: Trajectory) -> Trajectory:
        """The estimate with stamps of the reference's clock."""
        return estimate.at(self.corrected(estimate.stamps))

    def corrected(self, stamps: FloatArray) -> FloatArray:
        """Stamps of the estimate's clock, in s, by the reference's."""
        return stamps + self.offset_seconds + self.drift * (stamps - self.origin)


def find_offset(reference: Trajectory, estimate: Trajectory, *, drift: bool = False) -> TimeOffset:
    """Find the offset of the estimate's clock, and its drift where asked.

    Args:
        reference: Ground truth, with orientations.
        estimate: With orientations; any world, any frame fixed to the same body, any scale.
        drift: Whether the offset may grow with time.

    Returns:
        The offset with the highest correlation of the angular speeds.

    Raises:
        AssociationError: One has no orientations, turns too little, is too short or too long, or the two
            don't turn alike.
    """
    _require_turning(reference, "ground truth")
    _require_turning(estimate, "estimate")
    spacing = max(float(np.median(np.diff(one.stamps))) for one in (reference, estimate))
    span = max(_SPAN_SECONDS, 2.0 * spacing)
    grid = span / _SAMPLES_IN_SPAN
    whole = max(float(np.ptp(one.stamps)) for one in (reference, estimate))
    if whole / grid > _LONGEST_GRID / 2:
        raise AssociationError(f"{whole:.0f} s are too long to find a time offset; give it")
    true = _Speed(reference, span)
    found = _Speed(estimate, span)
    coarse = _coarse(true.sampled(grid), found.sampled(grid), grid)
    offset = coarse + reference.stamps[0] - estimate.stamps[0]
    origin = float(estimate.stamps[0] + estimate.stamps[-1]) / 2.0
    times = np.arange(estimate.stamps[0], estimate.stamps[-1], grid)
    rate = _rough_drift(true, found, times, offset, origin) if drift else 0.0
    turns = found.turns()
    offset, rate = _refined(true, turns, (offset, rate), origin, drift=drift)
    result = TimeOffset(float(offset), float(rate), origin, 0.0)
    correlation = _correlation(true, turns, result)
    if not correlation >= SMALLEST_CORRELATION:
        raise AssociationError(
            "the estimate doesn't turn as the ground truth does at any time offset (highest correlation of "
            f"angular speeds {correlation:.2f}, needed {SMALLEST_CORRELATION}); give the offset"
        )
    return TimeOffset(float(offset), float(rate), origin, correlation)


class _Speed:
    """Angular speed over a span around a time, in rad/s."""

    def __init__(self, trajectory: Trajectory, span: float) -> None:
        self._trajectory = trajectory
        self._span = span
        self._gap = max(1.0, 2.0 * span)

    def between(self, begin: FloatArray, end: FloatArray) -> tuple[npt.NDArray[np.bool_], FloatArray]:
        """Return a mask of the spans with a known speed, and it in rad/s, 0 elsewhere; shapes (n,)."""
        early, _, q0 = interpolate(self._trajectory, begin, self._gap)
        late, _, q1 = interpolate(self._trajectory, end, self._gap)
        known = early & late
        speed = rotation.angle(rotation.multiply(rotation.conjugate(q0), q1)) / (end - begin)
        return known, np.where(known, speed, 0.0)

    def at(self, times: FloatArray) -> tuple[npt.NDArray[np.bool_], FloatArray]:
        """Return a mask of the times amid a known speed, and it in rad/s, 0 elsewhere; shapes (n,)."""
        return self.between(times - self._span / 2.0, times + self._span / 2.0)

    def turns(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Begin and end in s of spans from pose to pose, and the speed over each in rad/s; shapes (n,).

        Nothing is interpolated here, which would shift the turns of sparse keyframes.
        """
        stamps, q = self._trajectory.stamps, self._trajectory.quaternions
        end = np.searchsorted(stamps, stamps + self._span)
        begin = np.flatnonzero(end < len(stamps))
        end = end[begin]
        begin, end = (index[stamps[end] - stamps[begin] <= self._gap] for index in (begin, end))
        angle = rotation.angle(rotation.multiply(rotation.conjugate(q[begin]), q[end]))
        return stamps[begin], stamps[end], angle / (stamps[end] - stamps[begin])

    def sampled(self, grid: float) -> tuple[npt.NDArray[np.bool_], FloatArray]:
        """The same every ``grid`` seconds from the first stamp."""
        stamps = self._trajectory.stamps
        return self.at(np.arange(stamps[0], stamps[-1] + grid, grid))


def _require_turning(trajectory: Trajectory, name: str) -> None:
    if not trajectory.oriented:
        raise AssociationError(f"a time offset is found by rotation, and the {name} has no orientations")
    if len(trajectory) < 10 or not np.ptp(trajectory.stamps) > 1.0:
        raise AssociationError(f"a time offset can't be found from {len(trajectory)} poses of the {name}")
    q = trajectory.quaternions
    turned = float(np.sum(rotation.angle(rotation.multiply(rotation.conjugate(q[:-1]), q[1:]))))
    if turned < np.deg2rad(20.0):
        raise AssociationError(
            f"a time offset can't be found: the {name} turns by {np.rad2deg(turned):.1f} degrees in all"
        )


def _coarse(
    true: tuple[npt.NDArray[np.bool_], FloatArray],
    found: tuple[npt.NDArray[np.bool_], FloatArray],
    grid: float,
) -> float:
    """Shift of ``found`` in s that correlates best, over what both have, for all shifts at once by FFT."""
    size = 1 << int(np.ceil(np.log2(len(true[1]) + len(found[1]))))

    def correlate(a: FloatArray, b: FloatArray) -> FloatArray:
        product = np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size))
        return np.fft.irfft(product, size)

    x, y = true[1], found[1]
    mx, my = true[0].astype(np.float64), found[0].astype(np.float64)
    count = np.maximum(np.round(correlate(mx, my)), 0.0)
    enough = count >= max(_OVERLAP * min(mx.sum(), my.sum()), 1.0)
    if not enough.any():
        raise AssociationError("the trajectories are too full of gaps to find a time offset")
    n = np.where(enough, count, 1.0)
    sum_x, sum_y = correlate(x, my), correlate(mx, y)
    covariance = correlate(x, y) - sum_x * sum_y / n
    variance = (correlate(x * x, my) - sum_x**2 / n) * (correlate(mx, y * y) - sum_y**2 / n)
    smallest = 1e-6 * float(np.max(np.abs(variance), where=enough, initial=0.0))
    usable = enough & (variance > smallest)
    quality = np.where(usable, covariance / np.sqrt(np.where(usable, variance, 1.0)), -1.0)
    best = int(np.argmax(quality))
    return grid * (best if best < size // 2 else best - size)


def _refined(
    true: _Speed,
    turns: tuple[FloatArray, FloatArray, FloatArray],
    start: tuple[float, float],
    origin: float,
    *,
    drift: bool,
) -> tuple[float, float]:
    """Gauss-Newton on the speeds that the truth has where the estimate's turns would be."""
    begin, end, wanted = turns
    offset, rate = start
    step = _SPAN_SECONDS / 10.0
    centre = (begin + end) / 2.0 - origin
    half = max(float(np.abs(centre).max(initial=0.0)), 1.0)
    for _ in range(_STEPS):
        b, e = (times + offset + rate * (times - origin) for times in (begin, end))
        inside, here = true.between(b, e)
        before, early = true.between(b - step, e - step)
        after, late = true.between(b + step, e + step)
        use = inside & before & after
        if np.count_nonzero(use) < 10:
            break
        slope = (late - early)[use] / (2.0 * step)
        # The drift's unit is that of its effect at the ends, so that both columns weigh alike.
        columns = np.column_stack((slope, slope * centre[use] / half))[:, : 1 + drift]
        change = np.linalg.lstsq(columns, (wanted - here)[use], rcond=1e-9)[0]
        change = np.clip(change, -_SPAN_SECONDS, _SPAN_SECONDS)
        offset += float(change[0])
        rate += float(change[1]) / half if drift else 0.0
        if np.abs(change).max() < 1e-7:
            break
    return offset, rate


def _rough_drift(true: _Speed, found: _Speed, times: FloatArray, offset: float, origin: float) -> float:
    """Slope of the offsets that parts of the estimate have on their own (Theil 1950 and Sen 1968)."""
    centres, offsets = [], []
    for part in np.array_split(times, _WINDOWS):
        if len(part) < 40:
            continue
        middle = float(part.mean())
        reach = 1.0 + 1e-3 * abs(middle - origin)
        grid = float(part[1] - part[0])
        around = np.arange(part[0] + offset - reach, part[-1] + offset + reach, grid)
        try:
            shift = _coarse(true.at(around), found.at(part), grid) - reach
        except AssociationError:
            continue
        if abs(shift) < reach:
            centres.append(middle)
            offsets.append(shift)
    if len(centres) < 3:
        return 0.0
    x, y = np.array(centres), np.array(offsets)
    i, j = np.triu_indices(len(x), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))


def _correlation(true: _Speed, turns: tuple[FloatArray, FloatArray, FloatArray], offset: TimeOffset) -> float:
    begin, end, y = turns
    use, x = true.between(offset.corrected(begin), offset.corrected(end))
    if np.count_nonzero(use) < 10 or not (np.ptp(x[use]) > 0 and np.ptp(y[use]) > 0):
        return 0.0
    return float(np.corrcoef(x[use], y[use])[0, 1])
