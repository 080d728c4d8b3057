# SPDX-License-Identifier: Apache-2.0
"""Accuracy against cost: which competitors nobody beats in both, whichever way is good of each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.boards import COMPETITORS, prepare
from slamhive.analysis.grouping import Outcomes, sound
from slamhive.analysis.measures import follows_trajectory, measure_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.boards import Grid
    from slamhive.analysis.columns import Floats
    from slamhive.analysis.frame import Frame


@dataclass(frozen=True)
class Spot:
    """A competitor on one dataset.

    Attributes:
        keys: what it is.
        x, y: medians; y is infinite, below 0 where large is good, when the median run failed; x is NaN where
            nothing is known.
        x_range, y_range: smallest and largest of the runs that count.
        front: whether no other competitor is at least as good in both and better in one.
        runs, n: runs, and different results of those that count.
        copies: runs that count and repeat a result.
        failures: runs that don't, by what became of them.
        coverage: mean over the evaluated runs, with 0 for those that failed of themselves.
    """

    keys: dict[str, Any]
    x: float
    y: float
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    front: bool
    runs: int
    n: int
    copies: int
    failures: dict[str, int]
    coverage: float


@dataclass(frozen=True)
class Front:
    """The competitors on one dataset under one set of facets, the best in x first."""

    facets: dict[str, Any]
    spots: list[Spot]


def pareto(
    frame: Frame,
    x: str,
    y: str = "ate.rmse",
    by: Sequence[str] = COMPETITORS,
    outcomes: Outcomes = Outcomes.TRACKED,
) -> tuple[list[Front], tuple[str, ...]]:
    """Return one front a dataset and set of facets, and notes.

    Args:
        frame: one row a run and evaluation.
        x: the cost, a column of numbers.
        y: the error; failed runs are last in it.
        by: columns that tell competitors apart.
        outcomes: which runs have a figure that counts.
    """
    found = prepare(frame, [y, x], by, outcomes, by_dataset=True)
    return [_front(grid, x) for grid in found.grids], found.notes


def _front(grid: Grid, x: str) -> Front:
    # What a run costs is known even where it failed, but then it says nothing of the algorithm.
    inside = grid.counted & ~np.isnan(grid.numbers) & sound(grid.frame, x)
    if follows_trajectory(x):
        inside &= grid.once
    costs = grid.places.numbers(grid.frame.column(x).floats(), inside)
    across = costs.medians()
    up = grid.medians[grid.at[:, 0], grid.at[:, 1]]
    way = measure_of(x).sign
    lists = zip(
        grid.at[:, 0].tolist(),
        zip(across.tolist(), (grid.sign * up).tolist(), nondominated(way * across, up).tolist(), strict=True),
        *(zip(*map(np.ndarray.tolist, found.ends()), strict=True) for found in (costs, grid.figures)),
        grid.places.counts(np.ones(len(grid.frame), dtype=bool)).tolist(),
        grid.places.counts(grid.counted & grid.once).tolist(),
        grid.places.counts(grid.counted & ~grid.once).tolist(),
        grid.failures(),
        grid.mean_coverages(),
        strict=True,
    )
    spots = [
        Spot(
            keys=grid.competitors[number],
            x=cost,
            y=error,
            x_range=x_range,
            y_range=y_range,
            front=front,
            runs=runs,
            n=n,
            copies=copies,
            failures=failures,
            coverage=np.nan if coverage is None else coverage,
        )
        for number, (cost, error, front), x_range, y_range, runs, n, copies, failures, coverage in lists
    ]
    spots.sort(
        key=lambda spot: (math.isnan(spot.x), 0.0 if math.isnan(spot.x) else way * spot.x, grid.sign * spot.y)
    )
    return Front(grid.facets, spots)


def nondominated(x: Floats, y: Floats) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Tell which points no other one beats in two costs, (n,); those not finite in both never stand."""
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    order = known[np.lexsort((y[known], x[known]))]
    across, up = x[order], y[order]
    # Of points with one x the first in this order is the best; those before it have a smaller x.
    first = np.searchsorted(across, across, side="left")
    lowest_before = np.concatenate(([np.inf], np.minimum.accumulate(up)))[first]
    stands = np.zeros(len(x), dtype=bool)
    stands[order] = (up == up[first]) & (up < lowest_before)
    return stands
