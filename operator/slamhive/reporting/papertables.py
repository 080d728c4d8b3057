# SPDX-License-Identifier: Apache-2.0
"""Tables as papers have them: competitors down, datasets across, a block of columns for each metric."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis import Metric, Outcomes
from slamhive.analysis.grouping import COPIED, aggregate, pooling_notes, varying
from slamhive.analysis.leaderboard import leaderboard
from slamhive.analysis.measures import measure_of
from slamhive.model.base import Choice
from slamhive.model.errors import InputError
from slamhive.tables.text import short_name
from slamhive.tables.words import disproportion_notes, meanings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.cells import Cell
    from slamhive.analysis.frame import Frame

LEAST_FOR_SECOND = 3
"""Rows from which on the second best is marked too."""

_MOST_DIGITS = 6


class Statistic(Choice):
    """Statistics that stand for several runs in a table or figure: mean or median."""

    MEAN = "mean"
    MEDIAN = "median"


class Overall(Choice):
    """Ranks or ratios of a row over all datasets, as metres of one dataset say nothing about another."""

    RANK = "rank"
    RATIO = "ratio"


class Best(Choice):
    """Among which cells of a column the best is bold."""

    COLUMN = "column"
    GROUP = "group"
    NONE = "none"


@dataclass(frozen=True)
class TableLayout:
    """Layout of a table for a paper: its rows, columns, metrics and how runs are summarised.

    Attributes:
        rows, columns: names of columns whose values tell rows and columns apart.
        metrics: what is shown, one block of columns each.
        outcomes: which runs enter the figures.
        statistic: what stands for several runs.
        spread: whether the standard deviation (or with a median the range) is shown beside.
        best: where the best number is bold, and the second one underlined.
        overall: what stands for each row over all datasets, of the first metric.
    """

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    metrics: tuple[Metric, ...]
    outcomes: Outcomes = Outcomes.TRACKED
    statistic: Statistic = Statistic.MEAN
    spread: bool = False
    best: Best = Best.COLUMN
    overall: tuple[Overall, ...] = ()


@dataclass(frozen=True)
class TableNumber:
    """One number of a table.

    Attributes:
        value: in the unit that is shown; None where no run counts.
        spread: standard deviation, or smallest and largest; empty where not asked for or unknown.
        bold: whether it is the best.
        second: whether it comes next.
        published: whether somebody else published it: what became of own runs says nothing of it.
    """

    value: float | None
    spread: tuple[float, ...] = ()
    bold: bool = False
    second: bool = False
    published: bool = False


@dataclass(frozen=True)
class OverAll:
    """Ranks or ratios of the rows, each over the datasets on which it has runs that are ranked.

    Attributes:
        kind: which of both.
        figures: of each row; without a value where nothing is ranked, infinite where a median run failed.
        datasets: of each row, (ranked on, of).
    """

    kind: Overall
    figures: tuple[TableNumber, ...]
    datasets: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class TableCell:
    """The runs of a row under one set of column values.

    Attributes:
        runs, n: runs, and different results of those in the figures.
        copies: runs that repeat one of these.
        failures: runs that aren't, by what became of them.
        untracked: runs that weren't tracked, in the figures or not, by what became of them.
        figures: one a metric.
        reader: whether figures of CPU hold the reading of the recording, or may, and others' don't.
        late: whether memory holds frames that waited, as poses came late.
    """

    runs: int
    n: int
    copies: int
    failures: dict[str, int]
    untracked: dict[str, int]
    figures: tuple[TableNumber, ...]
    reader: bool
    late: bool

    @property
    def tracked(self) -> int:
        """Number of runs that were tracked."""
        return self.runs - sum(self.untracked.values())

    @property
    def verdict(self) -> str:
        """Most frequent outcome among the runs that weren't tracked."""
        return max(self.untracked, key=lambda word: self.untracked[word], default="–")


