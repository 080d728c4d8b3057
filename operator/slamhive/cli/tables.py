# SPDX-License-Identifier: Apache-2.0
"""Tables for a terminal, as Markdown, CSV or JSON.

What people read is rounded and has units; CSV and JSON hold stored numbers with every digit.
"""

from __future__ import annotations

import csv
import json
from enum import StrEnum
from typing import TYPE_CHECKING, Any, TextIO

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    Row = Mapping[str, Any]

_WIDEST = 10_000


class Format(StrEnum):
    """How a table is printed."""

    TABLE = "table"
    CSV = "csv"
    JSON = "json"
    MARKDOWN = "markdown"


def show(console: Console, headings: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """Print lines of text as a table, as wide as it needs to be: a number is never broken in two."""
    table = Table(header_style="bold", box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    for heading in headings:
        table.add_column(Text(heading.replace(" [", "\n[")), no_wrap=True)
    for line in lines:
        table.add_row(*(Text(cell) for cell in line))
    wide = Console(
        file=console.file, width=_WIDEST, highlight=False, force_terminal=console.is_terminal or None
    )
    wide.print(table)


def write_markdown(stream: TextIO, headings: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """Write lines of text as a Markdown table."""
    for line in (headings, ["---"] * len(headings), *lines):
        cells = (cell.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ") for cell in line)
        stream.write(f"| {' | '.join(cells)} |\n")


def write_csv(stream: TextIO, columns: Sequence[str], rows: Iterable[Row]) -> None:
    """Write rows as CSV, numbers with every digit, empty where nothing is known."""
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_csv_cell(row.get(name)) for name in columns] for row in rows)


def write_json(stream: TextIO, rows: Iterable[Row]) -> None:
    """Write rows as a JSON array, one object a line, numbers with every digit."""
    separator = "[\n"
    for row in rows:
        stream.write(separator + json.dumps(row, ensure_ascii=False, allow_nan=False))
        separator = ",\n"
    stream.write("[]\n" if separator == "[\n" else "\n]\n")


def _csv_cell(value: Any) -> Any:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value) if isinstance(value, list | dict) else value
