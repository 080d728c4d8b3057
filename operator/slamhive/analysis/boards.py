# SPDX-License-Identifier: Apache-2.0
"""Medians of competitors on datasets: what leaderboard, comparison and Pareto front begin with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.grouping import (
    LOAD,
    Groups,
    apart,
    counting,
    covered,
    disturbance_notes,
    pooling_notes,
    ranked_errors,
    sound,
    unranked_notes,
    varies,
    varying,
    worst,
)
from slamhive.analysis.statistics import median_of_sorted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.columns import Floats, Indices, Mask
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.grouping import Outcomes

VERSION = "algorithm.version"

COMPETITORS = ("algorithm", "sensors")
"""Columns that tell competitors apart unless others are named."""


@dataclass(frozen=True)
class Grid:
    """Competitors that can be compared on their datasets.

    Attributes:
        metric: what is compared.
        facets: the values that all runs share, of columns that vary between grids.
        frame: the runs.
        competitors: what each is, by column, (c,).
        datasets: names, (d,).
        members: rows of the runs of a competitor on a dataset.
        numbers: the metric of each row, (n,).
        counted: rows with a figure that counts, (n,).
        failed: rows that failed of themselves, (n,): they rank behind all figures.
        coverage: of each row, 0 where it failed of itself, NaN where that isn't known, (n,).
        medians: (c, d), failed runs last: infinite for a failed one, NaN where no run has a rank.
    """

    metric: str
    facets: dict[str, Any]
    frame: Frame
    competitors: list[dict[str, Any]]
    datasets: list[Any]
    members: dict[tuple[int, int], Indices]
    numbers: Floats
    counted: Mask
    failed: Mask
    coverage: Floats
    medians: Floats

    def ranked(self, place: tuple[int, int]) -> Floats:
        """Return the sorted figures of a competitor on a dataset, failed runs last."""
        rows = self.members[place]
        return ranked_errors(self.numbers[rows], self.counted[rows], self.failed[rows])

    def mean_coverage(self, place: tuple[int, int]) -> float | None:
        """Return the mean coverage of a competitor on a dataset; None where nothing is known of it."""
        known = self.coverage[self.members[place]]
        known = known[~np.isnan(known)]
        return float(known.mean()) if len(known) else None


@dataclass(frozen=True)
class Marks:
    """Metric, outcome and coverage of each row, from which grids are made; fields as in ``Grid``."""

    numbers: Floats
    counted: Mask
    failed: Mask
    coverage: Floats

    def of(self, rows: Indices) -> Marks:
        """Return the marks of some rows."""
        return Marks(self.numbers[rows], self.counted[rows], self.failed[rows], self.coverage[rows])


@dataclass(frozen=True)
class Prepared:
    """Grids of one question, with sentences on what is pooled in them."""

    grids: list[Grid]
    notes: tuple[str, ...]


def prepare(
    frame: Frame, metrics: Sequence[str], by: Sequence[str], outcomes: Outcomes, *, by_dataset: bool = False
) -> Prepared:
    """Split runs into grids of what can be compared.

    Figures on errors are compared over processors, which is said; those on load never are.

    Args:
        frame: one row a run and evaluation.
        metrics: columns of numbers; the grids hold the first.
        by: columns that tell competitors apart.
        outcomes: which runs have a figure that counts.
        by_dataset: whether each dataset is a grid of its own.
    """
    frame, facets = apart(frame, (*by, "dataset"), metrics)
    notes: list[str] = []
    if "algorithm" in by and VERSION in facets:
        # Versions of an algorithm compete with each other, and with all others.
        facets.remove(VERSION)
        by = [*by, VERSION]
    if not any(metric.startswith(LOAD) for metric in metrics):
        if varies(frame, "provenance.cpuModel") and "provenance.cpuModel" not in by:
            notes.append("runs of different processors are compared with each other")
    elif "provenance.cpuModel" in facets:
        notes.append("runs of different processors are ranked apart: their loads can't be compared")
    if "alignment" in facets or "evaluation" in facets:
        notes.append("runs of different evaluations are ranked apart: their errors can't be compared")
    pooled = [name for name in varying(frame) if name not in (*by, *facets)]
    notes += [*pooling_notes(pooled), *disturbance_notes(frame, metrics), *unranked_notes(frame, outcomes)]
    if by_dataset:
        facets = [*facets, "dataset"]
    metric = metrics[0]
    numbers = np.where(sound(frame, metric, outcomes), frame.column(metric).floats(), np.nan)
    marks = Marks(numbers, counting(frame, outcomes), worst(frame, metric, outcomes), covered(frame))
    groups = Groups(frame, facets)
    told = [name for name in by if name not in facets]
    grids = []
    for rows, shared in zip(groups.members(), groups.keys, strict=True):
        inside = frame.select(rows)
        for part in _comparable(inside, told):
            grids.append(_grid(inside.select(part), shared, metric, told, marks.of(rows[part])))  # noqa: PERF401
    grids.sort(key=lambda grid: -len(grid.frame))
    return Prepared(grids, tuple(notes))


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


def _grid(frame: Frame, facets: dict[str, Any], metric: str, by: Sequence[str], marks: Marks) -> Grid:
    competitors, datasets = Groups(frame, by), Groups(frame, ("dataset",))
    medians = np.full((competitors.count, datasets.count), np.nan)
    members: dict[tuple[int, int], Indices] = {}
    for rows in Groups(frame, (*by, "dataset")).members():
        place = (int(competitors.of_row[rows[0]]), int(datasets.of_row[rows[0]]))
        members[place] = rows
        ranked = ranked_errors(marks.numbers[rows], marks.counted[rows], marks.failed[rows])
        if len(ranked):
            medians[place] = median_of_sorted(ranked)
    names = [key["dataset"] for key in datasets.keys]
    told = (metric, facets, frame, competitors.keys, names, members)
    return Grid(*told, **vars(marks), medians=medians)
