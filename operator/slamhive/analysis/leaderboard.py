# SPDX-License-Identifier: Apache-2.0
"""Who is better: ranks over datasets with their uncertainty.

Metres of one dataset say nothing about another: so competitors are ranked within each dataset, and what is
averaged over datasets are those ranks, and the logarithms of ratios to the best of the dataset. A run that
failed is ranked behind all others, never left out. How sure a rank is comes from a hierarchical bootstrap:
datasets are drawn first, then repetitions within each (Field and Welsh 2007).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.grouping import (
    Groups,
    counting,
    disturbance_notes,
    failures_of,
    pooling_notes,
    ranked_errors,
    sound,
    varies,
    varying,
    varying_facets,
    with_facets,
)
from slamhive.analysis.pivot import SUBJECT, Outcomes, Summary
from slamhive.analysis.statistics import (
    Interval,
    average_ranks,
    median_of_sorted,
    resampled_medians,
    summarize,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.columns import Floats, Indices, Mask
    from slamhive.analysis.frame import Frame

COMPETITORS = ("algorithm", "sensors")
"""What is ranked unless told."""

DRAWS = 1000
_OF_LOAD = "usage."
_ONLY_OF_LOAD = ("provenance.cpuModel", "usage.includesReader")
_SEED = 20230529


@dataclass(frozen=True)
class Standing:
    """A competitor on one dataset.

    Attributes:
        dataset: its name.
        runs, n: runs, and those with a figure that counts.
        failures: runs by what became of them, tracked ones left out.
        median: of all runs, failed ones last; infinite when it is a failed one.
        rank: among the competitors on the dataset, from 1.
        summary: of the figures that count.
        coverage: mean coverage of the evaluated runs.
    """

    dataset: Any
    runs: int
    n: int
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
        rank: its place in the order of ``score``, from 1; equal ones share the mean.
        rank_interval: where its place lies with 95 % confidence.
        score: mean over its datasets of its rank there, scaled to 0 (best of all) … 1 (last of all).
        ratio: geometric mean over datasets of its median over the best median there; infinite where a
            median is a failed run.
        ratio_interval: where that lies with 95 % confidence.
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
        """Number of its runs with a figure that counts."""
        return sum(standing.n for standing in self.standings)


@dataclass(frozen=True)
class Board:
    """Competitors that can be compared: the same facets.

    Attributes:
        facets: the values that all runs of the board share, of columns that vary between boards.
        datasets: names of the datasets.
        entries: the best first.
    """

    facets: dict[str, Any]
    datasets: list[Any]
    entries: list[Entry]


@dataclass(frozen=True)
class Leaderboard:
    """Boards, one for each combination of facets.

    Attributes:
        metric: what is ranked by, small is good.
        by: columns that tell competitors apart.
        boards: those with most runs first.
        notes: sentences on what is pooled.
    """

    metric: str
    by: tuple[str, ...]
    boards: list[Board]
    notes: tuple[str, ...] = field(default=())


def leaderboard(
    frame: Frame,
    metric: str = "ate.rmse",
    by: Sequence[str] = COMPETITORS,
    outcomes: Outcomes = Outcomes.TRACKED,
    draws: int = DRAWS,
) -> Leaderboard:
    """Rank competitors over datasets by a metric that is better the smaller it is.

    Args:
        frame: one row a run and evaluation.
        metric: a column of numbers.
        by: columns that tell competitors apart.
        outcomes: which runs have a figure that counts; all others are ranked last.
        draws: bootstrap samples.
    """
    frame = with_facets(frame)
    facets = varying_facets(frame, (*by, *SUBJECT))
    notes: list[str] = []
    if not metric.startswith(_OF_LOAD):
        facets = [name for name in facets if name not in _ONLY_OF_LOAD]
        if varies(frame, "provenance.cpuModel") and "provenance.cpuModel" not in by:
            notes.append("runs of different processors are ranked together")
    pooled = [name for name in varying(frame) if name not in (*by, *facets)]
    notes += [*pooling_notes(pooled), *disturbance_notes(frame, [metric])]
    counted = counting(frame, outcomes) & sound(frame, metric)
    groups = Groups(frame, facets)
    told = [name for name in by if name not in facets]
    boards = [
        _board(frame.select(rows[part]), shared, (metric, told, draws), counted[rows[part]])
        for rows, shared in zip(groups.members(), groups.keys, strict=True)
        for part in _comparable(frame.select(rows), told)
    ]
    boards.sort(key=lambda board: -sum(entry.runs for entry in board.entries))
    return Leaderboard(metric, tuple(by), boards, tuple(notes))


def _comparable(frame: Frame, by: Sequence[str]) -> list[Mask]:
    """Return masks of the rows of competitors that are linked by common datasets, (n,) each."""
    competitors, datasets = Groups(frame, by), Groups(frame, ("dataset",))
    links: Mask = np.zeros((competitors.count, datasets.count), dtype=bool)
    links[competitors.of_row, datasets.of_row] = True
    left, parts = np.ones(competitors.count, dtype=bool), []
    while left.any():
        reached = np.zeros(competitors.count, dtype=bool)
        reached[int(np.argmax(left))] = True
        size = 0
        while size < (size := int(reached.sum())):
            reached = np.any(links[:, np.any(links[reached], axis=0)], axis=1)
        left[reached] = False
        parts.append(reached[competitors.of_row])
    return parts


def _board(
    frame: Frame, facets: dict[str, Any], question: tuple[str, Sequence[str], int], counted: Mask
) -> Board:
    metric, by, draws = question
    competitors, datasets = Groups(frame, by), Groups(frame, ("dataset",))
    cells = Groups(frame, (*by, "dataset"))
    numbers = frame.column(metric).floats()
    shape = (competitors.count, datasets.count)
    medians = np.full(shape, np.nan)
    drawn = np.full((draws, *shape), np.nan)
    members: dict[tuple[int, int], Indices] = {}
    generator = np.random.default_rng(_SEED)
    for rows in cells.members():
        place = (int(competitors.of_row[rows[0]]), int(datasets.of_row[rows[0]]))
        members[place] = rows
        ordered = ranked_errors(numbers[rows], counted[rows])
        medians[place] = median_of_sorted(ordered)
        drawn[:, place[0], place[1]] = resampled_medians(ordered, draws, generator)
    chosen = generator.integers(0, shape[1], (draws, shape[1]))
    drawn = np.take_along_axis(drawn, chosen[:, None, :], axis=2)
    scores, ratios = _scores(medians[None]), _ratios(medians[None])
    drawn_ranks = np.apply_along_axis(average_ranks, 1, np.nan_to_num(_scores(drawn), nan=1.0))
    drawn_ratios = _ratios(drawn)
    ranks = average_ranks(scores[0])
    within = _dataset_ranks(medians)
    names = [key["dataset"] for key in datasets.keys]
    entries = [
        Entry(
            keys=key,
            rank=float(ranks[number]),
            rank_interval=_percentiles(drawn_ranks[:, number]),
            score=float(scores[0, number]),
            ratio=float(ratios[0, number]),
            ratio_interval=_percentiles(drawn_ratios[:, number]),
            standings=[
                _standing(
                    frame,
                    members[number, place],
                    name,
                    (numbers, counted),
                    (float(medians[number, place]), float(within[number, place])),
                )
                for place, name in enumerate(names)
                if (number, place) in members
            ],
        )
        for number, key in enumerate(competitors.keys)
    ]
    entries.sort(key=lambda entry: (entry.rank, entry.ratio))
    return Board(facets, names, entries)


def _standing(
    frame: Frame,
    rows: Indices,
    dataset: Any,
    figures: tuple[Floats, Mask],
    found: tuple[float, float],
) -> Standing:
    numbers, counted = figures[0][rows], figures[1][rows]
    values = numbers[counted & ~np.isnan(numbers)]
    status = frame.column("status")
    coverage = frame.column("coverage").floats()[rows]
    coverage = coverage[~np.isnan(coverage)]
    return Standing(
        dataset=dataset,
        runs=len(rows),
        n=len(values),
        failures=failures_of(status.values, status.codes[rows]),
        median=found[0],
        rank=found[1],
        summary=summarize(values),
        coverage=float(coverage.mean()) if len(coverage) else None,
    )


def _dataset_ranks(medians: Floats) -> Floats:
    """Return ranks within each dataset, (competitors, datasets), NaN where one has no run."""
    ranks = np.full(medians.shape, np.nan)
    for place in range(medians.shape[1]):
        there = ~np.isnan(medians[:, place])
        ranks[there, place] = average_ranks(medians[there, place])
    return ranks


def _scores(medians: Floats) -> Floats:
    """Return each competitor's mean scaled rank, (draws, competitors), from (draws, competitors, datasets).

    Where a competitor has no run there is NaN, which is no one's rival.
    """
    there = ~np.isnan(medians)
    better = np.zeros(medians.shape)
    with np.errstate(invalid="ignore"):
        for rival in range(medians.shape[1]):
            other = medians[:, rival : rival + 1]
            better += (other < medians) + 0.5 * (other == medians)
    better -= 0.5  # a competitor equals itself
    rivals = np.maximum(there.sum(axis=1, keepdims=True) - 1, 1)
    return _mean(np.where(there, better / rivals, np.nan))


def _ratios(medians: Floats) -> Floats:
    """Return the geometric mean of medians over the best of each dataset, (draws, competitors)."""
    best = np.min(np.where(np.isnan(medians), np.inf, medians), axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = medians / best
        # All failed: nobody is worse than the best; an error of 0 is equalled by another one alone.
        ratios[(medians == best) & ~np.isnan(medians)] = 1.0
        return np.exp(_mean(np.log(ratios)))


def _mean(values: Floats) -> Floats:
    there = ~np.isnan(values)
    counts = there.sum(axis=-1)
    sums = np.where(there, values, 0.0).sum(axis=-1)
    found: Floats = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    return found


def _percentiles(values: Floats) -> Interval:
    known = np.sort(values[~np.isnan(values)])
    if not len(known):
        return Interval(np.nan, np.nan, "bootstrap")
    last = len(known) - 1
    return Interval(float(known[round(0.025 * last)]), float(known[round(0.975 * last)]), "bootstrap")