@dataclass(frozen=True)
class PaperTable:
    """A table.

    Attributes:
        layout: as asked for.
        metrics: as shown, with their formats.
        keys: names of the columns that tell rows apart: facets that vary, then those asked for.
        rows: their values.
        columns: values of the layout's columns, side by side under each metric.
        places: by row and column, None where nothing was run.
        notes: sentences for its reader: what its figures mean, and over which settings they are.
        asides: sentences for its author: what is left out, doubtful or marked elsewhere.
        overall: what stands for the rows over all datasets.
        pooled: names of the settings that figures are over; empty where there are none.
    """

    layout: TableLayout
    metrics: tuple[Metric, ...]
    keys: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    columns: tuple[tuple[Any, ...], ...]
    places: tuple[tuple[TableCell | None, ...], ...]
    notes: tuple[str, ...]
    asides: tuple[str, ...] = ()
    overall: tuple[OverAll, ...] = ()
    pooled: str = ""

    @property
    def counts(self) -> tuple[int, int]:
        """Smallest and largest number of results in a figure."""
        found = [place.n for line in self.places for place in line if place is not None]
        return min(found, default=0), max(found, default=0)

    @property
    def has_copies(self) -> bool:
        """True if any result is counted once that several runs have."""
        return any(place.copies for line in self.places for place in line if place is not None)

    @property
    def has_failures(self) -> bool:
        """True if any run wasn't tracked."""
        return any(place.untracked for line in self.places for place in line if place is not None)

    @property
    def shows_counts(self) -> bool:
        """True if n is shown in the table: where it says more than a sentence could."""
        low, high = self.counts
        return low != high or any(
            place.n + place.copies < place.runs for line in self.places for place in line if place is not None
        )

    @property
    def failures(self) -> list[tuple[tuple[Any, ...], tuple[Any, ...], dict[str, int]]]:
        """Return (row, column, what became of the runs that weren't tracked) of each place that has some."""
        return [
            (row, column, place.untracked)
            for row, line in zip(self.rows, self.places, strict=True)
            for column, place in zip(self.columns, line, strict=True)
            if place is not None and place.untracked
        ]


def make_table(frame: Frame, layout: TableLayout) -> PaperTable:
    """Lay out runs as a table.

    Algorithms, datasets, evaluations, paces and processors are never averaged together: where they vary
    and nobody asked for them, they become rows.

    Args:
        frame: one row a run and evaluation.
        layout: what stands where.

    Raises:
        UnknownNameError: a column is unknown.
    """
    frame.require(layout.rows, "rows")
    frame.require(layout.columns, "columns")
    frame.require((metric.column for metric in layout.metrics), "metric")
    names = [metric.column for metric in layout.metrics]
    rows = [name for name in layout.rows if name not in layout.columns]
    found = aggregate(frame, names, [*rows, *layout.columns], layout.outcomes)
    keys = tuple(name for name in found.keys if name not in layout.columns)
    lines = _distinct(found.cells, keys)
    across = _in_order(frame, layout.columns, _distinct(found.cells, layout.columns))
    cells = {(_identity(cell.keys, keys), _identity(cell.keys, layout.columns)): cell for cell in found.cells}
    metrics = tuple(_with_digits(metric, found.cells, layout.statistic) for metric in layout.metrics)
    shown = replace(layout, metrics=metrics)
    names = [metric.column for metric in metrics]
    over = [name for name in varying(frame) if name not in found.keys]
    told = [note for note in found.notes if note not in pooling_notes(over)]
    pooled = ", ".join(short_name(name, over) for name in over)
    places = [[_place(cells.get((line, column)), shown) for column in across] for line in lines]
    overall = _over_datasets(frame, shown, [dict(zip(keys, row, strict=True)) for row in lines.values()])
    return PaperTable(
        layout=layout,
        pooled=pooled,
        metrics=metrics,
        keys=keys,
        rows=tuple(lines.values()),
        columns=tuple(across.values()),
        places=tuple(map(tuple, _with_best(places, list(lines.values()), shown))),
        notes=(
            *meanings(frame, names),
            *((f"over all tried values of {pooled}",) if pooled else ()),
            *(note.replace(f" {COPIED}", "") for note in told if COPIED in note),
        ),
        asides=(*(note for note in told if COPIED not in note), *disproportion_notes(frame)),
        overall=overall,
    )


