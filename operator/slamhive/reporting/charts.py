# SPDX-License-Identifier: Apache-2.0
"""The charts of a report: who stands where, accuracy against cost, one thing over another."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

from slamhive.analysis.measures import CONFIGURATION
from slamhive.reporting.drawing import BAND, WIDTH, SeriesStyle, SvgDrawing, cut
from slamhive.reporting.markup import parse_metric, shown
from slamhive.reporting.scales import MOST_TICKS, Scale, nice_ticks
from slamhive.reporting.titles import column_title, keys_text
from slamhive.tables.text import counts_text, number_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import Any

    from slamhive.analysis import Metric
    from slamhive.analysis.cells import Cell
    from slamhive.analysis.leaderboard import Board
    from slamhive.analysis.pareto import Front
    from slamhive.reporting.markup import Markup
    from slamhive.reporting.studies import Study, StudyPanel

MOST_ENTRIES = 30
MOST_LANES = 8
MOST_CROSSES = 3
"""Series of a chart up to which each has its own failures counted above it."""

_LEFT, _RIGHT = 52.0, 12.0
_TOP, _PLOT, _BELOW = 24.0, 220.0, 40.0
_LANE, _NAME = 13.0, 18.0
_FAILED = 62.0


def board_chart(board: Board, metric: Metric) -> Markup:
    """Draw a leaderboard: the median and range of each competitor on each dataset."""
    entries = board.entries[:MOST_ENTRIES]
    lanes = min(len(board.datasets), MOST_LANES)
    step = _NAME + lanes * _LANE + 4
    bottom = _TOP + len(entries) * step
    drawing = SvgDrawing(f"{metric.title} of each competitor on each dataset", bottom + _BELOW)
    failing = any(one.failures or math.isinf(one.median) for entry in entries for one in entry.standings)
    right = WIDTH - (_FAILED if failing else 24.0)
    numbers = [
        one.median * metric.factor
        for entry in entries
        for standing in entry.standings
        for one in (standing,)
        if math.isfinite(one.median)
    ]
    ends = [
        end * metric.factor
        for entry in entries
        for standing in entry.standings
        if standing.summary is not None
        for end in (standing.summary.min, standing.summary.max)
    ]
    scale = Scale.over([*numbers, *ends], 24.0, right)
    if failing:
        drawing.band(right + 6, _TOP, WIDTH - right - 6, bottom - _TOP)
        drawing.text(right + 10, _TOP - 6, "failed")
    drawing.x_axis(scale, _TOP, bottom, metric.title)
    for place, entry in enumerate(entries):
        top = _TOP + place * step
        name = keys_text(entry.keys)
        if place:
            drawing.line((0, top), (WIDTH, top), "rule strong")
        drawing.text(10, top + 13, cut(f"{number_text(entry.rank, 'g')}  {name}", WIDTH - 120), class_="who")
        for standing in entry.standings:
            lane = board.datasets.index(standing.dataset)
            y = top + _NAME + (lane % lanes + 0.5) * _LANE
            style = SeriesStyle(lane)
            title = f"{name} on {shown(standing.dataset)}: {_standing_words(standing, metric)}"
            if standing.summary is not None and standing.n > 1:
                low, high = (
                    scale.at(end * metric.factor) for end in (standing.summary.min, standing.summary.max)
                )
                drawing.line((low, y), (high, y), f"range {style.colour}")
            if math.isfinite(standing.median):
                drawing.mark(scale.at(standing.median * metric.factor), y, style, title)
            else:
                drawing.cross(right + 22, y, style, title)
            if failures := sum(standing.failures.values()):
                aside = 10 if math.isfinite(standing.median) else 32
                drawing.text(right + aside, y + 4, f"{failures} of {standing.runs}", class_="small")
    return drawing.svg()


def _standing_words(standing: Any, metric: Metric) -> str:
    median = metric.show(standing.median) if math.isfinite(standing.median) else "median run failed"
    return f"{median} ({standing.n + standing.copies} of {standing.runs} runs count)"


def front_chart(
    front: Front, among: Sequence[Front], axes: tuple[str, str], names: Sequence[str], title: str
) -> Markup:
    """Draw error over cost with the front.

    Args:
        front: competitors on one dataset.
        among: all that are drawn, on axes that they share.
        axes: columns of cost and error.
        names: all competitors, in the order of the legend.
        title: what it shows.
    """
    cost, error = parse_metric(axes[0]), parse_metric(axes[1])
    spots = [spot for spot in front.spots if not math.isnan(spot.x)]
    every = [spot for one in among for spot in one.spots if not math.isnan(spot.x)]
    drawing, top = _plot(title, failures=any(math.isinf(spot.y) for spot in every))
    bottom = top + _PLOT
    costs = [end * cost.factor for spot in every for end in (spot.x, *spot.x_range)]
    x = Scale.over(costs, _LEFT, WIDTH - _RIGHT, zero=True)
    ends = [end for spot in every for end in (spot.y, *spot.y_range)]
    y = Scale.over((end * error.factor for end in ends), bottom, top, ticks=4)
    drawing.x_axis(x, top, bottom, cost.title)
    drawing.y_axis(y, _LEFT, WIDTH - _RIGHT, error.title)
    best = [spot for spot in spots if spot.front]
    corners: list[tuple[float, float]] = []
    for spot in best:
        at = (x.at(spot.x * cost.factor), y.at(spot.y * error.factor))
        corners += [(at[0], corners[-1][1]), at] if corners else [at]
    drawing.path(corners, "front")
    for spot in spots:
        name = keys_text(spot.keys)
        style = SeriesStyle(names.index(name))
        across = x.at(spot.x * cost.factor)
        words = f"{name}: {cost.show(spot.x)} {cost.unit}, {spot.n + spot.copies} of {spot.runs} runs count"
        if math.isinf(spot.y):
            drawing.cross(across, top - 4 - BAND / 2, style, f"{words}; its median run failed")
            continue
        low, high = (y.at(end * error.factor) for end in spot.y_range)
        if high < low:
            drawing.line((across, low), (across, high), f"range {style.colour}")
        left, right = (x.at(end * cost.factor) for end in spot.x_range)
        if left < right:
            height = y.at(spot.y * error.factor)
            drawing.line((left, height), (right, height), f"range {style.colour}")
        title = f"{words}; {error.title} {error.show(spot.y)}"
        drawing.mark(across, y.at(spot.y * error.factor), style, title, hollow=not spot.front)
    return drawing.svg()


def study_chart(made: Study, panel: StudyPanel, title: str) -> Markup:
    """Draw one panel of a study."""
    question = made.question
    metrics = parse_metric(question.x), parse_metric(question.y)
    drawing, top = _plot(title, failures=any(_fails(made, one) for one in made.panels))
    bottom = top + _PLOT
    x = _x_scale(made, metrics[0])
    heights = [height for one in made.panels for height in _heights(made, one, metrics[1])]
    y = Scale.over(heights, bottom, top, log=question.log[1], ticks=4)
    if made.categories is None:
        drawing.x_axis(x, top, bottom, _x_title(made, metrics[0]))
    else:
        room = (WIDTH - _LEFT - _RIGHT) / len(made.categories)
        for number, value in enumerate(made.categories):
            down = 15 + (13 * (number % 2) if room < 90 else 0)
            drawing.text(
                x.at(number),
                bottom + down,
                cut(shown(value), room * (2 if room < 90 else 1)),
                anchor="middle",
            )
    drawing.y_axis(y, _LEFT, WIDTH - _RIGHT, metrics[1].title)
    if question.points:
        _draw_dots(drawing, panel, (x, y), metrics, top)
    else:
        _draw_groups(drawing, made, panel, (x, y), top)
    return drawing.svg()


def time_chart(title: str, seconds: Sequence[float], numbers: Sequence[float], label: str) -> Markup:
    """Draw numbers over the seconds since a run's start."""
    drawing, top = _plot(title, failures=False)
    bottom = top + _PLOT
    x = Scale(min(seconds), max(seconds) or 1.0, _LEFT, WIDTH - _RIGHT, False, nice_ticks(0, max(seconds), 5))
    y = Scale.over([0.0, *numbers], bottom, top, log=False, ticks=4)
    drawing.x_axis(x, top, bottom, "time since the start [s]")
    drawing.y_axis(y, _LEFT, WIDTH - _RIGHT, label)
    drawing.path(
        [(x.at(second), y.at(number)) for second, number in zip(seconds, numbers, strict=True)], "c0"
    )
    return drawing.svg()


