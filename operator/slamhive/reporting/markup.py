# SPDX-License-Identifier: Apache-2.0
"""HTML and SVG as text in which everything is escaped that isn't markup of our own."""

from __future__ import annotations

import base64
import html
import re
from typing import TYPE_CHECKING, Any

from slamhive.analysis import Metric

if TYPE_CHECKING:
    from collections.abc import Iterable

MOST_LETTERS = 160
"""Letters of a name or value that are shown; the CSV has all of them."""

_UNPRINTABLE = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff\ufffe\uffff]")
_VOID = frozenset({"meta", "link", "br"})


class Markup(str):
    """A text that is markup already."""

    __slots__ = ()


def escaped(value: Any) -> Markup:
    """Return a value as text in which nothing is markup."""
    if isinstance(value, Markup):
        return value
    return Markup(html.escape(_UNPRINTABLE.sub("\ufffd", str(value)), quote=True))


def element(name: str, *content: Any, **attributes: Any) -> Markup:
    """Return an element.

    Args:
        name: its name.
        content: what it holds, escaped unless it is markup; None for nothing.
        attributes: by name, without a trailing underscore, other underscores as dashes; None for none.
    """
    words = [name]
    for key, value in attributes.items():
        if value is not None:
            words.append(f'{key.rstrip("_").replace("_", "-")}="{escaped(value)}"')
    opened = f"<{' '.join(words)}>"
    return Markup(opened if name in _VOID else f"{opened}{joined(content)}</{name}>")


def joined(content: Iterable[Any]) -> Markup:
    """Return parts one behind the other."""
    return Markup("".join(escaped(part) for part in content if part is not None))


def clip(text: Any, most: int = MOST_LETTERS) -> str:
    """Return a text, or its beginning where it is long."""
    found = str(text)
    return found if len(found) <= most else found[: most - 1] + "…"


def shortened(text: str, most: int) -> str:
    """Return a text without its middle where it is long: names often differ at their ends."""
    if len(text) <= most:
        return text
    end = (most - 1) // 2
    return f"{text[: most - 1 - end].rstrip()}…{text[len(text) - end :].lstrip()}"


def download(name: str, text: str) -> Markup:
    """Return a link that holds a table, so that no script is needed to save it."""
    data = base64.b64encode(text.encode("utf-8", "replace")).decode()
    address = f"data:text/csv;charset=utf-8;base64,{data}"
    return element("a", "CSV", href=address, download=name, class_="csv")


def shown(value: Any, metric: Metric | None = None) -> str:
    """Return a value of a table as people read it."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float) and metric is not None:
        return metric.show(value)
    return clip(repr(value).removesuffix(".0") if isinstance(value, float) else value)


def parse_metric(column: str) -> Metric:
    """Return the metric of a column, which shows its numbers."""
    return Metric(column, "", 1.0) if ":" in column else Metric.parse(column)
