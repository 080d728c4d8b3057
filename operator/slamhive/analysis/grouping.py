# SPDX-License-Identifier: Apache-2.0
"""Groups of runs in a table of columns: what ``pivot.table`` does for rows, for 80,000 of them.

Both give the same groups and the same numbers; the tests compare them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.columns import Column
from slamhive.analysis.pivot import CONFIGURATION, DISTURBED, FACETS, SUBJECT, Outcomes, Summary
from slamhive.analysis.statistics import (
    ENOUGH,
    Interval,
    edges,
    mean_interval,
    median_interval,
    median_of_sorted,
    summarize,
)
from slamhive.model.results import Outcome

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    import numpy.typing as npt

    from slamhive.analysis.columns import Floats, Indices, Mask
    from slamhive.analysis.frame import Frame

ERRORS = ("ate.", "rpe[", "relations.", "ateRotationDeg.")
"""What the names of errors begin with: only they rank a failed run last."""

_MOST_NAMES = 6


@dataclass(frozen=True)
class Figure:
    """A metric over a group of runs.

    Attributes:
        summary: of the numbers that count; None for none.
        points: the numbers themselves, where they are few.
        mean_interval, median_interval: from 10 numbers on.
        censored: runs without a number, ranked behind all others: the failed ones.
        censored_median: median of all runs so ranked; infinite when it is a failed run.
    """

    summary: Summary | None
    points: tuple[float, ...] = ()
    mean_interval: Interval | None = None
    median_interval: Interval | None = None
    censored: int = 0
    censored_median: float | None = None


@dataclass(frozen=True)
class Cell:
    """What a group of runs came to.

    Attributes:
        keys: the values that its runs share, by column.
        runs: number of rows: runs, each once an evaluation.
        n: number of runs that enter the figures.
        failures: number of runs that weren't tracked, by what became of them.
        coverage: of all evaluated runs.
        figures: by column.
    """

    keys: dict[str, Any]
    runs: int
    n: int
    failures: dict[str, int]
    coverage: Summary | None
    figures: dict[str, Figure]


@dataclass(frozen=True)
class Aggregate:
    """Groups of runs in the order of their keys.

    Attributes:
        keys: columns that tell them apart: facets that vary, then those asked for.
        facets: those of the keys that nobody asked for.
        metrics: what was summarised.
        cells: the groups.
        notes: sentences on what is pooled and left out.
    """

    keys: tuple[str, ...]
    facets: tuple[str, ...]
    metrics: tuple[str, ...]
    cells: list[Cell]
    notes: tuple[str, ...] = field(default=())


class Groups:
    """Rows by the values of some columns.

    Args:
        frame: the rows.
        names: the columns.
    """

    def __init__(self, frame: Frame, names: Sequence[str]) -> None:
        self.frame = frame
        self.names = tuple(names)
        combined: npt.NDArray[np.int64] = np.zeros(len(frame), dtype=np.int64)
        for name in names:
            codes, values = frame.column(name).factorized()
            combined = combined * max(len(values), 1) + codes
            if len(values) > 1:
                _, inverse = np.unique(combined, return_inverse=True)
                combined = inverse.astype(np.int64)
        self.of_row: npt.NDArray[np.intp] = combined.astype(np.intp)
        self.count = int(combined.max()) + 1 if len(frame) else 0
        self.order: Indices = np.argsort(self.of_row, kind="stable")
        self._edges = edges(self.of_row[self.order], self.count)

    @cached_property
    def keys(self) -> list[dict[str, Any]]:
        """The values that the rows of each group share, by column."""
        firsts = np.array([self.order[begin] for begin, _ in self._edges], dtype=np.intp)
        return self.frame.select(firsts).records(self.names)

    def members(self) -> Iterator[Indices]:
        """Go through the rows of each group, in their order."""
        for begin, end in self._edges:
            yield self.order[begin:end]


def aggregate(
    frame: Frame,
    metrics: Sequence[str],
    by: Sequence[str] | None = None,
    outcomes: Outcomes = Outcomes.TRACKED,
) -> Aggregate:
    """Group rows and summarise metrics over each group; never pools what must not be pooled.

    Args:
        frame: one row a run and evaluation.
        metrics: columns of numbers.
        by: columns to group by; None for algorithm, sensors, dataset and what varies between their runs.
        outcomes: which runs enter the figures.
    """
    frame = with_facets(frame)
    changing = varying(frame)
    asked = list(dict.fromkeys([*SUBJECT, *changing] if by is None else by))
    facets = varying_facets(frame, asked)
    groups = Groups(frame, [*facets, *asked])
    material = _Material(frame, metrics, counting(frame, outcomes))
    cells = [material.cell(rows, keys) for rows, keys in zip(groups.members(), groups.keys, strict=True)]
    pooled = [name for name in changing if name not in groups.names]
    notes = [*pooling_notes(pooled), *disturbance_notes(frame, metrics)]
    return Aggregate(groups.names, tuple(facets), tuple(metrics), cells, tuple(notes))


def pooling_notes(pooled: Sequence[str]) -> list[str]:
    """Say which settings are averaged over."""
    if not pooled:
        return []
    named = list(pooled[:_MOST_NAMES])
    if len(pooled) > _MOST_NAMES:
        named.append(f"{len(pooled) - _MOST_NAMES} more")
    return [f"averaged over different values of {', '.join(named)}"]


def disturbance_notes(frame: Frame, metrics: Iterable[str]) -> list[str]:
    """Say how many runs are left out of the figures on load."""
    left_out = [name for name in metrics if name in DISTURBED]
    count = int(np.nansum(frame.column("disturbed").floats())) if left_out else 0
    if not count:
        return []
    runs = "1 run" if count == 1 else f"{count} runs"
    return [f"{runs} shared cores with other work or were throttled: left out of {', '.join(left_out)}"]


def counting(frame: Frame, outcomes: Outcomes) -> Mask:
    """Tell which rows enter the figures, (n,): tracked ones, or all that were evaluated."""
    if outcomes is Outcomes.ALL:
        return frame.column("outcome").present
    return where_equal(frame, "status", Outcome.TRACKED.value)


def where_equal(frame: Frame, name: str, value: Any) -> Mask:
    """Tell which rows have a value in a column of texts, (n,)."""
    column = frame.column(name)
    if column.kind.is_numeric or value not in column.values:
        return np.zeros(len(frame), dtype=bool)
    found: Mask = column.codes == column.values.index(value)
    return found


def sound(frame: Frame, name: str) -> Mask:
    """Tell which rows' figure of a name can be believed, (n,)."""
    if name not in DISTURBED:
        return np.ones(len(frame), dtype=bool)
    return ~(frame.column("disturbed").floats() > 0)


