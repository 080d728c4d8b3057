# SPDX-License-Identifier: Apache-2.0
"""Documents of runs in the tables: what they have in common is written once, in ``shapes``.

Whoever writes rows of ``runs`` or ``results`` passes them through ``store``, whoever reads them through
``whole``; ``tables.loading`` turns them into columns as they are.
"""

from __future__ import annotations

import json
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from sqlalchemy import func, select

from slamhive.analysis.shapes import divide, is_divided, join
from slamhive.archive import schema
from slamhive.archive.connection import insert_into

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from sqlalchemy import Connection

    from slamhive.analysis.shapes import Shape

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

_SOME = 500


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


def whole(connection: Connection, *groups: tuple[str, Sequence[dict[str, Any]]]) -> None:
    """Put documents in the places of what rows hold of them.

    Args:
        connection: the database.
        groups: tables' names and their rows, which are changed; columns that they don't have are no fault.

    Raises:
        MissingShapeError: a shape is not there.
    """
    divided = [
        (row, name, held)
        for table, rows in groups
        for row in rows
        for name in DOCUMENTS[table]
        if (held := row.get(name)) is not None and is_divided(held)
    ]
    shapes = read(connection, {held[0] for _, _, held in divided})
    for row, name, held in divided:
        row[name] = join(shapes, held)


def read(connection: Connection, numbers: Iterable[int]) -> dict[int, Any]:
    """Return parsed shapes by their numbers, as far as they are there."""
    columns, wanted = schema.shapes.c, sorted(numbers)
    found: dict[int, Any] = {}
    for start in range(0, len(wanted), _SOME):
        query = select(columns.number, columns.text).where(columns.number.in_(wanted[start : start + _SOME]))
        found |= {number: json.loads(text) for number, text in connection.execute(query)}
    return found


def read_all(connection: Connection) -> dict[int, Any]:
    """Return all parsed shapes by their numbers; what is no JSON is left out."""
    columns = schema.shapes.c
    found: dict[int, Any] = {}
    for number, text in connection.execute(select(columns.number, columns.text)):
        with suppress(ValueError):
            found[number] = json.loads(text)
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
