# SPDX-License-Identifier: Apache-2.0
"""Tables in LaTeX with booktabs, to be taken up by a paper as they are."""

from __future__ import annotations

import re
from itertools import groupby
from typing import TYPE_CHECKING, Any

from slamhive.analysis import Outcomes
from slamhive.analysis.grouping import SUBJECT
from slamhive.reporting.papertables import Best, Statistic
from slamhive.reporting.titles import column_title, keys_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis import Metric
    from slamhive.reporting.papertables import Figure, PaperTable, Place

FEW = 4
"""Columns up to which n stands under each, beyond once a row."""

COLUMN, PAGE = 58, 118
"""Characters that stand side by side in a column and on a page of two."""

_MOST_FAILURES = 12
_SPECIAL = {
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "°": r"\textdegree{}",
    "±": r"$\pm$",
    "×": r"$\times$",
    "–": "--",
    "…": r"\ldots{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
}
_DAGGER = r"\textsuperscript{\textdagger}"
_CONTROL = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff]+")
_GIVEN = ("parameters.", "dataset.attributes.", "label.")
_COMMANDS = re.compile(r"\\rotatebox\{60\}\{.*\}|\\[a-z]+\*?|[{}$]")


def escaped(text: Any) -> str:
    """Return a text that LaTeX prints as it is."""
    return "".join(_SPECIAL.get(sign, sign) for sign in _CONTROL.sub(" ", _text(text)))


def latex(table: PaperTable, *, caption: str = "", label: str = "", origin: Sequence[str] = ()) -> str:
    """Write a table.

    Args:
        table: the figures.
        caption: what it shows; statistic, n and what is bold are added.
        label: what the paper refers to it by; none for none.
        origin: sentences on where it comes from, put in front as comments.
    """
    body = _body(table)
    blocks = _blocks(table)
    turned = _width(body, _head(table, blocks)) > PAGE and table.layout.columns != ()
    head = _head(table, blocks, turned=turned)
    width = _width(body, head)
    star = "*" if width > COLUMN else ""
    shape = "l" * len(table.keys) + "".join(" " + "r" * len(block) for _, block in blocks)
    tabular = [rf"\begin{{tabular}}{{{shape}}}", r"\toprule", *head, r"\midrule", *body]
    tabular += [r"\bottomrule", r"\end{tabular}"]
    if width > PAGE or turned:
        # Safe to leave in place: what fits is not made smaller.
        tabular = [
            r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
            *tabular[:-1],
            tabular[-1] + "}",
        ]
    packages = r"booktabs, graphicx" if width > PAGE or turned else "booktabs"
    lines = [f"% {_CONTROL.sub(' ', one)}" for one in (*origin, rf"Needs \usepackage{{{packages}}}.")]
    lines += [f"\\begin{{table{star}}}[t]", r"\centering", rf"\caption{{{_caption(table, caption)}}}"]
    if label:
        lines.append(rf"\label{{{_CONTROL.sub('', label)}}}")
    lines += [r"\small", r"\setlength{\tabcolsep}{4pt}", *tabular]
    if notes := _footnotes(table):
        lines += ["", r"\smallskip", rf"{{\footnotesize {' '.join(notes)}}}"]
    return "\n".join([*lines, rf"\end{{table{star}}}", ""])


def _width(body: Sequence[str], head: Sequence[str]) -> int:
    """Return about how many characters wide a table is."""
    lines = [line for line in (*head, *body) if " & " in line and "multicolumn" not in line]
    cells = zip(*(line.removesuffix(r" \\").split(" & ") for line in lines), strict=True)
    return sum(max(len(_COMMANDS.sub("", cell)) for cell in column) + 2 for column in cells)


def _blocks(table: PaperTable) -> list[tuple[str, list[str]]]:
    """Return (heading, headings beneath it) of each block of columns of numbers."""
    names = table.layout.columns
    beneath = [escaped(", ".join(_column(names, column))) for column in table.columns]
    titles = [escaped(metric.title) for metric in table.metrics]
    blocks = [(title, beneath) for title in titles]
    if table.shows_counts:
        blocks.append(("$n$", beneath if len(beneath) <= FEW else [""]))
    return blocks


def _column(names: Sequence[str], values: Sequence[Any]) -> list[str]:
    """Return what stands above a column: values, with name and unit where they don't explain themselves."""
    return [
        _text(value) if name in SUBJECT else f"{column_title(name, names)} {_text(value)}"
        for name, value in zip(names, values, strict=True)
    ]


