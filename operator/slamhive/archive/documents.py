# SPDX-License-Identifier: Apache-2.0
"""Documents of runs in the tables: what they have in common is written once, in ``shapes``.

Whoever writes rows of ``runs`` or ``results`` passes them through ``store``. Whoever reads rows of any table
asks for them as they are (``raw``) and has them opened (``opened``), by which it is known what is wrong with
each. ``tables.loading`` turns them into columns as they are.
"""

from __future__ import annotations

from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from typing import TYPE_CHECKING, Any

from sqlalchemy import DateTime, Float, String, Text, cast, func, select, type_coerce

from slamhive.analysis.compact.shapes import divide, is_divided, join, loads
from slamhive.archive import schema
from slamhive.archive.connection import insert_into

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from sqlalchemy import ColumnElement, Connection, Table

    from slamhive.analysis.compact.shapes import Shape

MOST_SHAPES = 5_000
"""Shapes of a document's kind from which on new ones are not written: what is never alike stays as it is."""

DOCUMENTS = {
    "runs": (
        *("spec", "attributes", "labels", "metrics", "usage", "frames", "trajectory", "provenance"),
        "evaluations",
    ),
    "results": ("values",),
}
"""Columns whose documents are divided, by table."""

DEEPEST = 100
"""Objects and lists in each other up to which a document is read."""

UNREADABLE = (ValueError, TypeError, AttributeError, LookupError, OverflowError, RecursionError)
"""Errors of reading what any program may have written into a row."""

_SOME = 500
_CONTAINERS = (dict, list)
_YEARS = range(1970, 9000)


def store(connection: Connection, *groups: tuple[str, Sequence[dict[str, Any]]]) -> None:
    """Put a shape's number and values in the place of documents, and write the shapes that are new.

    Args:
        connection: in a transaction that writes. Call it once in each, before any row is written: two writers
            of the same new shapes then wait for each other in one order.
        groups: tables' names and their rows, whose documents are replaced.
    """
    places: dict[Shape, list[tuple[dict[str, Any], str, list[Any]]]] = {}
    kinds: dict[Shape, str] = {}
    for table, rows in groups:
        for row in rows:
            for name in DOCUMENTS[table]:
                found = divide(name, row.get(name))
                if found is not None:
                    shape, own = found
                    places.setdefault(shape, []).append((row, name, own))
                    kinds.setdefault(shape, name)
    for shape in _written(connection, kinds):
        for row, name, own in places[shape]:
            row[name] = [shape.number, *own]


def raw(connection: Connection, column: ColumnElement[Any]) -> ColumnElement[Any]:
    """Return a column as the database holds it: documents as texts, times as SQLAlchemy has not read them."""
    served = connection.dialect.name == "postgresql"
    if isinstance(column.type, schema.JsonDocument):
        return (cast(column, Text) if served else type_coerce(column, Text)).label(column.name)
    if isinstance(column.type, schema.UtcDateTime):
        return type_coerce(column, DateTime if served else String).label(column.name)
    return column


def all_raw(connection: Connection, table: Table) -> list[ColumnElement[Any]]:
    """Return the columns of a table as the database holds them."""
    return [raw(connection, column) for column in table.columns]


def opened(
    connection: Connection,
    *groups: tuple[Table, Sequence[dict[str, Any]]],
    shapes: Mapping[int, Any] | None = None,
) -> list[list[Exception | None]]:
    """Put documents and times in the places of what rows hold, and return of each what is wrong with it.

    Args:
        connection: the database.
        groups: tables and rows of theirs, as ``raw`` has them, which are changed; columns that they don't
            have are no fault.
        shapes: those that are there; None to read what is needed.
    """
    wrong = [[_failure(_open, table, row) for row in rows] for table, rows in groups]
    divided = [
        (group, place, row, name)
        for group, (table, rows) in enumerate(groups)
        for place, row in enumerate(rows)
        if wrong[group][place] is None
        for name in DOCUMENTS.get(table.name, ())
        if is_divided(row.get(name))
    ]
    if shapes is None:
        shapes = read(connection, {row[name][0] for _, _, row, name in divided})
    for group, place, row, name in divided:
        wrong[group][place] = wrong[group][place] or _failure(_join, row, name, shapes)
    return wrong


def _failure(work: Any, *given: Any) -> Exception | None:
    try:
        work(*given)
    except UNREADABLE as error:
        return error
    return None


