# SPDX-License-Identifier: Apache-2.0
"""Query strings that select rows of the table of runs. The dashboard's addresses are made of them.

::

    algorithm=orb-slam3&dataset=mh01&dataset=mh02    values of a name are alternatives, names all hold
    coverage>=0.9&parameters.nFeatures<4000          orders; !=  is there too
    where=run in (126, 141) or scale < 1             a condition as for slamhive results --where
"""

from __future__ import annotations

import re
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from slamhive.analysis.conditions import All, Comparison, Literal, Membership, Name
from slamhive.analysis.expressions import parse_where
from slamhive.analysis.grouping import Outcomes
from slamhive.analysis.selection import meeting
from slamhive.model.errors import InputError, suggestion

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from slamhive.analysis.conditions import Node
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.selection import Chosen

    Pairs = Sequence[tuple[str, str]]

MAX_FILTERS = 100

SUPERSEDED = "superseded"
"""Parameter by which results of earlier versions are asked for."""

_OPERATOR = re.compile(r"(.+?)(<=|>=|!=|<|>)(.*)", re.DOTALL)
_WORDS: dict[str, Any] = {"true": True, "false": False, "null": None}


class QueryError(InputError):
    """A query string that can't be understood.

    Attributes:
        field: name of the parameter that is wrong.
        position: where in its text the mistake is, from 0.
    """

    reason = "InvalidQuery"

    def __init__(self, sentence: str, field: str | None = None, position: int | None = None) -> None:
        super().__init__(sentence)
        self.field = field
        self.position = position


@contextmanager
def within(field: str) -> Iterator[None]:
    """Say of mistakes found inside in which parameter they were made.

    Raises:
        QueryError: in the place of an InputError.
    """
    try:
        yield
    except InputError as error:
        raise QueryError(str(error), field, getattr(error, "position", None)) from None


def select(
    frame: Frame, pairs: Pairs, reserved: Iterable[str], *, each: bool = False, always: bool = False
) -> Chosen:
    """Return the rows that the filters of a query string mean, current ones alone unless they ask for more.

    Args:
        frame: all rows.
        pairs: names and values of the query string; ``superseded=1`` asks for earlier versions too.
        reserved: names that mean something else to the request.
        each: whether runs are meant one by one: those of equal content too, and unfinished ones.
        always: whether earlier versions are meant whether or not they are asked for.

    Raises:
        QueryError: with the parameter that is wrong.
    """
    node = condition(frame, pairs, {*reserved, SUPERSEDED})
    asked = [value for name, value in pairs if name == SUPERSEDED]
    if asked and asked[-1] not in {"0", "1", "false", "true"}:
        raise QueryError(f"{SUPERSEDED}: expected 0 or 1, found {asked[-1][:40]!r}", SUPERSEDED)
    superseded = always or (bool(asked) and asked[-1] in {"1", "true"})
    return meeting(frame, node, superseded=superseded, each=each)


def condition(frame: Frame, pairs: Pairs, reserved: Iterable[str]) -> Node | None:
    """Return the condition on a row in the filters of a query string; None for none.

    Raises:
        QueryError: with the parameter that is wrong.
    """
    reserved = frozenset(reserved)
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
        raise QueryError(f"more than {MAX_FILTERS} filters", "where")
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
        raise QueryError(f"{column}{symbol}: a number or a text is missing behind it", column)
    return Comparison(symbol, Name(column), Literal(value))


def _meanings(values: Iterable[str]) -> list[Any]:
    return [meaning for text in values for meaning in (text, *([_WORDS[text]] if text in _WORDS else ()))]


def _require(frame: Frame, name: str, reserved: frozenset[str]) -> None:
    if not frame.has(name):
        shown = name[:200]
        hint = suggestion(shown, [*frame.names, *reserved, "where"])
        raise QueryError(f"unknown parameter or column {shown!r}{hint}", shown)


def split_names(text: str | None) -> list[str]:
    """Return the names in a list such as ``a,b``."""
    return [part.strip() for part in text.split(",") if part.strip()] if text else []


def columns(frame: Frame, text: str | None, field: str, default: Sequence[str] = ()) -> list[str]:
    """Return the columns that a list names, each once.

    Raises:
        QueryError: one of them is unknown.
    """
    chosen = list(dict.fromkeys(split_names(text))) or list(default)
    for name in chosen:
        if not frame.has(name.removeprefix("-") if field == "sort" else name):
            shown = name.removeprefix("-")[:200]
            raise QueryError(f"unknown column {shown!r}{suggestion(shown, frame.names)}", field)
    return chosen


def column(frame: Frame, name: str, field: str) -> str:
    """Return the one column that a parameter names.

    Raises:
        QueryError: it is unknown, or there is none.
    """
    found = columns(frame, name, field)
    if len(found) != 1:
        raise QueryError(f"{field}: expected the name of one column", field)
    return found[0]


def number_column(frame: Frame, name: str, field: str) -> str:
    """Return the column of numbers that a parameter names.

    Raises:
        QueryError: it is unknown, or holds no numbers.
    """
    chosen = column(frame, name, field)
    held = frame.column(chosen)
    if not held.is_empty and not (held.floats() == held.floats()).any():
        raise QueryError(f"{chosen}: a column of numbers is needed, this one holds none", field)
    return chosen


def outcomes(text: str) -> Outcomes:
    """Return the outcomes that count.

    Raises:
        QueryError: the word is unknown.
    """
    if text not in set(Outcomes):
        raise QueryError(f"unknown choice {text[:100]!r}{suggestion(text[:100], Outcomes)}", "outcomes")
    return Outcomes(text)