def _over_datasets(frame: Frame, layout: TableLayout, rows: Sequence[dict[str, Any]]) -> tuple[OverAll, ...]:
    """Return ranks and ratios of the rows over the datasets, as the leaderboard has them.

    Raises:
        InputError: the datasets don't stand side by side, or nobody knows which way the first metric is good.
    """
    if not layout.overall:
        return ()
    metric = layout.metrics[0].column
    if "dataset" not in layout.columns:
        raise InputError(
            "ranks and ratios are over datasets, which then stand side by side: --columns dataset", "overall"
        )
    if not _way(metric):
        raise InputError(
            f"{metric}: ranks are by a figure that is good when it is small, or when it is large; nobody has "
            "said so of this one",
            "overall",
        )
    others = [name for name in layout.columns if name != "dataset"]
    if others:
        raise InputError(f"{others[0]} stands in the columns too: ranks are over datasets alone", "overall")
    by = [name for name in layout.rows if name != "dataset"]
    boards = leaderboard(frame, metric, by, layout.outcomes, draws=1).boards
    found: list[tuple[float | None, float | None, tuple[int, int]]] = []
    for row in rows:
        fitting = [
            (entry, len(board.datasets))
            for board in boards
            for entry in board.entries
            if all(row.get(name, value) == value for name, value in (board.facets | entry.keys).items())
        ]
        if len(fitting) != 1:
            found.append((None, None, (0, 0)))
            continue
        entry, of = fitting[0]
        ranks = [standing.rank for standing in entry.standings if not math.isnan(standing.rank)]
        ratio = None if math.isnan(entry.ratio) else entry.ratio
        found.append((sum(ranks) / len(ranks) if ranks else None, ratio, (len(ranks), of)))
    over = []
    for kind in layout.overall:
        values = [one[1] if kind is Overall.RATIO else one[0] for one in found]
        costs = [math.inf if value is None else float(format(value, ".2f")) for value in values]
        marked = _marked([TableNumber(value) for value in values], costs, layout, len(values))
        over.append(OverAll(kind, marked, tuple(one[2] for one in found)))
    return tuple(over)


def _marked(
    numbers: Sequence[TableNumber], costs: Sequence[float], layout: TableLayout, rows: int
) -> tuple[TableNumber, ...]:
    """Return numbers with the best and the second one marked.

    Args:
        numbers: those of a column, or of a group of its rows.
        costs: of each as it is shown, small is good; infinite for what can't be the best.
        layout: of the table.
        rows: number of rows that they stand in.
    """
    if layout.best is Best.NONE or rows < 2:
        return tuple(numbers)
    first, second = [*sorted({cost for cost in costs if math.isfinite(cost)}), math.nan, math.nan][:2]
    return tuple(
        replace(number, bold=cost == first, second=rows >= LEAST_FOR_SECOND and cost == second)
        for number, cost in zip(numbers, costs, strict=True)
    )


def flat(table: PaperTable) -> dict[str, list[Any]]:
    """Return a table's figures as columns, one row a place: stored units, every digit."""
    rows = []
    for number, (row, line) in enumerate(zip(table.rows, table.places, strict=True)):
        for column, place in zip(table.columns, line, strict=True):
            if place is None:
                continue
            record = dict(zip(table.keys, row, strict=True))
            record |= dict(zip(table.layout.columns, column, strict=True))
            for metric, figure in zip(table.metrics, place.figures, strict=True):
                record[metric.heading] = figure.value
                for part, value in zip(_spread_names(table.layout), figure.spread, strict=False):
                    record[f"{metric.heading} {part}"] = value
            for over in table.overall:
                record[f"{over.kind} over datasets"] = over.figures[number].value
            failures = sum(place.failures.values())
            rows.append(record | {"n": place.n, "copies": place.copies, "runs": place.runs})
            rows[-1]["failures"] = failures
            rows[-1]["failures.by"] = place.failures
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [row.get(name) for row in rows] for name in names}


def _spread_names(layout: TableLayout) -> tuple[str, ...]:
    return ("std",) if layout.statistic is Statistic.MEAN else ("min", "max")


