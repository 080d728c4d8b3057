# SPDX-License-Identifier: Apache-2.0
"""Medians of competitors on datasets: what leaderboard, comparison and Pareto front begin with."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.cells import Places
from slamhive.analysis.columns import FIRST_THEN_ALL
from slamhive.analysis.grouping import (
    LOAD,
    PROCESSOR,
    SUBJECT,
    Copies,
    Groups,
    apart,
    condition_words,
    copy_notes,
    counting,
    covered,
    differing,
    direction_notes,
    disturbance_notes,
    idle_notes,
    origin_notes,
    pooling_notes,
    reader_notes,
    sound,
    unranked_notes,
    varies,
    varying,
    without_chosen,
    worst,
)
from slamhive.analysis.measures import follows_trajectory, measure_of
from slamhive.analysis.statistics import Numbers, average_ranks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.columns import Floats, Indices, Mask
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.grouping import Outcomes

VERSION = "algorithm.version"

COMPETITORS = ("algorithm", "sensors")
"""Columns that tell competitors apart unless others are named."""

READABLE = 12
"""Competitors that are shown unless asked otherwise where nobody could read all of them."""


@dataclass(frozen=True)
class Window:
    """The competitors that are shown where there are too many, by their place in the order of mean ranks.

    Attributes:
        most: how many; None for all where they can be read, else for READABLE of them.
        first: place of the first one, from 1 for the best.
    """

    most: int | None = None
    first: int = 1

    def of(self, medians: Floats, *, readable: bool) -> Indices:
        """Return the numbers of the competitors that are shown, ascending.

        Args:
            medians: of competitors on datasets, failed runs' infinite, NaN where no run has a rank, (c, d).
            readable: whether all of them can be shown.
        """
        if readable and self == Window():
            return np.arange(len(medians))
        # Scores that differ by rounding alone are equal; those of whom no median came through come last.
        scores = np.where(np.isfinite(medians).any(axis=1), np.round(mean_ranks(medians), 12), np.inf)
        order = np.argsort(scores, kind="stable")
        begin = self.first - 1
        return np.sort(order[begin : begin + (self.most or READABLE)])

    def notes(self, shown: int, count: int) -> list[str]:
        """Say which of the competitors are shown, where that isn't all of them."""
        if shown == count:
            return []
        if not shown:
            return [f"there are {count} competitors: none has place {self.first} by mean rank"]
        best = f"the {shown} best" if self.first == 1 else f"places {self.first} to {self.first + shown - 1}"
        return [f"of {count} competitors {best} by mean rank are shown: first and most choose others"]


