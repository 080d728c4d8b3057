# SPDX-License-Identifier: Apache-2.0
"""Questions that a report answers with a chart: ``X:Y``, or an address of the dashboard's explore page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl

from slamhive.analysis.boards import COMPETITORS
from slamhive.analysis.columns import ColumnKind
from slamhive.analysis.grouping import FACETS, varies, varying
from slamhive.analysis.measures import CONFIGURATION
from slamhive.model.errors import InputError
from slamhive.tables import queries
from slamhive.tables.reading import with_figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis import Outcomes
    from slamhive.analysis.frame import Frame

KINDS = {"scatter": "points", "line": "groups", "box": "groups", "points": "points", "groups": "groups"}
"""Names of pictures on the explore page, and what is drawn here."""

RANKED_BY = ("ate.rmse", "relations.translation.rmse")
"""Errors, the first of which that there is is meant where none is named."""

MOST_GROUPS = 40
MOST_QUESTIONS = 4
_LOOKS = ("figure", "xlog", "ylog", "scales", "title", "embed")
_SETTINGS = ("kind", "x", "y", "colour", "facet", "outcomes", *_LOOKS)
_ARGUMENT = "analysis"


@dataclass(frozen=True)
class Question:
    """Something to draw.

    Attributes:
        x, y: columns.
        by: columns that tell series apart.
        frame: the runs.
        outcomes: which of them have a figure that counts.
        points: whether each run is drawn by itself, or the runs of each x together.
        log: whether x and y are logarithmic; None where the numbers are to say.
        title: what it is called.
        filters: what is left out, in words.
    """

    x: str
    y: str
    by: tuple[str, ...]
    frame: Frame
    outcomes: Outcomes
    points: bool
    log: tuple[bool | None, bool | None] = (None, None)
    title: str = ""
    filters: str = ""


def parse_question(text: str, frame: Frame, outcomes: Outcomes) -> Question:
    """Read what is to be drawn.

    Args:
        text: ``X:Y``, ``X:Y:BY``, or an address or query string as the explore page has it.
        frame: the runs.
        outcomes: which of them count, unless the address says otherwise.

    Raises:
        InputError: it can't be understood, or names a column that there isn't.
    """
    if "=" in text:
        return _of_address(text, frame, outcomes)
    parts = text.split(":")
    if not 2 <= len(parts) <= 3 or not all(part.strip() for part in parts):
        raise InputError(
            f"{text!r} is neither X:Y, X:Y:COLOUR nor an address of the explore page; "
            "an example is input.frameRate:ate.rmse",
            _ARGUMENT,
        )
    x, y, *more = (frame.resolve(part.strip(), _ARGUMENT) for part in parts)
    return _question(frame, (x, y), tuple(more) or COMPETITORS, outcomes)


def usual_metric(frame: Frame) -> str:
    """Return the error that is meant where none is named: the first that some run has."""
    return next((name for name in RANKED_BY if not frame.column(name).is_empty), RANKED_BY[0])


def usual_questions(frame: Frame, metric: str, outcomes: Outcomes) -> list[Question]:
    """Return the metric over each setting that was varied, those with most values first."""
    frame, _ = with_figure(frame, metric)
    return [
        _question(frame, (name, metric), COMPETITORS, outcomes) for name in varied(frame)[:MOST_QUESTIONS]
    ]


def varied(frame: Frame) -> list[str]:
    """Return the settings that were varied, those with most values first."""
    names = [name for name in varying(frame) if is_setting(name)]
    counts = {name: len(frame.column(name).unique()) for name in names}
    return sorted(names, key=lambda name: -counts[name])


def is_setting(name: str) -> bool:
    """Tell whether a column is a setting that somebody chose, and neither a facet nor a seed."""
    return name.startswith(CONFIGURATION) and name not in FACETS and "seed" not in name.lower()


def _of_address(text: str, frame: Frame, outcomes: Outcomes) -> Question:
    query = text.partition("?")[2] or text
    pairs = parse_qsl(query, keep_blank_values=True)
    given = {name: value for name, value in pairs if name in _SETTINGS and value}
    kind = given.get("kind", "scatter")
    if kind not in KINDS:
        raise InputError(f"kind={kind[:60]}: a report draws {', '.join(KINDS)}", _ARGUMENT)
    for name in ("x", "y"):
        if name not in given:
            raise InputError(f"{text[:200]!r} says no {name}=", _ARGUMENT)
    try:
        node = queries.condition(frame, pairs, (*_SETTINGS, queries.SUPERSEDED))
        chosen = frame if node is None else frame.select(node.mask(frame))
        counted = queries.outcomes(given["outcomes"]) if "outcomes" in given else outcomes
    except InputError as error:
        raise InputError(str(error), _ARGUMENT) from None
    by = tuple(frame.resolve(given[name], _ARGUMENT) for name in ("colour", "facet") if name in given)
    log = tuple(True if given.get(name) == "1" else None for name in ("xlog", "ylog"))
    left = [f"{name}={value}" if value else name for name, value in pairs if name not in _SETTINGS]
    return _question(
        chosen,
        (frame.resolve(given["x"], _ARGUMENT), frame.resolve(given["y"], _ARGUMENT)),
        by or COMPETITORS,
        counted,
        points=KINDS[kind] == "points",
        log=(log[0], log[1]),
        title=given.get("title", ""),
        filters=", ".join(left),
    )


def _question(
    frame: Frame,
    axes: tuple[str, str],
    by: Sequence[str],
    outcomes: Outcomes,
    *,
    points: bool | None = None,
    log: tuple[bool | None, bool | None] = (None, None),
    title: str = "",
    filters: str = "",
) -> Question:
    x, y = axes
    if frame.column(x).is_empty:
        raise InputError(f"no run has {x}", _ARGUMENT)
    number = frame.column(y)
    if not number.is_empty and not (number.floats() == number.floats()).any():
        raise InputError(f"{y}: a column of numbers is needed, this one holds none", _ARGUMENT)
    if points is None:
        column = frame.column(x)
        counts = column.kind in {ColumnKind.NUMBER, ColumnKind.INTEGER}
        points = counts and not x.startswith(CONFIGURATION) and len(column.unique()) > MOST_GROUPS
    points = points or frame.column(x).kind is ColumnKind.TIME
    told = tuple(name for name in by if name != x and varies(frame, name))
    return Question(x, y, told, frame, outcomes, points, log, title, filters)
