# SPDX-License-Identifier: Apache-2.0
"""Accuracy against cost: which competitors nobody beats in both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.boards import COMPETITORS, prepare
from slamhive.analysis.grouping import Outcomes, sound, tally

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
        x, y: medians; y is infinite when the median run failed, x is NaN where nothing is known.
        x_range, y_range: smallest and largest of the runs that count.
        front: whether no other competitor is at least as good in both and better in one.
        runs, n: runs, and those that count.
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
    failures: dict[str, int]
    coverage: float


@dataclass(frozen=True)
class Front:
    """The competitors on one dataset under one set of facets, from cheap to costly."""

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
        x: the cost, a column of numbers, small is good.
        y: the error, small is good; failed runs are last in it.
        by: columns that tell competitors apart.
        outcomes: which runs have a figure that counts.
    """
    found = prepare(frame, [y, x], by, outcomes, by_dataset=True)
    return [_front(grid, x) for grid in found.grids], found.notes


def _front(grid: Grid, x: str) -> Front:
    costs = np.where(sound(grid.frame, x), grid.frame.column(x).floats(), np.nan)
    spots = [_spot(grid, place, costs) for place in sorted(grid.members)]
    best = nondominated(np.array([spot.x for spot in spots]), np.array([spot.y for spot in spots]))
    marked = [Spot(**{**vars(spot), "front": bool(on)}) for spot, on in zip(spots, best, strict=True)]
    return Front(grid.facets, sorted(marked, key=lambda spot: (np.isnan(spot.x), spot.x, spot.y)))


def _spot(grid: Grid, place: tuple[int, int], costs: Floats) -> Spot:
    rows = grid.members[place]
    errors = grid.numbers[rows]
    inside = grid.counted[rows] & ~np.isnan(errors)
    cost = costs[rows]
    # What a run costs is known even where it failed, but then it says nothing of the algorithm.
    cost = cost[inside & ~np.isnan(cost)]
    coverage = grid.mean_coverage(place)
    status = grid.frame.column("status")
    return Spot(
        keys=grid.competitors[place[0]],
        x=float(np.median(cost)) if len(cost) else np.nan,
        y=float(grid.medians[place]),
        x_range=_range(cost),
        y_range=_range(errors[inside]),
        front=False,
        runs=len(rows),
        n=int(np.count_nonzero(grid.counted[rows])),
        failures=tally(status.values, status.codes[rows][~grid.counted[rows]]),
        coverage=np.nan if coverage is None else coverage,
    )


def _range(values: Floats) -> tuple[float, float]:
    return (float(values.min()), float(values.max())) if len(values) else (np.nan, np.nan)


def nondominated(x: Floats, y: Floats) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Tell which points no other one beats, (n,); those that aren't finite in both never stand."""
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    order = known[np.lexsort((y[known], x[known]))]
    across, up = x[order], y[order]
    # Of points with one x the first in this order is the best; those before it have a smaller x.
    first = np.searchsorted(across, across, side="left")
    lowest_before = np.concatenate(([np.inf], np.minimum.accumulate(up)))[first]
    stands = np.zeros(len(x), dtype=bool)
    stands[order] = (up == up[first]) & (up < lowest_before)
    return stands