def _plot(title: str, *, failures: bool) -> tuple[SvgDrawing, float]:
    """Return an empty chart, and where its axes begin."""
    top = _TOP + (BAND + 4 if failures else 0)
    drawing = SvgDrawing(title, top + _PLOT + _BELOW)
    if failures:
        drawing.band(_LEFT, _TOP, WIDTH - _LEFT - _RIGHT, BAND)
        drawing.text(_LEFT - 6, _TOP + BAND / 2 + 4, "failed", anchor="end")
    return drawing, top


def _x_title(made: Study, metric: Metric) -> str:
    kind = made.question.frame.column(made.question.x).kind
    return f"{metric.column} [h after the first]" if kind == "time" else column_title(metric.column)


def _x_scale(made: Study, metric: Metric) -> Scale:
    if made.categories is not None:
        return Scale(-0.5, len(made.categories) - 0.5, _LEFT, WIDTH - _RIGHT, False, ())
    numbers = [dot.x for panel in made.panels for dot in panel.dots] or [
        made.place(cell.keys[made.question.x]) for panel in made.panels for cell in panel.cells
    ]
    return Scale.over(
        (number * metric.factor for number in numbers),
        _LEFT + 8,
        WIDTH - _RIGHT - 8,
        log=made.question.log[0],
        tried=MOST_TICKS if made.question.x.startswith(CONFIGURATION) else 0,
    )


