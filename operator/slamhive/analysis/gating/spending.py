# SPDX-License-Identifier: Apache-2.0
"""Spending of an allowed error over looks at growing data (Lan and DeMets 1983).

The k-th look may bring what is spent to α k/(k+1), the last one to α. Looks see much of the same, so a test
at a look may be at a larger level than what it spends: how much larger follows from how the data grew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from slamhive.analysis.columns import Floats

_NORMAL = NormalDist()
_STEPS = 801
_REACH = 8.0
_LEAST_GROWTH = 1e-6


def union_level(alpha: float, look: int, *, last: bool) -> float:
    """Return a level for a look whose sum over looks is α at most, whatever they are of."""
    return alpha / (look if last else look * (look + 1))


@dataclass
class Spending:
    """An error that is spent look by look.

    Attributes:
        alpha: allowed in all, one-sided.
    """

    alpha: float
    _look: int = 0
    _information: float = 0.0
    _level: float = 0.0
    _places: Floats = field(default_factory=lambda: np.zeros(1))
    _weights: Floats = field(default_factory=lambda: np.ones(1))

    def level(self, information: float, *, last: bool = False) -> float:
        """Return the level of a test at the next look.

        Args:
            information: of the data so far: one over the variance of what is tested, in any unit.
            last: whether no look follows.
        """
        self._look += 1
        spent = self.alpha * (1 - 1 / self._look)
        allowed = (self.alpha if last else self.alpha * (1 - 1 / (self._look + 1))) - spent
        growth = information - self._information
        if growth <= _LEAST_GROWTH * information:
            return self._level
        scale = math.sqrt(information)
        places = np.linspace(-_REACH * scale, _REACH * scale, _STEPS)
        steps = (places[:, None] - self._places[None, :]) / math.sqrt(growth)
        density = np.exp(-(steps**2) / 2) @ self._weights / math.sqrt(2 * math.pi * growth)
        width = places[1] - places[0]
        beyond = np.cumsum(density[::-1])[::-1] * width
        number = min(int(np.searchsorted(-beyond, -allowed)), _STEPS - 1)
        bound = float(places[number])
        kept = places < bound
        self._places, self._weights = places[kept], density[kept] * width
        self._information = information
        self._level = 1 - _NORMAL.cdf(bound / scale)
        return self._level
