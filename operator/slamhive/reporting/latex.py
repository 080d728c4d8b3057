# SPDX-License-Identifier: Apache-2.0
"""Tables in LaTeX, with booktabs or as IEEE has them, to be taken up by a paper as they are."""

from __future__ import annotations

import re
from itertools import groupby
from typing import TYPE_CHECKING, Any

from slamhive.model.base import Choice
from slamhive.reporting.tablewords import caption as caption_of
from slamhive.reporting.tablewords import column_words, count_text, footnotes, key_title, parts_text, plain
from slamhive.tables.text import cost_mark, number_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis import Metric
    from slamhive.reporting.papertables import PaperTable, TableCell, TableNumber

FEW = 4
"""Columns up to which n stands under each, beyond once a row."""

COLUMN, PAGE = 58, 118
"""Characters that stand side by side in a column and on a page of two."""

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
    "†": r"\textsuperscript{\textdagger}",
    "‡": r"\textsuperscript{\textdaggerdbl}",
    "§": r"\textsuperscript{\S}",
    "∞": r"$\infty$",
    '"': r"\textquotedbl{}",
}
_DAGGER = r"\textsuperscript{\textdagger}"
_CONTROL = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff]+")
_N = re.compile(r"\bn = (\d+)(?: to (\d+))?")
_COMMANDS = re.compile(r"\\rotatebox\{60\}\{.*\}|\\[a-z]+\*?|[{}$]")


class Rules(Choice):
    """Styles of the lines in a LaTeX table."""

    BOOKTABS = "booktabs"
    IEEE = "ieee"

    @property
    def package(self) -> str | None:
        """The package that draws them."""
        return "booktabs" if self is Rules.BOOKTABS else None

    def line(self, place: str) -> str:
        """Return the line at a place: top, mid or bottom."""
        if self is Rules.BOOKTABS:
            return rf"\{place}rule"
        return r"\hline\hline" if place == "top" else r"\hline"

    def under(self, first: int, last: int) -> str:
        """Return a line under some columns, counted from 1."""
        return rf"\cmidrule(lr){{{first}-{last}}}" if self is Rules.BOOKTABS else rf"\cline{{{first}-{last}}}"


def escaped(text: Any) -> str:
    """Return a text that LaTeX prints as it is."""
    return "".join(_SPECIAL.get(sign, sign) for sign in _CONTROL.sub(" ", plain(text)))


def latex(
    table: PaperTable,
    *,
    caption: str = "",
    label: str = "",
    origin: Sequence[str] = (),
    rules: Rules = Rules.BOOKTABS,
) -> str:
    """Write a table.

    Args:
        table: the figures.
        caption: what it shows; statistic, n and what is bold are added.
        label: what the paper refers to it by; none for none.
        origin: sentences on where it comes from, put in front as comments.
        rules: how its lines are drawn.
    """
    body = _body(table, rules)
    blocks = _blocks(table)
    turned = _width(body, _head(table, blocks, rules)) > PAGE and table.layout.columns != ()
    head = _head(table, blocks, rules, turned=turned)
    width = _width(body, head)
    star = "*" if width > COLUMN else ""
    shape = "l" * len(table.keys) + "".join(" " + "r" * len(block) for _, block in blocks)
    lines_of = {place: rules.line(place) for place in ("top", "mid", "bottom")}
    tabular = [rf"\begin{{tabular}}{{{shape}}}", lines_of["top"], *head, lines_of["mid"], *body]
    tabular += [lines_of["bottom"], r"\end{tabular}"]
    if width > PAGE or turned:
        # Safe to leave in place: what fits is not made smaller.
        tabular = [
            r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
            *tabular[:-1],
            tabular[-1] + "}",
        ]
    packages = [name for name in (rules.package, "graphicx" if width > PAGE or turned else None) if name]
    needs = [rf"Needs \usepackage{{{', '.join(packages)}}}."] if packages else []
    lines = [f"% {_CONTROL.sub(' ', one)}" for one in (*origin, *needs)]
    told = " ".join(map(_counted, caption_of(table, caption)))
    # Most classes leave no room between a caption and what stands beneath it.
    lines += [f"\\begin{{table{star}}}[t]", r"\centering", r"\setlength{\belowcaptionskip}{4pt}"]
    lines += [rf"\caption{{{told}}}"]
    if rules is Rules.IEEE:
        lines.append(r"\renewcommand{\arraystretch}{1.2}")
    if label:
        lines.append(rf"\label{{{_CONTROL.sub('', label)}}}")
    lines += [r"\small", r"\setlength{\tabcolsep}{4pt}", *tabular]
    if notes := [escaped(note) for note in footnotes(table)]:
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
    beneath = [escaped(column_words(names, column)) for column in table.columns]
    shown = [metric.column for metric in table.metrics]
    titles = [escaped(metric.title_among(shown)) for metric in table.metrics]
    blocks = [(title, beneath) for title in titles]
    if table.overall:
        blocks.append(("Over datasets", [str(over.kind.value) for over in table.overall]))
    if table.shows_counts:
        blocks.append(("$n$", beneath if len(beneath) <= FEW else [""]))
    return blocks


