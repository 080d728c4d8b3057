# SPDX-License-Identifier: Apache-2.0
"""The sections of a report that rank: leaderboard, comparison two by two, accuracy against cost."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from slamhive.analysis.comparing import compare
from slamhive.analysis.leaderboard import leaderboard
from slamhive.analysis.measures import Better, measure_of
from slamhive.analysis.pareto import pareto
from slamhive.model.base import plural
from slamhive.reporting.charts import MOST_ENTRIES, board_chart, front_chart
from slamhive.reporting.drawing import legend
from slamhive.reporting.markup import Markup, clip, element, joined, parse_metric, shown
from slamhive.reporting.tables import Sheet, bold, small
from slamhive.reporting.titles import column_title, keys_text
from slamhive.tables.text import (
    as_columns,
    counts_text,
    flat_summary,
    interval_text,
    n_of_runs,
    number_text,
    range_text,
)
from slamhive.tables.timeliness import timeliness
from slamhive.tables.words import meanings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis import Metric, Outcomes
    from slamhive.analysis.comparing import BoardComparison, CompetitorPair
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.leaderboard import Board, Entry, Standing
    from slamhive.analysis.pareto import Front, Spot

MOST_PAIRS = 30
MOST_FRONTS = 12
MOST_BOARDS = 12
RATIOS = {Better.LOWER: "× best", Better.HIGHER: "best over it", Better.NONE: "× smallest"}


def leaderboard_section(
    frame: Frame, metric: str, by: Sequence[str], outcomes: Outcomes
) -> tuple[Markup, list[str]]:
    """Return the leaderboards and their notes."""
    found = leaderboard(frame, metric, by, outcomes)
    unit = parse_metric(metric)
    parts: list[Markup] = [element("p", found.pooling)] if found.pooling else []
    boards = sorted(found.boards, key=lambda board: len(board.entries) < 2)
    for number, board in enumerate(boards[:MOST_BOARDS], 1):
        parts.append(element("h3", _board_title(board.facets, board.datasets)))
        if len(board.entries) > 1 and _has_medians(board):
            names = [shown(name) for name in board.datasets]
            what = f"Median {unit.title}; the line is the range of the runs that count."
            parts.append(figure(what, board_chart(board, unit), legend(names) if len(names) > 1 else None))
        if len(board.entries) > MOST_ENTRIES:
            parts.append(element("p", f"The chart has the first {MOST_ENTRIES}.", class_="quiet"))
        parts.append(_board_sheet(board, unit, number).html())
    left = len(found.boards) - MOST_BOARDS
    notes = [*found.notes, *([f"{left} further boards with fewer runs are left out"] if left > 0 else [])]
    return joined(parts), notes


def timeliness_section(
    frame: Frame, metric: str, by: Sequence[str], outcomes: Outcomes
) -> tuple[Markup, list[str]] | None:
    """Return the table of what was known when, and its notes; None where no run was played to."""
    found = timeliness(frame, metric, by, outcomes)
    if found is None:
        return None
    units = [parse_metric(name) for name in found.metrics]
    headings = [(column_title(name, found.keys), False) for name in found.keys]
    headings += [(unit.title_among(found.metrics), True) for unit in units] + [("n/runs", True)]
    lines, rows = [], []
    for cell in found.cells:
        summaries = {name: figure.summary for name, figure in cell.figures.items()}
        medians = {name: one.median if one else None for name, one in summaries.items()}
        lines.append(
            [
                *(shown(value) for value in cell.keys.values()),
                *(unit.show(medians[unit.column]) for unit in units),
                n_of_runs(cell),
            ]
        )
        flat = {
            key: value for name, one in summaries.items() for key, value in flat_summary(name, one).items()
        }
        rows.append({**cell.keys, "runs": cell.runs, "n": cell.n, **flat})
    caption = "Causal and final errors, latency and real-time factor"
    sheet = Sheet("timeliness", caption, headings, lines, as_columns(rows))
    return sheet.html(), [*meanings(frame, found.metrics), *found.notes]


def _has_medians(board: Board) -> bool:
    return any(math.isfinite(one.median) for entry in board.entries for one in entry.standings)


def _board_title(facets: dict[str, Any], datasets: Sequence[Any]) -> str:
    told = keys_text(facets)
    names = clip(", ".join(shown(name) for name in datasets), 200)
    return f"{names} ({told})" if told else names


def _board_sheet(board: Board, metric: Metric, number: int) -> Sheet:
    names = list(board.entries[0].keys)
    headings = [("rank", True), ("95 %", True), *((column_title(name, names), False) for name in names)]
    headings += [("score", True), (RATIOS[measure_of(metric.column).better], True), ("n/runs", True)]
    headings += [(shown(dataset), True) for dataset in board.datasets]
    lines = []
    for entry in board.entries:
        here = {str(standing.dataset): standing for standing in entry.standings}
        ratio = "failed" if math.isinf(entry.ratio) else number_text(entry.ratio)
        lines.append(
            [
                entry.unranked or bold(number_text(entry.rank, "g")),
                interval_text(entry.rank_interval),
                *(shown(value) for value in entry.keys.values()),
                number_text(entry.score, ".2f"),
                ratio,
                n_of_runs(entry),
                *(_standing(here.get(str(dataset)), metric) for dataset in board.datasets),
            ]
        )
    rows = [_standing_row(board, entry, one) for entry in board.entries for one in entry.standings]
    caption = f"Median {metric.title} of each dataset with range, n of runs, coverage and failures"
    return Sheet(f"leaderboard-{number}", caption, headings, lines, as_columns(rows))


def _standing(standing: Standing | None, metric: Metric) -> Markup:
    if standing is None:
        return Markup("–")
    median = bold("failed" if math.isinf(standing.median) else number_text(None))
    if math.isfinite(standing.median):
        median = bold(metric.show(standing.median))
    words = [f"n {n_of_runs(standing)}"]
    if standing.summary is not None and standing.n > 1:
        words.insert(0, range_text(metric, standing.summary))
    if standing.coverage is not None:
        words.append(f"cov. {standing.coverage:.3f}")
    failed = counts_text(standing.failures)
    return joined(
        [median, Markup("<br>"), small(", ".join(words), *([Markup("<br>"), failed] if failed else []))]
    )


def _standing_row(board: Board, entry: Entry, standing: Standing) -> dict[str, Any]:
    return {
        **board.facets,
        **entry.keys,
        "rank": entry.rank,
        "rank.low": entry.rank_interval.low,
        "rank.high": entry.rank_interval.high,
        "score": entry.score,
        "ratio": entry.ratio,
        "dataset": standing.dataset,
        "runs": standing.runs,
        "n": standing.n,
        "copies": standing.copies,
        "failures": standing.failures,
        "median.censored": standing.median,
        "dataset.rank": standing.rank,
        "coverage": standing.coverage,
        **flat_summary("figure", standing.summary),
    }


def comparison_section(
    frame: Frame, metric: str, by: Sequence[str], outcomes: Outcomes
) -> tuple[Markup, list[str]]:
    """Return the comparisons two by two and their notes."""
    boards, notes = compare(frame, metric, by, outcomes)
    parts: list[Markup] = []
    for number, board in enumerate((one for one in boards if one.pairs), 1):
        if number > MOST_BOARDS:
            break
        datasets = list(dict.fromkeys(name for pair in board.pairs for name in pair.datasets))
        parts += [element("h3", _board_title(board.facets, datasets)), _pairs_sheet(board, number).html()]
    if not parts:
        parts = [element("p", "No two competitors share a dataset under equal conditions.")]
    return joined(parts), notes


def _pairs_sheet(board: BoardComparison, number: int) -> Sheet:
    word = board.pairs[0].word
    headings = [("A", False), ("B", False), ("datasets", True), (f"A {word}", True), (f"B {word}", True)]
    headings += [("B / A", True), ("95 %", True), ("effect", True), ("p (Holm)", True)]
    verdicts = [_verdict(pair) for pair in board.pairs]
    alike = len(set(verdicts)) == 1
    headings += [] if alike else [("verdict", False)]
    lines = [
        [
            keys_text(pair.a),
            keys_text(pair.b),
            str(len(pair.datasets)),
            str(pair.wins[0]),
            str(pair.wins[1]),
            number_text(pair.ratio),
            interval_text(pair.ratio_interval),
            f"{pair.effect:+.2f}",
            number_text(pair.p_holm),
            *([] if alike else [verdict]),
        ]
        for pair, verdict in zip(board.pairs[:MOST_PAIRS], verdicts, strict=False)
    ]
    rows = [board.facets | pair.flat() for pair in board.pairs]
    shown_of = f", the surest {MOST_PAIRS} of {len(rows)}" if len(rows) > MOST_PAIRS else ""
    caption = f"Two by two: medians of each dataset, sign-flip test, corrected after Holm{shown_of}"
    if alike:
        caption += f". All of them: {verdicts[0]}"
    return Sheet(f"comparison-{number}", caption, headings, lines, as_columns(rows))


def _verdict(pair: CompetitorPair) -> str:
    sentence = pair.sentence
    return sentence.partition(": ")[2] or sentence


def fronts_section(
    frame: Frame, axes: tuple[str, str], by: Sequence[str], outcomes: Outcomes
) -> tuple[Markup, list[str]]:
    """Return accuracy against one cost, and notes.

    Args:
        frame: the runs.
        axes: columns of cost and error.
        by: columns that tell competitors apart.
        outcomes: which runs count.
    """
    found, notes = pareto(frame, *axes, by, outcomes)
    drawn = [front for front in found if any(math.isfinite(spot.x) for spot in front.spots)]
    drawn.sort(key=lambda front: len(front.spots) < 2)
    if not drawn:
        return element("p", f"No run that counts has a figure for {axes[0]}."), []
    told = [name for name in by if name != "dataset"]  # each dataset has a chart of its own
    names = sorted({keys_text(spot.keys) for front in drawn for spot in front.spots})
    there = {keys_text(spot.keys) for front in drawn[:MOST_FRONTS] for spot in front.spots}
    charts = []
    for front in drawn[:MOST_FRONTS]:
        title = keys_text(front.facets) or "all runs"
        charts.append(figure(title, front_chart(front, drawn[:MOST_FRONTS], axes, names, title)))
    left = len(drawn) - len(charts)
    more = [f"{left} further charts with fewer runs are left out; the table has them"] if left else []
    if unknown := sum(math.isnan(spot.x) for front in drawn for spot in front.spots):
        more.append(
            f"in the table alone, without a run that counts with this cost: {plural(unknown, 'competitor')}"
        )
    sheet = _fronts_sheet(drawn, axes)
    return joined(
        [legend(names, there) if told else None, element("div", *charts, class_="grid"), sheet.html()]
    ), [*notes, *more]


def _fronts_sheet(fronts: Sequence[Front], axes: tuple[str, str]) -> Sheet:
    cost, error = parse_metric(axes[0]), parse_metric(axes[1])
    spots = [(front, spot) for front in fronts for spot in front.spots]
    names = [*spots[0][0].facets, *spots[0][1].keys]
    headings = [
        *((column_title(name, names), False) for name in names),
        (cost.title, True),
        (error.title, True),
    ]
    headings += [("n/runs", True), ("coverage", True), ("failures", False), ("front", False)]
    lines, rows = [], []
    for front, spot in spots:
        keys = [*front.facets.values(), *spot.keys.values()]
        lines.append(
            [
                *(shown(value) for value in keys),
                "–" if math.isnan(spot.x) else cost.show(spot.x),
                "failed" if math.isinf(spot.y) else error.show(spot.y),
                n_of_runs(spot),
                number_text(spot.coverage),
                counts_text(spot.failures),
                "yes" if spot.front else "",
            ]
        )
        rows.append(_spot_row(front, spot, axes))
    return Sheet(
        f"pareto-{axes[0]}", f"Medians of {cost.title} and {error.title}", headings, lines, as_columns(rows)
    )


def _spot_row(front: Front, spot: Spot, axes: tuple[str, str]) -> dict[str, Any]:
    return {
        **front.facets,
        **spot.keys,
        axes[0]: spot.x,
        axes[1]: spot.y,
        "runs": spot.runs,
        "n": spot.n,
        "copies": spot.copies,
        "failures": spot.failures,
        "coverage": spot.coverage,
        "front": spot.front,
    }


def figure(caption: str, chart: Markup, below: Markup | None = None) -> Markup:
    """Return a chart with its caption and what stands below it."""
    return element("figure", element("figcaption", clip(caption)), chart, below)
