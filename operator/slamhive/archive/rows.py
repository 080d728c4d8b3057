# SPDX-License-Identifier: Apache-2.0
"""Rows of the archive as records; those that can't be read are left out, and named."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from pydantic import ValidationError
from sqlalchemy import select

from slamhive.archive import documents, schema
from slamhive.archive.documents import UNREADABLE
from slamhive.archive.records import to_record, to_result
from slamhive.model.base import explain
from slamhive.model.leftout import LeftOut

if TYPE_CHECKING:
    from collections.abc import Callable

    from sqlalchemy import Connection, Select, Table

    from slamhive.model.results import Result, RunRecord

_SHOWN = 100
_NAMES = {
    "runs": ("run", "uid"),
    "sweeps": ("sweep", "name"),
    "algorithms": ("Algorithm", "name"),
    "datasets": ("Dataset", "name"),
}
Item = TypeVar("Item")


class RunRows(NamedTuple):
    """Some rows of ``runs`` in their order.

    Attributes:
        met: their number.
        last: id of the last one, 0 where there is none.
        records: of those that can be read.
        left_out: the others.
    """

    met: int
    last: int
    records: list[RunRecord]
    left_out: list[LeftOut]


def read_runs(connection: Connection, query: Select[Any]) -> RunRows:
    """Read runs with their results; one of which a result can't be read is left out as a whole.

    Args:
        connection: the database.
        query: chooses rows of ``runs``; its columns are of no account.
    """
    runs, measures = schema.runs, schema.results
    chosen = query.with_only_columns(*documents.all_raw(connection, runs))
    rows = [dict(row) for row in connection.execute(chosen).mappings()]
    wanted = select(*documents.all_raw(connection, measures)).where(
        measures.c.run_id.in_([row["id"] for row in rows])
    )
    ordered = wanted.order_by(measures.c.run_id, measures.c.evaluation)
    measured = [dict(row) for row in connection.execute(ordered).mappings()]
    wrong_results, wrong_runs = documents.opened(connection, (measures, measured), (runs, rows))
    results: dict[int, list[Result]] = {}
    failed: dict[int, Exception] = {}
    for row, wrong in zip(measured, wrong_results, strict=True):
        try:
            results.setdefault(row["run_id"], []).append(_sound(to_result, row, wrong))
        except UNREADABLE as error:
            failed[row["run_id"]] = error
    found = RunRows(len(rows), rows[-1]["id"] if rows else 0, [], [])
    for row, wrong in zip(rows, wrong_runs, strict=True):
        number = row["id"]
        try:
            record = _sound(lambda row: to_record(row, results.get(row["id"], [])), row, wrong)
            if number in failed:
                raise failed[number]
            found.records.append(record)
        except UNREADABLE as error:
            texts = (
                row[name] if isinstance(row[name], str) else None for name in ("uid", "folder", "dataset")
            )
            found.left_out.append(LeftOut(f"run {_shown(row['uid'])}", why(error), number, *texts))
    return found


def read_rows(
    connection: Connection, query: Select[Any], table: Table, make: Callable[[dict[str, Any]], Item]
) -> tuple[list[Item], list[LeftOut]]:
    """Read rows of a table.

    Args:
        connection: the database.
        query: chooses rows and columns of a table, among them the one that names a row.
        table: whose rows they are.
        make: makes of a row what is returned.

    Returns:
        What was made, and the rows that were left out.
    """
    columns = [documents.raw(connection, column) for column in query.selected_columns]
    asked = connection.execute(query.with_only_columns(*columns)).mappings()
    rows, (what, name) = [dict(row) for row in asked], _NAMES[table.name]
    found: list[Item] = []
    left_out: list[LeftOut] = []
    for row, wrong in zip(rows, *documents.opened(connection, (table, rows)), strict=True):
        try:
            found.append(_sound(make, row, wrong))
        except UNREADABLE as error:
            left_out.append(LeftOut(f"{what} {_shown(row[name])}", why(error)))
    return found, left_out


def why(error: Exception) -> str:
    """Return the fault of a row, as part of a sentence."""
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        return f"{'.'.join(map(str, first['loc']))}: {explain(first)}"[: 2 * _SHOWN]
    return (str(error) if isinstance(error, ValueError | TypeError) else repr(error))[: 2 * _SHOWN]


def _sound(make: Callable[[dict[str, Any]], Item], row: dict[str, Any], wrong: Exception | None) -> Item:
    if wrong is not None:
        raise wrong
    return make(row)


def _shown(name: object) -> str:
    return repr(name if isinstance(name, str) else str(name))[:_SHOWN]
