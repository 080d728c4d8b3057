# SPDX-License-Identifier: Apache-2.0
"""Distributions of a figure, failures included: cumulative shares, slices, contours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.boards import Window
from slamhive.analysis.columns import Column
from slamhive.analysis.grouping import (
    Groups,
    apart,
    copy_notes,
    direction_notes,
    disturbance_notes,
    pooling_notes,
    unranked_notes,
    varying,
)
from slamhive.analysis.ranking import Ranking
from slamhive.dashboard.answering.encoding import Body, plain
from slamhive.dashboard.answers.columns import heading
from slamhive.dashboard.problems import BadRequest, TooLarge
from slamhive.tables.queries import column, columns, number_column, outcomes, select
from slamhive.tables.text import as_columns

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from slamhive.analysis.columns import Mask
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.grouping import Outcomes
    from slamhive.analysis.ranking import Ranked
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.tables.queries import Pairs

ECDF_RESERVED = ("metric", "by", "over", "outcomes", "most", "first", "format")
SURFACE_RESERVED = ("x", "y", "metric", "outcomes", "format")
SLICES_RESERVED = ("metric", "outcomes", "format")
MOST_CURVES = 200
"""Curves of an answer; where there are more, those of some competitors are shown, in some pictures."""

MOST_RANKED = 200_000
"""Competitors times pictures of which the best can be found."""

MOST_BOARDS = 24
"""Most boards, told apart by what must not be pooled; more pictures than these say nothing."""

MOST_PLACES = 24
"""Values of a setting along an axis; of more, neighbours are taken together."""

MOST_SLICES = 16
MOST_STEPS = 300
"""Steps of a curve that are sent: more could not be seen."""


def ecdf(
    snapshot: Snapshot,
    pairs: Pairs,
    metric: str,
    told: tuple[str | None, str | None],
    which: str,
    *,
    window: Window | None = None,
) -> Body:
    """Return for each group of runs which share of them has a figure of at most so much, or at least.

    The share is of all runs of the group that say something of the algorithm: those that failed never reach
    any value, so that a curve ends below 1 by their share.

    Args:
        snapshot: the data.
        pairs: the query string: filters.
        metric: column of numbers.
        told: list of columns that tell curves apart (default: algorithm), and of those whose values may be in
            one curve, such as dataset: a share of runs has a meaning where a mean of metres has none.
        which: tracked or all.
        window: the competitors, told apart by ``by``, whose curves are shown where there are too many.
    """
    number_column(snapshot.frame, metric, "metric")
    by, over = told
    asked = columns(snapshot.frame, by, "by", ["algorithm"])
    chosen = select(snapshot.frame, pairs, ECDF_RESERVED)
    counted = outcomes(which)
    pooled = [name for name in columns(snapshot.frame, over, "over", []) if name not in asked]
    frame, facets = apart(chosen.frame, [*asked, *pooled], [metric])
    shown = _shown(frame, (facets, asked), Ranking(frame, metric, counted), window or Window())
    frame = frame.select(shown.rows)
    groups = Groups(frame, [*facets, *asked])
    ranking = Ranking(frame, metric, counted)
    found = list(zip(groups.keys, ranking.each(groups), strict=True))
    mixed = [name for name in varying(frame) if name not in (*groups.names, *pooled)]
    content = {
        "revision": snapshot.revision,
        "rows": len(frame),
        "metric": heading(frame, metric),
        "keys": [heading(frame, name) | {"facet": name in facets} for name in groups.names],
        "competitors": shown.competitors,
        "shown": shown.count,
        "curves": [_curve(ranked, keys) for keys, ranked in found],
        "notes": [
            *chosen.notes,
            *shown.notes,
            *(note.replace("averaged over", "runs of") for note in pooling_notes(mixed)),
            *_unlike_notes(frame, groups, pooled),
            *direction_notes([metric]),
            *disturbance_notes(frame, [metric]),
            *unranked_notes(frame, counted),
            *copy_notes(sum(ranked.copies for _, ranked in found), [metric]),
        ],
    }
    return Body(content, lambda: as_columns(list(_steps(found))))


@dataclass(frozen=True)
class _Shown:
    """The part of the runs whose curves are shown.

    Attributes:
        rows: the runs, (n,).
        competitors: how many competitors there are.
        count: how many of them are shown.
        notes: sentences on what is not.
    """

    rows: Mask
    competitors: int
    count: int
    notes: list[str]


def _shown(
    frame: Frame, names: tuple[Sequence[str], Sequence[str]], ranking: Ranking, window: Window
) -> _Shown:
    """Choose the competitors and pictures whose curves are shown; all of them where that is few enough.

    Args:
        frame: the runs.
        names: columns that tell pictures apart, and those that tell competitors apart.
        ranking: of the runs.
        window: what is asked for.

    Raises:
        TooLarge: there are too many to find the best ones.
    """
    pictures, competitors = (Groups(frame, columns_) for columns_ in names)
    curves = Groups(frame, [*names[0], *names[1]])
    if curves.count <= MOST_CURVES and window == Window():
        return _Shown(np.ones(len(frame), dtype=bool), competitors.count, competitors.count, [])
    if competitors.count * pictures.count > MOST_RANKED:
        raise TooLarge(
            f"{curves.count:,} curves are asked for, too many to find the best of them: choose fewer columns "
            "to tell them apart, or fewer runs",
            "by",
        )
    medians = np.full((competitors.count, pictures.count), np.nan)
    firsts = curves.firsts
    medians[competitors.of_row[firsts], pictures.of_row[firsts]] = ranking.medians(curves)
    chosen = window.of(medians, readable=False)
    rows = np.isin(competitors.of_row, chosen)
    notes = window.notes(len(chosen), competitors.count)
    held = pictures.of_row[firsts[np.isin(competitors.of_row[firsts], chosen)]]
    kept = np.unique(held)
    # Whole pictures, as long as their curves are not too many.
    fitting = max(1, int(np.count_nonzero(np.cumsum(np.bincount(held)[kept]) <= MOST_CURVES)))
    if len(kept) > fitting:
        rows &= np.isin(pictures.of_row, kept[:fitting])
        notes.append(f"of {len(kept)} pictures the first {fitting} are shown: filter the runs for others")
    return _Shown(rows, competitors.count, len(chosen), notes)


def _unlike_notes(frame: Frame, groups: Groups, pooled: list[str]) -> list[str]:
    """Say over what the curves are, and where they aren't over the same."""
    notes = []
    for name in pooled:
        codes, values = frame.column(name).factorized()
        if len(values) < 2:
            continue
        held = {frozenset(codes[rows].tolist()) for rows in groups.members()}
        same = "the same" if len(held) == 1 else "not the same: curves of other runs can't be compared"
        notes.append(f"each curve is over runs of several values of {name}, and these are {same}")
    return notes


