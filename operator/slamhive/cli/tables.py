# SPDX-License-Identifier: Apache-2.0
"""Tables for a terminal, as Markdown or JSON.

What people read is rounded and has units; JSON holds stored numbers with every digit.
"""

from __future__ import annotations

import json
from enum import StrEnum
from typing import TYPE_CHECKING, Any, TextIO

from rich.cells import cell_len

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from rich.console import Console

    Row = Mapping[str, Any]

_GAP = "   "
_UNPRINTABLE = dict.fromkeys((*range(32), 127), " ")


class Format(StrEnum):
    """Formats in which commands print a table."""

    TABLE = "table"
    CSV = "csv"
    JSON = "json"
    MARKDOWN = "markdown"


def show(console: Console, headings: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """Print lines of text as a table, as wide as it needs to be: a number is never broken in two.

    Rich takes five minutes for 80,000 lines of 30 columns, this some seconds.
    """
    kept = [tuple(map(_printable, line)) for line in lines]
    titles = [heading.replace(" [", "\n[").split("\n") for heading in headings]
    deep = max(map(len, titles), default=0)
    head = list(zip(*([""] * (deep - len(title)) + title for title in titles), strict=True))
    columns = zip(*head, *kept, strict=True)
    widths = [max(map(_width, column)) for column in columns]

    def aligned(line: Sequence[str]) -> str:
        cells = [cell + " " * (width - _width(cell)) for cell, width in zip(line, widths, strict=True)]
        return _GAP.join(cells) + "\n"

    bold, plain = ("\x1b[1m", "\x1b[0m") if console.is_terminal and not console.no_color else ("", "")
    console.file.writelines(f"{bold}{aligned(line)[:-1]}{plain}\n" for line in head)
    console.file.write("─" * (sum(widths) + len(_GAP) * max(len(widths) - 1, 0)) + "\n")
    console.file.writelines(map(aligned, kept))


def _printable(cell: str) -> str:
    return cell if cell.isprintable() else cell.translate(_UNPRINTABLE)


def _width(cell: str) -> int:
    return len(cell) if cell.isascii() else cell_len(cell)


def write_markdown(stream: TextIO, headings: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """Write lines of text as a Markdown table."""
    for line in (headings, ["---"] * len(headings), *lines):
        cells = (cell.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ") for cell in line)
        stream.write(f"| {' | '.join(cells)} |\n")


def write_json(stream: TextIO, rows: Iterable[Row]) -> None:
    """Write rows as a JSON array, one object a line, numbers with every digit."""
    separator = "[\n"
    for row in rows:
        stream.write(separator + json.dumps(row, ensure_ascii=False, allow_nan=False))
        separator = ",\n"
    stream.write("[]\n" if separator == "[\n" else "\n]\n")
