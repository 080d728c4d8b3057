# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/analysis``: what is behind the charts."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.boards import COMPETITORS
from slamhive.analysis.grouping import (
    CPU,
    FACETS,
    LOAD_FACETS,
    MEMORY_FACETS,
    OWNERS,
    SUBJECT,
    Groups,
    aggregate,
    follows,
    shows_cpu,
    varies,
    varying,
)
from slamhive.analysis.leaderboard import leaderboard
from slamhive.analysis.measures import CAUSAL
from slamhive.dashboard.answering.encoding import Body, plain
from slamhive.dashboard.answers.columns import coded, figure_json, heading, interval_json, summary_json
from slamhive.dashboard.problems import TooLarge
from slamhive.tables.queries import column, columns, number_column, outcomes, select
from slamhive.tables.text import as_columns, flat_cells, flat_summary, key_text
from slamhive.tables.timeliness import FACTOR, LATENCIES, WORDS, timeliness
from slamhive.tables.words import disproportion_notes, meanings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.frame import Frame
    from slamhive.analysis.grouping import Aggregate
    from slamhive.analysis.leaderboard import Board, Entry, Leaderboard, Standing
    from slamhive.analysis.selection import Chosen
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.tables.queries import Pairs

_NO_FACETS = {*SUBJECT, "settings", "evaluationVersion"}
KEPT_APART = tuple(name for name in (*FACETS, *LOAD_FACETS) if name not in _NO_FACETS)
"""Columns whose mixture a chart must not pass over in silence; of versions of the evaluation a note tells."""

_READER = "usage.includesReader"
_MEMORY, (_KIND,) = ("usage.memory.peakBytes", "usage.memory.meanBytes"), MEMORY_FACETS

EXACT = 5000
"""Points up to which a chart gets every digit and the UIDs of the runs."""

MAX_FIGURES = 30_000
"""Groups times figures of an answer: each takes up to 0.1 ms, with its summary and intervals."""

DIGITS = 6
DEFAULT_METRICS = (
    *("ate.rmse", f"{CAUSAL}ate.rmse", "rpe[0].rmse", "usage.cpu.secondsPerDataSecond"),
    *("usage.cpu.meanCores", "usage.memory.peakBytes", *LATENCIES, FACTOR),
)
POINTS_RESERVED = ("x", "y", "colour", "size", "facet", "digits", "format")
AGGREGATE_RESERVED = ("by", "metrics", "outcomes", "format")
LEADERBOARD_RESERVED = ("metric", "by", "outcomes", "format")


def points(snapshot: Snapshot, pairs: Pairs, axes: dict[str, str | None], digits: int | None) -> Body:
    """Return one point a run and evaluation: columns for any axis, with what became of each run.

    Args:
        snapshot: the data.
        pairs: the query string: filters.
        axes: column by axis: x, y, colour, size, facet.
        digits: significant digits; default: all of them up to 5,000 points, 6 beyond.
    """
    for axis, name in axes.items():
        if name is not None:
            column(snapshot.frame, name, axis)
    chosen = select(snapshot.frame, pairs, POINTS_RESERVED)
    frame = chosen.frame
    exact = len(frame) <= EXACT
    shown = digits if digits is not None else (None if exact else DIGITS)
    content: dict[str, Any] = {
        "revision": snapshot.revision,
        "count": len(frame),
        "digits": shown,
        "axes": {
            axis: heading(frame, name, [*filter(None, axes.values())]) | coded(frame.column(name), shown)
            for axis, name in axes.items()
            if name is not None
        },
        "status": coded(frame.column("status")),
        "id": frame.column("id").floats().astype(np.int64),
        "uid": frame.column("uid").tolist() if exact else None,
        "run": frame.column("run").tolist() if exact else None,
        "notes": list(chosen.notes),
        "mixed": mixtures(frame, [name for name in axes.values() if name]),
    }
    names = list(dict.fromkeys(["uid", "run", "status", *(name for name in axes.values() if name)]))
    return Body(content, lambda: {name: frame.column(name).tolist() for name in names})


