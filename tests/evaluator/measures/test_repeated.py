# SPDX-License-Identifier: Apache-2.0
"""Summaries of repeated runs."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from slamhive_eval import OptionError
from slamhive_eval.measures.repeated import summarize
from slamhive_eval.statistics import student_quantile, student_tail

TABLE = {  # two-sided 95 % and 99 % from printed tables
    (0.975, 1): 12.7062047364,
    (0.975, 2): 4.30265272975,
    (0.975, 3): 3.18244630528,
    (0.975, 4): 2.7764451052,
    (0.975, 8): 2.30600413503,
    (0.975, 9): 2.26215716274,
    (0.995, 5): 4.03214298356,
    (0.95, 30): 1.69726088659,
}


@pytest.mark.parametrize(("asked", "expected"), TABLE.items())
def test_quantiles_of_student(asked: tuple[float, int], expected: float) -> None:
    assert student_quantile(*asked) == pytest.approx(expected, rel=1e-9)
    assert student_quantile(1 - asked[0], asked[1]) == pytest.approx(-expected, rel=1e-9)
    assert student_tail(expected, asked[1]) == pytest.approx(1 - asked[0], rel=1e-4)


def test_numbers_by_hand() -> None:
    found = summarize([0.2, 0.1, None, 0.4, float("inf")], (0.1, 0.3))
    assert (found.runs, found.failures, found.values) == (5, 2, (0.2, 0.1, 0.4))
    assert found.mean == pytest.approx(0.7 / 3)
    assert found.std == pytest.approx(np.std([0.2, 0.1, 0.4], ddof=1))
    assert (found.median, found.min, found.max) == (0.2, 0.1, 0.4)
    assert found.geometric_mean == pytest.approx(0.2)
    # Logarithms are ln 0.2 + (0, −ln 2, ln 2): deviation ln 2, t of two degrees.
    factor = math.exp(4.30265272975 * math.log(2) / math.sqrt(3))
    assert (found.interval.low, found.interval.high) == pytest.approx((0.2 / factor, 0.2 * factor))
    assert (found.interval.of, found.interval.method) == ("geometric mean", "t on log")
    assert [(rate.count, rate.rate) for rate in found.success] == [(1, 0.2), (2, 0.4)]
    # Wilson's interval of 2 of 5, from its paper's formula solved as a quadratic.
    n, p, z = 5, 0.4, 1.959963984540054
    ends = np.sort(np.roots((1 + z * z / n, -(2 * p + z * z / n), p * p)))
    assert (found.success[1].low, found.success[1].high) == pytest.approx(ends)
    told = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert told["interval"]["confidence"] == 0.95
    assert told["success"][0]["threshold"] == 0.1


@pytest.mark.parametrize(
    ("errors", "interval"),
    [
        ([0.1], None),
        ([0.0, 0.1], None),
        ([1e-300, 1e30], None),
        ([0.2] * 10, (0.2, 0.2)),
        ([0.2] * 3, (0.2, 0.2)),
    ],
)
def test_degenerate_samples(errors: list[float], interval: tuple[float, float] | None) -> None:
    found = summarize(errors)
    ends = found.interval and (found.interval.low, found.interval.high)
    assert ends == (None if interval is None else pytest.approx(interval))
    assert (found.std is None) == (len(errors) == 1)
    json.dumps(found.as_dict(), allow_nan=False)


def test_nothing_but_failures() -> None:
    found = summarize([None, None], (1.0,))
    assert (found.mean, found.interval, found.success[0].rate) == (None, None, 0.0)
    assert 0.6 < found.success[0].high < 0.7
    with pytest.raises(OptionError, match="at least one run"):
        summarize([])
    with pytest.raises(OptionError, match="≥ 0 or None, not -1"):
        summarize([-1.0, 2.0])
    with pytest.raises(OptionError, match="not nan"):
        summarize([math.nan])


@pytest.mark.parametrize("n", [3, 5])
def test_the_interval_of_few_runs_covers_as_promised(n: int) -> None:
    rng = np.random.default_rng(n)
    intervals = [summarize(sample).interval for sample in rng.lognormal(-3, 0.7, (2000, n))]
    inside = [one.low <= math.exp(-3) <= one.high for one in intervals]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.015)


def test_the_bootstrap_leans_to_the_long_tail_and_can_be_repeated() -> None:
    sample = np.random.default_rng(7).lognormal(0, 1, 40)
    found = summarize(sample.tolist())
    assert found.interval == summarize(sample.tolist()).interval
    assert (found.interval.of, found.interval.method) == ("mean", "BCa bootstrap")
    assert found.interval.low < found.mean < found.interval.high
    assert found.interval.high - found.mean > found.mean - found.interval.low
    half = 1.96 * found.std / math.sqrt(40)
    assert found.interval.high - found.interval.low == pytest.approx(2 * half, rel=0.25)
    even = summarize(np.linspace(1, 2, 40).tolist())
    assert even.interval.low + even.interval.high == pytest.approx(3.0, abs=0.01)