@dataclass(frozen=True)
class Grid:
    """Competitors that can be compared on their datasets.

    Attributes:
        metric: what is compared.
        facets: the values that all runs share, of columns that vary between grids.
        frame: the runs, place by place.
        competitors: what each is, by column, (c,).
        datasets: names, (d,).
        places: the rows of the runs of a competitor on a dataset, where it has any.
        at: the competitor and the dataset of each of these places, (places, 2).
        numbers: the metric of each row, (n,).
        counted: rows with a figure that counts, (n,).
        failed: rows that failed of themselves, (n,): they rank behind all figures.
        once: rows but those that repeat the result of an earlier one, where the metric is of it, (n,).
        coverage: of each row, 0 where it failed of itself, NaN where that isn't known and for copies, (n,).
    """

    metric: str
    facets: dict[str, Any]
    frame: Frame
    competitors: list[dict[str, Any]]
    datasets: list[Any]
    places: Places
    at: Indices
    numbers: Floats
    counted: Mask
    failed: Mask
    once: Mask
    coverage: Floats

    @property
    def sign(self) -> float:
        """Factor that makes costs of figures, of which small is good."""
        return measure_of(self.metric).sign

    @cached_property
    def figures(self) -> Numbers:
        """The figures that count, of each place."""
        return self.places.numbers(self.numbers, self.counted & self.once)

    @cached_property
    def costs(self) -> Numbers:
        """The same as costs."""
        return self.figures.times(self.sign)

    @cached_property
    def behind(self) -> Indices:
        """Numbers of failed runs of each place, which rank behind all its figures, (places,)."""
        return self.places.counts(self.failed & self.once)

    @cached_property
    def contends(self) -> Mask:
        """Mask of the competitors of whom any run has a figure, (c,): others have no rank and no rivals."""
        found: Mask = np.zeros(len(self.competitors), dtype=bool)
        found[self.at[self.figures.counts > 0, 0]] = True
        return found

    @cached_property
    def rated(self) -> Floats:
        """Medians of costs of those who contend, NaN for all others, (c, d)."""
        return np.where(self.contends[:, None], self.medians, np.nan)

    @cached_property
    def medians(self) -> Floats:
        """Medians of costs, (c, d): infinite for a failed run, NaN where no run has a rank."""
        found = np.full((len(self.competitors), len(self.datasets)), np.nan)
        found[self.at[:, 0], self.at[:, 1]] = self.costs.medians(self.behind)
        return found

    def ranked(self, place: int) -> Floats:
        """Return the sorted costs of a place, failed runs last."""
        return np.concatenate([self.costs.ordered(place), np.full(self.behind[place], np.inf)])

    def mean_coverages(self) -> list[float | None]:
        """Return the mean coverage of each place; None where nothing is known of it."""
        means = self.places.numbers(self.coverage, ~np.isnan(self.coverage)).means()
        return [None if mean != mean else mean for mean in means.tolist()]  # noqa: PLR0124 - NaN

    def failures(self) -> list[dict[str, int]]:
        """Return the counts of each place's runs that don't count, by their status."""
        status = self.frame.column("status")
        found = self.places.tallies(status.values, status.codes.astype(np.intp), ~self.counted)
        return [found.get(place, {}) for place in range(self.places.count)]


@dataclass(frozen=True)
class PreparedGrids:
    """Grids of one question, with the settings that are pooled in them, whose they are, and sentences."""

    grids: list[Grid]
    pooled: dict[str, int]
    whose: dict[str, tuple[str, ...]]
    notes: tuple[str, ...]


def prepare(
    frame: Frame, metrics: Sequence[str], by: Sequence[str], outcomes: Outcomes, *, by_dataset: bool = False
) -> PreparedGrids:
    """Split runs into grids of what can be compared.

    Figures on errors are compared over processors, which is said; those on load never are.

    Args:
        frame: one row a run and evaluation.
        metrics: columns of numbers; the grids hold the first.
        by: columns that tell competitors apart.
        outcomes: which runs have a figure that counts.
        by_dataset: whether each dataset is a grid of its own.
    """
    frame, notes = without_chosen(frame)
    frame, facets = apart(frame, (*by, "dataset"), metrics)
    if "algorithm" in by and VERSION in facets:
        # Versions of an algorithm compete with each other, and with all others.
        facets.remove(VERSION)
        by = [*by, VERSION]
    if not any(metric.startswith(LOAD) for metric in metrics):
        if varies(frame, PROCESSOR) and PROCESSOR not in by:
            notes.append("runs of different processors are compared with each other")
    elif unlike := condition_words(facets):
        notes.append(f"runs {unlike} are ranked apart: their loads can't be compared")
    if "alignment" in facets or "evaluation" in facets:
        notes.append("runs of different evaluations are ranked apart: their errors can't be compared")
    pooled = [name for name in varying(frame) if name not in (*by, *facets)]
    notes += [*pooling_notes(pooled), *idle_notes(frame, pooled)]
    notes += [*direction_notes(metrics), *disturbance_notes(frame, metrics)]
    notes += unranked_notes(frame, outcomes) + reader_notes(frame, metrics) + origin_notes(frame)
    if by_dataset:
        facets = [*facets, "dataset"]
    metric = metrics[0]
    numbers = np.where(sound(frame, metric, outcomes), frame.column(metric).floats(), np.nan)
    counted = counting(frame, outcomes)
    cells = Groups(frame, [*facets, *by, "dataset"])
    once = ~Copies(frame, outcomes).among(cells.of_row)
    coverage = np.where(once, covered(frame), np.nan)
    if follows_trajectory(metric):
        notes += copy_notes(int((counted & ~once).sum()), metrics)
    else:
        once[:] = True
    marks = numbers, counted, worst(frame, metric, outcomes), once, coverage
    told = [name for name in by if name not in facets]
    # What follows from the columns that tell cells apart is asked of one row of each.
    examples = frame.select(cells.firsts)
    groups = Groups(examples, facets)
    grids = []
    for inside, shared in zip(groups.members(), groups.keys, strict=True):
        parts = _comparable(examples.select(inside), told)
        grids += [_grid(cells, inside[part], shared, metric=metric, by=told, marks=marks) for part in parts]
    grids.sort(key=lambda grid: -len(grid.frame))
    return PreparedGrids(grids, *_pooled(frame, pooled), tuple(notes))