def _identity(keys: dict[str, Any], names: Sequence[str]) -> str:
    return json.dumps([keys[name] for name in names], default=str)


def _distinct(cells: Sequence[Cell], names: Sequence[str]) -> dict[str, tuple[Any, ...]]:
    return {_identity(cell.keys, names): tuple(cell.keys[name] for name in names) for cell in cells}


def _in_order(
    frame: Frame, names: Sequence[str], found: dict[str, tuple[Any, ...]]
) -> dict[str, tuple[Any, ...]]:
    """Return column values in the order of their columns, whatever row they were first seen in."""
    values = [frame.column(name).unique() for name in names]
    orders = [{_plain(value): place for place, value in enumerate(one)} for one in values]
    sort = lambda item: [order[_plain(value)] for order, value in zip(orders, item[1], strict=True)]  # noqa: E731
    return dict(sorted(found.items(), key=sort))


def _plain(value: Any) -> str:
    return json.dumps(value, sort_keys=True, default=str)


def _with_digits(metric: Metric, cells: Sequence[Cell], statistic: Statistic) -> Metric:
    """Return a metric with as many decimals as give its middle number three digits, unless told."""
    if metric.format:
        return metric
    values = [
        abs(getattr(summary, statistic) * metric.factor)
        for cell in cells
        if (summary := cell.figures[metric.column].summary) is not None
    ]
    values = [value for value in values if value > 0]
    if not values:
        return metric
    decimals = 2 - math.floor(math.log10(float(np.median(values))))
    return replace(metric, format=f".{min(max(decimals, 0), _MOST_DIGITS)}f")


def _place(cell: Cell | None, layout: TableLayout) -> TableCell | None:
    if cell is None:
        return None
    figures = []
    for metric in layout.metrics:
        summary = cell.figures[metric.column].summary
        if summary is None:
            figures.append(TableNumber(None))
            continue
        value = getattr(summary, layout.statistic) * metric.factor
        spread: tuple[float, ...] = ()
        if layout.spread and summary.n > 1 and summary.std is not None:
            ends = (summary.std,) if layout.statistic is Statistic.MEAN else (summary.min, summary.max)
            spread = tuple(end * metric.factor for end in ends)
        figures.append(TableNumber(value, spread))
    untracked = Counter(cell.failures) + Counter(cell.untracked)
    left_out = dict(sorted(untracked.items()))
    return TableCell(
        cell.runs, cell.n, cell.copies, cell.failures, left_out, tuple(figures), cell.reader, cell.late
    )


def _with_best(
    places: list[list[TableCell | None]], rows: Sequence[tuple[Any, ...]], layout: TableLayout
) -> list[list[TableCell | None]]:
    """Mark best and second numbers; one of which not even half of the runs were tracked is none."""
    groups: dict[str, list[list[TableCell | None]]] = {}
    for row, line in zip(rows, places, strict=True):
        group = _plain(row[0]) if layout.best is Best.GROUP and len(row) > 1 else ""
        groups.setdefault(group, []).append(line)
    for lines in groups.values():
        for column in range(len(lines[0])):
            held = [(line, place) for line in lines if (place := line[column]) is not None]
            costs = zip(*(_costs(place, layout.metrics) for _, place in held), strict=True)
            numbers = zip(*(place.figures for _, place in held), strict=True)
            marked = (_marked(*both, layout, len(lines)) for both in zip(numbers, costs, strict=True))
            for (line, place), figures in zip(held, zip(*marked, strict=True), strict=True):
                line[column] = replace(place, figures=figures)
    return places


def _costs(place: TableCell, metrics: Sequence[Metric]) -> list[float]:
    """Return each figure as a cost, small is good, as it is shown; infinite for what can't be the best."""
    return [
        _way(metric.column) * float(format(figure.value, metric.format or ".4g"))
        if figure.value is not None and _way(metric.column) and 2 * place.tracked > place.runs
        else math.inf
        for figure, metric in zip(place.figures, metrics, strict=True)
    ]


def _way(column: str) -> float:
    """Return 1 where small is good, -1 where large is, 0 where neither is known."""
    return measure_of(column).sign if measure_of(column).better else 0.0
