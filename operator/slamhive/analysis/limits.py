# SPDX-License-Identifier: Apache-2.0
"""Limits of axes that a few numbers far away don't flatten; figures and pages mark what lies outside.

Two diverged runs of 4 m press forty of 1 cm into a line. Numbers farther from the quartiles than three times
their distance (Tukey, Exploratory Data Analysis, 1977: "far out") are left outside, if they are few and the
axis gains much by it. Nothing else is changed: they count wherever they counted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

FAR = 3.0
"""Quartile distances beyond the quartiles from which on a number is far out."""

LEAST = 8
"""Numbers below which none is left outside: of a few, none is the exception."""

MOST = 0.2
"""Share of the numbers that may be left outside; more of them are a second group, not exceptions."""

GAIN = 2.0
"""Least ratio of the axis' length with them to that without."""

STEEP = 50.0
"""Ratio of the largest to the smallest number from which on an axis had better be logarithmic."""


@dataclass(frozen=True)
class Limits:
    """Limits of an axis, with counts of the numbers that lie outside of them.

    Attributes:
        low, high: the smallest and largest number inside.
        below, above: how many numbers lie outside.
    """

    low: float
    high: float
    below: int = 0
    above: int = 0

    @property
    def outside(self) -> int:
        """Count of the numbers that are not on the axis."""
        return self.below + self.above


def robust_limits(numbers: npt.ArrayLike, *, log: bool = False) -> Limits | None:
    """Return the limits of an axis over some numbers; None where there is none.

    Args:
        numbers: of any shape; what isn't finite is left out, and what isn't positive on a logarithmic axis.
        log: whether the axis is logarithmic: distances are then those of the logarithms.
    """
    found = np.asarray(numbers, dtype=np.float64).ravel()
    found = found[np.isfinite(found) & ((found > 0) | (not log))]
    if not len(found):
        return None
    places = np.sort(np.log10(found) if log else found)
    low, high = _fences(places)
    inside = places[(places >= low) & (places <= high)]
    few = len(found) - len(inside) <= MOST * len(found)
    if len(found) < LEAST or not few or not _gains(places, inside):
        inside = places
    below = int(np.searchsorted(places, inside[0], side="left"))
    above = len(places) - int(np.searchsorted(places, inside[-1], side="right"))
    if log:
        return Limits(float(10 ** inside[0]), float(10 ** inside[-1]), below, above)
    return Limits(float(inside[0]), float(inside[-1]), below, above)


def _fences(ordered: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Return between what sorted numbers are not far out."""
    first, third = np.percentile(ordered, (25, 75))
    distance = third - first
    if not distance:  # half of them are equal: the middle four fifths tell
        first, third = np.percentile(ordered, (10, 90))
        distance = (third - first) or math.inf
    return float(first - FAR * distance), float(third + FAR * distance)


def _gains(whole: npt.NDArray[np.float64], inside: npt.NDArray[np.float64]) -> bool:
    return bool(whole[-1] - whole[0] >= GAIN * (inside[-1] - inside[0]) > 0)
