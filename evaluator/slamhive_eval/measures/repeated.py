# SPDX-License-Identifier: Apache-2.0
"""Statistics over several runs of one configuration, for ``slamhive-eval repeated``.

A mean alone hides how runs scatter and that some failed. The interval's method depends on how many there
are: the percentile bootstrap covers a lognormal's mean in 73 % for three runs and in 82 % for five instead
of 95 %, so that up to nine runs get Student's interval on the logarithm of the error, and only from ten on
a bootstrap is taken, corrected for bias and skewness (BCa, Efron 1987).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.errors import OptionError
from slamhive_eval.statistics import student_quantile, wilson
from slamhive_eval.trajectory import LARGEST_METRES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive_eval.rotation import FloatArray

MIN_BOOTSTRAP = 10
RESAMPLES = 9999
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Interval:
    """A confidence interval.

    Attributes:
        low: Its lower end.
        high: Its upper end.
        of: What it encloses: ``geometric mean`` or ``mean``.
        method: ``t on log`` or ``BCa bootstrap``.
    """

    low: float
    high: float
    of: str
    method: str


@dataclass(frozen=True)
class SuccessRate:
    """Number and share of the runs whose error stays within a threshold; failed ones are never among them.

    Attributes:
        threshold: Largest error of a success, included.
        count: Successes.
        rate: Their share of all runs.
        low: Lower end of Wilson's 95 % interval of the rate (Wilson 1927).
        high: Its upper end.
    """

    threshold: float
    count: int
    rate: float
    low: float
    high: float


@dataclass(frozen=True)
class Repeated:
    """Errors of repeated runs, in their unit.

    Attributes:
        values: Errors of the runs that have one, in the order given: with few, show these.
        failures: Runs without an error; they count in success rates and nowhere else.
        mean: Mean.
        std: Standard deviation, divided by n − 1; None for n = 1.
        median: Median.
        min: Smallest.
        max: Largest.
        geometric_mean: exp of the mean logarithm; None where an error is zero.
        interval: The 95 % interval; None for n = 1 or where it isn't defined.
        success: One rate a threshold.
    """

    values: tuple[float, ...]
    failures: int
    mean: float | None
    std: float | None
    median: float | None
    min: float | None
    max: float | None
    geometric_mean: float | None
    interval: Interval | None
    success: tuple[SuccessRate, ...]

    @property
    def runs(self) -> int:
        """All runs, failed ones too."""
        return len(self.values) + self.failures

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data."""
        interval = self.interval
        return {
            "runs": self.runs,
            "failures": self.failures,
            "mean": self.mean,
            "std": self.std,
            "median": self.median,
            "min": self.min,
            "max": self.max,
            "geometricMean": self.geometric_mean,
            "interval": None
            if interval is None
            else {
                "low": interval.low,
                "high": interval.high,
                "confidence": CONFIDENCE,
                "of": interval.of,
                "method": interval.method,
            },
            "success": [
                {
                    "threshold": rate.threshold,
                    "count": rate.count,
                    "rate": rate.rate,
                    "low": rate.low,
                    "high": rate.high,
                }
                for rate in self.success
            ],
            "values": list(self.values),
        }


def summarize(errors: Sequence[float | None], thresholds: Sequence[float] = (), seed: int = 0) -> Repeated:
    """Summarize errors of repeated runs.

    Args:
        errors: One a run, ≥ 0; None for a run that failed. One above 1e30, or not finite, failed too.
        thresholds: Errors up to which a run counts as a success, in the errors' unit.
        seed: Of the bootstrap's resampling.

    Returns:
        The summary; without a single error its numbers are None.

    Raises:
        OptionError: No runs, or a negative error.
    """
    if not len(errors):
        raise OptionError("a summary needs at least one run")
    values = np.array([error for error in errors if error is not None and not error > LARGEST_METRES])
    if not (values >= 0).all():
        raise OptionError(f"errors must be ≥ 0 or None, not {values.min():g}")
    success = tuple(_success(values, len(errors), threshold) for threshold in thresholds)
    failures = len(errors) - len(values)
    if not len(values):
        return Repeated((), failures, None, None, None, None, None, None, None, success)
    return Repeated(
        values=tuple(values.tolist()),
        failures=failures,
        mean=float(values.mean()),
        std=float(values.std(ddof=1)) if len(values) > 1 else None,
        median=float(np.median(values)),
        min=float(values.min()),
        max=float(values.max()),
        geometric_mean=float(np.exp(np.mean(np.log(values)))) if (values > 0).all() else None,
        interval=_interval(values, seed),
        success=success,
    )


def _interval(values: FloatArray, seed: int) -> Interval | None:
    n = len(values)
    if n < 2:
        return None
    if n >= MIN_BOOTSTRAP:
        return Interval(*_bca(values, seed), "mean", "BCa bootstrap")
    if not (values > 0).all():
        return None
    logs = np.log(values)
    half = student_quantile((1.0 + CONFIDENCE) / 2.0, n - 1) * float(logs.std(ddof=1)) / math.sqrt(n)
    middle = float(logs.mean())
    try:
        return Interval(math.exp(middle - half), math.exp(middle + half), "geometric mean", "t on log")
    except OverflowError:
        return None


def _bca(values: FloatArray, seed: int) -> tuple[float, float]:
    """The bias-corrected and accelerated interval of the mean."""
    n = len(values)
    mean = float(values.mean())
    if np.ptp(values) == 0:
        return mean, mean
    normal = NormalDist()
    # One resample a time: memory stays linear in n.
    rng = np.random.default_rng(seed)
    means = np.sort([values[rng.integers(0, n, n)].mean() for _ in range(RESAMPLES)])
    below = np.count_nonzero(means < mean) + 0.5 * np.count_nonzero(means == mean)
    bias = normal.inv_cdf(min(max(below / RESAMPLES, 1e-6), 1.0 - 1e-6))
    left_out = (values.sum() - values) / (n - 1)
    away = left_out.mean() - left_out
    acceleration = float(np.sum(away**3) / (6.0 * np.sum(away**2) ** 1.5))

    def end(share: float) -> float:
        z = bias + normal.inv_cdf(share)
        return float(np.quantile(means, normal.cdf(bias + z / (1.0 - acceleration * z))))

    return end((1.0 - CONFIDENCE) / 2.0), end((1.0 + CONFIDENCE) / 2.0)


def _success(values: FloatArray, runs: int, threshold: float) -> SuccessRate:
    count = int(np.count_nonzero(values <= threshold))
    low, high = wilson(count, runs, CONFIDENCE)
    return SuccessRate(float(threshold), count, count / runs, low, high)
