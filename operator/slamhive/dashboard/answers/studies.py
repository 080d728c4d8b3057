# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/analysis``: comparisons, fronts, what matters, what repeats, what is suspect."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from slamhive.analysis.boards import COMPETITORS, Window
from slamhive.analysis.comparing import compare
from slamhive.analysis.importance import importance
from slamhive.analysis.machines.nodes import compare_nodes, kind_text
from slamhive.analysis.pareto import pareto
from slamhive.analysis.repeating import repeatability, suspects
from slamhive.dashboard.answering.encoding import Body, plain
from slamhive.dashboard.answers.analysis import limit_groups
from slamhive.dashboard.answers.columns import figure_json, heading, interval_json, summary_json
from slamhive.tables.published import differences_of, load_published, published_on
from slamhive.tables.queries import columns, number_column, outcomes, select
from slamhive.tables.text import as_columns, flat_summary
from slamhive.tables.verdicts import RULE

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.analysis.comparing import CompetitorPair
    from slamhive.analysis.importance import Influences
    from slamhive.analysis.pareto import Spot
    from slamhive.analysis.repeating import Repetitions
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.tables.queries import Pairs

RESERVED = ("metric", "x", "y", "by", "outcomes", "most", "first", "format")
MAX_GROUPS = 1000


def compared(
    snapshot: Snapshot, pairs: Pairs, metric: str, by: str | None, which: str, *, window: Window | None = None
) -> Body:
    """Return competitors two by two; the window says which, where there are too many to read."""
    number_column(snapshot.frame, metric, "metric")
    told = columns(snapshot.frame, by, "by", COMPETITORS)
    chosen = select(snapshot.frame, pairs, RESERVED)
    frame = chosen.frame
    boards, notes = compare(frame, metric, told, outcomes(which), window)
    content = {
        "revision": snapshot.revision,
        "rows": len(frame),
        "metric": heading(frame, metric),
        "by": told,
        "boards": [
            {
                "facets": board.facets,
                "competitors": board.competitors,
                "shown": board.shown,
                "pairs": [_pair_json(pair) for pair in board.pairs],
            }
            for board in boards
        ],
        "notes": [*chosen.notes, *notes],
    }
    return Body(
        content, lambda: as_columns([board.facets | pair.flat() for board in boards for pair in board.pairs])
    )


def _pair_json(pair: CompetitorPair) -> dict[str, Any]:
    return {
        "a": pair.a,
        "b": pair.b,
        "n": len(pair.datasets),
        "datasets": [
            {"dataset": name, "a": plain(a), "b": plain(b)}
            for name, (a, b) in zip(pair.datasets, pair.medians, strict=True)
        ],
        "ratio": plain(pair.ratio),
        "ratioInterval": interval_json(pair.ratio_interval),
        "wins": dict(zip(("a", "b", "ties"), pair.wins, strict=True)),
        "effect": pair.effect,
        "p": pair.p,
        "pHolm": pair.p_holm,
        "leastP": pair.least_p,
        "sentence": pair.sentence,
    }


def fronts(snapshot: Snapshot, pairs: Pairs, axes: tuple[str, str], by: str | None, which: str) -> Body:
    """Return error against cost, one front a dataset."""
    x, y = (number_column(snapshot.frame, name, field) for name, field in zip(axes, "xy", strict=True))
    told = columns(snapshot.frame, by, "by", COMPETITORS)
    chosen = select(snapshot.frame, pairs, RESERVED)
    frame = chosen.frame
    limit_groups(frame, [*told, "dataset"], 1)
    found, notes = pareto(frame, x, y, told, outcomes(which))
    content = {
        "revision": snapshot.revision,
        "rows": len(frame),
        "x": heading(frame, x),
        "y": heading(frame, y),
        "by": told,
        "fronts": [
            {"facets": front.facets, "points": [_spot_json(spot) for spot in front.spots]} for front in found
        ],
        "notes": [*chosen.notes, *notes],
    }
    return Body(
        content,
        lambda: as_columns(
            [{**front.facets, **_flat(_spot_json(spot))} for front in found for spot in front.spots]
        ),
    )


def _spot_json(spot: Spot) -> dict[str, Any]:
    return {
        "keys": spot.keys,
        "x": plain(spot.x),
        "y": plain(spot.y),
        "failed": sum(spot.failures.values()),
        "yFailed": math.isinf(spot.y),
        "xRange": [plain(value) for value in spot.x_range],
        "yRange": [plain(value) for value in spot.y_range],
        "front": spot.front,
        "runs": spot.runs,
        "n": spot.n,
        "copies": spot.copies,
        "failures": spot.failures,
        "coverage": plain(spot.coverage),
    }


def _flat(item: dict[str, Any]) -> dict[str, Any]:
    keys: dict[str, Any] = item.pop("keys")
    return keys | item


def influences(snapshot: Snapshot, pairs: Pairs, metric: str) -> Body:
    """Return the influence of each setting."""
    number_column(snapshot.frame, metric, "metric")
    chosen = select(snapshot.frame, pairs, RESERVED)
    frame = chosen.frame
    found, notes = importance(frame, metric)
    content = {
        "revision": snapshot.revision,
        "rows": len(frame),
        "metric": heading(frame, metric),
        "subjects": [_subject_json(subject) for subject in found],
        "notes": [*chosen.notes, *notes],
    }
    return Body(content, lambda: as_columns([row for subject in found for row in _subject_rows(subject)]))


