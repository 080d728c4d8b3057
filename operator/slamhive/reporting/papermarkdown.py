# SPDX-License-Identifier: Apache-2.0
"""Tables for papers as Markdown: for a README, a pull request, supplementary material."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from slamhive.contract.lines import printable
from slamhive.reporting.tablewords import (
    caption,
    column_words,
    count_text,
    footnotes,
    key_title,
    parts_text,
    plain,
)
from slamhive.tables.text import cost_mark, number_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis import Metric
    from slamhive.reporting.papertables import PaperTable, TableCell, TableNumber

_SPECIAL = re.compile(r"([\\`*_\[\]<>|~])")


def escaped(text: Any) -> str:
    """Return a text that Markdown shows as it is."""
    return _SPECIAL.sub(r"\\\1", printable(plain(text)))


def markdown(table: PaperTable, *, told: str = "", origin: Sequence[str] = ()) -> str:
    """Write a table.

    Args:
        table: the figures.
        told: what it shows; statistic, n and what is marked are added.
        origin: sentences on where it comes from, put beneath.
    """
    heads = [escaped(key_title(name, table.keys)) for name in table.keys]
    above = [escaped(column_words(table.layout.columns, values)) for values in table.columns]
    for metric in table.metrics:
        title = escaped(metric.title_among([one.column for one in table.metrics]))
        heads += [f"{title}, {words}" if words else title for words in above]
    heads += [f"{over.kind.value} over datasets" for over in table.overall]
    if table.shows_counts:
        heads += [f"n, {words}" if words else "n" for words in above]
    lines = [_line(heads), _line(["---"] * len(table.keys) + ["---:"] * (len(heads) - len(table.keys)))]
    for number, (row, places) in enumerate(zip(table.rows, table.places, strict=True)):
        cells = [escaped(key) for key in row]
        for place, metric in enumerate(table.metrics):
            cells += [_cell(metric, one, place) for one in places]
        for over in table.overall:
            figure = over.figures[number]
            cells.append(
                _marked(figure, number_text(figure.value, ".2f")) + parts_text(over.datasets[number])
            )
        if table.shows_counts:
            cells += ["–" if one is None else count_text([one]) for one in places]
        lines.append(_line(cells))
    words = [escaped(sentence) for sentence in caption(table, told)]
    notes = [escaped(sentence) for sentence in (*footnotes(table), *origin)]
    return "\n".join([" ".join(words), "", *lines, "", *([" ".join(notes), ""] if notes else [])])


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(metric: Metric, place: TableCell | None, number: int) -> str:
    if place is None:
        return "–"
    figure = place.figures[number]
    if figure.value is None:
        return "–" if place.n or figure.published else f"*{escaped(place.verdict)}*"
    shape = metric.format or ".4g"
    text = _marked(figure, format(figure.value, shape))
    ends = [format(end, shape) for end in figure.spread]
    if len(ends) == 1:
        text += f" ± {ends[0]}"
    elif ends:
        text += f" \\[{ends[0]}, {ends[1]}\\]"
    text += cost_mark(metric.column, reader=place.reader, late=place.late).strip()
    return text + ("†" if place.untracked and not number else "")


def _marked(figure: TableNumber, text: str) -> str:
    if figure.bold:
        return f"**{text}**"
    return f"<u>{text}</u>" if figure.second else text
