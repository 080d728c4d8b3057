# SPDX-License-Identifier: Apache-2.0
"""Noise of an IMU, measured where it rests."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive_eval import Trajectory

    Array = npt.NDArray[np.float64]
    Numbers = npt.NDArray[np.floating[Any]]

_WINDOW, _BLOCK = 2.0, 0.1
"""Seconds that are looked at for rest, and those that are averaged: longer than the filters of IMUs, by which
neighbouring samples are alike, and shorter than their biases need to walk."""
_STILL_RATE, _STILL_FORCE = 0.01, 0.05
"""Deviations of averages that a hand or an engine exceeds, rad/s and m/s²; those of an IMU of the default
noise are a third of them."""
_TURNS_NOT = 0.05
"""Mean rate that is no turn: the Earth's is 7e-5 rad/s, biases are up to some 0.02."""
_WHITE = 1.2
"""Ratio of von Neumann (1941), that of the mean squared difference of neighbours to the variance, 2 for white
noise: of 20 averages one in thirty is below this; of what moves, few are above."""
_STAYS, _FACTOR = 0.01, 4.0
"""Way of the truth, m and rad, within a window at rest, and the factor by which noise may be more then."""


@dataclass(frozen=True)
class Rest:
    """Noise of an IMU at rest.

    Attributes:
        first: When the first rest begins, s.
        seconds: How long it rests in all.
        rates: Noise density of the turning rates, rad/s/√Hz.
        forces: Noise density of the specific forces, m/s²/√Hz.
    """

    first: float
    seconds: float
    rates: float
    forces: float


def noise_at_rest(times: Array, rates: Numbers, forces: Numbers, truth: Trajectory | None) -> Rest | None:
    """Measure the noise of an IMU where it rests for 2 s or more; None where it doesn't.

    The density is the Allan deviation at 0.1 s times the root of that (IEEE Std 952).

    Args:
        times: s, never decreasing, shape (n,).
        rates: Turning rates, rad/s, shape (n, 3).
        forces: Specific forces, m/s², shape (n, 3).
        truth: Poses that say whether it stays where it is.
    """
    if times[-1] - times[0] < _WINDOW:
        return None
    size = round(_BLOCK * len(times) / (times[-1] - times[0]))
    count = round(_WINDOW / _BLOCK)
    whole = len(times) // (size * count) if size else 0
    if not whole:
        return None
    used, shape = whole * size * count, (whole, count, size, 3)
    means = [table[:used].reshape(shape).mean(axis=2, dtype=np.float64) for table in (rates, forces)]
    blocks = np.concatenate(means, axis=2)
    begins = times[: used : size * count]
    ends = times[size * count - 1 :: size * count][:whole]
    variance = blocks.var(axis=1)
    squares = (np.diff(blocks, axis=1) ** 2).mean(axis=1)
    stays, factor = np.ones(whole, dtype=np.bool_), 1.0
    if truth is not None and len(truth.stamps) > 1:
        stays, factor = _stays(truth, begins, ends), _FACTOR
    limits = np.repeat([_STILL_RATE, _STILL_FORCE], 3) * factor
    still = stays & (variance < limits**2).all(axis=1)
    still &= np.linalg.norm(blocks[:, :, :3].mean(axis=1), axis=1) < _TURNS_NOT
    still &= (squares > _WHITE * variance).all(axis=1) & (np.abs(ends - begins - _WINDOW) < _BLOCK)
    if not still.any():
        return None
    densities = np.sqrt(squares[still] / 2 * _BLOCK)
    return Rest(
        float(begins[still][0]),
        float(still.sum() * _WINDOW),
        float(np.median(densities[:, :3])),
        float(np.median(densities[:, 3:])),
    )


def _stays(truth: Trajectory, begins: Array, ends: Array) -> npt.NDArray[np.bool_]:
    """Tell in which windows the poses of a truth, its nearest at five times, stay where they are."""
    times = np.linspace(begins, ends, 5)
    nearest = np.searchsorted(truth.stamps, times).clip(max=len(truth.stamps) - 1)
    known = (begins >= truth.stamps[0]) & (ends <= truth.stamps[-1])
    known &= (np.abs(truth.stamps[nearest] - times) < _WINDOW / 4).all(axis=0)
    ways = np.ptp(truth.positions[nearest], axis=0), np.ptp(truth.quaternions[nearest], axis=0)
    return np.asarray(known & (np.linalg.norm(ways[0], axis=1) < _STAYS) & (ways[1].max(axis=1) < _STAYS / 2))