def mixtures(frame: Frame, told: list[str]) -> list[dict[str, Any]]:
    """Return the columns that ought not be mixed and yet are, with a sentence each.

    Args:
        frame: the rows.
        told: columns that a chart tells apart itself.
    """
    mixed = []
    candidates = [(name, frame) for name in KEPT_APART if name != _READER]
    if any(name.startswith(CPU) for name in told):
        candidates.append((_READER, frame.select(shows_cpu(frame))))
    if not set(_MEMORY).isdisjoint(told):
        candidates.append((_KIND, frame.select(frame.column(_MEMORY[0]).present)))
    for name, rows in candidates:
        if name in told or not varies(rows, name):
            continue
        owner = OWNERS.get(name)
        if owner in {*SUBJECT, *told} and follows(rows, name, owner):
            continue
        values = rows.column(name).unique()
        shown = ", ".join("unknown" if value is None else key_text(value) for value in values[:6])
        sentence = f"runs of different {name} are mixed here ({shown}): choose one, or tell them apart by it"
        mixed.append({"column": name, "values": values[:100], "sentence": sentence})
    return mixed


def aggregated(snapshot: Snapshot, pairs: Pairs, by: str | None, metrics: str | None, which: str) -> Body:
    """Return groups of runs with their figures.

    Args:
        snapshot: the data.
        pairs: the query string: filters.
        by: list of columns; default: algorithm, sensors, dataset and what varies.
        metrics: list of columns; default: those of DEFAULT_METRICS that hold something.
        which: tracked or all.
    """
    chosen = select(snapshot.frame, pairs, AGGREGATE_RESERVED)
    frame = chosen.frame
    asked = None if by is None else columns(snapshot.frame, by, "by")
    usual = [name for name in DEFAULT_METRICS if not frame.column(name).is_empty]
    shown = columns(snapshot.frame, metrics, "metrics", usual)
    for name in shown:
        number_column(snapshot.frame, name, "metrics")
    keys = [*SUBJECT, *varying(frame)] if asked is None else asked
    limit_groups(frame, keys, len(shown))
    found = aggregate(frame, shown, asked, outcomes(which))
    return Body(_aggregate_json(snapshot, chosen, found), lambda: as_columns(flat_cells(found)))


def limit_groups(frame: Frame, keys: Sequence[str], figures: int) -> None:
    """Refuse a question whose answer would have too many figures, before they are computed.

    Args:
        frame: the rows.
        keys: columns that tell groups apart; facets may tell apart some more.
        figures: of each group.

    Raises:
        TooLarge: there are more than MAX_FIGURES.
    """
    if len(frame) * figures <= MAX_FIGURES:
        return
    groups = Groups(frame, keys).count
    if groups * figures > MAX_FIGURES:
        each = "" if figures == 1 else f" of {figures} figures each"
        raise TooLarge(
            f"{groups:,} groups{each} are asked for, and an answer has at most {MAX_FIGURES:,} figures: "
            "choose fewer columns to group by, or fewer runs",
            "by",
        )


def _aggregate_json(snapshot: Snapshot, chosen: Chosen, found: Aggregate) -> dict[str, Any]:
    """Return groups of runs with the figures of each."""
    frame = chosen.frame
    return {
        "revision": snapshot.revision,
        "rows": len(frame),
        "keys": [heading(frame, name) | {"facet": name in found.facets} for name in found.keys],
        "metrics": [heading(frame, name, found.metrics) for name in found.metrics],
        "groups": [
            {
                "keys": cell.keys,
                "runs": cell.runs,
                "n": cell.n,
                "copies": cell.copies,
                "failed": sum(cell.failures.values()),
                "failures": cell.failures,
                "untracked": cell.untracked,
                "deterministic": cell.deterministic,
                "findings": cell.findings,
                "reader": cell.reader,
                "late": cell.late,
                "chosen": cell.chosen,
                "coverage": summary_json(cell.coverage),
                "figures": {name: figure_json(figure) for name, figure in cell.figures.items()},
            }
            for cell in found.cells
        ],
        "notes": [
            *meanings(frame, [*found.metrics, "coverage"]),
            *chosen.notes,
            *found.notes,
            *disproportion_notes(frame),
        ],
    }


