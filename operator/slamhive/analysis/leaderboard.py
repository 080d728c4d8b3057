# SPDX-License-Identifier: Apache-2.0
"""Leaderboard: ranks of competitors over datasets, with their uncertainty. Dashboard and report show it.

Metres of one dataset say nothing about another: so competitors are ranked within each dataset, and what is
averaged over datasets are those ranks, and the logarithms of ratios to the best of the dataset. A run that
failed is ranked behind all others, never left out. How sure a rank is comes from a hierarchical bootstrap:
datasets are drawn first, then repetitions within each (Field and Welsh 2007).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.boards import (
    COMPETITORS,
    mean_of_known,
    mean_ranks,
    prepare,
    ranks_of_known,
    scaled_ranks,
)
from slamhive.analysis.grouping import Outcomes
from slamhive.analysis.statistics import (
    Interval,
    Summary,
    average_ranks,
    log_ratios,
    percentiles,
    resampled_medians,
)
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from slamhive.analysis.boards import Grid
    from slamhive.analysis.columns import Floats
    from slamhive.analysis.frame import Frame

DRAWS = 1000
MAX_COMPETITORS = 500
"""Rows of a table that a page can still show."""
_SEED = 20230529
_MOST_NAMES = 3
_UNKNOWN = Interval(math.nan, math.nan, "none: a single result")


@dataclass(frozen=True)
class Standing:
    """A competitor on one dataset.

    Attributes:
        dataset: its name.
        runs, n: runs, and different results of those that count.
        copies: runs that count and repeat a result.
        failures: runs that don't, by what became of them.
        median: of the figures, failed runs last; infinite, below 0 where large is good, when it is a failed
            one, NaN where none has a rank.
        rank: among the competitors on the dataset, from 1; NaN where no run has one.
        summary: of the figures that count.
        coverage: mean over the evaluated runs, with 0 for those that failed of themselves.
    """

    dataset: Any
    runs: int
    n: int
    copies: int
    failures: dict[str, int]
    median: float
    rank: float
    summary: Summary | None
    coverage: float | None


@dataclass(frozen=True)
class Entry:
    """A competitor.

    Attributes:
        keys: what it is.
        rank: its place in the order of ``score``, from 1; equal ones share the mean. NaN for who never
            succeeded: such a one has no score either, and comes after all others.
        rank_interval: where its place lies with 95 % confidence; NaN of a single result, which can't tell.
        score: mean over its datasets of its rank there, scaled to 0 (best of all) … 1 (last of all).
        ratio: geometric mean over datasets of its median over the best median there, where large is good of
            the best over it; infinite where a median is a failed run.
        ratio_interval: where that lies with 95 % confidence; NaN of a single result.
        standings: by dataset.
    """

    keys: dict[str, Any]
    rank: float
    rank_interval: Interval
    score: float
    ratio: float
    ratio_interval: Interval
    standings: list[Standing]

    @property
    def runs(self) -> int:
        """Number of its runs."""
        return sum(standing.runs for standing in self.standings)

    @property
    def n(self) -> int:
        """Number of different results among its runs that count."""
        return sum(standing.n for standing in self.standings)

    @property
    def copies(self) -> int:
        """Number of its runs that count and repeat a result."""
        return sum(standing.copies for standing in self.standings)

    @property
    def failed(self) -> int:
        """Number of its runs that don't count."""
        return sum(sum(standing.failures.values()) for standing in self.standings)

    @property
    def unranked(self) -> str:
        """Reason in words for having no rank; empty where it has one."""
        if not np.isnan(self.rank):
            return ""
        never = any(np.isinf(standing.median) for standing in self.standings)
        return "never succeeded" if never else "nothing measured"


@dataclass(frozen=True)
class Board:
    """Competitors that can be compared: the same facets.

    Attributes:
        facets: the values that all runs of the board share, of columns that vary between boards.
        datasets: names of the datasets.
        entries: the best first, those without a rank last.
    """

    facets: dict[str, Any]
    datasets: list[Any]
    entries: list[Entry]