def _subject_json(subject: Influences) -> dict[str, Any]:
    return {
        "keys": subject.keys,
        "runs": subject.runs,
        "n": subject.n,
        "copies": subject.copies,
        "failed": subject.runs - subject.n - subject.copies,
        "parameters": [
            {
                "name": one.name,
                "distinct": one.distinct,
                "variance": one.variance,
                "rankCorrelation": one.rank_correlation,
                "failures": one.failures,
            }
            for one in subject.influences
        ],
        "interactions": [{"a": one.a, "b": one.b, "variance": one.variance} for one in subject.interactions],
        "unexplained": subject.unexplained,
    }


def _subject_rows(subject: Influences) -> list[dict[str, Any]]:
    described = _subject_json(subject)
    shared = {**subject.keys, "runs": subject.runs, "n": subject.n}
    return [
        *(shared | {"kind": "parameter", **one} for one in described["parameters"]),
        *(
            shared | {"kind": "interaction", "name": f"{one['a']} × {one['b']}", "variance": one["variance"]}
            for one in described["interactions"]
        ),
    ]


def repeated(snapshot: Snapshot, pairs: Pairs, metric: str) -> Body:
    """Return configurations with their repetitions."""
    number_column(snapshot.frame, metric, "metric")
    chosen = select(snapshot.frame, pairs, RESERVED)
    frame = chosen.frame
    found, notes = repeatability(frame, metric)
    if len(found) > MAX_GROUPS:
        notes.append(f"of {len(found):,} configurations the {MAX_GROUPS:,} with most runs are shown")
    shown = found[:MAX_GROUPS]
    content = {
        "revision": snapshot.revision,
        "rows": len(frame),
        "metric": heading(frame, metric),
        "groups": [_repetitions_json(one, metric) for one in shown],
        "notes": [*chosen.notes, *notes],
    }
    return Body(content, lambda: as_columns([_repetitions_row(one, metric) for one in found]))


def _repetitions_json(one: Repetitions, metric: str) -> dict[str, Any]:
    return {
        "keys": one.cell.keys,
        "runs": one.cell.runs,
        "n": one.cell.n,
        "copies": one.cell.copies,
        "failed": sum(one.cell.failures.values()),
        "failures": one.cell.failures,
        "coverage": summary_json(one.cell.coverage),
        "distinct": one.distinct,
        "deterministic": one.cell.deterministic,
        "figure": figure_json(one.cell.figures[metric]),
        "relativeSpread": one.relative_spread,
        "verdict": one.verdict,
    }


def _repetitions_row(one: Repetitions, metric: str) -> dict[str, Any]:
    return {
        **one.cell.keys,
        "runs": one.cell.runs,
        "n": one.cell.n,
        "failures": sum(one.cell.failures.values()),
        "distinct": one.distinct,
        "relativeSpread": one.relative_spread,
        **flat_summary(metric, one.cell.figures[metric].summary),
        "verdict": one.verdict,
    }


def suspicions(snapshot: Snapshot, pairs: Pairs) -> Body:
    """Return the subjects whose scale is off by the same factor in all runs."""
    chosen = select(snapshot.frame, pairs, RESERVED)
    frame = chosen.frame
    items = [
        {"keys": one.keys, "scale": one.scale, "spread": one.spread, "n": one.n, "sentence": one.sentence}
        for one in suspects(frame)
    ]
    return Body(
        {"revision": snapshot.revision, "rows": len(frame), "items": items, "notes": list(chosen.notes)},
        lambda: as_columns([_flat(dict(item)) for item in items]),
    )


def slow_nodes(snapshot: Snapshot, pairs: Pairs) -> Body:
    """Return nodes beside others of their kind, by the load of equal runs."""
    chosen = select(snapshot.frame, pairs, RESERVED, each=True)
    found = compare_nodes(chosen.frame)
    content = {
        "revision": snapshot.revision,
        "rows": len(chosen.frame),
        "items": [{**one.as_json(), "kind": kind_text(one.kind)} for one in found.nodes],
        "notes": [*found.notes, *chosen.notes],
    }
    return Body(content, lambda: as_columns([one.flat() for one in found.nodes]))


def published(snapshot: Snapshot, pairs: Pairs, home: Path | None) -> Body:
    """Return the published numbers on the datasets of the runs that are meant: never rows of their table."""
    chosen = select(snapshot.frame, pairs, RESERVED)
    found = published_on(chosen.frame, load_published(home))
    items = [
        {
            "system": one.system,
            "dataset": one.dataset,
            "where": one.where,
            "url": one.source.url,
            "title": one.source.title,
            "alignment": one.table.alignment and str(one.table.alignment),
            "statistic": one.table.statistic and str(one.table.statistic),
            "runs": one.table.runs,
            "notes": one.row.notes,
            "values": one.values,
            "differences": list(one.differences),
            "verdicts": {name: judged.sentence for name, judged in one.verdicts.items()},
            "isDrawn": one.is_drawn,
        }
        for one in found
    ]
    return Body(
        {"revision": snapshot.revision, "items": items, "why": differences_of(found), "rule": RULE},
        lambda: as_columns([one.flat() for one in found]),
    )