def _open(table: Table, row: dict[str, Any]) -> None:
    for name, wanted in kinds(table):
        value = row.get(name)
        if value is None:
            continue
        if wanted is None:
            row[name] = parsed(value, name)
        elif wanted is datetime:
            row[name] = _moment(value)
        elif not isinstance(value, wanted):
            raise TypeError(f"{name}: expected {wanted[0].__name__}, found {str(value)[:40]!r}")


@cache
def kinds(table: Table) -> list[tuple[str, Any]]:
    """Return the types of a table's values by column: a tuple of them, datetime, or None for documents."""
    return [
        (
            column.name,
            None
            if isinstance(column.type, schema.JsonDocument)
            else datetime
            if isinstance(column.type, schema.UtcDateTime)
            else (float, int)
            if isinstance(column.type, Float)
            else (column.type.python_type,),
        )
        for column in table.columns
    ]


def _moment(value: Any) -> datetime:
    found = datetime.fromisoformat(value) if isinstance(value, str) else value
    found = found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)
    if found.year not in _YEARS:
        raise ValueError(f"the time {found.isoformat()} is none of a run")
    return found


def _join(row: dict[str, Any], name: str, shapes: Mapping[int, Any]) -> None:
    row[name] = join(shapes, row[name])


def parsed(text: Any, name: str = "text") -> Any:
    """Return a document's value, or a shape's.

    Args:
        text: as the database holds it: SQLite takes anything.
        name: of its column.

    Raises:
        ValueError: it is no JSON, or nested too deeply.
    """
    try:
        found = loads(text if isinstance(text, str) else f"no text but {text!r}"[:40])
    except ValueError as error:
        raise ValueError(f"a document of it is no JSON: {name}: {error}") from None
    if isinstance(found, _CONTAINERS):
        require_shallow(found)
    return found


def require_shallow(value: Any, left: int = DEEPEST) -> None:
    """Check that objects and lists are not nested too deeply.

    Raises:
        ValueError: they are.
    """
    if not left:
        raise ValueError(f"a document is nested more than {DEEPEST} deep")
    for item in value.values() if type(value) is dict else value:
        if type(item) in _CONTAINERS:
            require_shallow(item, left - 1)


def read(connection: Connection, numbers: Iterable[int]) -> dict[int, Any]:
    """Return parsed shapes by their numbers, as far as they are there and can be read."""
    columns, wanted = schema.shapes.c, sorted(numbers)
    found: dict[int, Any] = {}
    for start in range(0, len(wanted), _SOME):
        query = select(columns.number, columns.text).where(columns.number.in_(wanted[start : start + _SOME]))
        found |= _readable(connection.execute(query))
    return found


def read_all(connection: Connection) -> dict[int, Any]:
    """Return all parsed shapes by their numbers, those left out that can't be read."""
    columns = schema.shapes.c
    return _readable(connection.execute(select(columns.number, columns.text)))


def _readable(rows: Iterable[Any]) -> dict[int, Any]:
    found: dict[int, Any] = {}
    for number, text in rows:
        with suppress(*UNREADABLE):
            found[number] = parsed(text)
    return found


def _written(connection: Connection, kinds: Mapping[Shape, str]) -> list[Shape]:
    """Return the shapes that are in the database, of which new ones are written now."""
    columns, wanted = schema.shapes.c, list(kinds)
    if not wanted:
        return []
    there = _texts(connection, wanted)
    new = sorted(shape for shape in wanted if shape.number not in there)
    if new:
        query = select(columns.kind, func.count()).group_by(columns.kind)
        room = {kind: MOST_SHAPES - count for kind, count in connection.execute(query)}
        rows = []
        for shape in new:
            kind = kinds[shape]
            room[kind] = room.get(kind, MOST_SHAPES) - 1
            if room[kind] >= 0:
                rows.append({"number": shape.number, "kind": kind, "text": shape.text})
        if rows:
            connection.execute(insert_into(connection.dialect, schema.shapes).on_conflict_do_nothing(), rows)
            there |= _texts(connection, new)
    # Two texts of one number are as good as impossible; the second one's documents are then kept as they are.
    return [shape for shape in wanted if there.get(shape.number) == shape.text]


def _texts(connection: Connection, shapes: Sequence[Shape]) -> dict[int, str]:
    columns = schema.shapes.c
    found: dict[int, str] = {}
    for start in range(0, len(shapes), _SOME):
        numbers = [shape.number for shape in shapes[start : start + _SOME]]
        rows = connection.execute(select(columns.number, columns.text).where(columns.number.in_(numbers)))
        found |= {row.number: row.text for row in rows}
    return found