@dataclass(frozen=True)
class Leaderboard:
    """Boards, one for each combination of facets.

    Attributes:
        metric: what is ranked by.
        by: columns that tell competitors apart.
        boards: those with most runs first.
        pooled: settings that rows are over, with the number of their values.
        whose: algorithms whose rows are over a setting, where not all are.
        notes: sentences on what is pooled.
    """

    metric: str
    by: tuple[str, ...]
    boards: list[Board]
    pooled: dict[str, int] = field(default_factory=dict)
    whose: dict[str, tuple[str, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = field(default=())

    @property
    def pooling(self) -> str:
        """Sentence on the settings that rows are over; empty where there are none."""
        named = list(self.pooled)[:_MOST_NAMES]
        told = [f"{self.pooled[name]} values of {name}{self._whose(name)}" for name in named]
        told += [f"{len(self.pooled) - len(named)} further settings"] if len(self.pooled) > len(named) else []
        apart = ", ".join([*self.by, *named])
        return f"Rows are over {', '.join(told)}: by {apart} tells them apart." if told else ""

    def _whose(self, name: str) -> str:
        mine = self.whose.get(name, ())
        return (
            f" ({', '.join(mine) if len(mine) <= _MOST_NAMES else f'{len(mine)} algorithms'})" if mine else ""
        )


def leaderboard(
    frame: Frame,
    metric: str = "ate.rmse",
    by: Sequence[str] = COMPETITORS,
    outcomes: Outcomes = Outcomes.TRACKED,
    draws: int = DRAWS,
) -> Leaderboard:
    """Rank competitors over datasets by a metric: the best first, as its measure has it, else the smallest.

    Args:
        frame: one row a run and evaluation.
        metric: a column of numbers.
        by: columns that tell competitors apart.
        outcomes: which runs have a figure that counts; all others are ranked last.
        draws: bootstrap samples.

    Raises:
        InputError: a board would have more than `MAX_COMPETITORS`.
    """
    found = prepare(frame, [metric], by, outcomes)
    most = max((len(grid.competitors) for grid in found.grids), default=0)
    if most > MAX_COMPETITORS:
        raise InputError(
            f"leaderboard by {', '.join(by)}: {most} competitors on one board, at most {MAX_COMPETITORS} can "
            "be ranked; fewer columns in by, or a condition on the runs, leave fewer"
        )
    boards = [_board(grid, draws) for grid in found.grids]
    return Leaderboard(metric, tuple(by), boards, found.pooled, found.whose, found.notes)


def _board(grid: Grid, draws: int) -> Board:
    scores, ratios = mean_ranks(grid.rated), np.exp(mean_of_known(_log_ratios(grid.rated.T, grid.sign).T))
    # Of whom no median run came through is not as good as the best, though all others failed too.
    ratios[np.isinf(grid.medians).any(axis=1) & ~np.isfinite(grid.rated).any(axis=1)] = np.inf
    drawn_ranks, drawn_ratios = _bootstrap(grid, draws)
    # Scores that differ by rounding alone are equal.
    ranks, within = ranks_of_known(np.round(scores, 12)), ranks_of_known(grid.rated.T).T
    rank_intervals, ratio_intervals = percentiles(drawn_ranks.T), percentiles(drawn_ratios.T)
    standings: list[list[Standing]] = [[] for _ in grid.competitors]
    for number, standing in _standings(grid, within):
        standings[number].append(standing)
    several = [sum(one.n + sum(one.failures.values()) for one in mine) > 1 for mine in standings]
    entries = [
        Entry(
            keys=key,
            rank=float(ranks[number]),
            rank_interval=rank_intervals[number] if several[number] else _UNKNOWN,
            score=float(scores[number]),
            ratio=float(ratios[number]),
            ratio_interval=ratio_intervals[number] if several[number] else _UNKNOWN,
            standings=standings[number],
        )
        for number, key in enumerate(grid.competitors)
    ]
    entries.sort(key=lambda entry: (np.isnan(entry.rank), entry.rank, entry.ratio))
    return Board(grid.facets, grid.datasets, entries)


def _bootstrap(grid: Grid, draws: int) -> tuple[Floats, Floats]:
    """Return ranks and ratios of samples: datasets are drawn, then repetitions in each, (draws, c) each."""
    generator = np.random.default_rng(_SEED)
    count, datasets = grid.medians.shape
    chosen = generator.integers(0, datasets, (draws, datasets))
    scores, logs, weights = np.zeros((3, draws, count))
    for place in range(datasets):
        times = np.count_nonzero(chosen == place, axis=1)
        drawing = np.flatnonzero(times)
        drawn = np.full((count, len(drawing)), np.nan)
        for group in np.flatnonzero(grid.at[:, 1] == place).tolist():
            ordered = grid.ranked(group)
            if len(ordered) and grid.contends[grid.at[group, 0]]:
                drawn[grid.at[group, 0]] = resampled_medians(ordered, len(drawing), generator)
        medians = np.ascontiguousarray(drawn.T)
        weight = times[drawing, None] * ~np.isnan(medians)
        scores[drawing] += weight * np.nan_to_num(scaled_ranks(medians))
        logs[drawing] += np.where(weight > 0, times[drawing, None] * _log_ratios(medians, grid.sign), 0.0)
        weights[drawing] += weight
    with np.errstate(invalid="ignore", over="ignore"):
        scores, ratios = scores / weights, np.exp(logs / weights)
    ranks = average_ranks(np.where(grid.contends, np.nan_to_num(scores, nan=1.0), np.inf))
    return np.where(grid.contends, ranks, np.nan), ratios


def _standings(grid: Grid, ranks: Floats) -> Iterator[tuple[int, Standing]]:
    """Go through the competitors' standings, dataset by dataset, each with the competitor's number."""
    places = grid.places
    lists = zip(
        grid.at.tolist(),
        places.sizes.tolist(),
        places.counts(grid.counted & grid.once).tolist(),
        places.counts(grid.counted & ~grid.once).tolist(),
        grid.failures(),
        map(grid.figures.summaries().of, range(places.count)),
        grid.mean_coverages(),
        strict=True,
    )
    for (number, place), runs, n, copies, failures, summary, coverage in lists:
        yield (
            number,
            Standing(
                dataset=grid.datasets[place],
                runs=runs,
                n=n,
                copies=copies,
                failures=failures,
                median=grid.sign * float(grid.medians[number, place]),
                rank=float(ranks[number, place]),
                summary=summary,
                coverage=coverage,
            ),
        )


def _log_ratios(medians: Floats, sign: float) -> Floats:
    """Return by how much costs are worse than the best of a dataset; the same shape, (…, competitors).

    All failed: nobody is worse than the best; an error of 0 is equalled by another one alone.
    """
    return log_ratios(np.fmin.reduce(medians, axis=-1, keepdims=True), medians, sign)