def _pooled(frame: Frame, names: Sequence[str]) -> tuple[dict[str, int], dict[str, tuple[str, ...]]]:
    """Return the number of values of each pooled setting, and whose it is where not all algorithms vary it.

    Those of all come first, then one of each algorithm, so that a few of them tell something of everyone.
    """
    subjects = Groups(frame, SUBJECT)
    example = subjects.firsts[subjects.of_row]
    codes, algorithms = frame.column("algorithm").factorized()
    counts: dict[str, int] = {}
    whose: dict[str, tuple[str, ...]] = {}
    for name in names:
        column = frame.column(name)
        for rows in FIRST_THEN_ALL:
            whose_differ = codes[rows][differing(column, example, rows)]
            varied = np.bincount(whose_differ, minlength=len(algorithms)) > 0
            if varied.all():
                break
        else:
            column = column.take(varied[codes])
            whose[name] = tuple(sorted(str(algorithms[code]) for code in np.flatnonzero(varied)))
        known = column.distinct()
        # Having none is a value beside a single other one.
        counts[name] = max(2, known)
    seen: Counter[tuple[str, ...]] = Counter()
    order = {}
    for name in counts:
        mine = whose.get(name, ())
        order[name] = (seen[mine] + 1 if mine else 0, mine)
        seen[mine] += 1
    return {name: counts[name] for name in sorted(counts, key=order.__getitem__)}, whose


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


def _grid(
    cells: Groups,
    mine: Indices,
    facets: dict[str, Any],
    *,
    metric: str,
    by: Sequence[str],
    marks: Sequence[Any],
) -> Grid:
    """Return the grid of some cells, (c,): the rows of a competitor on a dataset each."""
    examples = cells.frame.select(cells.firsts[mine])
    competitors, datasets = Groups(examples, by), Groups(examples, ("dataset",))
    rows = np.concatenate(list(cells.members(mine)))
    return Grid(
        metric,
        facets,
        cells.frame.select(rows),
        competitors.keys,
        [key["dataset"] for key in datasets.keys],
        Places(cells.sizes[mine]),
        np.stack([competitors.of_row, datasets.of_row], axis=1),
        *(of_row[rows] for of_row in marks),
    )


def scaled_ranks(medians: Floats) -> Floats:
    """Return ranks on one dataset, from 0 (best of all) to 1 (last of all); the same shape.

    Where a competitor has no run there is NaN, which is no one's rival.

    Args:
        medians: of costs, failed runs' are infinite, (…, competitors).
    """
    rivals = np.count_nonzero(~np.isnan(medians), axis=-1, keepdims=True) - 1
    return (ranks_of_known(medians) - 1) / np.maximum(rivals, 1)


def ranks_of_known(values: Floats) -> Floats:
    """Return ranks from 1 along the last axis, NaN for NaN: sorted behind all others, it moves no rank."""
    return np.where(np.isnan(values), np.nan, average_ranks(values))


def mean_ranks(medians: Floats) -> Floats:
    """Return each competitor's scaled rank, averaged over the datasets it has runs on, (c,).

    Args:
        medians: of costs, failed runs' are infinite, NaN where there is no run, (c, d).
    """
    return mean_of_known(scaled_ranks(medians.T).T)


def mean_of_known(values: Floats) -> Floats:
    """Return means along the last axis without NaN, and NaN where there is nothing else."""
    there = ~np.isnan(values)
    counts = there.sum(axis=-1)
    sums = np.where(there, values, 0.0).sum(axis=-1)
    found: Floats = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    return found
