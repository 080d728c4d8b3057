# SPDX-License-Identifier: Apache-2.0
"""Figures of the table of runs in which one mark stands for several: lines, boxes, heat maps, fronts."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.boards import COMPETITORS
from slamhive.analysis.columns import sort_key
from slamhive.analysis.grouping import Groups, aggregate, counting, sound, varies
from slamhive.analysis.measures import CONFIGURATION, measure_of
from slamhive.analysis.metrics import label_of
from slamhive.analysis.pareto import pareto
from slamhive.figures.asking import (
    check_categories,
    check_panels,
    check_series,
    cost_of,
    error_of,
    is_numeric,
    nothing,
    parted,
    setting_of,
)
from slamhive.figures.counts import Tally, span
from slamhive.figures.pictures import Box, Dots, Line, MissingMark, Panel, Picture, PictureAxis, Ranges, Tiles
from slamhive.model.base import plural
from slamhive.model.errors import InputError
from slamhive.reporting.markup import shown
from slamhive.reporting.papertables import Statistic
from slamhive.reporting.scales import MOST_TICKS
from slamhive.reporting.titles import keys_text
from slamhive.tables.reading import with_figure
from slamhive.tables.text import as_columns, flat_cells

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from slamhive.analysis.cells import Cell
    from slamhive.analysis.cells import Figure as Summed
    from slamhive.analysis.columns import Floats
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.grouping import Aggregate
    from slamhive.analysis.metrics import Metric
    from slamhive.analysis.pareto import Front
    from slamhive.figures.asking import Wish

MOST_POINTS = 20
"""Runs of a box up to which each is drawn in it, beyond those outside of its whiskers."""

MOST_COUNTED = 3
"""Series side by side up to which each has its own runs without a figure counted above it."""

_LEAST_BOX = 5
"""Runs from which on quartiles mean something; below, they are drawn one by one."""


class Series:
    """Series of a picture by the values of their columns.

    Args:
        names: the columns.
        frame: all runs of the picture.
    """

    def __init__(self, names: Sequence[str], frame: Frame) -> None:
        self.names = tuple(names)
        keys = Groups(frame, names).keys
        check_series(names, keys)
        self._numbers = {_identity(key): number for number, key in enumerate(keys)}
        self.labels = tuple(keys_text(key) for key in keys) if names else ("",)

    def of(self, keys: dict[str, Any]) -> int:
        """Return the number of the series that some keys belong to."""
        return self._numbers[_identity({name: keys[name] for name in self.names})]


class Along:
    """Places along an axis: numbers themselves, or 0, 1, 2, … of texts and of values of several columns.

    Args:
        frame: all runs of the picture.
        names: the columns.
        field: the option that named them.
        metric: how the numbers of a column are shown; None where they stand as texts.
    """

    def __init__(self, frame: Frame, names: Sequence[str], field: str, metric: Metric | None = None) -> None:
        self.names = tuple(names)
        self._metric = metric
        self.texts: tuple[str, ...] = ()
        self._ticks = values_tried(frame, metric) if metric is not None else ()
        if metric is None or not is_numeric(frame, metric.column):
            keys = Groups(frame, names).keys
            check_categories(field, ", ".join(names), len(keys))
            self.texts = tuple(", ".join(shown(value) for value in key.values()) for key in keys)
            self._places = {_identity(key): float(place) for place, key in enumerate(keys)}

    def axis(self, log: bool | None = None) -> PictureAxis:
        """Return the axis."""
        if self._metric is not None and not self.texts:
            return PictureAxis(self._metric.label, log, ticks=self._ticks, robust=False)
        return PictureAxis(", ".join(label_of(name) for name in self.names), categories=self.texts)

    def place(self, keys: dict[str, Any]) -> float:
        """Return the place of some keys; NaN where the number is missing."""
        if self.texts or self._metric is None:
            return self._places[_identity({name: keys[name] for name in self.names})]
        value = keys[self.names[0]]
        return math.nan if value is None else float(value) * self._metric.factor


def values_tried(frame: Frame, metric: Metric) -> tuple[float, ...]:
    """Return the values of a setting that has few, in the unit they are shown in; else nothing."""
    if not metric.column.startswith(CONFIGURATION) or not is_numeric(frame, metric.column):
        return ()
    numbers = frame.column(metric.column).floats() * metric.factor
    found = np.unique(numbers[np.isfinite(numbers)])
    return tuple(found.tolist()) if len(found) <= MOST_TICKS else ()


def _identity(value: Any) -> str:
    return repr(value)


def lines(frame: Frame, wish: Wish) -> Picture:
    """Return a figure over a setting: what stands for the runs of each value, and its spread."""
    y = wish.number("y", error_of(frame), frame)
    frame, left = with_figure(frame, y.column)
    x = wish.place("x", setting_of(frame), frame)
    frame, without = _known(frame, x.column)
    by, facet = wish.series(frame, (x.column,)), wish.columns("facet", (), frame)
    told = list(dict.fromkeys([*by, x.column]))
    parts = parted(frame, facet, told, (x.column, y.column))
    found = aggregate(parts.frame, [y.column], [*parts.names, *told], wish.outcomes)
    along, series = Along(parts.frame, [x.column], "x", x), Series(by, parts.frame)
    drawn: list[tuple[dict[str, Any], list[Cell]]] = []
    for keys, _ in parts.panels:
        cells = [cell for cell in found.cells if all(cell.keys[name] == keys[name] for name in parts.names)]
        drawn.append((keys, cells))
    kept, notes = _with_breadth(drawn, x.column, by)
    check_panels(len(kept), parts.names, parts.frame, wish.facet)
    panels = tuple(
        Panel(parts.title(keys), tuple(_line_marks(cells, along, series, y, wish.statistic)))
        for keys, cells in kept
    )
    cells = [cell for _, cells in kept for cell in cells]
    axis = along.axis(wish.log.of("x"))
    drawn_at = {along.place(cell.keys) for cell in cells}
    return Picture(
        x=replace(axis, ticks=tuple(tick for tick in axis.ticks if tick in drawn_at)),
        y=PictureAxis(y.label, wish.log.of("y"), robust=wish.robust),
        panels=panels,
        series=series.labels,
        notes=(
            *_averaged(cells, y.column, wish.statistic),
            *Tally.of(cells).notes(wish.outcomes),
            *notes,
            *found.notes,
            *without,
            *left,
        ),
        columns=as_columns(flat_cells(found)),
        runs=sum(cell.runs for cell in cells),
    )


def _known(frame: Frame, name: str) -> tuple[Frame, list[str]]:
    """Return the runs that have a value, and a sentence on those that don't."""
    present = frame.column(name).present
    if present.all():
        return frame, []
    if not present.any():
        raise InputError(f"{name}: none of the runs has it: there is nothing to draw", "x")
    return frame.select(present), [f"not drawn: {plural(int((~present).sum()), 'run')} without {name}"]


