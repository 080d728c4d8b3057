# SPDX-License-Identifier: Apache-2.0
"""Scales of charts: from numbers to places on paper, and the ticks."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

STEEP = 25.0
"""Ratio of the largest to the smallest number from which on an axis is logarithmic."""

MOST_TICKS = 12
"""Values of a setting up to which each has a tick."""

_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
_WHOLE = 1e-9


@dataclass(frozen=True)
class Scale:
    """An axis.

    Attributes:
        low, high: the numbers at its ends.
        begin, end: their places.
        log: whether it is logarithmic.
        ticks: numbers that are written beside it.
    """

    low: float
    high: float
    begin: float
    end: float
    log: bool
    ticks: tuple[float, ...]

    @classmethod
    def over(
        cls,
        numbers: Iterable[float],
        begin: float,
        end: float,
        *,
        log: bool | None = None,
        ticks: int = 5,
        tried: int = 0,
        zero: bool = False,
    ) -> Scale:
        """Return an axis that holds some numbers with a little air around them.

        Args:
            numbers: what is drawn; what isn't finite is left out.
            begin: the place of its lower end.
            end: the place of its upper end.
            log: whether it is logarithmic; None where the numbers are to say.
            ticks: about how many.
            tried: up to so many different numbers have a tick each.
            zero: whether it begins at 0 however close the numbers are; a logarithmic one doesn't.
        """
        scale = cls._over(numbers := list(numbers), begin, end, log=log, ticks=ticks, zero=zero)
        values = sorted({number for number in numbers if math.isfinite(number)})
        return replace(scale, ticks=tuple(values)) if 0 < len(values) <= tried else scale

    @classmethod
    def _over(
        cls, numbers: Iterable[float], begin: float, end: float, *, log: bool | None, ticks: int, zero: bool
    ) -> Scale:
        found = [number for number in numbers if math.isfinite(number)]
        low, high = min(found, default=0.0), max(found, default=1.0)
        logarithmic = low > 0 and (high / low > STEEP if log is None else log)
        if logarithmic:
            air = (high / low) ** 0.06 if high > low else 1.5
            low, high = low / air, high * air
            return cls(low, high, begin, end, True, _log_ticks(low, high, ticks))
        # An axis begins at zero unless that would press the numbers together.
        if low > 0 and (zero or low < 0.6 * high):
            low = 0.0
        elif high == low:
            low, high = low - (abs(low) / 2 or 0.5), high + (abs(high) / 2 or 0.5)
        else:
            low -= 0.07 * (high - low)
        high += 0.06 * (high - low)
        return cls(low, high, begin, end, False, nice_ticks(low, high, ticks))

    def at(self, number: float) -> float:
        """Return the place of a number."""
        if self.log:
            share = math.log(number / self.low) / math.log(self.high / self.low)
        else:
            share = (number - self.low) / (self.high - self.low)
        return self.begin + share * (self.end - self.begin)

    def label(self, tick: float) -> str:
        """Return a tick as it is written."""
        if tick and not 1e-4 <= abs(tick) < 1e6:
            return f"{tick:.3g}"
        return f"{tick:.6f}".rstrip("0").rstrip(".")


def nice_ticks(low: float, high: float, count: int) -> tuple[float, ...]:
    """Return about so many round numbers between two, none where there is no room."""
    rough = (high - low) / max(count, 1)
    if not rough > 0 or not math.isfinite(rough):
        return ()
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * one for one in _STEPS if power * one >= rough * (1 - _WHOLE))
    first, last = math.ceil(low / step - _WHOLE), math.floor(high / step + _WHOLE)
    return tuple(round(number * step, 12) for number in range(first, last + 1))


def _log_ticks(low: float, high: float, count: int) -> tuple[float, ...]:
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    for factors in ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), tuple(map(float, range(1, 10)))):
        ticks = [
            factor * 10.0**power
            for power in range(first, last + 1)
            for factor in factors
            if low <= factor * 10.0**power <= high
        ]
        if len(ticks) >= 3:
            every = math.ceil(len(ticks) / (2 * count))
            return tuple(float(f"{tick:.12g}") for tick in ticks[::every])
    return nice_ticks(low, high, count)