def _curve(ranked: Ranked, keys: dict[str, Any]) -> dict[str, Any]:
    n = ranked.n
    places = np.arange(n)
    if n > MOST_STEPS:
        places = np.unique(np.linspace(0, n - 1, MOST_STEPS).round().astype(np.intp))
    return {
        "keys": keys,
        "runs": ranked.runs,
        "total": ranked.total,
        "n": n,
        "failures": ranked.failures,
        "leftOut": ranked.left_out,
        "median": plain(ranked.median),
        "x": ranked.values[places],
        "share": ranked.shares[places],
    }


def _steps(found: list[tuple[dict[str, Any], Ranked]]) -> Iterator[dict[str, Any]]:
    """Go through all steps of all curves: a table leaves out none."""
    for keys, ranked in found:
        shared = {**keys, "runs": ranked.runs, "total": ranked.total, "n": ranked.n}
        for value, share in zip(ranked.values.tolist(), ranked.shares.tolist(), strict=True):
            yield shared | {"value": value, "share": share}


def surface(snapshot: Snapshot, pairs: Pairs, axes: tuple[str, str], metric: str, which: str) -> Body:
    """Return the median of a figure over two settings, failed runs ranked last.

    Args:
        snapshot: the data.
        pairs: the query string: filters.
        axes: columns of the settings, x and y.
        metric: column of numbers.
        which: tracked or all.
    """
    x, y = (column(snapshot.frame, name, field) for name, field in zip(axes, "xy", strict=True))
    if x == y:
        raise BadRequest(f"y: {y} is along x already, expected another column", "y")
    number_column(snapshot.frame, metric, "metric")
    chosen = select(snapshot.frame, pairs, SURFACE_RESERVED)
    counted = outcomes(which)
    frame, facets = apart(chosen.frame, [x, y], [metric])
    frame, binned = _placed(frame, [x, y])
    boards = _boards(frame, facets, metric, counted, [[x, y]])
    mixed = [name for name in varying(frame) if name not in (*facets, x, y)]
    content = {
        "revision": snapshot.revision,
        "rows": len(frame),
        "metric": heading(snapshot.frame, metric),
        "axes": [heading(snapshot.frame, name) for name in (x, y)],
        "boards": [{"keys": keys, "cells": cells[0]} for keys, cells in boards],
        "notes": [*chosen.notes, *binned, *pooling_notes(mixed), *_load_notes(frame, metric, counted)],
    }
    rows = [keys | cell for keys, cells in boards for cell in _flat(cells[0], [x, y])]
    return Body(content, lambda: as_columns(rows))