def varying(frame: Frame) -> list[str]:
    """Return the columns of the configuration that differ between runs of one algorithm on one dataset."""
    if not len(frame):
        return []
    groups = Groups(frame, SUBJECT)
    firsts = np.empty(groups.count, dtype=np.intp)
    firsts[groups.of_row[::-1]] = np.arange(len(frame))[::-1]
    example = firsts[groups.of_row]
    names = (name for name in frame.stored if name.startswith(CONFIGURATION) and name not in FACETS)
    return sorted(name for name in names if _differs(frame.glance(name), example))


def varying_facets(frame: Frame, asked: Iterable[str]) -> list[str]:
    """Return the columns that must not be pooled and that differ, but for those asked for."""
    given = set(asked)
    facets = [name for name in FACETS if name not in given and varies(frame, name)]
    if "evaluation" in facets and "alignment" in facets:
        pairs, evaluations = Groups(frame, ("evaluation", "alignment")), Groups(frame, ("evaluation",))
        if pairs.count == evaluations.count:
            facets.remove("alignment")
    return facets


def varies(frame: Frame, name: str) -> bool:
    """Tell whether a column has more than one value, a missing one counted as a value."""
    return len(frame) > 0 and _differs(frame.column(name), np.zeros(len(frame), dtype=np.intp))


def _differs(column: Column, example: Indices) -> bool:
    if not column.kind.is_numeric:
        return bool((column.codes != column.codes[example]).any())
    other = column.numbers[example]
    same = (column.numbers == other) | (np.isnan(column.numbers) & np.isnan(other))
    return not same.all()


