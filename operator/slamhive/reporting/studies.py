# SPDX-License-Identifier: Apache-2.0
"""The figures behind a question: panels of series of groups, what must not be pooled in panels of its own."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.columns import ColumnKind
from slamhive.analysis.grouping import LOAD, LOAD_FACETS, PROCESSOR, Groups, aggregate, apart, varies
from slamhive.tables.reading import with_figure

if TYPE_CHECKING:
    from slamhive.analysis.cells import Cell
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.grouping import Aggregate
    from slamhive.reporting.questions import Question

MOST_PANELS = 12
MOST_POINTS = 3000
"""Runs that are drawn one by one at most; beyond, some are chosen evenly."""

_HOUR = 3600.0


@dataclass(frozen=True)
class Dot:
    """A run in a chart.

    Attributes:
        x, y: its numbers, or for a text its place among the values; y is NaN for a run without a figure.
        series: number of its series.
        run: what it is called.
        status: what became of it.
    """

    x: float
    y: float
    series: int
    run: str
    status: str


@dataclass(frozen=True)
class StudyPanel:
    """One chart.

    Attributes:
        keys: the values that all of its runs share, of columns that vary between panels.
        cells: groups of runs, where they are drawn together.
        dots: runs, where they are drawn by themselves.
        runs: number of runs.
    """

    keys: dict[str, Any]
    cells: list[Cell]
    dots: list[Dot]
    runs: int


@dataclass(frozen=True)
class Study:
    """Answer to a question about runs: panels of charts, groups of runs for the table, and notes.

    Attributes:
        question: what was asked.
        categories: the texts along x, None where x holds numbers.
        series: the values that tell them apart.
        panels: those with most runs.
        found: all groups of runs, for the table.
        notes: sentences on what is pooled and left out.
    """

    question: Question
    categories: list[Any] | None
    series: list[tuple[Any, ...]]
    panels: list[StudyPanel]
    found: Aggregate
    notes: list[str]

    def series_of(self, keys: dict[str, Any]) -> int:
        """Return the number of the series that some keys belong to."""
        wanted = _plain([keys[name] for name in self.question.by])
        return next(number for number, values in enumerate(self.series) if _plain(values) == wanted)

    def drawn(self, panel: StudyPanel) -> set[int]:
        """Return the numbers of the series in a panel."""
        return {dot.series for dot in panel.dots} or {self.series_of(cell.keys) for cell in panel.cells}

    def place(self, value: Any) -> float:
        """Return the place of a value of x: the number itself, or a text's place; NaN where missing."""
        if self.categories is not None:
            return float(next(k for k, one in enumerate(self.categories) if _plain(one) == _plain(value)))
        return math.nan if value is None else float(value)


def study(question: Question) -> Study:
    """Answer a question."""
    frame, left = with_figure(question.frame, question.y)
    x, y, by = question.x, question.y, question.by
    asked = [*by, *([x] if x not in by else [])]
    frame, names = apart(frame, asked, (x, y, *by))
    found = aggregate(frame, [y], [*names, *asked], question.outcomes)
    column = frame.column(x)
    numeric = column.kind.is_numeric and column.kind is not ColumnKind.BOOLEAN
    categories = None if numeric else column.unique()
    series = [tuple(key[name] for name in by) for key in Groups(frame, by).keys]
    made = Study(question, categories, series, [], found, [*left, *_mixed(question, frame), *found.notes])
    groups = Groups(frame, names)
    panels = []
    for rows, keys in zip(groups.members(), groups.keys, strict=True):
        mine = _plain(list(keys.values()))
        cells = [cell for cell in found.cells if _plain([cell.keys[name] for name in names]) == mine]
        part = frame.select(rows)
        dots = _dots(made, part) if question.points else []
        panels.append(StudyPanel(keys, cells, dots, len(part)))
    made.panels.extend(_worth_drawing(made, panels))
    return made


def _mixed(question: Question, frame: Frame) -> list[str]:
    """Say that runs of different processors are together, where only errors are drawn."""
    drawn = (question.x, question.y, *question.by)
    if any(name.startswith(LOAD) or name in LOAD_FACETS for name in drawn):
        return []
    return ["runs of different processors are drawn together"] if varies(frame, PROCESSOR) else []


def _worth_drawing(made: Study, panels: list[StudyPanel]) -> list[StudyPanel]:
    """Leave out panels with a single x where others have several, and those beyond the most."""
    wide = [panel for panel in panels if _breadth(made, panel) > 1]
    kept = wide or panels
    if len(kept) < len(panels):
        left = len(panels) - len(kept)
        made.notes.append(
            f"{left} {'chart' if left == 1 else 'charts'} with a single value of {made.question.x} "
            "left out; the table has them"
        )
    kept = sorted(kept, key=lambda panel: -panel.runs)
    if len(kept) > MOST_PANELS:
        made.notes.append(
            f"of {len(kept)} charts the {MOST_PANELS} with most runs are drawn; the table has all"
        )
    return kept[:MOST_PANELS]


def _breadth(made: Study, panel: StudyPanel) -> int:
    """Return the number of x of the series with most of them."""
    if panel.dots:
        return len({dot.x for dot in panel.dots})
    if made.categories is not None:
        return len({_plain(cell.keys[made.question.x]) for cell in panel.cells})
    known = [cell for cell in panel.cells if cell.keys[made.question.x] is not None]
    return max(Counter(made.series_of(cell.keys) for cell in known).values(), default=0)


def _dots(made: Study, frame: Frame) -> list[Dot]:
    question = made.question
    if len(frame) > MOST_POINTS:
        made.notes.append(f"{MOST_POINTS:,} of {len(frame):,} runs are drawn, evenly chosen")
        frame = frame.select(np.unique(np.linspace(0, len(frame) - 1, MOST_POINTS).astype(np.intp)))
    names = list(dict.fromkeys(("run", "status", *question.by)))
    column = frame.column(question.x)
    if made.categories is not None:
        places = [made.place(value) for value in column.tolist()]
    elif column.kind is ColumnKind.TIME:
        first = np.nanmin(question.frame.column(question.x).numbers)
        places = ((column.numbers - first) / _HOUR).tolist()
    else:
        places = column.floats().tolist()
    figures = frame.column(question.y).floats().tolist()
    return [
        Dot(place, y, made.series_of(row), str(row["run"]), str(row["status"]))
        for place, y, row in zip(places, figures, frame.records(names), strict=True)
        if not math.isnan(place)
    ]


def _plain(values: Any) -> str:
    return json.dumps(values, default=str)
