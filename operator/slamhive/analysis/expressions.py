# SPDX-License-Identifier: Apache-2.0
"""Conditions on rows: ``algorithm == 'orb-slam2' and parameters.nFeatures < 1000``.

::

    condition  = and-part { "or" and-part }
    and-part   = not-part { "and" not-part }
    not-part   = "not" not-part | "(" condition ")" | comparison
    comparison = operand { ("==" | "=" | "!=" | "<" | "<=" | ">" | ">=") operand }
               | operand [ "not" ] "in" "(" literal { "," literal } ")"
               | operand [ "not" ] "contains" ( word | 'text' | "text" )
               | operand "is" [ "not" ] "null"
    operand    = column | `column` | number | 'text' | "text" | true | false | null

A column that a row lacks is null. Null equals nothing but null and has no order, so ``x < 5`` and
``x >= 5`` are both false where x is missing. A text that looks like a number compares as one with
numbers. A text contains another in any spelling of its letters, tags contain whole ones. Nothing is ever
evaluated as a program.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

from slamhive.analysis.conditions import (
    ORDERS,
    All,
    AnyOf,
    Comparison,
    Holding,
    Literal,
    Membership,
    Name,
    Negation,
    NullTest,
    Truth,
)
from slamhive.analysis.measures import columns_ending_in
from slamhive.model.errors import InputError, suggestion

if TYPE_CHECKING:
    from collections.abc import Collection

    from slamhive.analysis.conditions import Node, Operand

MAX_LENGTH = 10_000
MAX_DEPTH = 50
MAX_LITERALS = 500
MAX_COLUMNS = 500
MAX_DIGITS = 300

_TOKEN = re.compile(
    # Digits are never given back (++): each shorter number would be tried in vain, in quadratic time.
    r"""\s*+(?:
      (?P<number>(?:\d++\.?\d*+|\.\d++)(?:[eE][-+]?\d++)?+(?![\w.]))
    | (?P<text>'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*")
    | `(?P<quoted>[^`]+)`
    | (?P<name>[^\W\d]\w*(?:\[\d+\])*(?:\.\w+(?:\[\d+\])*)*)
    | (?P<symbol><=|>=|==|!=|<>|[=<>(),+-])
    )""",
    re.VERBOSE,
)
_EQUAL = {"==": True, "=": True, "!=": False, "<>": False}
_CONSTANTS = {"true": True, "false": False, "null": None, "none": None}
_WORDS = {"and", "or", "not", "in", "is"}


class ExpressionError(InputError):
    """A condition that can't be understood.

    Attributes:
        position: where in the text it goes wrong, counted from 0.
    """

    reason = "InvalidExpression"

    def __init__(self, text: str, position: int, problem: str) -> None:
        line = text.replace("\n", " ").replace("\t", " ")
        begin = max(0, position - 60)
        window = line[begin : position + 40]
        super().__init__(
            f"condition, character {position + 1}: {problem}\n  {window}\n  {' ' * (position - begin)}^"
        )
        self.position = position


class _Token(NamedTuple):
    kind: str
    value: str
    position: int


def parse_where(text: str, columns: Collection[str]) -> Node:
    """Return a condition as a tree.

    Args:
        text: the condition.
        columns: the names that it may use.

    Raises:
        ExpressionError: with the place, and the nearest known column for an unknown one.
    """
    if len(text) > MAX_LENGTH:
        raise ExpressionError(text[:100], 0, f"a condition may have {MAX_LENGTH} characters")
    return _Parser(text, columns).parse()


class _Parser:
    def __init__(self, text: str, columns: Collection[str]) -> None:
        self._text = text
        self._columns = columns
        self._tokens = _tokens(text)
        self._next = 0
        self._depth = 0
        self._literals = 0
        self._named = 0

    def parse(self) -> Node:
        condition = self._any()
        if self._token.kind != "end":
            self._fail(f"expected 'and', 'or' or the end, found {self._token.value!r}")
        return condition

    @property
    def _token(self) -> _Token:
        return self._tokens[self._next]

    def _fail(self, problem: str, position: int | None = None) -> NoReturn:
        raise ExpressionError(self._text, self._token.position if position is None else position, problem)

    def _take(self, *values: str) -> str | None:
        """Take the next token if it is one of some words or symbols."""
        token = self._token
        if token.kind in {"word", "symbol"} and token.value in values:
            self._next += 1
            return token.value
        return None

    def _expect(self, value: str) -> None:
        if not self._take(value):
            found = "the end" if self._token.kind == "end" else repr(self._token.value)
            self._fail(f"expected {value!r}, found {found}")

    def _any(self) -> Node:
        parts = [self._all()]
        while self._take("or"):
            parts.append(self._all())
        return parts[0] if len(parts) == 1 else AnyOf(tuple(parts))

    def _all(self) -> Node:
        parts = [self._not()]
        while self._take("and"):
            parts.append(self._not())
        return parts[0] if len(parts) == 1 else All(tuple(parts))

    def _not(self) -> Node:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            self._fail(f"nested more than {MAX_DEPTH} deep")
        try:
            if self._take("not"):
                return Negation(self._not())
            if self._take("("):
                condition = self._any()
                self._expect(")")
                return condition
            return self._comparison()
        finally:
            self._depth -= 1

    def _comparison(self) -> Node:
        left = self._operand()
        if self._take("is"):
            wanted = not self._take("not")
            self._expect_null()
            return NullTest(left, wanted)
        negated = bool(self._take("not"))
        if self._take("in"):
            return Membership(left, tuple(self._list()), negated)
        if self._token.kind == "name" and self._token.value.lower() == "contains":
            self._next += 1
            return Holding(left, self._text_held(), negated)
        if negated:
            self._fail("expected 'in' or 'contains' after 'not'")
        parts: list[Node] = []
        while symbol := self._take(*ORDERS, *_EQUAL):
            right = self._operand()
            found = Comparison("==" if symbol in _EQUAL else symbol, left, right)
            parts.append(found if _EQUAL.get(symbol, True) else Negation(found))
            left = right
        if not parts:
            return Truth(left)
        return parts[0] if len(parts) == 1 else All(tuple(parts))

    def _text_held(self) -> str:
        """Take the text behind ``contains``: one word may stand without quotes."""
        token, behind = self._token, self._tokens[min(self._next + 1, len(self._tokens) - 1)]
        if token.kind not in {"name", "number", "text"}:
            self._fail("expected a word or a text in quotes after 'contains'")
        if token.kind == "text":
            return str(self._literal())
        if behind.kind == "symbol" and behind.value != ")":
            self._fail("a text of more than letters, digits and _ stands in quotes")
        self._next += 1
        return token.value

    def _expect_null(self) -> None:
        token = self._token
        if token.kind != "constant" or token.value not in {"null", "none"}:
            self._fail("expected 'null' after 'is'")
        self._next += 1

    def _list(self) -> list[Any]:
        self._expect("(")
        values = [self._literal()]
        while self._take(","):
            if self._token.value == ")":
                break
            values.append(self._literal())
        self._expect(")")
        return values

    def _operand(self) -> Operand:
        token = self._token
        if token.kind == "name":
            self._next += 1
            name = self._meant(token.value, token.position)
            self._named += 1
            if self._named > MAX_COLUMNS:
                self._fail(f"a condition may name columns {MAX_COLUMNS} times", token.position)
            return Name(name)
        return Literal(self._literal())

    def _meant(self, name: str, position: int) -> str:
        """Return the column that a name means: its whole name, or its last part where that is clear."""
        if name in self._columns:
            return name
        found = columns_ending_in(name, self._columns)
        if len(found) > 1:
            self._fail(f"{name!r} may be {', '.join(found[:6])}; write which", position)
        if not found:
            self._fail(f"unknown column {name!r}{self._hint(name)}", position)
        return found[0]

    def _hint(self, name: str) -> str:
        hint = suggestion(name, self._columns)
        return hint if hint.startswith("; did") else f"{hint}; a text stands in quotes"

    def _literal(self) -> Any:
        sign = self._take("-", "+")
        token = self._token
        self._literals += 1
        if self._literals > MAX_LITERALS:
            self._fail(f"a condition may hold {MAX_LITERALS} numbers and texts")
        match token.kind:
            case "number" if len(token.value) > MAX_DIGITS:
                self._fail(f"a number may have {MAX_DIGITS} digits, this one has {len(token.value)}")
            case "number":
                value: Any = float(token.value)
                value = int(token.value) if token.value.isdecimal() else value
                value = -value if sign == "-" else value
            case "text" if not sign:
                value = re.sub(r"\\(.)", r"\1", token.value[1:-1], flags=re.DOTALL)
            case "constant" if not sign:
                value = _CONSTANTS[token.value]
            case "name":
                self._fail(f"expected a number or a text in quotes, found the name {token.value!r}")
            case "end":
                self._fail("expected a column, a number or a text in quotes, found the end")
            case _:
                self._fail(f"expected a column, a number or a text in quotes, found {token.value!r}")
        self._next += 1
        return value


def _tokens(text: str) -> list[_Token]:
    tokens, position = [], 0
    end = len(text.rstrip())
    while position < end:
        match = _TOKEN.match(text, position)
        if match is None:
            start = position + len(text[position:]) - len(text[position:].lstrip())
            raise ExpressionError(text, start, _strange(text[start]))
        kind = str(match.lastgroup)
        value = match.group(kind)
        start = match.start(kind) - (kind == "quoted")
        if kind == "name" and value.lower() in _WORDS:
            kind, value = "word", value.lower()
        elif kind == "name" and value.lower() in _CONSTANTS:
            kind, value = "constant", value.lower()
        tokens.append(_Token("name" if kind == "quoted" else kind, value, start))
        position = match.end()
    return [*tokens, _Token("end", "", len(text))]


def _strange(character: str) -> str:
    if character in "'\"`":
        return f"the quote {character} is never closed"
    if character.isdigit():
        return "not a number; a column whose name begins with a digit or holds signs stands in `backquotes`"
    return f"unexpected {character!r}; a column whose name holds other signs stands in `backquotes`"
