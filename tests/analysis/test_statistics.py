# SPDX-License-Identifier: Apache-2.0
"""Intervals, tests and ranks beside those of SciPy, and what they cover."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from importlib import import_module
from itertools import product
from typing import Any

import numpy as np
import pytest

from slamhive.analysis.statistics import (
    Numbers,
    Summary,
    average_ranks,
    holm,
    mean_interval,
    median_interval,
    median_of_sorted,
    rank_correlation,
    resampled_medians,
    sign_flip_test,
)
from slamhive_eval.statistics import student_quantile


@pytest.fixture(scope="module")
def stats() -> Any:
    """SciPy's; all workers collect this file, and importing it takes a second."""
    return import_module("scipy.stats")


def summary_of(values: Any) -> Summary:
    found = Numbers(values, np.zeros(len(values), dtype=np.intp), 1).summaries().of(0)
    assert found is not None
    return found


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 9, 10, 99, 400, 401, 5000])
@pytest.mark.parametrize("probability", [0.6, 0.95, 0.975, 0.9995])
def test_students_quantiles(stats: Any, degrees: int, probability: float) -> None:
    assert student_quantile(probability, degrees) == pytest.approx(
        stats.t.ppf(probability, degrees), rel=1e-6
    )


@pytest.mark.parametrize("count", [2, 3, 10, 101])
def test_summaries_are_those_of_the_standard_library(count: int) -> None:
    values = np.random.default_rng(count).lognormal(size=count)
    found = summary_of(values)
    numbers = values.tolist()
    assert (found.n, found.median, found.min, found.max) == (
        *(count, statistics.median(numbers), min(numbers), max(numbers)),
    )
    assert (found.mean, found.std) == pytest.approx((statistics.mean(numbers), statistics.stdev(numbers)))


@pytest.mark.parametrize("count", [10, 11, 30, 500, 1500])
def test_the_interval_of_a_median_covers_it(stats: Any, count: int) -> None:
    interval = median_interval(np.arange(count, dtype=float))
    assert interval is not None
    below = int(interval.low)
    covered = stats.binom.cdf(count - 1 - below, count, 0.5) - stats.binom.cdf(below, count, 0.5)
    assert covered >= 0.95
    assert interval.low + interval.high == count - 1


def test_failures_reach_into_the_interval_of_a_median() -> None:
    interval = median_interval(np.array([1.0] * 8 + [np.inf] * 4))
    assert interval is not None
    assert (interval.low, interval.high) == (1.0, math.inf)


def test_the_interval_of_a_mean_is_students(stats: Any) -> None:
    values = np.random.default_rng(1).normal(size=20)
    interval = mean_interval(summary_of(values))
    assert interval is not None
    expected = stats.t.interval(0.95, 19, values.mean(), stats.sem(values))
    assert (interval.low, interval.high) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("count", [1, 2, 5, 6, 40, 127, 128, 129, 600])
def test_medians_without_samples_are_those_of_samples(count: int) -> None:
    generator = np.random.default_rng(3)
    ordered = np.sort(generator.lognormal(size=count))
    fast = resampled_medians(ordered, 20_000, generator)
    slow = np.median(generator.choice(ordered, (20_000, count)), axis=1)
    assert np.quantile(fast, [0.1, 0.5, 0.9]) == pytest.approx(np.quantile(slow, [0.1, 0.5, 0.9]), rel=0.02)
    assert fast.mean() == pytest.approx(slow.mean(), rel=0.02)


@pytest.mark.parametrize("numbers", [[0, 1, 10], [0, 1, 10, 100], [0, 1, 10, 100, 1000]])
def test_medians_are_as_frequent_as_among_all_samples(numbers: list[float]) -> None:
    every = Counter(np.median(list(product(numbers, repeat=len(numbers))), axis=1).tolist())
    drawn = Counter(resampled_medians(np.array(numbers), 200_000, np.random.default_rng(7)).tolist())
    assert drawn.keys() == every.keys()
    for median, times in every.items():
        share = times / every.total()
        assert drawn[median] / 200_000 == pytest.approx(share, abs=4 * math.sqrt(share / 200_000))


@pytest.mark.parametrize("values", [[1.0, 2.0, 3.0], [1.0, -0.5, 0.25, 2.0, 0.125], [-1.0] * 6])
def test_flipping_signs_is_exact(stats: Any, values: list[float]) -> None:
    expected = stats.permutation_test(
        (np.array(values),), np.sum, permutation_type="samples", n_resamples=np.inf, vectorized=False
    ).pvalue
    assert sign_flip_test(np.array(values)) == pytest.approx(expected)


def test_many_pairs_are_tested_by_a_sample() -> None:
    generator = np.random.default_rng(5)
    assert sign_flip_test(generator.normal(1, 1, 60)) < 0.001
    assert sign_flip_test(generator.normal(0, 1, 60)) > 0.01
    assert sign_flip_test(np.zeros(5)) == 1.0


def test_differences_that_cancel_say_nothing_whatever_their_rounding() -> None:
    assert sum([0.1, 0.2, -0.3]) != 0
    assert sign_flip_test(np.array([0.1, 0.2, -0.3])) == 1.0


def test_holms_correction() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_ranks_and_their_correlation(stats: Any) -> None:
    a, b = np.array([3.0, 1.0, 1.0, 9.0]), np.array([1.0, 2.0, 3.0, np.inf])
    assert average_ranks(a) == pytest.approx(stats.rankdata(a))
    assert rank_correlation(a, b) == pytest.approx(stats.spearmanr(a, [1, 2, 3, 4]).statistic)
    assert rank_correlation(a, np.ones(4)) is None
    assert median_of_sorted(np.array([1.0, 2.0, np.inf, np.inf])) == math.inf