def with_facets(frame: Frame) -> Frame:
    """Give failed runs the evaluations that the others have, so that they are counted beside them."""
    outcome, evaluation = frame.column("outcome"), frame.column("evaluation")
    orphans = ~outcome.present & ~evaluation.present
    names = evaluation.factorized()[1] if evaluation.present.any() else []
    names = [name for name in names if name is not None]
    if not orphans.any() or not names:
        return frame
    repeats = np.where(orphans, len(names), 1)
    rows = np.repeat(np.arange(len(frame)), repeats)
    starts = np.cumsum(repeats) - repeats
    turn = np.arange(len(rows)) - starts[rows]
    grown = frame.select(rows)
    codes = np.where(orphans[rows], turn, _codes_in(evaluation, names)[rows])
    given = grown.replaced({"evaluation": Column.of_codes(codes, names)})
    return given.replaced({"alignment": _alignments(given)})


def _codes_in(column: Column, values: list[Any]) -> npt.NDArray[np.int32]:
    places = {value: place for place, value in enumerate(values)}
    lookup = np.array([*(places.get(value, -1) for value in column.values), -1], dtype=np.int32)
    return lookup[column.codes]


def _alignments(frame: Frame) -> Column:
    """Return the alignment of each row; where missing, that of others like it if they agree.

    Those are of its evaluation, algorithm and sensors, then of its evaluation and sensors, then of its
    evaluation: an algorithm all of whose runs failed still stands beside the others.
    """
    alignment = frame.column("alignment")
    if alignment.kind.is_numeric:
        return alignment
    codes = alignment.codes
    have = alignment.present
    for names in (("evaluation", "algorithm", "sensors"), ("evaluation", "sensors"), ("evaluation",)):
        groups = Groups(frame, names)
        low = np.full(groups.count, len(alignment.values), dtype=np.int32)
        high = np.full(groups.count, -1, dtype=np.int32)
        np.minimum.at(low, groups.of_row[have], alignment.codes[have])
        np.maximum.at(high, groups.of_row[have], alignment.codes[have])
        known = np.where(low == high, low, -1)
        codes = np.where(codes >= 0, codes, known[groups.of_row]).astype(np.int32)
    return Column.of_codes(codes, alignment.values)


class _Material:
    """What cells are made of: arrays over all rows, taken out of their columns once.

    Args:
        frame: the rows.
        metrics: what to summarise.
        counted: which rows enter the figures, (n,).
    """

    def __init__(self, frame: Frame, metrics: Sequence[str], counted: Mask) -> None:
        status = frame.column("status")
        self._words = status.values
        self._status = status.codes
        self._counted = counted
        self._coverage = frame.column("coverage").floats()
        self._metrics = {
            name: (frame.column(name).floats(), counted & sound(frame, name), name.startswith(ERRORS))
            for name in metrics
        }

    def cell(self, rows: Indices, keys: dict[str, Any]) -> Cell:
        """Return what the runs of some rows came to."""
        coverage = self._coverage[rows]
        return Cell(
            keys=keys,
            runs=len(rows),
            n=int(np.count_nonzero(self._counted[rows])),
            failures=failures_of(self._words, self._status[rows]),
            coverage=summarize(coverage[~np.isnan(coverage)]),
            figures={name: self._figure(rows, name) for name in self._metrics},
        )

    def _figure(self, rows: Indices, name: str) -> Figure:
        everywhere, counting_, is_error = self._metrics[name]
        numbers, inside = everywhere[rows], counting_[rows]
        inside &= ~np.isnan(numbers)
        values = numbers[inside]
        summary = summarize(values)
        points = tuple(values.tolist()) if len(values) < ENOUGH else ()
        interval = mean_interval(summary) if summary else None
        if not is_error:
            return Figure(summary, points, interval, median_interval(np.sort(values)))
        ranked = ranked_errors(numbers, inside)
        failed = len(rows) - len(values)
        return Figure(summary, points, interval, median_interval(ranked), failed, median_of_sorted(ranked))


def failures_of(words: Sequence[str], codes: npt.NDArray[np.int32]) -> dict[str, int]:
    """Return how many runs failed, by what became of them; tracked ones did not."""
    counts = np.bincount(codes, minlength=len(words)).tolist()
    found = {word: count for word, count in zip(words, counts, strict=True) if count}
    found.pop(Outcome.TRACKED.value, None)
    return dict(sorted(found.items()))


def ranked_errors(numbers: Floats, inside: Mask) -> Floats:
    """Return errors sorted, runs that don't count or have none as +inf behind all others."""
    return np.sort(np.where(inside & ~np.isnan(numbers), numbers, np.inf))