def slices(snapshot: Snapshot, pairs: Pairs, metric: str, which: str) -> Body:
    """Return the distribution of a figure over the values of each setting, whatever the others are.

    Args:
        snapshot: the data.
        pairs: the query string: filters.
        metric: column of numbers.
        which: tracked or all.
    """
    number_column(snapshot.frame, metric, "metric")
    chosen = select(snapshot.frame, pairs, SLICES_RESERVED)
    counted = outcomes(which)
    settings = [name for name in varying(chosen.frame) if not name.startswith("dataset.attributes.")]
    shown = settings[:MOST_SLICES]
    frame, facets = apart(chosen.frame, shown, [metric])
    frame, binned = _placed(frame, shown)
    boards = _boards(frame, facets, metric, counted, [[name] for name in shown])
    notes = [*chosen.notes, *binned, *_load_notes(frame, metric, counted)]
    if len(settings) > len(shown):
        notes.append(f"of {len(settings)} settings the first {len(shown)} are drawn")
    if len(shown) > 1:
        notes.append("each chart is over all values of the other settings")
    content = {
        "revision": snapshot.revision,
        "rows": len(frame),
        "metric": heading(snapshot.frame, metric),
        "settings": [heading(snapshot.frame, name) for name in shown],
        "boards": [{"keys": keys, "slices": dict(zip(shown, cells, strict=True))} for keys, cells in boards],
        "notes": notes,
    }
    rows = [
        keys | {"setting": name} | cell
        for keys, cells in boards
        for name, found in zip(shown, cells, strict=True)
        for cell in _flat(found, ["value"])
    ]
    return Body(content, lambda: as_columns(rows))


def _load_notes(frame: Frame, metric: str, which: Outcomes) -> list[str]:
    return [*direction_notes([metric]), *disturbance_notes(frame, [metric]), *unranked_notes(frame, which)]


def _placed(frame: Frame, names: list[str]) -> tuple[Frame, list[str]]:
    """Return rows whose many numbers of some columns are taken together with their neighbours, and notes.

    Each stretch holds about equally many runs, and its median stands for it.
    """
    changed, notes = {}, []
    for name in names:
        held = frame.column(name)
        if not held.kind.is_numeric:
            continue
        numbers = held.floats()
        uniques, codes = np.unique(numbers[~np.isnan(numbers)], return_inverse=True)
        if len(uniques) <= MOST_PLACES:
            continue
        edges = np.unique(np.quantile(uniques[codes], np.linspace(0, 1, MOST_PLACES + 1))[1:-1])
        part = np.searchsorted(edges, numbers, side="right")
        placed = numbers.copy()
        for number in np.unique(part[~np.isnan(numbers)]):
            inside = (part == number) & ~np.isnan(numbers)
            placed[inside] = np.median(numbers[inside])
        changed[name] = Column.of_numbers(placed)
        notes.append(f"the {len(uniques):,} values of {name} are taken together in {MOST_PLACES} stretches")
    return frame.replaced(changed), notes


def _boards(
    frame: Frame, facets: list[str], metric: str, which: Outcomes, asked: list[list[str]]
) -> list[tuple[dict[str, Any], list[list[dict[str, Any]]]]]:
    """Return for each combination of facets the cells by each list of columns.

    Raises:
        TooLarge: there are too many combinations.
    """
    apart_ = Groups(frame, facets)
    if apart_.count > MOST_BOARDS:
        raise TooLarge(
            f"{apart_.count:,} pictures are asked for, by {', '.join(facets)}, and an answer has at most "
            f"{MOST_BOARDS}: choose fewer runs",
            "where",
        )
    found = []
    for rows, keys in zip(apart_.members(), apart_.keys, strict=True):
        board = frame.select(rows)
        ranking = Ranking(board, metric, which)
        found.append((keys, [_cells(board, ranking, names) for names in asked]))
    return found


def _cells(board: Frame, ranking: Ranking, names: list[str]) -> list[dict[str, Any]]:
    groups = Groups(board, names)
    cells = []
    for ranked, keys in zip(ranking.each(groups), groups.keys, strict=True):
        low, middle, high = map(plain, ranked.quartiles)
        cells.append(
            {
                "at": [keys[name] for name in names],
                "runs": ranked.runs,
                "total": ranked.total,
                "n": ranked.n,
                "failures": ranked.failures,
                "best": plain(ranked.values[0]) if ranked.n else None,
                "low": low,
                "median": middle,
                "high": high,
            }
        )
    return cells


def _flat(cells: list[dict[str, Any]], names: list[str]) -> list[dict[str, Any]]:
    return [
        dict(zip(names, cell["at"], strict=True))
        | {name: cell[name] for name in ("runs", "total", "n", "best", "low", "median", "high")}
        for cell in cells
    ]
