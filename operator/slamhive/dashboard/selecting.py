# SPDX-License-Identifier: Apache-2.0
"""Which rows a request means: readable query strings.

::

    algorithm=orb-slam3&dataset=mh01&dataset=mh02    values of a name are alternatives, names all hold
    coverage>=0.9&parameters.nFeatures<4000          orders; !=  is there too
    where=run in (126, 141) or scale < 1             a condition as for slamhive results --where
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from slamhive.analysis.conditions import All, Comparison, Literal, Membership, Name
from slamhive.analysis.expressions import parse_where
from slamhive.analysis.grouping import with_facets
from slamhive.analysis.pivot import Outcomes
from slamhive.dashboard.problems import BadRequest, within
from slamhive.model.errors import suggestion

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from slamhive.analysis.conditions import Node
    from slamhive.analysis.frame import Frame

    Pairs = Sequence[tuple[str, str]]

MAX_FILTERS = 100
_OPERATOR = re.compile(r"(.+?)(<=|>=|!=|<|>)(.*)", re.DOTALL)
_WORDS: dict[str, Any] = {"true": True, "false": False, "null": None}


def select(frame: Frame, pairs: Pairs, reserved: Iterable[str]) -> Frame:
    """Return the rows that the filters of a query string mean.

    Args:
        frame: all rows.
        pairs: names and values of the query string.
        reserved: names that mean something else to the request.

    Raises:
        BadRequest: with the parameter that is wrong.
    """
    node = _filters(frame, pairs, frozenset(reserved))
    return frame if node is None else frame.select(node.mask(frame))


def select_analysed(frame: Frame, pairs: Pairs, reserved: Iterable[str]) -> Frame:
    """Return the rows that an analysis is asked for: as ``select``, but no filter loses failed runs.

    They have no evaluation; asked for those of one, they count as failed in it.

    Raises:
        BadRequest: with the parameter that is wrong.
    """
    asked = any(word in text for pair in pairs for text in pair for word in ("evaluation", "alignment"))
    return select(with_facets(frame) if asked else frame, pairs, reserved)


def _filters(frame: Frame, pairs: Pairs, reserved: frozenset[str]) -> Node | None:
    parts: list[Node] = []
    equal: dict[str, list[str]] = {}
    for name, value in pairs:
        if name in reserved:
            continue
        if name == "where":
            if value.strip():
                with within("where"):
                    parts.append(parse_where(value, frame.names))
        elif (match := _operator(name, value)) is not None:
            column, symbol, right = match
            _require(frame, column, reserved)
            parts.append(_comparison(column, symbol, right))
        else:
            _require(frame, name, reserved)
            equal.setdefault(name, []).append(value)
    if len(parts) + len(equal) > MAX_FILTERS:
        raise BadRequest(f"more than {MAX_FILTERS} filters", "where")
    for name, values in equal.items():
        parts.append(Membership(Name(name), tuple(_meanings(values)), negated=False))
    if not parts:
        return None
    return parts[0] if len(parts) == 1 else All(tuple(parts))


def _operator(name: str, value: str) -> tuple[str, str, str] | None:
    """Read ``coverage>=0.9`` where the query string was split at its equals sign."""
    text = f"{name}={value}" if name.endswith(("<", ">", "!")) else name
    match = _OPERATOR.fullmatch(text)
    return (match[1], match[2], match[3]) if match else None


def _comparison(column: str, symbol: str, text: str) -> Node:
    if symbol == "!=":
        return Membership(Name(column), tuple(_meanings([text])), negated=True)
    try:
        value: Any = float(text)
    except ValueError:
        value = text
    if value == "":
        raise BadRequest(f"{column}{symbol}: a number or a text is missing behind it", column)
    return Comparison(symbol, Name(column), Literal(value))


def _meanings(values: Iterable[str]) -> list[Any]:
    return [meaning for text in values for meaning in (text, *([_WORDS[text]] if text in _WORDS else ()))]


def _require(frame: Frame, name: str, reserved: frozenset[str]) -> None:
    if not frame.has(name):
        shown = name[:200]
        hint = suggestion(shown, [*frame.names, *reserved, "where"])
        raise BadRequest(f"unknown parameter or column {shown!r}{hint}", shown)


def names(text: str | None) -> list[str]:
    """Return the names in a list such as ``a,b``."""
    return [part.strip() for part in text.split(",") if part.strip()] if text else []


def columns(frame: Frame, text: str | None, field: str, default: Sequence[str] = ()) -> list[str]:
    """Return the columns that a list names, each once.

    Raises:
        BadRequest: one of them is unknown.
    """
    found = list(dict.fromkeys(names(text))) or list(default)
    for name in found:
        if not frame.has(name.removeprefix("-") if field == "sort" else name):
            shown = name.removeprefix("-")[:200]
            raise BadRequest(f"unknown column {shown!r}{suggestion(shown, frame.names)}", field)
    return found


def column(frame: Frame, name: str, field: str) -> str:
    """Return the one column that a parameter names.

    Raises:
        BadRequest: it is unknown, or there is none.
    """
    found = columns(frame, name, field)
    if len(found) != 1:
        raise BadRequest(f"{field}: expected the name of one column", field)
    return found[0]


def number_column(frame: Frame, name: str, field: str) -> str:
    """Return the column of numbers that a parameter names.

    Raises:
        BadRequest: it is unknown, or holds no numbers.
    """
    found = column(frame, name, field)
    held = frame.column(found)
    if not held.is_empty and not (held.floats() == held.floats()).any():
        raise BadRequest(f"{found}: a column of numbers is needed, this one holds none", field)
    return found


def outcomes(text: str) -> Outcomes:
    """Return which runs count.

    Raises:
        BadRequest: the word is unknown.
    """
    if text not in set(Outcomes):
        raise BadRequest(f"unknown choice {text[:100]!r}{suggestion(text[:100], Outcomes)}", "outcomes")
    return Outcomes(text)
