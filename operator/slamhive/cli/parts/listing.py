# SPDX-License-Identifier: Apache-2.0
"""Tables of the catalog: names are never cut, prose gives way to them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from slamhive.cli.parts.console import out

if TYPE_CHECKING:
    from collections.abc import Sequence

_LEAST = 24
"""Characters below which a column of prose says nothing."""
_FRAME = 3
"""Characters that a column takes beside its text."""


def show_catalog(
    headings: Sequence[str], lines: Sequence[Sequence[str]], prose: Sequence[int] = (), console: Console = out
) -> bool:
    """Print a table, a line an entry.

    Args:
        headings: of the columns.
        lines: of text, one for each entry.
        prose: numbers of columns that are cut to one line, or left out where there is no room; the most
            important first. All others stand as they are.
        console: where to print; one that is no terminal has the width that COLUMNS says, or 80.

    Returns:
        Whether every column had room.
    """
    width = console.width
    widest = [max(len(cell) for cell in column) + _FRAME for column in zip(headings, *lines, strict=True)]
    left = width - 1 - sum(size for number, size in enumerate(widest) if number not in prose)
    limits = {number: widest[number] - _FRAME for number in range(len(headings)) if number not in prose}
    for number in prose:
        if left >= min(widest[number], _LEAST + _FRAME):
            limits[number] = min(widest[number], left) - _FRAME
            left -= limits[number] + _FRAME
    table = Table(header_style="bold")
    for number in sorted(limits):
        table.add_column(Text(headings[number]), no_wrap=True)
    for line in lines:
        table.add_row(*(_cut(line[number], limit) for number, limit in sorted(limits.items())))
    # Names that are wider than the terminal are better wrapped by it than cut.
    needed = 1 + sum(limit + _FRAME for limit in limits.values())
    Console(file=console.file, force_terminal=console.is_terminal, width=needed, highlight=False).print(table)
    return len(limits) == len(headings)


def _cut(text: str, limit: int) -> Text:
    return Text(text if len(text) <= limit else text[: limit - 1].rstrip() + "…")