def _with_breadth(
    drawn: list[tuple[dict[str, Any], list[Cell]]], name: str, by: Sequence[str]
) -> tuple[list[tuple[dict[str, Any], list[Cell]]], list[str]]:
    """Leave out panels with a single value where others have several."""
    wide = [one for one in drawn if _breadth(one[1], name, by) > 1]
    if not wide or len(wide) == len(drawn):
        return drawn, []
    left = len(drawn) - len(wide)
    panels = "panel" if left == 1 else "panels"
    return wide, [f"{left} {panels} with a single value of {name} left out"]


def _breadth(cells: Sequence[Cell], name: str, by: Sequence[str]) -> int:
    """Return the number of values of the series with most of them."""
    found: dict[str, set[str]] = {}
    for cell in cells:
        series = _identity([cell.keys[one] for one in by])
        found.setdefault(series, set()).add(_identity(cell.keys[name]))
    return max(map(len, found.values()), default=0)


def _line_marks(
    cells: Sequence[Cell], along: Along, series: Series, y: Metric, statistic: Statistic
) -> list[Line | MissingMark]:
    ways: dict[int, list[Cell]] = {}
    for cell in cells:
        ways.setdefault(series.of(cell.keys), []).append(cell)
    marks: list[Line | MissingMark] = []
    failed: Counter[tuple[int, float]] = Counter()
    for number, members in ways.items():
        ordered = sorted(members, key=lambda cell: along.place(cell.keys))
        places = [along.place(cell.keys) for cell in ordered]
        three = np.array([_three(cell.figures[y.column], statistic) for cell in ordered]) * y.factor
        marks.append(Line(number, np.array(places), three[:, 0], three[:, 1], three[:, 2], marked=True))
        for place, cell in zip(places, ordered, strict=True):
            key = (number if len(ways) <= MOST_COUNTED else -1, place)
            failed[key] += sum(cell.failures.values())
    return [
        *marks,
        *(MissingMark(number, place, count) for (number, place), count in failed.items() if count),
    ]


