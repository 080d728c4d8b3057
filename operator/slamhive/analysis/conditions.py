# SPDX-License-Identifier: Apache-2.0
"""Conditions as trees, tried on all rows of a table at once."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from slamhive.analysis.columns import Column, ColumnKind
from slamhive.model.results import TAG_SEPARATOR

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.analysis.columns import Mask
    from slamhive.analysis.frame import Frame

ORDERS: dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_TURNED = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "=="}


class Node(Protocol):
    """A condition or a part of one."""

    def mask(self, frame: Frame) -> Mask:
        """Tell for each row of a table whether it meets it, (n,)."""


class Operand(Protocol):
    """One side of a comparison."""

    def column(self, frame: Frame) -> Column | None:
        """Return its values in all rows; None for a literal."""


@dataclass(frozen=True)
class Name:
    """A column."""

    name: str

    def column(self, frame: Frame) -> Column:
        """Return the table's column."""
        return frame.column(self.name)


@dataclass(frozen=True)
class Literal:
    """A number, text, true, false or null."""

    literal: Any

    def column(self, frame: Frame) -> None:
        """Return None: it has none."""


@dataclass(frozen=True)
class AnyOf:
    """At least one of several."""

    parts: tuple[Node, ...]

    def mask(self, frame: Frame) -> Mask:
        """Tell for each row."""
        return reduce(np.logical_or, (part.mask(frame) for part in self.parts))


@dataclass(frozen=True)
class All:
    """Each of several."""

    parts: tuple[Node, ...]

    def mask(self, frame: Frame) -> Mask:
        """Tell for each row."""
        return reduce(np.logical_and, (part.mask(frame) for part in self.parts))


@dataclass(frozen=True)
class Negation:
    """The opposite."""

    part: Node

    def mask(self, frame: Frame) -> Mask:
        """Tell for each row."""
        return ~self.part.mask(frame)


@dataclass(frozen=True)
class Truth:
    """A value that is neither missing, false, 0 nor empty."""

    operand: Operand

    def mask(self, frame: Frame) -> Mask:
        """Tell for each row."""
        return _by_value(self.operand, frame, bool)


@dataclass(frozen=True)
class NullTest:
    """Condition that a value is missing, or that it is there if ``wanted`` is false."""

    operand: Operand
    wanted: bool

    def mask(self, frame: Frame) -> Mask:
        """Tell for each row."""
        return _by_value(self.operand, frame, lambda value: (value is None) == self.wanted)


@dataclass(frozen=True)
class Membership:
    """Condition that a value equals one of several, or none of them if ``negated``."""

    operand: Operand
    values: tuple[Any, ...]
    negated: bool

    def mask(self, frame: Frame) -> Mask:
        """Tell for each row."""
        column = self.operand.column(frame)
        # A column may have as many texts as rows, names of runs: where no number is asked for they are looked
        # up as they are.
        if column is not None and column.kind is ColumnKind.TEXT and not self._numbers:
            return column.among(self.values) ^ self.negated
        return _by_value(self.operand, frame, self._holds) ^ self.negated

    def _holds(self, found: Any) -> bool:
        """Tell whether a value is equal to one of them, as `equal` means it, at the cost of a look-up."""
        if isinstance(found, str):
            return found in self._texts or _as_number(found) in self._numbers
        if isinstance(found, int | float):
            return found in self._numbers or found in self._text_numbers
        return found is None and None in self.values

    @cached_property
    def _texts(self) -> frozenset[str]:
        return frozenset(value for value in self.values if isinstance(value, str))

    @cached_property
    def _numbers(self) -> frozenset[float]:
        return frozenset(value for value in self.values if isinstance(value, int | float))

    @cached_property
    def _text_numbers(self) -> frozenset[float | str]:
        return frozenset(map(_as_number, self._texts))


@dataclass(frozen=True)
class Holding:
    """Condition that a text holds another in any spelling of its letters; tags hold whole ones."""

    operand: Operand
    text: str
    negated: bool

    def mask(self, frame: Frame) -> Mask:
        """Tell for each row."""
        of_tags = isinstance(self.operand, Name) and self.operand.name == "tags"
        wanted = self.text.casefold()

        def holds(found: Any) -> bool:
            if found is None:
                return False
            text = str(found).casefold()
            return wanted in (text.split(TAG_SEPARATOR) if of_tags else text)

        return _by_value(self.operand, frame, holds) ^ self.negated


@dataclass(frozen=True)
class Comparison:
    """``==`` or an order between two operands."""

    symbol: str
    left: Operand
    right: Operand

    def mask(self, frame: Frame) -> Mask:
        """Tell for each row."""
        left, right = self.left.column(frame), self.right.column(frame)
        if left is None and right is None:
            return np.full(len(frame), _compare(self.symbol, _literal(self.left), _literal(self.right)))
        if left is None or right is None:
            operand, other = (self.right, self.left) if left is None else (self.left, self.right)
            symbol = _TURNED[self.symbol] if left is None else self.symbol
            literal = _literal(other)
            column = right if left is None else left
            if column is not None and _is_plain(column) and _is_number(literal):
                return _compare_numbers(symbol, column.numbers, np.float64(literal))
            return _by_value(operand, frame, lambda value: _compare(symbol, value, literal))
        if _is_plain(left) and _is_plain(right):
            same = _compare_numbers(self.symbol, left.numbers, right.numbers)
            return same | ~(left.present | right.present) if self.symbol == "==" else same
        pairs = zip(left.tolist(), right.tolist(), strict=True)
        return np.array([_compare(self.symbol, *pair) for pair in pairs], dtype=bool)


def _literal(operand: Operand) -> Any:
    return operand.literal if isinstance(operand, Literal) else None


def equal(left: Any, right: Any) -> bool:
    """Tell whether two values mean the same; a text is read as a number where it meets one."""
    left, right = _alike(left, right)
    return bool(left == right)


def _is_plain(column: Column) -> bool:
    return column.kind.is_numeric and column.kind is not ColumnKind.TIME


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and abs(value) < 2**53


def _compare_numbers(symbol: str, left: Any, right: Any) -> Mask:
    compare: Callable[[Any, Any], Any] = ORDERS.get(symbol, operator.eq)
    with np.errstate(invalid="ignore"):
        found: Mask = compare(left, right)
    return found


def _by_value(operand: Operand, frame: Frame, test: Callable[[Any], bool]) -> Mask:
    """Try each distinct value once."""
    column = operand.column(frame)
    if column is None:
        return np.full(len(frame), test(_literal(operand)))
    if column.kind.is_numeric:
        codes, values = column.factorized()
        return np.array([test(value) for value in values], dtype=bool)[codes]
    verdicts = [test(value) for value in column.values]
    return column.having(np.array([*verdicts, test(None)], dtype=bool))


def _compare(symbol: str, left: Any, right: Any) -> bool:
    if symbol == "==":
        return equal(left, right)
    if left is None or right is None:
        return False
    left, right = _alike(left, right)
    try:
        return bool(ORDERS[symbol](left, right))
    except TypeError:
        return False


def _alike(left: Any, right: Any) -> tuple[Any, Any]:
    """Read a text as a number where it meets one."""
    if isinstance(left, str) and isinstance(right, int | float):
        return _as_number(left), right
    if isinstance(right, str) and isinstance(left, int | float):
        return left, _as_number(right)
    return left, right


def _as_number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text