def _head(
    table: PaperTable, blocks: Sequence[tuple[str, list[str]]], rules: Rules, *, turned: bool = False
) -> list[str]:
    keys = [escaped(key_title(name, table.keys)) for name in table.keys]
    if not table.layout.columns:
        parts = [title.partition(" [") for title, _ in blocks]
        units = [f"[{unit}" if unit else "" for _, _, unit in parts]
        lines = [_line([*keys, *(name for name, _, _ in parts)])]
        return [*lines, _line([*("" for _ in keys), *units])] if any(units) else lines
    first, under, at = [""] * len(keys), [], len(keys) + 1
    for title, beneath in blocks:
        first.append(rf"\multicolumn{{{len(beneath)}}}{{c}}{{{title}}}")
        under.append(rules.under(at, at + len(beneath) - 1))
        at += len(beneath)
    names = [rf"\rotatebox{{60}}{{{name}}}" if turned else name for _, block in blocks for name in block]
    return [_line(first), "".join(under), _line([*keys, *names])]


def _body(table: PaperTable, rules: Rules) -> list[str]:
    pairs = list(zip(table.rows, table.places, range(len(table.rows)), strict=True))
    grouped = len(table.keys) > 1
    lines = []
    for number, (_, group) in enumerate(
        groupby(pairs, key=lambda pair: plain(pair[0][0]) if grouped else "")
    ):
        if number:
            lines.append(rules.line("mid"))
        for place, (row, line, at_row) in enumerate(group):
            keys = ["" if grouped and place and not at else escaped(key) for at, key in enumerate(row)]
            lines.append(_line([*keys, *_cells(table, line, at_row)]))
    return lines


def _cells(table: PaperTable, line: Sequence[TableCell | None], row: int) -> list[str]:
    cells = []
    for number, metric in enumerate(table.metrics):
        cells += [_figure(metric, place, number) for place in line]
    for over in table.overall:
        figure = over.figures[row]
        text = "--" if figure.value is None else escaped(number_text(figure.value, ".2f"))
        cells.append(_marked(figure, text) + parts_text(over.datasets[row]))
    if table.shows_counts and len(line) <= FEW:
        cells += ["--" if place is None else count_text([place]) for place in line]
    elif table.shows_counts:
        cells.append(count_text([place for place in line if place is not None]))
    return cells


def _figure(metric: Metric, place: TableCell | None, number: int) -> str:
    if place is None:
        return "--"
    figure: TableNumber = place.figures[number]
    if figure.value is None:
        failed = not place.n and not figure.published
        return rf"\textit{{{escaped(place.verdict)}}}" if failed else "--"
    shape = metric.format or ".4g"
    text = format(figure.value, shape)
    text = _marked(figure, text)
    ends = [format(end, shape) for end in figure.spread]
    if len(ends) == 1:
        text += rf" $\pm$ {ends[0]}"
    elif ends:
        text += rf" [{ends[0]}, {ends[1]}]"
    text += escaped(cost_mark(metric.column, reader=place.reader, late=place.late).strip())
    return text + (_DAGGER if place.untracked and not number else "")


def _marked(figure: TableNumber, text: str) -> str:
    if figure.bold:
        return rf"\textbf{{{text}}}"
    return rf"\underline{{{text}}}" if figure.second else text


def _counted(sentence: str) -> str:
    """Return a sentence in which n and its numbers are set as a formula."""
    told = escaped(sentence)
    return _N.sub(lambda found: f"$n = {found[1]}$" + (f" to ${found[2]}$" if found[2] else ""), told)


def _line(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"
