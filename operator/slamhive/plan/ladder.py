# SPDX-License-Identifier: Apache-2.0
"""The ladder of an axis: its numbers in ascending order, between which a threshold is sought.

A range without step has rungs too: so many that they are no farther apart than what is good enough.
"""

from __future__ import annotations

import bisect
import math
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from slamhive.plan.axes import Dimension

_DIGITS = 12
_MOST_HALVINGS = 40
_USUAL_PARTS = 100


class Ladder:
    """Numbers of an axis, lowest first, none of them listed where they are many.

    Args:
        axis: the compiled axis.
        is_integer: whether only whole numbers of its range may be tried.
        tolerance: distance of neighbours at most on a range of any numbers, of a logarithmic range their
            ratio less 1; default: a hundredth of the range.

    Raises:
        InputError: its values are no numbers, or there is one alone.
    """

    def __init__(self, axis: Dimension, tolerance: float | None = None, *, is_integer: bool = False) -> None:
        span, where = axis.span, axis.where
        self.is_log = span is not None and span.scale == "Log"
        self._rungs: dict[float, int | None] = {}
        self._values: list[Any] | range | None = None
        if span is None:
            odd = [value for value in axis.values if not _is_number(value)]
            if odd:
                raise InputError(
                    f"spec.search.axis: a threshold is sought on numbers, {axis.label} has the value "
                    f"{odd[0]!r}"
                )
            self._values = sorted(axis.values)
        elif is_integer:
            self._values = range(math.ceil(span.from_), math.floor(span.to) + 1)
        else:
            self._low, self._high = span.from_, span.to
            self._parts = _parts((span.from_, span.to), tolerance, where, is_log=self.is_log)
        if len(self) < 2:
            raise InputError(f"{where}: has one value, a threshold needs two at least")
        if tolerance is not None and self._values is not None:
            raise InputError(
                f"spec.search.tolerance: {axis.label} has values of its own; it is for a range without step"
            )

    def __len__(self) -> int:
        return self._parts + 1 if self._values is None else len(self._values)

    def __getitem__(self, rung: int) -> Any:
        if self._values is not None:
            return self._values[rung]
        rung = range(len(self))[rung]
        if rung in {0, self._parts}:
            return self._high if rung else self._low
        if self.is_log:
            return float(f"{self._low * (self._high / self._low) ** (rung / self._parts):.{_DIGITS}g}")
        first, last = (Fraction(repr(float(end))) for end in (self._low, self._high))
        return float(first + (last - first) * rung / self._parts)

    def rung(self, value: float) -> int | None:
        """Return the place of a number; None where it isn't one of them."""
        if value not in self._rungs:
            place = bisect.bisect_left(range(len(self)), value, key=self.__getitem__)
            self._rungs[value] = place if place < len(self) and self[place] == value else None
        return self._rungs[value]

    def between(self, low: int, high: int) -> int:
        """Return the rung in the middle of two, of whole numbers on a logarithmic range by their ratio."""
        if self.is_log and isinstance(self._values, range):
            middle = round(math.sqrt(self[low] * self[high])) - self._values.start
            return min(max(middle, low + 1), high - 1)
        return (low + high) // 2

    @cached_property
    def halvings(self) -> int:
        """Return the number of values that bisection tries between the ends at most."""
        rungs = len(self) - 1
        if self.is_log and isinstance(self._values, range):
            return 2 * math.ceil(math.log2(rungs)) if rungs > 1 else 0
        return math.ceil(math.log2(rungs))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _parts(ends: tuple[float, float], tolerance: float | None, where: str, *, is_log: bool) -> int:
    low, high = ends
    if low >= high:
        raise InputError(f"{where}: has one value, a threshold needs two at least")
    if tolerance is None:
        parts = float(_USUAL_PARTS)
    elif is_log:
        parts = math.log(high / low) / math.log1p(tolerance)
    else:
        parts = (high - low) / tolerance
    halvings = max(0, math.ceil(math.log2(parts) - 1e-9))
    if halvings > _MOST_HALVINGS:
        raise InputError(
            f"spec.search.tolerance: {tolerance:g} is too fine for {low:g} to {high:g}, which would have to "
            f"be halved {halvings} times; at most {_MOST_HALVINGS} are allowed"
        )
    return int(2**halvings)
