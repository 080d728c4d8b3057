# SPDX-License-Identifier: Apache-2.0
"""Tables for a terminal, as Markdown or JSON.

What people read is rounded and has units; JSON holds stored numbers with every digit.
"""

from __future__ import annotations

import json
from enum import StrEnum
from typing import TYPE_CHECKING, Any, TextIO

from rich.cells import cell_len

from slamhive.contract.lines import printable

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from rich.console import Console

    Row = Mapping[str, Any]

_GAP = "   "


class PrintFormat(StrEnum):
    """Formats in which commands print a table."""

    TABLE = "table"
    CSV = "csv"
    JSON = "json"
    MARKDOWN = "markdown"


def show(console: Console, headings: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """Print lines of text as a table, as wide as it needs to be: a number is never broken in two.

    Rich takes five minutes for 80,000 lines of 30 columns, this some seconds.
    """
    show_columns(console, headings, list(zip(*lines, strict=True)) or [()] * len(headings))


def show_columns(console: Console, headings: Sequence[str], columns: Sequence[Sequence[str]]) -> None:
    """Print the same of texts by their columns, which needs no line more than once."""
    titles = [printable(heading).replace(" [", "\n[").split("\n") for heading in headings]
    deep = max(map(len, titles), default=0)
    widths, heads, bodies = [], [], []
    for title, column in zip(titles, columns, strict=True):
        head = [""] * (deep - len(title)) + title
        # Columns repeat few texts: each is made fit once.
        cells = {text: printable(text) for text in set(column)}
        width = max(map(_width, (*head, *cells.values())))
        padded = {text: cell + " " * (width - _width(cell)) for text, cell in cells.items()}
        widths.append(width)
        heads.append([text + " " * (width - _width(text)) for text in head])
        bodies.append(map(padded.__getitem__, column))
    bold, plain = ("\x1b[1m", "\x1b[0m") if console.is_terminal and not console.no_color else ("", "")
    console.file.writelines(f"{bold}{_GAP.join(line)}{plain}\n" for line in zip(*heads, strict=True))
    console.file.write("─" * (sum(widths) + len(_GAP) * max(len(widths) - 1, 0)) + "\n")
    console.file.writelines(f"{_GAP.join(line)}\n" for line in zip(*bodies, strict=True))


def _width(cell: str) -> int:
    return len(cell) if cell.isascii() else cell_len(cell)


def write_markdown(stream: TextIO, headings: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """Write lines of text as a Markdown table."""
    for line in (headings, ["---"] * len(headings), *lines):
        cells = (printable(cell).replace("\\", "\\\\").replace("|", "\\|") for cell in line)
        stream.write(f"| {' | '.join(cells)} |\n")


def write_json(stream: TextIO, rows: Iterable[Row]) -> None:
    """Write rows as a JSON array, one object a line, numbers with every digit."""
    separator = "[\n"
    for row in rows:
        stream.write(separator + json.dumps(row, ensure_ascii=False, allow_nan=False))
        separator = ",\n"
    stream.write("[]\n" if separator == "[\n" else "\n]\n")