def _heights(made: Study, panel: StudyPanel, metric: Metric) -> Iterable[float]:
    if made.question.points:
        return [dot.y * metric.factor for dot in panel.dots]
    heights = []
    for cell in panel.cells:
        figure = cell.figures[made.question.y]
        median, ends = figure.middle, figure.ends
        heights += [value * metric.factor for value in (median, *ends, *figure.points) if value is not None]
    return heights


def _fails(made: Study, panel: StudyPanel) -> bool:
    if made.question.points:
        return any(math.isnan(dot.y) for dot in panel.dots)
    return any(cell.failures for cell in panel.cells)


def _draw_dots(
    drawing: SvgDrawing,
    panel: StudyPanel,
    axes: tuple[Scale, Scale],
    metrics: tuple[Metric, Metric],
    top: float,
) -> None:
    x, y = axes
    for dot in panel.dots:
        style, across = SeriesStyle(dot.series), x.at(dot.x * metrics[0].factor)
        words = f"{dot.run}: {metrics[1].show(dot.y)} at {metrics[0].show(dot.x)}, {dot.status}"
        if math.isnan(dot.y):
            drawing.cross(across, top - BAND / 2 - 4, style, f"{dot.run}: {dot.status}")
        else:
            drawing.mark(
                across, y.at(dot.y * metrics[1].factor), style, words, hollow=dot.status != "Tracked"
            )


def _draw_groups(
    drawing: SvgDrawing, made: Study, panel: StudyPanel, axes: tuple[Scale, Scale], top: float
) -> None:
    x, y = axes
    lines: dict[int, list[Cell]] = {}
    for cell in panel.cells:
        lines.setdefault(made.series_of(cell.keys), []).append(cell)
    across, metric = parse_metric(made.question.x), parse_metric(made.question.y)
    crowded = len(lines) > MOST_CROSSES
    failed: Counter[float] = Counter()
    for turn, (number, cells) in enumerate(lines.items()):
        style, way = SeriesStyle(number), []
        # Series that share an x stand side by side.
        aside = (turn - (len(lines) - 1) / 2) * min(9.0, _crowd(made, len(lines)))
        for cell in cells:
            value = made.place(cell.keys[made.question.x])
            if math.isnan(value):
                continue
            factor = 1.0 if made.categories is not None else across.factor
            at = x.at(value * factor) + aside
            point = _draw_group(drawing, cell, at, (y, metric), style)
            way += [point] if point else []
            failures = sum(cell.failures.values())
            failed[at - aside if crowded else at] += failures
            if failures and not crowded:
                words = f"{keys_text(cell.keys)}: {counts_text(cell.failures)} of {cell.runs} runs"
                drawing.cross(at, top - 4 - 0.72 * BAND, style, words)
        if made.categories is None:
            drawing.path(way, style.colour)
    for at, count in failed.items():
        if count:
            down = 0.36 if crowded else 0.07
            drawing.text(at, top - 4 - down * BAND, f"{count:,}", anchor="middle", class_="small")


def _crowd(made: Study, series: int) -> float:
    places = len(made.categories) if made.categories is not None else 12
    return (WIDTH - _LEFT - _RIGHT) / places / (series + 1)


def _draw_group(
    drawing: SvgDrawing, cell: Cell, at: float, axis: tuple[Scale, Metric], style: SeriesStyle
) -> tuple[float, float] | None:
    y, metric = axis
    figure = cell.figures[metric.column]
    median, ends = figure.middle, figure.ends
    keys = keys_text(cell.keys)
    if len(ends) == 2:
        low, high = (y.at(end * metric.factor) for end in ends)
        drawing.line((at, low), (at, high), f"range {style.colour}")
    for value in figure.points if len(figure.points) > 1 else ():
        drawing.dot(at, y.at(value * metric.factor), style)
    if median is None or not math.isfinite(median):
        return None
    point = (at, y.at(median * metric.factor))
    words = f"{keys}: {metric.title} {metric.show(median)}, {cell.n + cell.copies} of {cell.runs} runs count"
    drawing.mark(*point, style, words)
    return point