def ranked(snapshot: Snapshot, pairs: Pairs, metric: str, by: str | None, which: str) -> Body:
    """Return leaderboards.

    Args:
        snapshot: the data.
        pairs: the query string: filters.
        metric: column to rank by.
        by: list of columns that tell competitors apart; default: algorithm, sensors.
        which: tracked or all.
    """
    number_column(snapshot.frame, metric, "metric")
    told = columns(snapshot.frame, by, "by", COMPETITORS)
    chosen = select(snapshot.frame, pairs, LEADERBOARD_RESERVED)
    frame = chosen.frame
    found = leaderboard(frame, metric, told, outcomes(which))
    timely = timeliness(frame, metric, told, outcomes(which))
    content = {
        "revision": snapshot.revision,
        "rows": len(frame),
        "metric": heading(frame, metric),
        "by": list(found.by),
        "pooled": found.pooled,
        "whose": found.whose,
        "boards": [_board_json(board) for board in found.boards],
        "timely": timely and {"words": WORDS} | _aggregate_json(snapshot, chosen, timely),
        "notes": [
            *meanings(frame, [metric, "coverage"]),
            *chosen.notes,
            *found.notes,
            *disproportion_notes(frame),
        ],
    }
    return Body(content, lambda: as_columns(_board_rows(found)))


def _board_json(board: Board) -> dict[str, Any]:
    return {
        "facets": board.facets,
        "datasets": board.datasets,
        "entries": [_entry_json(entry) for entry in board.entries],
    }


def _entry_json(entry: Entry) -> dict[str, Any]:
    return {
        "keys": entry.keys,
        "rank": plain(entry.rank),
        "unranked": entry.unranked,
        "rankInterval": interval_json(entry.rank_interval),
        "score": plain(entry.score),
        "ratio": plain(entry.ratio),
        "ratioInterval": interval_json(entry.ratio_interval),
        "ratioFailed": plain(entry.ratio) is None,
        "runs": entry.runs,
        "n": entry.n,
        "copies": entry.copies,
        "failed": entry.failed,
        "datasets": [_standing_json(standing) for standing in entry.standings],
    }


def _standing_json(standing: Standing) -> dict[str, Any]:
    return {
        "dataset": standing.dataset,
        "runs": standing.runs,
        "n": standing.n,
        "copies": standing.copies,
        "failures": standing.failures,
        "median": plain(standing.median),
        "medianFailed": math.isinf(standing.median),
        "rank": plain(standing.rank),
        "summary": summary_json(standing.summary),
        "coverage": standing.coverage,
    }


def _board_rows(found: Leaderboard) -> list[dict[str, Any]]:
    return [
        {
            **board.facets,
            **entry.keys,
            "rank": entry.rank,
            "rank.low": entry.rank_interval.low,
            "rank.high": entry.rank_interval.high,
            "score": entry.score,
            "ratio": entry.ratio,
            "runs": entry.runs,
            "n": entry.n,
            "dataset": standing.dataset,
            "dataset.runs": standing.runs,
            "dataset.n": standing.n,
            "dataset.failures": standing.failures,
            "dataset.median": standing.median,
            "dataset.rank": standing.rank,
            "dataset.coverage": standing.coverage,
            **flat_summary("dataset", standing.summary),
        }
        for board in found.boards
        for entry in board.entries
        for standing in entry.standings
    ]
