# SPDX-License-Identifier: Apache-2.0
"""Comparison of competitors in pairs: which one is better, and whether that is more than chance.

The unit is the dataset: repetitions on one dataset are not independent of each other, so each dataset gives
one pair of medians. Their differences are logarithms of ratios, tested by flipping signs (exact up to 14
datasets), and corrected for the number of pairs (Holm 1979).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.boards import COMPETITORS, Window, prepare
from slamhive.analysis.grouping import Outcomes
from slamhive.analysis.measures import Better, measure_of
from slamhive.analysis.statistics import (
    Interval,
    average_ranks,
    holm,
    log_ratios,
    percentiles,
    resampled_medians,
    sign_flip_tests,
)
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.boards import Grid
    from slamhive.analysis.columns import Floats, Indices
    from slamhive.analysis.frame import Frame

MAX_COMPETITORS = 40
"""Competitors whose pairs are shown at most: a table of 780."""

MOST_TESTED = 500
"""Competitors whose pairs are tested at most, as many as a leaderboard has."""

DRAWS = 500
LEVEL = 0.05
_SEED = 20230529
_RATIOS_AT_ONCE = 200_000
"""Ratios reckoned with at once: what they need memory for."""


@dataclass(frozen=True)
class CompetitorPair:
    """Two competitors over their common datasets.

    Attributes:
        a, b: what they are.
        datasets: names of the datasets.
        medians: of a and of b on each, infinite where the median run failed.
        ratio: geometric mean of b over a. NaN where failed runs forbid it.
        ratio_interval: where it lies with 95 % confidence, by hierarchical bootstrap.
        wins: datasets on which a is better, b is better, neither.
        effect: matched-pairs rank-biserial correlation, −1 … 1; above 0 a is better.
        p: that both are equally good, two-sided.
        p_holm: corrected for the number of pairs.
        least_p: the smallest p that so many datasets can give.
        word: what the one is more often than the other: better, or lower where it isn't known which is good.
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
    word: str

    def flat(self) -> dict[str, Any]:
        """Return it as a flat record."""
        return {
            **{f"a.{name}": value for name, value in self.a.items()},
            **{f"b.{name}": value for name, value in self.b.items()},
            "datasets": len(self.datasets),
            "ratio": self.ratio,
            "ratio.low": self.ratio_interval.low,
            "ratio.high": self.ratio_interval.high,
            "wins.a": self.wins[0],
            "wins.b": self.wins[1],
            "effect": self.effect,
            "p": self.p,
            "p.holm": self.p_holm,
            "p.least": self.least_p,
            "sentence": self.sentence,
        }

    @property
    def sentence(self) -> str:
        """Result in a sentence: how often each competitor is better, and whether that may be chance."""
        count = len(self.datasets)
        datasets = "1 dataset" if count == 1 else f"{count} datasets"
        better = f"{_words(self.a)} {self.wins[0]} times {self.word}, {_words(self.b)} {self.wins[1]} times"
        if self.p_holm <= LEVEL:
            return f"{better} on {datasets}: more than chance (p = {self.p_holm:.3g} after correction)"
        if self.least_p > LEVEL:
            return f"{better} on {datasets}: too few to tell (p can't go below {self.least_p:.3g})"
        return f"{better} on {datasets}: may be chance (p = {self.p_holm:.3g} after correction)"


@dataclass(frozen=True)
class BoardComparison:
    """Pairs of one board.

    Attributes:
        facets: the values that all runs of the board share.
        pairs: those of the competitors that are shown, the surest first.
        competitors: how many there are in all.
        shown: how many have their pairs shown.
    """

    facets: dict[str, Any]
    pairs: list[CompetitorPair]
    competitors: int
    shown: int


def compare(
    frame: Frame,
    metric: str = "ate.rmse",
    by: Sequence[str] = COMPETITORS,
    outcomes: Outcomes = Outcomes.TRACKED,
    window: Window | None = None,
) -> tuple[list[BoardComparison], list[str]]:
    """Compare competitors two by two; returns one comparison a board, and notes.

    All pairs of a board are tested, and p is corrected for their number, whichever are shown.

    Args:
        frame: one row a run and evaluation.
        metric: a column of numbers.
        by: columns that tell competitors apart.
        outcomes: which runs have a figure that counts; all others are ranked last.
        window: the competitors whose pairs are shown.

    Raises:
        InputError: a board would have more than MOST_TESTED.
    """
    window = window or Window()
    found = prepare(frame, [metric], by, outcomes)
    notes = list(found.notes)
    boards = []
    for grid in found.grids:
        count = len(grid.competitors)
        if count > MOST_TESTED:
            raise InputError(
                f"pairs by {', '.join(by)}: {count} competitors on one board, at most {MOST_TESTED} can be "
                "compared; fewer columns in by, or a condition on the runs, leave fewer"
            )
        chosen = window.of(grid.rated, readable=count <= MAX_COMPETITORS)
        boards.append(_compared(grid, chosen))
        if told := window.notes(len(chosen), count):
            notes += [*told, "p is corrected for all pairs, shown or not"]
    return boards, list(dict.fromkeys(notes))


