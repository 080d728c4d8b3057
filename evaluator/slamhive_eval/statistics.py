# SPDX-License-Identifier: Apache-2.0
"""Statistics of errors, under the names that results have for them, Student's distribution and chi-square."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slamhive_eval.rotation import FloatArray


@dataclass(frozen=True)
class Statistics:
    """Statistics of errors e ≥ 0 under evo's names, in the errors' unit.

    Attributes:
        rmse: √(Σe²/n).
        mean: Mean.
        median: Median.
        std: Standard deviation, divided by n.
        min: Smallest.
        max: Largest.
        sse: Σe², in the unit squared.
    """

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    sse: float

    @classmethod
    def of(cls, errors: FloatArray) -> Statistics | None:
        """Statistics of errors, shape (n,); None for n = 0."""
        import numpy as np  # noqa: PLC0415 - whoever asks for the names alone needs none

        if not errors.size:
            return None
        sse = float(np.sum(errors * errors))
        return cls(
            rmse=float(np.sqrt(sse / errors.size)),
            mean=float(np.mean(errors)),
            median=_median(errors),
            std=float(np.std(errors)),
            min=float(np.min(errors)),
            max=float(np.max(errors)),
            sse=sse,
        )

    def as_dict(self) -> dict[str, float | None]:
        """The seven numbers by name; one that isn't finite becomes None, for JSON knows no infinity."""
        return {name: value if math.isfinite(value) else None for name, value in asdict(self).items()}


STATISTICS = Statistics.__match_args__
"""Names of the statistics."""

IN_UNIT = tuple(name for name in STATISTICS if name != "sse")
"""Those in the errors' own unit, which tables compare."""


_LONG_SERIES = 400


def _median(errors: FloatArray) -> float:
    """Return np.median, without its import of numpy.ma: a tenth of what a small evaluation takes."""
    import numpy as np  # noqa: PLC0415

    upper = errors.size // 2
    lower = upper - 1 + errors.size % 2
    middle = np.partition(errors, (lower, upper))
    return float(np.mean(middle[lower : upper + 1]))


def wilson(count: int, total: int, confidence: float = 0.95) -> tuple[float, float]:
    """Ends of Wilson's interval of a share (Wilson 1927), count of total ≥ 1."""
    from statistics import NormalDist  # noqa: PLC0415 - it takes longer than all of this module

    z = NormalDist().inv_cdf((1.0 + confidence) / 2.0)
    share = count / total
    centre = (share + z * z / (2 * total)) / (1 + z * z / total)
    half = z / (1 + z * z / total) * math.sqrt(share * (1 - share) / total + (z / (2 * total)) ** 2)
    return max(0.0, centre - half), min(1.0, centre + half)


@cache
def student_quantile(share: float, degrees: int) -> float:
    """The x that Student's t stays below with the given probability.

    Args:
        share: Within (0, 1).
        degrees: Of freedom, ≥ 1.

    Returns:
        The quantile, from the closed form of the distribution for whole degrees (Abramowitz and Stegun
        1964, 26.7.3 and 26.7.4) by bisection of the angle arctan(t/√degrees); of more than 400 degrees by
        the expansion around the normal distribution (26.7.5), to nine digits.
    """
    if degrees > _LONG_SERIES:
        from statistics import NormalDist  # noqa: PLC0415 - it takes longer than all of this module

        z = NormalDist().inv_cdf(share)
        return z + (z**3 + z) / (4 * degrees) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * degrees**2)
    low, high = 0.0, math.pi / 2.0
    goal = 2.0 * max(share, 1.0 - share) - 1.0
    while True:
        theta = (low + high) / 2.0
        if theta in (low, high):
            break
        low, high = (theta, high) if _student_between(theta, degrees) < goal else (low, theta)
    return math.copysign(math.tan(theta) * math.sqrt(degrees), share - 0.5)


def student_tail(t: float, degrees: int) -> float:
    """The probability that Student's t of whole degrees of freedom ≥ 1 lies above t ≥ 0.

    By the normal distribution from 400 degrees on, and not below 1e-15, the rounding of the closed form.
    """
    if degrees > _LONG_SERIES:
        return math.erfc(t / math.sqrt(2.0)) / 2.0
    return max(1e-15, (1.0 - _student_between(math.atan(t / math.sqrt(degrees)), degrees)) / 2.0)


def _student_between(theta: float, degrees: int) -> float:
    """P(|t| < tan θ·√degrees)."""
    sine, cosine = math.sin(theta), math.cos(theta)
    odd = degrees % 2
    term, total = (cosine, 0.0) if odd else (1.0, 0.0)
    for k in range(1 + odd, degrees, 2):
        total += term
        term *= cosine * cosine * k / (k + 1)
    return 2.0 / math.pi * (theta + sine * total) if odd else sine * total


def chi_square_quantile(share: float, degrees: int) -> float:
    """The x that chi-square stays below with the given probability.

    Args:
        share: Within (0, 1).
        degrees: Of freedom, ≥ 1.

    Returns:
        The quantile after Wilson and Hilferty 1931, k·(1 − 2/(9k) + z·√(2/(9k)))³: to 0.1 % from 30 degrees
        on; of fewer the low ones are too small, of 3 degrees and a share of 0.025 by a sixth.
    """
    from statistics import NormalDist  # noqa: PLC0415 - it takes longer than all of this module

    spread = 2.0 / (9.0 * degrees)
    return float(degrees * max(1.0 - spread + NormalDist().inv_cdf(share) * math.sqrt(spread), 0.0) ** 3)
