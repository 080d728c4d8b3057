# SPDX-License-Identifier: Apache-2.0
"""Documents of runs without what others have too: a shape, and the values that are a run's own.

The archive keeps each shape once, and of a run its values alone. Tables are made of both: documents of one
shape are columns already.

::

    {"cpu": {"seconds": 61.5}, "source": "cgroup"}      a document
    {"cpu": {"seconds": 0}, "source": "cgroup"}         its shape; 0 stands for a value of the run's own
    [93710245571, 61.5]                                 what a row holds: the shape's number, the values
"""

from __future__ import annotations

import hashlib
import json
import math
from itertools import islice
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple

try:
    from orjson import loads as loads  # noqa: PLC0414 - others take it from here
except ModuleNotFoundError:  # the extra is not installed: slower, the same

    def loads(text: str | bytes) -> Any:  # type: ignore[misc]
        """Return a JSON value, as orjson does: no NaN, no infinity, no half of a character.

        Raises:
            ValueError: it is none.
        """
        found = json.loads(text, parse_constant=_finite, parse_float=_finite, parse_int=_integer)
        if (b"\\u" if isinstance(text, bytes) else "\\u") in text:  # type: ignore[operator]
            json.dumps(found, ensure_ascii=False).encode()
        return found


if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

SHORT = 16
"""Characters of a document up to which it is kept as it is."""

MOST_ITEMS = 16
"""Records in a list up to which each of them is a part of the shape."""

_OWN = frozenset(
    {"contentHash", "specHash", "reusedFrom", "sha256", "node", "processors", "suspect", "message", "notes"}
)
_OWN_BELOW = frozenset({"parameters", "metrics"})
_NUMBER_BYTES = 5
_DIGITS = 19


class Shape(NamedTuple):
    """Common part of documents.

    Attributes:
        number: 40 bits of its text's SHA-256; the same in every archive.
        text: as JSON.
    """

    number: int
    text: str

    @classmethod
    def of(cls, text: str) -> Shape:
        """Return the shape of a text."""
        digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).digest()
        return cls(int.from_bytes(digest[:_NUMBER_BYTES], "big"), text)


class MissingShapeError(ValueError):
    """A document names a shape that is not there, or does not fit it."""


def divide(kind: str, document: Any) -> tuple[Shape, list[Any]] | None:
    """Return a document's shape and its own values, in the order of the document.

    Args:
        kind: which document of a run it is, such as ``usage``.
        document: a JSON value.

    Returns:
        None where it is better kept as it is: it is short, or neither an object nor a list of objects.
    """
    if not document or not (isinstance(document, dict) or _is_records(document)):
        return None
    own: list[Any] = []
    shape = json.dumps(_shape(document, own, kind in _OWN_BELOW), separators=(",", ":"))
    return None if len(shape) <= SHORT else (Shape.of(shape), own)


def join(shapes: Mapping[int, Any], held: Any) -> Any:
    """Return the document that a row holds.

    Args:
        shapes: parsed shapes by their numbers.
        held: what the row holds: a document as it is, or a shape's number and values.

    Raises:
        MissingShapeError: the shape is not there, or has another number of values.
    """
    if not is_divided(held):
        return held
    values = iter(held)
    number = next(values)
    try:
        document = _joined(shapes[number], values)
    except (KeyError, StopIteration):
        raise MissingShapeError(f"a document needs shape {number}, which is missing") from None
    if next(values, values) is not values:
        raise MissingShapeError(f"a document has more values than its shape {number}")
    return document


def is_divided(held: Any) -> bool:
    """Tell whether a row holds a shape's number and values in the place of a document."""
    return (
        type(held) is list and bool(held) and type(held[0]) is int and 0 <= held[0] < 1 << 8 * _NUMBER_BYTES
    )


class Names(NamedTuple):
    """The names that the values of a shape have in a table.

    Attributes:
        own: of the values of a run's own, in their order; None: it has no column.
        common: the others', with the values.
    """

    own: tuple[str | None, ...]
    common: dict[str, Any]


class Constant(NamedTuple):
    """The same value in all of some rows.

    Attributes:
        value: the value.
    """

    value: Any


