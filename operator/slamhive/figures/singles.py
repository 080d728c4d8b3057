# SPDX-License-Identifier: Apache-2.0
"""Figures of the table of runs in which each run is seen: points, distributions, repetitions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.grouping import SUBJECT, Groups, Outcomes, disturbance_notes, tally, worst
from slamhive.analysis.ranking import Ranking
from slamhive.analysis.repeating import repeatability
from slamhive.figures.asking import check_panels, cost_of, error_of, nothing, parted
from slamhive.figures.counts import Tally
from slamhive.figures.groups import Series, _runs, counts, values_tried
from slamhive.figures.pictures import Dots, Line, Panel, Picture, PictureAxis, Ranges
from slamhive.model.base import plural
from slamhive.model.errors import InputError
from slamhive.model.results import Outcome
from slamhive.reporting.titles import keys_text
from slamhive.tables.reading import with_figure
from slamhive.tables.text import as_columns, n_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.columns import Mask
    from slamhive.analysis.frame import Frame
    from slamhive.figures.asking import Wish
    from slamhive.tables.published import Published

MOST_ROWS = 40
"""Configurations of which the repetitions are drawn, at most."""


def _tally(frame: Frame, inside: Mask, copies: int = 0) -> Tally:
    """Count the runs that are drawn, and what became of the others."""
    status = frame.column("status")
    left = tally(status.values, status.codes[~inside])
    good = left.pop(Outcome.TRACKED.value, 0)
    if good:
        left["without these numbers"] = good
    return Tally(len(frame), int(inside.sum()) - copies, copies, left)


def scatter(frame: Frame, wish: Wish, beside: Sequence[Published] = ()) -> Picture:
    """Return one column of numbers over another, a mark a run; published numbers are hollow marks beside.

    Args:
        frame: the runs.
        wish: what was asked for.
        beside: published rows on the datasets of the runs; those that have both numbers are drawn.
    """
    y = wish.number("y", error_of(frame), frame)
    x = wish.number("x", cost_of(frame), frame)
    frame, left = with_figure(frame, y.column)
    by, facet = wish.series(frame), wish.columns("facet", (), frame)
    parts = parted(frame, facet, by, (x.column, y.column))
    check_panels(len(parts.panels), parts.names, parts.frame, wish.facet)
    series = Series(by, parts.frame)
    both = [one for one in beside if x.column in one.values and y.column in one.values]
    sources = ", ".join(dict.fromkeys(one.where for one in both))
    panels, crossed = [], 0
    for keys, part in parts.panels:
        inside = counts(part, x, wish) & counts(part, y, wish)
        failed = worst(part, y.column, wish.outcomes) & ~inside & np.isfinite(part.column(x.column).floats())
        crossed += int(failed.sum())
        groups = Groups(part, by)
        marks = []
        for rows, values in zip(groups.members(), groups.keys, strict=True):
            drawn = rows[inside[rows]]
            across, up = (part.column(metric.column).floats()[drawn] * metric.factor for metric in (x, y))
            status = part.select(drawn).column("status").tolist()
            hollow = tuple(word != Outcome.TRACKED.value for word in status)
            lost = rows[failed[rows]]
            if len(drawn) or len(lost):
                at = part.column(x.column).floats()[lost] * x.factor
                across, up = np.append(across, at), np.append(up, np.full(len(lost), np.nan))
                marks.append(Dots(series.of(values), across, up, (*hollow, *(False,) * len(lost))))
        datasets = set(part.column("dataset").tolist())
        apart = [one for one in both if one.dataset in datasets]
        if marks and apart:
            ways = [np.array([one.values[axis.column] * axis.factor for one in apart]) for axis in (x, y)]
            marks.append(Dots(len(series.labels), ways[0], ways[1], (True,) * len(apart)))
        panels.append(Panel(parts.title(keys), tuple(marks)))
    inside = counts(parts.frame, x, wish) & counts(parts.frame, y, wish)
    if not inside.any():
        raise nothing(f"both {x.column} and {y.column}")
    untracked = ["hollow: runs that were not tracked"] if wish.outcomes is Outcomes.ALL else []
    return Picture(
        x=PictureAxis(
            x.label_among([y.column]),
            wish.log.of("x"),
            ticks=values_tried(parts.frame, x),
            robust=wish.robust,
        ),
        y=PictureAxis(y.label_among([x.column]), wish.log.of("y"), robust=wish.robust),
        panels=tuple(panel for panel in panels if panel.marks),
        series=(*series.labels, "published"),
        notes=(
            "each mark is one run",
            *([f"crosses above: {plural(crossed, 'failed run')} at the place along x"] if crossed else []),
            *([f"published are {len(both)} hollow marks, from {sources}"] if both else []),
            *untracked,
            *_tally(parts.frame, inside).notes(wish.outcomes, above=False),
            *disturbance_notes(parts.frame, (x.column, y.column)),
            *left,
        ),
        columns=_with_published(_runs(parts.frame, [*parts.names, *by], (x, y), inside), both),
        runs=len(parts.frame),
    )


def _with_published(columns: dict[str, list[Any]], both: Sequence[Published]) -> dict[str, list[Any]]:
    """Return the runs of a figure with the published rows below them, which a column of their own marks."""
    if not both:
        return columns
    count = len(next(iter(columns.values())))
    said: dict[str, list[Any]] = {"published": [one.where for one in both]}
    said["published.system"] = [one.system for one in both]
    for name in columns:
        said[name] = [one.dataset if name == "dataset" else one.values.get(name) for one in both]
    said["drawn"] = [True] * len(both)
    return {name: [*columns.get(name, [None] * count), *below] for name, below in said.items()}


def ecdf(frame: Frame, wish: Wish) -> Picture:
    """Return the share of runs below each error; those that failed never come below any."""
    wish.refuse(y="an ECDF has the share of runs along y; --x names what it is of")
    x = wish.number("x", error_of(frame), frame)
    frame, left = with_figure(frame, x.column)
    by, facet = wish.series(frame), wish.columns("facet", (), frame)
    parts = parted(frame, facet, by, (x.column,))
    check_panels(len(parts.panels), parts.names, parts.frame, wish.facet)
    series = Series(by, parts.frame)
    whole = Ranking(parts.frame, x.column, wish.outcomes)
    inside, sign = whole.inside, whole.sign
    if not inside.any():
        raise nothing(x.column)
    panels, rows, copies = [], [], 0
    for keys, part in parts.panels:
        marks = []
        groups = Groups(part, by)
        ranking = Ranking(part, x.column, wish.outcomes)
        for ranked, values in zip(ranking.each(groups), groups.keys, strict=True):
            copies += ranked.copies
            if not ranked.n:
                continue
            found, share = ranked.values * x.factor, ranked.shares
            across, up = np.append(found[:1], found), np.append(0.0, share)  # it begins at zero
            marks.append(Line(series.of(values), across, up, steps=True, onward=1 if sign > 0 else -1))
            rows += [
                {**keys, **values, x.column: value, "share": part_of, "n": ranked.n, "runs": ranked.total}
                for value, part_of in zip(ranked.values.tolist(), share.tolist(), strict=True)
            ]
        panels.append(Panel(parts.title(keys), tuple(marks)))
    failed = int(np.count_nonzero(whole.failed))
    which = "at most this error" if sign > 0 else f"at least this {x.label.partition(' [')[0]}"
    stated = f"share of all runs that were tracked and have {which}" if failed else "share of runs"
    ended = int(len(inside) - inside.sum() - failed)
    apart = (
        [f"count nowhere: {plural(ended, 'run')} that the machine or the user ended, or without a number"]
        if ended
        else []
    )
    return Picture(
        x=PictureAxis(x.label, wish.log.of("x"), robust=wish.robust),
        y=PictureAxis("share of runs", False, ends=(0.0, 1.0)),
        panels=tuple(panel for panel in panels if panel.marks),
        series=series.labels,
        notes=(
            f"{stated}; runs that failed are in the whole, so that a line may end below 1"
            if failed
            else stated,
            *_tally(parts.frame, inside, copies).notes(wish.outcomes, above=False),
            *apart,
            *left,
        ),
        columns=as_columns(rows),
        runs=len(parts.frame),
    )


def repetitions(frame: Frame, wish: Wish) -> Picture:
    """Return the figure of every repetition of each configuration, one line a configuration."""
    wish.refuse(
        y="repetitions have configurations along y; --x names what is drawn",
        facet="repetitions have one panel: choose runs by --where",
    )
    if wish.outcomes is not Outcomes.TRACKED:
        raise InputError("the spread of repetitions is that of tracked runs", "outcomes")
    x = wish.number("x", error_of(frame), frame)
    frame, left = with_figure(frame, x.column)
    found, notes = repeatability(frame, x.column)
    found = [one for one in found if one.figures]
    if not found:
        raise InputError(
            "no configuration has more than one run that counts: there is nothing to draw; "
            "repetitions: 5 in a sweep runs each of its points five times"
        )
    dropped = found[MOST_ROWS:]
    found = found[:MOST_ROWS]
    told = [name for name in found[0].cell.keys if len({repr(one.cell.keys.get(name)) for one in found}) > 1]
    by = [name for name in wish.series(frame) if name in found[0].cell.keys]
    kinds = list(dict.fromkeys(keys_text({name: one.cell.keys[name] for name in by}) for one in found))
    found.sort(
        key=lambda one: [
            repr(one.cell.keys.get(name))
            if not isinstance(one.cell.keys.get(name), int | float)
            else f"{one.cell.keys[name]:020.6f}"
            for name in told
        ]
    )
    shown = {name for name in told if name not in by} or set(told)
    categories: list[str] = []
    marks: list[Ranges | Dots] = []
    rows: list[dict[str, Any]] = []
    height = len(found) - 1
    for place, one in enumerate(found):
        keys = {name: one.cell.keys[name] for name in told if name in shown}
        settings = {name: value for name, value in keys.items() if name not in SUBJECT}
        text = keys_text(settings | keys) or keys_text(one.cell.keys)
        categories.append(f"{text}, n {n_text(one.cell)}")
        number = kinds.index(keys_text({name: one.cell.keys[name] for name in by}))
        at = float(height - place)
        values = np.array(one.figures) * x.factor
        middle = float(np.median(values))
        marks.append(
            Ranges(number, np.array([middle]), np.array([at]), y_ends=np.array([[at - 0.3, at + 0.3]]))
        )
        marks.append(Dots(number, values, np.full(len(values), at)))
        rows += [{**one.cell.keys, x.column: value} for value in one.figures]
    cells = [one.cell for one in found]
    more = (
        [f"of {len(found) + len(dropped)} configurations the {len(found)} with most runs are drawn"]
        if dropped
        else []
    )
    return Picture(
        x=PictureAxis(x.label, wish.log.of("x"), robust=wish.robust),
        y=PictureAxis("", categories=tuple(reversed(categories))),
        panels=(Panel("", tuple(marks)),),
        series=tuple(kinds),
        notes=(
            "each mark is one repetition, equal trajectories (n =) counted once; the bar is their median",
            *Tally.of(cells).notes(wish.outcomes, above=False),
            *more,
            *notes,
            *left,
        ),
        columns=as_columns(rows),
        runs=sum(cell.runs for cell in cells),
        rows=len(found),
    )