def _three(figure: Summed, statistic: Statistic) -> tuple[float, float, float]:
    """Return the middle of some runs and the ends of its bar, NaN where there are none."""
    if figure.summary is None:
        return (math.nan,) * 3
    if statistic is Statistic.MEAN:
        mean, std = figure.summary.mean, figure.summary.std
        return (mean, math.nan, math.nan) if std is None else (mean, mean - std, mean + std)
    middle = figure.middle
    ends = figure.ends if len(figure.ends) == 2 else (math.nan, math.nan)
    return (middle if middle is not None and math.isfinite(middle) else math.nan, *ends)


def _averaged(cells: Sequence[Cell], name: str, statistic: Statistic) -> list[str]:
    """Say what stands for several runs."""
    figures = [cell.figures[name] for cell in cells]
    summaries = [figure.summary for figure in figures if figure.summary is not None]
    if not summaries:
        raise nothing(name)
    ns = [summary.n for summary in summaries]
    if max(ns) == 1:
        return ["each mark is one result"]
    if statistic is Statistic.MEAN:
        return [f"each mark is the mean of {span(ns)} results, bars are the standard deviation (n − 1)"]
    many = any(figure.median_interval is not None for figure in figures)
    bars = "the range, from 10 runs on the 95 % interval of the median" if many else "the range"
    last = ", runs that failed behind all others" if any(figure.censored for figure in figures) else ""
    return [f"each mark is the median of {span(ns)} results{last}; bars are {bars}"]


def box(frame: Frame, wish: Wish) -> Picture:
    """Return the spread of a figure: a box for each value along x and each series."""
    y = wish.number("y", error_of(frame), frame)
    frame, left = with_figure(frame, y.column)
    x = wish.named("x", ("dataset",), frame)
    by, facet = wish.series(frame, x), wish.columns("facet", (), frame)
    told = list(dict.fromkeys([*by, *x]))
    parts = parted(frame, facet, told, (*x, y.column))
    check_panels(len(parts.panels), parts.names, parts.frame, wish.facet)
    found = aggregate(parts.frame, [y.column], [*parts.names, *told], wish.outcomes)
    along, series = Along(parts.frame, x, "x"), Series(by, parts.frame)
    members = list(zip(found.cells, _values(parts.frame, found, y, wish), strict=True))
    _averaged(found.cells, y.column, wish.statistic)
    panels = []
    for keys, _ in parts.panels:
        mine = [one for one in members if all(one[0].keys[name] == keys[name] for name in parts.names)]
        panels.append(Panel(parts.title(keys), tuple(_box_marks(mine, along, series))))
    few = any(0 < len(values) < _LEAST_BOX for _, values in members)
    whole = any(len(values) >= _LEAST_BOX for _, values in members)
    what = []
    if whole:
        what.append(
            "boxes: median, quartiles, whiskers to the last run that counts in 1.5 quartile distances"
        )
    if few:
        what.append(f"below {_LEAST_BOX} runs: each that counts, with a bar at their median")
    return Picture(
        x=along.axis(),
        y=PictureAxis(y.label, wish.log.of("y"), robust=wish.robust),
        panels=tuple(panels),
        series=series.labels,
        notes=(
            *what,
            *Tally.of(found.cells).notes(wish.outcomes),
            *(note.replace("averaged over", "boxes hold") for note in found.notes),
            *left,
        ),
        columns=_runs(parts.frame, [*parts.names, *told], (y,), counts(parts.frame, y, wish)),
        runs=len(parts.frame),
    )


def counts(frame: Frame, metric: Metric, wish: Wish) -> Any:
    """Tell which rows have a number of a metric that counts, (n,)."""
    known = ~np.isnan(frame.column(metric.column).floats())
    return counting(frame, wish.outcomes) & sound(frame, metric.column, wish.outcomes) & known


def _values(frame: Frame, found: Aggregate, metric: Metric, wish: Wish) -> list[Floats]:
    numbers = frame.column(metric.column).floats() * metric.factor
    inside = counts(frame, metric, wish)
    return [numbers[rows[inside[rows]]] for rows in found.members]


def _box_marks(
    members: Sequence[tuple[Cell, Floats]], along: Along, series: Series
) -> list[Box | Dots | Ranges | MissingMark]:
    marks: list[Box | Dots | Ranges | MissingMark] = []
    places: dict[float, list[tuple[int, Cell, Floats]]] = {}
    for cell, values in members:
        places.setdefault(along.place(cell.keys), []).append((series.of(cell.keys), cell, values))
    for place, inside in places.items():
        room = min(0.84 / len(inside), 0.5)
        for turn, (number, cell, values) in enumerate(sorted(inside, key=lambda one: one[0])):
            at = place + (turn - (len(inside) - 1) / 2) * room
            marks += _one_box(number, at, room, values)
            if len(inside) <= MOST_COUNTED and (failed := sum(cell.failures.values())):
                marks.append(MissingMark(number, at, failed))
        if len(inside) > MOST_COUNTED and (
            failed := sum(sum(cell.failures.values()) for _, cell, _ in inside)
        ):
            marks.append(MissingMark(-1, place, failed))
    return marks