def names_of(shape: Any) -> Names:
    """Return the names of a parsed shape's values: nested ones joined by dots, items of lists numbered."""
    own: list[str | None] = []
    common: dict[str, Any] = {}
    _name(shape, "", own, common)
    return Names(tuple(own), common)


def _is_records(value: Any) -> bool:
    return (
        isinstance(value, list)
        and 0 < len(value) <= MOST_ITEMS
        and all(isinstance(item, dict) for item in value)
    )


def _shape(value: Any, own: list[Any], below: bool) -> Any:
    if isinstance(value, dict):
        found = {}
        for key, item in value.items():
            if key in _OWN and not isinstance(item, dict):
                own.append(item)
                found[key] = 0
            else:
                found[key] = _shape(item, own, below or key in _OWN_BELOW)
        return found
    if _is_records(value):
        return [_shape(item, own, below) for item in value]
    if value == {} or (not below and (value is None or isinstance(value, str | bool))):
        return value
    own.append(value)
    return 0


def _joined(shape: Any, values: Iterator[Any]) -> Any:
    if type(shape) is int:
        return next(values)
    if type(shape) is dict:
        found = {}
        for key, item in shape.items():
            found[key] = _joined(item, values)
        return found
    if type(shape) is list:
        return [_joined(item, values) for item in shape]
    return shape


def _name(shape: Any, name: str, own: list[str | None], common: dict[str, Any]) -> None:
    if type(shape) is int:
        own.append(name)
    elif isinstance(shape, dict):
        for key, item in shape.items():
            _name(item, f"{name}.{key}" if name else key, own, common)
    elif isinstance(shape, list):
        for number, item in enumerate(islice(shape, MOST_ITEMS)):
            _name(item, f"{name}[{number}]", own, common)
    elif shape is not None:
        common[name] = shape


def turned(
    held: Sequence[Any], shapes: Mapping[int, Names]
) -> Iterator[tuple[list[int] | None, dict[str, Sequence[Any] | Constant]]]:
    """Turn divided documents round: yield the values of those that have the same names, by name.

    Args:
        held: what rows hold, each a shape's number and values.
        shapes: names of the shapes by number.

    Yields:
        The places of the rows, None for all, and their values by name.

    Raises:
        MissingShapeError: a shape is not there, or has another number of values.
    """
    groups: dict[tuple[str | None, ...], list[int]] = {}
    numbers = list(map(itemgetter(0), held))
    try:
        layouts = {number: shapes[number].own for number in set(numbers)}
    except KeyError as error:
        raise MissingShapeError(f"a document needs shape {error}, which is missing") from None
    if len(set(layouts.values())) == 1:
        yield None, _columns(held, numbers, shapes)
        return
    for place, number in enumerate(numbers):
        groups.setdefault(layouts[number], []).append(place)
    for places in sorted(groups.values(), key=len, reverse=True):
        yield (
            places,
            _columns([held[place] for place in places], [numbers[place] for place in places], shapes),
        )


def _columns(
    held: Sequence[Sequence[Any]], numbers: Sequence[int], shapes: Mapping[int, Names]
) -> dict[str, Sequence[Any] | Constant]:
    used = {number: shapes[number] for number in set(numbers)}
    layout = used[numbers[0]].own
    try:
        values = list(zip(*held, strict=True))[1:]
        found: dict[str, Sequence[Any] | Constant] = {
            name: column for name, column in zip(layout, values, strict=True) if name is not None
        }
    except ValueError:
        raise MissingShapeError("a document has another number of values than its shape") from None
    for name in dict.fromkeys(name for one in used.values() for name in one.common):
        by_shape = {number: one.common.get(name) for number, one in used.items()}
        different = set(by_shape.values())
        found[name] = (
            Constant(different.pop()) if len(different) == 1 else [by_shape[number] for number in numbers]
        )
    return found


def _finite(text: str) -> float:
    found = float(text)
    if not math.isfinite(found):
        raise ValueError(f"{text[:20]} is no number of JSON's")
    return found


def _integer(text: str) -> int | float:
    return int(text) if len(text) <= _DIGITS else _finite(text)
