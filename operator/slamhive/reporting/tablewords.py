# SPDX-License-Identifier: Apache-2.0
"""Words of tables for papers: heads, captions and footnotes, in LaTeX as in Markdown."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from slamhive.analysis import Outcomes
from slamhive.analysis.grouping import SUBJECT
from slamhive.reporting.papertables import Best, Overall, Statistic
from slamhive.reporting.titles import column_title, keys_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.reporting.papertables import PaperTable, TableCell

_MOST_FAILURES = 12
_GIVEN = ("parameters.", "dataset.attributes.", "label.")
_OVERALL = {
    Overall.RANK: "rank: the mean over datasets of the rank of the median there",
    Overall.RATIO: "ratio: the geometric mean over datasets of the median over the best one there",
}


def key_title(name: str, names: Sequence[str]) -> str:
    """Return a heading; names that somebody gave keep their letters."""
    title = column_title(name, names)
    return title if name.startswith(_GIVEN) or "." in title else title[:1].upper() + title[1:]


def column_words(names: Sequence[str], values: Sequence[Any]) -> str:
    """Return the heading of a column: values, with name and unit where they don't explain themselves."""
    return keys_text(dict(zip(names, values, strict=True)), SUBJECT, plain)


def caption(table: PaperTable, told: str) -> list[str]:
    """Return the sentences of a caption: what it shows, what the numbers are, what is marked.

    Args:
        table: the figures.
        told: what the table shows, as its author says; a full stop is added where it has no end.
    """
    low, high = table.counts
    layout = table.layout
    runs = "tracked runs" if layout.outcomes is Outcomes.TRACKED else "all evaluated runs"
    what = "Mean" if layout.statistic is Statistic.MEAN else "Median"
    if layout.spread:
        what += " ± standard deviation" if layout.statistic is Statistic.MEAN else " [range]"
        what += f" (of settings, {table.pooled}, not of repetitions alone)" if table.pooled else ""
    told = told.strip()
    if told and not told.endswith((".", "!", "?", "…")):
        told += "."
    count = f"n = {low}" if low == high else f"n = {low} to {high}"
    sentences = [told] if told else []
    of = f"the different results of {runs}" if table.has_copies else runs
    sentences.append(f"{what} over {of}, {count} each.")
    figures = [one for line in table.places for place in line if place for one in place.figures]
    figures += [one for over in table.overall for one in over.figures]
    if any(one.bold for one in figures):
        of = "best of its column" + (" and group" if is_grouped(table) else "")
        second = ", underlined: second" if any(one.second for one in figures) else ""
        sentences.append(f"Bold: {of}{second}.")
    if table.overall:
        words = "; ".join(_OVERALL[over.kind] for over in table.overall)
        ends = any(math.isinf(one.value or 0.0) for over in table.overall for one in over.figures)
        last = "; ∞: of a dataset the median run failed" if ends else ""
        sentences.append(f"{words[:1].upper()}{words[1:]}; runs that failed are behind all others{last}.")
        if any(one.value is None for over in table.overall for one in over.figures):
            sentences.append("Without a rank: no run counts on any dataset.")
        if any(on < of for over in table.overall for on, of in over.datasets):
            sentences.append("In parentheses: on how many datasets of all, where some are missing.")
    if table.has_failures:
        sentences.append(
            "† some runs were not tracked and are left out."
            if layout.outcomes is Outcomes.TRACKED
            else "† holds runs that were not tracked."
        )
    return sentences


def is_grouped(table: PaperTable) -> bool:
    """Tell whether the best is marked within each first row key."""
    return table.layout.best is Best.GROUP and len(table.keys) > 1


def footnotes(table: PaperTable) -> list[str]:
    """Return the sentences beneath a table: what became of runs that were not tracked, what numbers mean."""
    found = []
    failures = table.failures
    for row, column, words in failures[:_MOST_FAILURES]:
        keys = zip((*table.keys, *table.layout.columns), (*row, *column), strict=True)
        who = keys_text(dict(keys), ("algorithm", "dataset"), plain)
        counts = ", ".join(f"{count} {word}" for word, count in words.items())
        found.append(f"{who}: {counts}")
    if len(failures) > _MOST_FAILURES:
        found.append(f"and {len(failures) - _MOST_FAILURES} more")
    sentences = [f"Not tracked: {'; '.join(found)}."] if found else []
    return [*sentences, *(f"{note[:1].upper()}{note[1:]}." for note in table.notes)]


def parts_text(datasets: tuple[int, int]) -> str:
    """Return on how many datasets a rank is, where some are missing."""
    on, of = datasets
    return f" ({on}/{of})" if on < of else ""


def count_text(places: Sequence[TableCell]) -> str:
    """Return the number of results in figures, as text, and of how many runs where some are left out."""
    n, runs = sum(place.n for place in places), sum(place.runs for place in places)
    counted = n + sum(place.copies for place in places)
    if counted == runs:
        return str(n)
    return f"{n}/{runs}" if n == counted else f"{n} ({counted}/{runs})"


def plain(value: Any) -> str:
    """Return a value as it stands in a table."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)
