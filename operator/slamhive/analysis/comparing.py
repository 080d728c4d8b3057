# SPDX-License-Identifier: Apache-2.0
"""Comparison of competitors in pairs: which has the smaller errors, and whether that is more than chance.

The unit is the dataset: repetitions on one dataset are not independent of each other, so each dataset gives
one pair of medians. Their differences are logarithms of ratios, tested by flipping signs (exact up to 14
datasets), and corrected for the number of pairs (Holm 1979).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.boards import COMPETITORS, prepare
from slamhive.analysis.grouping import Outcomes
from slamhive.analysis.statistics import (
    Interval,
    average_ranks,
    holm,
    percentiles,
    resampled_medians,
    sign_flip_test,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.boards import Grid
    from slamhive.analysis.columns import Floats
    from slamhive.analysis.frame import Frame

MAX_COMPETITORS = 40
DRAWS = 500
LEVEL = 0.05
_SEED = 20230529


@dataclass(frozen=True)
class Pair:
    """Two competitors over their common datasets.

    Attributes:
        a, b: what they are.
        datasets: names of the datasets.
        medians: of a and of b on each, infinite where the median run failed.
        ratio: geometric mean of b over a; above 1 a has the smaller errors. NaN where failed runs forbid it.
        ratio_interval: where it lies with 95 % confidence, by hierarchical bootstrap.
        wins: datasets on which a is better, b is better, neither.
        effect: matched-pairs rank-biserial correlation, −1 … 1; above 0 a has the smaller errors.
        p: that both are equally good, two-sided.
        p_holm: corrected for the number of pairs.
        least_p: the smallest p that so many datasets can give.
    """

    a: dict[str, Any]
    b: dict[str, Any]
    datasets: list[Any]
    medians: list[tuple[float, float]]
    ratio: float
    ratio_interval: Interval
    wins: tuple[int, int, int]
    effect: float
    p: float
    p_holm: float
    least_p: float

    @property
    def sentence(self) -> str:
        """Result in a sentence: how often each competitor is better, and whether that may be chance."""
        count = len(self.datasets)
        datasets = "1 dataset" if count == 1 else f"{count} datasets"
        better = f"{_words(self.a)} {self.wins[0]} times better, {_words(self.b)} {self.wins[1]} times"
        if self.p_holm <= LEVEL:
            return f"{better} on {datasets}: more than chance (p = {self.p_holm:.3g} after correction)"
        if self.least_p > LEVEL:
            return f"{better} on {datasets}: too few to tell (p can't go below {self.least_p:.3g})"
        return f"{better} on {datasets}: may be chance (p = {self.p_holm:.3g} after correction)"


@dataclass(frozen=True)
class Comparison:
    """All pairs of one board.

    Attributes:
        facets: the values that all runs of the board share.
        pairs: the surest first.
    """

    facets: dict[str, Any]
    pairs: list[Pair]


def compare(
    frame: Frame,
    metric: str = "ate.rmse",
    by: Sequence[str] = COMPETITORS,
    outcomes: Outcomes = Outcomes.TRACKED,
) -> tuple[list[Comparison], list[str]]:
    """Compare competitors two by two; returns one comparison a board, and notes.

    Args:
        frame: one row a run and evaluation.
        metric: a column of numbers, small is good.
        by: columns that tell competitors apart.
        outcomes: which runs have a figure that counts; all others are ranked last.
    """
    found = prepare(frame, [metric], by, outcomes)
    notes = list(found.notes)
    boards = []
    for grid in found.grids:
        if len(grid.competitors) > MAX_COMPETITORS:
            notes.append(
                f"of {len(grid.competitors)} competitors the {MAX_COMPETITORS} with most runs are compared"
            )
        boards.append(Comparison(grid.facets, _pairs(grid)))
    return boards, notes


def _pairs(grid: Grid) -> list[Pair]:
    runs = [0] * len(grid.competitors)
    for (number, _), rows in grid.members.items():
        runs[number] += len(rows)
    chosen = sorted(sorted(range(len(runs)), key=lambda number: -runs[number])[:MAX_COMPETITORS])
    generator = np.random.default_rng(_SEED)
    drawn = {
        place: resampled_medians(ordered, DRAWS, generator)
        for place in grid.members
        if place[0] in set(chosen) and len(ordered := grid.ranked(place))
    }
    pairs = [
        pair
        for a, b in combinations(chosen, 2)
        if (pair := _pair(grid, (a, b), drawn, generator)) is not None
    ]
    corrected = holm([pair.p for pair in pairs])
    finished = [
        Pair(**{**vars(pair), "p_holm": p_holm}) for pair, p_holm in zip(pairs, corrected, strict=True)
    ]
    return sorted(finished, key=lambda pair: (pair.p_holm, -abs(pair.effect)))


def _pair(
    grid: Grid, who: tuple[int, int], drawn: dict[tuple[int, int], Floats], generator: np.random.Generator
) -> Pair | None:
    a, b = who
    common = np.flatnonzero(~np.isnan(grid.medians[a]) & ~np.isnan(grid.medians[b])).tolist()
    if not common:
        return None
    first, second = grid.medians[a, common], grid.medians[b, common]
    differences = log_ratios(first, second)
    finite = np.isfinite(differences)
    signs = signed_differences(differences)
    places = generator.integers(0, len(common), (DRAWS, len(common)))
    samples = np.array([log_ratios(drawn[a, place], drawn[b, place]) for place in common])
    with np.errstate(invalid="ignore"):
        means = samples[places, np.arange(DRAWS)[:, None]].mean(axis=1)
        mean = float(differences.mean()) if finite.all() else math.nan
        interval = percentiles(np.exp(means))
    return Pair(
        a=grid.competitors[a],
        b=grid.competitors[b],
        datasets=[grid.datasets[place] for place in common],
        medians=list(zip(first.tolist(), second.tolist(), strict=True)),
        ratio=math.exp(mean) if math.isfinite(mean) else math.nan,
        ratio_interval=interval,
        wins=(int((signs > 0).sum()), int((signs < 0).sum()), int((signs == 0).sum())),
        effect=rank_biserial(signs),
        p=sign_flip_test(signs),
        p_holm=1.0,
        least_p=min(1.0, 2.0 ** (1 - len(common))),
    )


def log_ratios(first: Floats, second: Floats) -> Floats:
    """Return log(second / first), (n,): ±inf where one failed, 0 where both did or both are equal."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = np.log(second / first)
    ratios[first == second] = 0.0
    return ratios


def signed_differences(differences: Floats) -> Floats:
    """Return differences with infinite ones made larger than all others, (n,): a failure outweighs."""
    finite = np.abs(differences[np.isfinite(differences)])
    beyond = 2 * float(finite.max(initial=0.0)) + 1.0
    return np.where(np.isfinite(differences), differences, np.sign(differences) * beyond)


def rank_biserial(differences: Floats) -> float:
    """Return the matched-pairs rank-biserial correlation of differences, −1 … 1 (Kerby 2014)."""
    moved = differences[differences != 0]
    if not len(moved):
        return 0.0
    ranks = average_ranks(np.abs(moved))
    return float((ranks * np.sign(moved)).sum() / ranks.sum())


def _words(keys: dict[str, Any]) -> str:
    return " ".join("–" if value is None else str(value) for value in keys.values())
