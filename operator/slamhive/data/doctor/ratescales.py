# SPDX-License-Identifier: Apache-2.0
"""Turning rates against what else tells of a turn: the way of gravity in the sensor's axes, or a truth.

The way of gravity tells the sign, too: no mounting makes it move against the rates of the same device.
How far a truth turns doesn't.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval import rotation

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy.typing as npt

    from slamhive_eval import Trajectory

    Array = npt.NDArray[np.float64]
    Numbers = npt.NDArray[np.floating[Any]]

DEGREE = float(np.pi / 180.0)
SCALES = (DEGREE, 1.0 / DEGREE)
"""Factors that rates in other units need: deg/s, and radians that were taken for degrees."""
_SIGNED = (*SCALES, -1.0, *(-scale for scale in SCALES))
_BLOCK, _WINDOW, _STEPS = 0.02, 1.0, (0.5, 2.0)
"""Seconds over which rates are averaged, which turns by no more than a rad even where they are in deg/s, over
which gravity's way is compared, and over which turns are with those of a truth: more for slow turns."""
_SMOOTH = 10
"""Blocks over which forces are averaged, to tell where gravity is."""
_TILTED, _TURNED = 0.1, 0.05
"""Way of gravity and turn of a truth, rad, from which on they tell of a scale: errors of both are less."""
_FEWEST, _MOST, _LONGEST = 5, 400, 7200.0
"""Windows that have to tell of it, those that are looked at, and the seconds that they are of."""
_EXPLAINED, _NEAR = 0.3, 0.25
"""Share of a turn that the right scale leaves unexplained at most, and that of what the stated one leaves."""


class IntegratedTurns:
    """Turns of an IMU, integrated over windows.

    Args:
        times: Sensor times, s, never decreasing, shape (n,).
        rates: Turning rates, shape (n, 3).
        forces: Specific forces, shape (n, 3).
    """

    def __init__(self, times: Array, rates: Numbers, forces: Numbers) -> None:
        edges = np.arange(times[0], min(times[-1], times[0] + _LONGEST), _BLOCK)
        self._edges = edges
        self._turns = self._forces = np.zeros((0, 3))
        if len(edges) > 1:
            self._turns, self._forces = (_integrals(times, table, edges) for table in (rates, forces))

    def scale_by_gravity(self) -> float | None:
        """Return the factor that the rates need for gravity to keep its place; None where that isn't told.

        A force that is averaged points up but for accelerations. Where its direction moves in the sensor's
        axes by more than these do, the rates, integrated, must move it alike.
        """
        size = round(_WINDOW / _BLOCK)
        smooth = np.cumsum(np.vstack([np.zeros((1, 3)), self._forces]), axis=0)
        smooth = smooth[_SMOOTH:] - smooth[:-_SMOOTH]
        lengths = np.linalg.norm(smooth, axis=1, keepdims=True)
        if len(smooth) <= size or not lengths.all():
            return None
        up = smooth / lengths
        starts = _some(np.arange(0, len(up) - size, size // 2))
        before, after = up[starts], up[starts + size]
        moved = np.linalg.norm(after - before, axis=1)
        tells = moved > _TILTED

        def error(scale: float) -> Array:
            turn = self._turned(starts + _SMOOTH // 2, size, scale)
            left = rotation.rotate(rotation.conjugate(turn), before) - after
            return np.asarray(np.linalg.norm(left, axis=1)[tells])

        return _better(_SIGNED, error, moved[tells])

    def scale_by_truth(self, truth: Trajectory) -> float | None:
        """Return the factor that the rates need to turn as far as the truth; None where that isn't told."""
        if not truth.oriented or len(truth.stamps) < 2 or not len(self._turns):
            return None
        found = (self._scale_by_truth(truth, step) for step in _STEPS)
        return next((scale for scale in found if scale is not None), None)

    def _scale_by_truth(self, truth: Trajectory, step: float) -> float | None:
        # Poses about a step apart, and the blocks nearest to them: of lengths of their own, so one by one.
        ticks = np.arange(truth.stamps[0], truth.stamps[-1], step)
        poses = np.unique(np.searchsorted(truth.stamps, ticks).clip(max=len(truth.stamps) - 1))
        at = truth.stamps[poses]
        pairs = np.flatnonzero(
            (at[:-1] >= self._edges[0]) & (at[1:] <= self._edges[-2]) & (np.diff(at) < 2 * step)
        )
        pairs = _some(pairs)
        relative = rotation.multiply(
            rotation.conjugate(truth.quaternions[poses[pairs]]), truth.quaternions[poses[pairs + 1]]
        )
        angles = rotation.angle(relative)
        tells = (angles > _TURNED) & (angles < 3.0)
        begins = np.searchsorted(self._edges, at[pairs])
        counts = np.searchsorted(self._edges, at[pairs + 1]) - begins

        def error(scale: float) -> Array:
            found = np.abs(rotation.angle(self._turned(begins, counts, scale)) - angles)
            return np.asarray(found[tells])

        return _better(SCALES, error, angles[tells])

    def _turned(self, starts: npt.NDArray[np.intp], sizes: npt.NDArray[np.intp] | int, scale: float) -> Array:
        """Return the turns over some blocks from each start on, as quaternions, shape (k, 4)."""
        sizes = np.broadcast_to(sizes, starts.shape)
        total = np.tile([0.0, 0.0, 0.0, 1.0], (len(starts), 1))
        for step in range(int(sizes.max(initial=0))):
            places = np.minimum(starts + step, len(self._turns) - 1)
            turn = self._turns[places] * (scale * (step < sizes))[:, np.newaxis]
            angle = np.linalg.norm(turn, axis=1, keepdims=True)
            half = np.hstack([turn * np.sinc(angle / (2 * np.pi)) / 2, np.cos(angle / 2)])
            total = rotation.multiply(total, half)
        return np.asarray(total)


def _better(scales: Sequence[float], error: Callable[[float], Array], turned: Array) -> float | None:
    """Return the scale that explains turns; 1 where the stated one does, None where none is the right one."""
    if len(turned) < _FEWEST:
        return None
    stated, usual = float(np.median(error(1.0))), float(np.median(turned))
    for scale in scales:
        left = float(np.median(error(scale)))
        if left < _EXPLAINED * usual and left < _NEAR * stated:
            return scale
    return 1.0 if stated < _EXPLAINED * usual else None


def _integrals(times: Array, values: Numbers, edges: Array) -> Array:
    """Return the integrals of columns of values by the trapezium rule between one edge and the next."""
    steps, total = np.diff(times), np.zeros(len(times))
    columns = []
    for column in values.T:
        np.cumsum((column[1:] + column[:-1]) / 2 * steps, out=total[1:])
        columns.append(np.diff(np.interp(edges, times, total)))
    return np.column_stack(columns)


def _some(numbers: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    return np.asarray(numbers[:: max(1, -(-len(numbers) // _MOST))])