def _one_box(number: int, at: float, room: float, values: Floats) -> list[Box | Dots | Ranges]:
    """Return some runs of a series: as a box with those outside; few as themselves and their median."""
    if not len(values):
        return []
    if len(values) >= _LEAST_BOX:
        whole = Box(number, at, 0.8 * room, values)
        dots = values if len(values) <= MOST_POINTS else whole.outside
        aside = _beside(len(dots)) * 0.2 * room
        return [whole, Dots(number, at + aside, dots, small=True)]
    aside = _beside(len(values)) * 0.25 * room
    middle, ends = np.median(values, keepdims=True), np.array([[at - 0.35 * room, at + 0.35 * room]])
    bar = [Ranges(number, np.array([at]), middle, x_ends=ends)] if len(values) > 1 else []
    return [*bar, Dots(number, at + aside, values)]


def _beside(count: int) -> Floats:
    """Return the places of runs beside a box's middle, -1 … 1, (n,): not in a line, the same each time."""
    if count < 2:
        return np.zeros(count)
    return (np.arange(count, dtype=np.float64) * 0.618034 % 1.0) * 2 - 1


def _runs(frame: Frame, names: Sequence[str], metrics: Sequence[Metric], inside: Any) -> dict[str, list[Any]]:
    """Return the runs of a figure one by one, those without a number too."""
    columns = list(dict.fromkeys(["run", *names, *(metric.column for metric in metrics), "status"]))
    return {name: frame.column(name).tolist() for name in columns} | {"drawn": inside.tolist()}


def heat(frame: Frame, wish: Wish) -> Picture:
    """Return a figure over two columns: the median of each pair of values as a colour."""
    colour = wish.number("by", error_of(frame), frame)
    frame, left = with_figure(frame, colour.column)
    both = [setting_of(frame, number, "") for number in (0, 1)]
    if not both[1] and (not both[0] or varies(frame, "dataset")):  # one setting at most was varied
        both = ["dataset", ""]
    x = wish.named("x", (both[0],), frame)
    y = wish.named("y", (both[1],) if both[1] else COMPETITORS, frame)
    if twice := set(x) & set(y):
        raise InputError(f"{min(twice)} stands along x already: a heat map has two sides", "y")
    facet = wish.columns("facet", (), frame)
    told = [*x, *y]
    parts = parted(frame, facet, told, (*told, colour.column))
    check_panels(len(parts.panels), parts.names, parts.frame, wish.facet)
    found = aggregate(parts.frame, [colour.column], [*parts.names, *told], wish.outcomes)
    across, up = Along(parts.frame, x, "x"), Along(parts.frame, y, "y")
    stated = (
        _averaged(found.cells, colour.column, wish.statistic)[0].partition("; bars")[0].partition(", bars")[0]
    )
    panels = []
    for keys, _ in parts.panels:
        cells = [cell for cell in found.cells if all(cell.keys[name] == keys[name] for name in parts.names)]
        panels.append(Panel(parts.title(keys), (_tiles(cells, across, up, colour, wish.statistic),)))
    failed = any(cell.failures and not cell.n for cell in found.cells)
    return Picture(
        x=across.axis(),
        y=up.axis(),
        panels=tuple(panels),
        series=(),
        notes=(
            stated.replace("mark", "tile"),
            *(["×: all runs failed or were not tracked; empty: nothing was run"] if failed else []),
            *Tally.of(found.cells).notes(wish.outcomes, above=False),
            *found.notes,
            *left,
        ),
        columns=as_columns(flat_cells(found)),
        runs=len(parts.frame),
        colour=PictureAxis(
            colour.label, wish.log.of("y"), robust=wish.robust, better=measure_of(colour.column).better
        ),
    )


def _tiles(cells: Sequence[Cell], across: Along, up: Along, metric: Metric, statistic: Statistic) -> Tiles:
    shape = len(up.texts), len(across.texts)
    values, texts = np.full(shape, np.nan), [[""] * shape[1] for _ in range(shape[0])]
    for cell in cells:
        column = int(across.place(cell.keys))
        row = int(up.place(cell.keys))
        value = _three(cell.figures[metric.column], statistic)[0] * metric.factor
        values[row, column] = value
        texts[row][column] = "×" if math.isnan(value) else format(value, metric.format or ".3g")
    return Tiles(values, tuple(map(tuple, texts)))


