# SPDX-License-Identifier: Apache-2.0
"""Tables of a report: what people read, and the same with every digit as a file to save."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from slamhive.reporting.markup import Markup, clip, download, element, escaped, joined
from slamhive_eval.formats.csv_writing import csv_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


MOST_LINES = 300
"""Lines of a table that are shown; the CSV has all."""


@dataclass(frozen=True)
class Sheet:
    """A table.

    Attributes:
        name: of its file, without the ending.
        caption: what it shows.
        headings: of its columns; numbers stand to the right.
        lines: what is read, a row a line: texts, or markup.
        columns: the same with every digit, by name, for the CSV; None for no file.
    """

    name: str
    caption: str
    headings: Sequence[tuple[str, bool]]
    lines: Sequence[Sequence[Any]]
    columns: Mapping[str, Sequence[Any]] | None = field(default=None)

    def html(self) -> Markup:
        """Return it as HTML."""
        kinds = [number for _, number in self.headings]
        head = [
            element("th", clip(title), scope="col", class_="n" if number else None)
            for title, number in self.headings
        ]
        rows = [
            element(
                "tr",
                *(
                    element(
                        "td", cell if isinstance(cell, Markup) else clip(cell), class_="n" if number else None
                    )
                    for cell, number in zip(line, kinds, strict=True)
                ),
            )
            for line in self.lines[:MOST_LINES]
        ]
        left = len(self.lines) - len(rows)
        more = [element("p", f"{left:,} more lines are in the CSV.", class_="quiet")] if left > 0 else []
        link = [] if self.columns is None else [" ", download(f"{self.name}.csv", csv_text(self.columns))]
        caption = element("p", clip(self.caption, 400), *link, class_="caption")
        body = element("thead", element("tr", *head)), element("tbody", *rows)
        table = element("table", *body, aria_label=clip(self.caption))
        about = f"{clip(self.caption)} ({self.name})"  # landmarks need names of their own
        scroll = element("div", table, class_="scroll", tabindex="0", role="region", aria_label=about)
        return joined([caption, scroll, *more])


def notes_html(notes: Sequence[str]) -> Markup | None:
    """Return sentences as a list; None for none."""
    if not notes:
        return None
    said = dict.fromkeys(_sentence(note) for note in notes)
    return element("ul", *(element("li", clip(note, 600)) for note in said), class_="notes")


def _sentence(note: str) -> str:
    """Return a note as a sentence; a name at its beginning stays as it is."""
    first = note.partition(" ")[0]
    return (note[:1].upper() + note[1:] if first.isalpha() else note).rstrip(".") + "."


def bold(text: Any) -> Markup:
    """Return a text that stands out."""
    return element("b", text)


def small(*parts: Any) -> Markup:
    """Return a text that stands back."""
    return element("small", *(escaped(part) for part in parts))