def _compared(grid: Grid, chosen: Indices) -> BoardComparison:
    medians = grid.rated
    first, second = np.triu_indices(len(grid.competitors), 1)
    common = ~np.isnan(medians[first]) & ~np.isnan(medians[second])
    some = common.any(axis=1)
    first, second, common = first[some], second[some], common[some]
    lengths = common.sum(axis=1)
    chances, effects = np.ones((2, len(first)))
    wins = np.zeros((len(first), 3), dtype=np.intp)
    for length in np.unique(lengths).tolist():
        # Pairs of equally many datasets are lines of one matrix.
        alike = np.flatnonzero(lengths == length)
        for start in range(0, len(alike), most := max(1, _RATIOS_AT_ONCE // length)):
            pairs = alike[start : start + most]
            line = np.nonzero(common[pairs])[1].reshape(-1, length)
            of_a, of_b = (medians[one[pairs, None], line] for one in (first, second))
            differences = log_ratios(of_a, of_b, grid.sign)
            signs = signed_differences(differences)
            chances[pairs], effects[pairs] = sign_flip_tests(signs), rank_biserial(signs)
            wins[pairs] = np.stack([(signs > 0).sum(1), (signs < 0).sum(1), (signs == 0).sum(1)], axis=1)
    corrected = holm(chances)
    shown = np.flatnonzero(np.isin(first, chosen) & np.isin(second, chosen))
    told = [(int(first[k]), int(second[k]), np.flatnonzero(common[k])) for k in shown]
    pairs_shown = [
        CompetitorPair(
            a=grid.competitors[a],
            b=grid.competitors[b],
            datasets=[grid.datasets[place] for place in both.tolist()],
            medians=list(zip(*(grid.sign * medians[[a, b]][:, both]).tolist(), strict=True)),
            ratio=_mean_ratio(medians[a, both], medians[b, both], grid.sign),
            ratio_interval=interval,
            wins=(won, lost, even),
            effect=effect,
            p=p,
            p_holm=p_holm,
            least_p=min(1.0, 2.0 ** (1 - len(both))),
            word="lower" if measure_of(grid.metric).better is Better.NONE else "better",
        )
        for (a, b, both), interval, (won, lost, even), effect, p, p_holm in zip(
            told,
            _ratio_intervals(grid, chosen, told),
            wins[shown].tolist(),
            effects[shown].tolist(),
            chances[shown].tolist(),
            np.array(corrected)[shown].tolist(),
            strict=True,
        )
    ]
    pairs_shown.sort(key=lambda pair: (pair.p_holm, -abs(pair.effect)))
    return BoardComparison(grid.facets, pairs_shown, len(grid.competitors), len(chosen))


def _mean_ratio(first: Floats, second: Floats, sign: float) -> float:
    differences = log_ratios(first, second, sign)
    if not np.isfinite(differences).all():
        return math.nan
    mean = sign * float(differences.mean())
    return math.exp(mean) if math.isfinite(mean) else math.nan


def _ratio_intervals(
    grid: Grid, chosen: Indices, pairs: Sequence[tuple[int, int, Indices]]
) -> list[Interval]:
    """Return the intervals of the ratios of pairs, by drawing datasets and then repetitions in each.

    Args:
        grid: the competitors.
        chosen: those whose pairs these are.
        pairs: two competitors and the datasets that both have, each.
    """
    generator = np.random.default_rng(_SEED)
    row = np.full(len(grid.competitors), -1)
    row[chosen] = np.arange(len(chosen))
    drawn = np.full((len(chosen), len(grid.datasets), DRAWS), np.nan)
    for group, (number, place) in enumerate(grid.at.tolist()):
        if row[number] >= 0 and len(ordered := grid.ranked(group)):
            drawn[row[number], place] = resampled_medians(ordered, DRAWS, generator)
    found: list[Interval] = []
    for length, alike in groupby(pairs, lambda pair: len(pair[2])):
        rest = list(alike)
        at_once = max(1, _RATIOS_AT_ONCE // (DRAWS * length))
        for start in range(0, len(rest), at_once):
            part = rest[start : start + at_once]
            line = np.array([common for _, _, common in part])
            first, second = (
                drawn[row[np.array([pair[side] for pair in part])][:, np.newaxis], line] for side in (0, 1)
            )
            places = np.array([generator.integers(0, length, (DRAWS, length)) for _ in part])
            samples = np.take_along_axis(
                grid.sign * log_ratios(first, second, grid.sign).swapaxes(1, 2), places, axis=2
            )
            with np.errstate(invalid="ignore"):
                found += percentiles(np.exp(np.ascontiguousarray(samples).mean(axis=2)))
    return found


def signed_differences(differences: Floats) -> Floats:
    """Return differences, (…, n), infinite ones larger than all others in their line: a failure outweighs."""
    finite = np.where(np.isfinite(differences), np.abs(differences), 0.0)
    beyond = 2 * finite.max(axis=-1, keepdims=True, initial=0.0) + 1.0
    return np.where(np.isfinite(differences), differences, np.sign(differences) * beyond)


def rank_biserial(differences: Floats) -> Floats:
    """Return matched-pairs rank-biserial correlations, −1 … 1, of lines of differences (Kerby 2014).

    Args:
        differences: (lines, n).
    """
    still = differences == 0
    ranks = average_ranks(np.abs(differences)) - still.sum(axis=1, keepdims=True)
    ranks[still] = 0.0  # the smallest, and of no weight
    totals = ranks.sum(axis=1)
    found: Floats = (ranks * np.sign(differences)).sum(axis=1) / np.where(totals > 0, totals, 1.0)
    return found


def _words(keys: dict[str, Any]) -> str:
    return " ".join("–" if value is None else str(value) for value in keys.values())