def front(frame: Frame, wish: Wish) -> Picture:
    """Return error over cost: the medians of the competitors, and those that none beats in both."""
    wish.refuse(
        facet="a front has a panel for each dataset, and for whatever else can't be compared",
        each="a front is of medians",
    )
    y = wish.number("y", error_of(frame), frame)
    x = wish.number("x", cost_of(frame), frame)
    frame, left = with_figure(frame, y.column)
    by = wish.series(frame)
    fronts, notes = pareto(frame, x.column, y.column, by, wish.outcomes)
    fronts = [one for one in fronts if any(math.isfinite(spot.x * spot.y) for spot in one.spots)]
    if not fronts:
        raise nothing(f"both {x.column} and {y.column}")
    varying = [
        name for name in fronts[0].facets if len({_identity(one.facets.get(name)) for one in fronts}) > 1
    ]
    check_panels(len(fronts), varying, frame, None)
    fronts.sort(key=lambda one: [sort_key(one.facets[name]) for name in varying])
    keys = {keys_text(spot.keys): spot.keys for one in fronts for spot in one.spots}
    labels = sorted(keys, key=lambda label: [sort_key(value) for value in keys[label].values()])
    check_series(by, labels)
    panels, rows = [], []
    for one in fronts:
        marks: list[Dots | Ranges | Line | MissingMark] = []
        known = [spot for spot in one.spots if math.isfinite(spot.x) and math.isfinite(spot.y)]
        best = [spot for spot in known if spot.front]
        corners = np.array([[spot.x * x.factor, spot.y * y.factor] for spot in best]).reshape(-1, 2)
        marks.append(Line(-1, corners[:, 0], corners[:, 1], steps=True))
        for spot in one.spots:
            number = labels.index(keys_text(spot.keys))
            rows.append(
                {
                    **one.facets,
                    **spot.keys,
                    x.column: spot.x,
                    y.column: spot.y,
                    "front": spot.front,
                    "n": spot.n,
                    "runs": spot.runs,
                    "failures.by": spot.failures,
                }
            )
            if spot not in known:
                if math.isfinite(spot.x) and math.isinf(spot.y):
                    marks.append(Dots(number, np.array([spot.x]) * x.factor, np.array([math.nan])))
                continue
            place = np.array([spot.x * x.factor]), np.array([spot.y * y.factor])
            if spot.n > 1:
                ends = np.array([spot.x_range]) * x.factor, np.array([spot.y_range]) * y.factor
                marks.append(Ranges(number, *place, *ends))
            marks.append(Dots(number, *place, hollow=(not spot.front,)))
        title = keys_text({name: one.facets[name] for name in varying})
        panels.append(Panel(title, tuple(marks)))
    spots = [spot for one in fronts for spot in one.spots]
    tally = Tally.of(spots)
    ns = [spot.n for spot in spots if spot.n]
    what = "one result" if max(ns) == 1 else f"the median of {span(ns)} results, bars are the range"
    stated = f"each mark is {what}; filled: none is better in both"
    return Picture(
        x=PictureAxis(x.label, wish.log.of("x"), robust=wish.robust),
        y=PictureAxis(y.label, wish.log.of("y"), robust=wish.robust),
        panels=tuple(panels),
        series=tuple(labels),
        notes=(stated, *_failing(fronts, varying), *tally.notes(wish.outcomes, above=False), *notes, *left),
        columns=as_columns(rows),
        runs=sum(spot.runs for spot in spots),
    )


def _failing(fronts: Sequence[Front], varying: Sequence[str]) -> Iterator[str]:
    """Name who is crossed in the field above the axes, and who is nowhere, each with the panels."""
    crossed: dict[str, list[str]] = {}
    absent: dict[str, list[str]] = {}
    for one in fronts:
        title = keys_text({name: one.facets[name] for name in varying})
        for spot in one.spots:
            if math.isinf(spot.y):
                found = crossed if math.isfinite(spot.x) else absent
                found.setdefault(keys_text(spot.keys), []).append(title)
    for said, found in (
        ("crossed above, as the median run failed", crossed),
        ("without a mark, as no run that counts has a cost", absent),
    ):
        if found:
            names = (f"{name} ({', '.join(on)})" if any(on) else name for name, on in found.items())
            yield f"{said}: {'; '.join(names)}"