def _head(table: PaperTable, blocks: Sequence[tuple[str, list[str]]], *, turned: bool = False) -> list[str]:
    keys = [escaped(_key_title(name, table.keys)) for name in table.keys]
    if not table.layout.columns:
        parts = [title.partition(" [") for title, _ in blocks]
        units = [f"[{unit}" if unit else "" for _, _, unit in parts]
        lines = [_line([*keys, *(name for name, _, _ in parts)])]
        return [*lines, _line([*("" for _ in keys), *units])] if any(units) else lines
    first, rules, at = [""] * len(keys), [], len(keys) + 1
    for title, beneath in blocks:
        first.append(rf"\multicolumn{{{len(beneath)}}}{{c}}{{{title}}}")
        rules.append(rf"\cmidrule(lr){{{at}-{at + len(beneath) - 1}}}")
        at += len(beneath)
    names = [rf"\rotatebox{{60}}{{{name}}}" if turned else name for _, block in blocks for name in block]
    return [_line(first), "".join(rules), _line([*keys, *names])]


def _key_title(name: str, names: Sequence[str]) -> str:
    """Return a heading; names that somebody gave keep their letters."""
    title = column_title(name, names)
    return title if name.startswith(_GIVEN) or "." in title else title[:1].upper() + title[1:]


def _body(table: PaperTable) -> list[str]:
    pairs = list(zip(table.rows, table.places, strict=True))
    grouped = len(table.keys) > 1
    lines = []
    for number, (_, group) in enumerate(
        groupby(pairs, key=lambda pair: _text(pair[0][0]) if grouped else "")
    ):
        if number:
            lines.append(r"\midrule")
        for place, (row, line) in enumerate(group):
            keys = ["" if grouped and place and not at else escaped(key) for at, key in enumerate(row)]
            lines.append(_line([*keys, *_cells(table, line)]))
    return lines


def _cells(table: PaperTable, line: Sequence[Place | None]) -> list[str]:
    cells = []
    for number, metric in enumerate(table.metrics):
        cells += [_figure(metric, place, number) for place in line]
    if table.shows_counts and len(line) <= FEW:
        cells += ["--" if place is None else _count(place.n, place.runs) for place in line]
    elif table.shows_counts:
        held = [place for place in line if place is not None]
        cells.append(_count(sum(place.n for place in held), sum(place.runs for place in held)))
    return cells


def _count(n: int, runs: int) -> str:
    return str(n) if n == runs else f"{n}/{runs}"


def _figure(metric: Metric, place: Place | None, number: int) -> str:
    if place is None:
        return "--"
    figure: Figure = place.figures[number]
    if figure.value is None:
        return rf"\textit{{{escaped(place.verdict)}}}" if not place.n else "--"
    shape = metric.format or ".4g"
    text = format(figure.value, shape)
    if figure.bold:
        text = rf"\textbf{{{text}}}"
    ends = [format(end, shape) for end in figure.spread]
    if len(ends) == 1:
        text += rf" $\pm$ {ends[0]}"
    elif ends:
        text += rf" [{ends[0]}, {ends[1]}]"
    return text + (_DAGGER if place.untracked and not number else "")


def _caption(table: PaperTable, caption: str) -> str:
    low, high = table.counts
    layout = table.layout
    runs = "tracked runs" if layout.outcomes is Outcomes.TRACKED else "all evaluated runs"
    what = "Mean" if layout.statistic is Statistic.MEAN else "Median"
    if layout.spread:
        what += r" $\pm$ standard deviation" if layout.statistic is Statistic.MEAN else " [range]"
    count = f"$n = {low}$" if low == high else f"$n = {low}$ to ${high}$"
    told = caption.strip()
    if told and not told.endswith((".", "!", "?")):
        told += "."
    parts = [escaped(told)] if told else []
    parts.append(f"{what} over {runs}, {count} each.")
    if any(one.bold for line in table.places for place in line if place for one in place.figures):
        parts.append("Bold: best of its column" + (" and group." if _is_grouped(table) else "."))
    if table.has_failures:
        parts.append(
            f"{_DAGGER} some runs were not tracked and are left out."
            if layout.outcomes is Outcomes.TRACKED
            else f"{_DAGGER} holds runs that were not tracked."
        )
    return " ".join(parts)


def _is_grouped(table: PaperTable) -> bool:
    return table.layout.best is Best.GROUP and len(table.keys) > 1


def _footnotes(table: PaperTable) -> list[str]:
    found = []
    failures = table.failures
    for row, column, words in failures[:_MOST_FAILURES]:
        keys = zip((*table.keys, *table.layout.columns), (*row, *column), strict=True)
        who = keys_text(dict(keys), ("algorithm", "dataset"), _text)
        counts = ", ".join(f"{count} {word}" for word, count in words.items())
        found.append(escaped(f"{who}: {counts}"))
    if len(failures) > _MOST_FAILURES:
        found.append(f"and {len(failures) - _MOST_FAILURES} more")
    sentences = [f"Not tracked: {'; '.join(found)}."] if found else []
    return [*sentences, *(escaped(note[:1].upper() + note[1:] + ".") for note in table.notes)]


def _line(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def _text(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, float) else str(value)
