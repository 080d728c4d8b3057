# SPDX-License-Identifier: Apache-2.0
"""Digests of what an archive holds: equal ones mean that it holds the same, whenever that was written.

Rows are digested as the database has them: documents are not opened, so that 80,000 runs take some seconds.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sqlalchemy import select

from slamhive.archive import schema
from slamhive.archive.documents import all_raw

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from sqlalchemy import Connection, Table

_ROWS = 500
_SIZE = 16


@dataclass(frozen=True)
class ArchiveDigests:
    """Digests of an archive's content.

    Attributes:
        runs: of each run with its results, by UID, in the order of storing.
        folders: of the runs, as they are noted, by UID.
        rest: of sweeps and catalog.
    """

    runs: Mapping[str, str] = field(default_factory=dict)
    folders: Mapping[str, str | None] = field(default_factory=dict)
    rest: str = ""


def digests(connection: Connection) -> ArchiveDigests:
    """Return the digests of an archive, in a transaction that sees one state of it."""
    measured: dict[int, Any] = {}
    results = schema.results.c
    for row in _rows(connection, schema.results, results.run_id, results.evaluation):
        measured.setdefault(row.run_id, _hash()).update(_text(row))
    runs: dict[str, str] = {}
    folders: dict[str, str | None] = {}
    for row in _rows(connection, schema.runs, schema.runs.c.id):
        found = measured.get(row.id) or _hash()
        found.update(_text(row))
        runs[row.uid], folders[row.uid] = found.hexdigest(), row.folder
    rest = _hash()
    for table in (schema.sweeps, schema.algorithms, schema.datasets):
        for row in _rows(connection, table, *table.primary_key.columns):
            rest.update(table.name.encode() + _text(row))
    return ArchiveDigests(runs, folders, rest.hexdigest())


def _rows(connection: Connection, table: Table, *order: Any) -> Iterator[Any]:
    query = select(*all_raw(connection, table)).order_by(*order)
    return iter(connection.execute(query.execution_options(yield_per=_ROWS)))


def _hash() -> Any:
    return hashlib.blake2b(digest_size=_SIZE)


def _text(row: Any) -> bytes:
    return repr(tuple(row)).encode("utf-8", "surrogatepass")
