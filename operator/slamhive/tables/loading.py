# SPDX-License-Identifier: Apache-2.0
"""The archive as a table of columns, kept up to date by reading again only what changed.

The archive has no word for "changed since": so a look compares the short columns of all rows with those of
the last look, and reads the documents of those runs that differ. In a large archive that takes long: between
two such looks, others find the runs alone that were stored since. A look is only taken when the database says
that anything at all was written.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from sqlalchemy import select, text

from slamhive.analysis.columns import Column
from slamhive.analysis.derived import SweepVersion, with_derived
from slamhive.analysis.flattening import MAX_COLUMNS, bound, stack
from slamhive.analysis.frame import Frame
from slamhive.archive import schema
from slamhive.archive.connection import reading
from slamhive.archive.documents import raw
from slamhive.archive.rows import read_rows
from slamhive.contract.heap import return_memory
from slamhive.model.search import choosing_method
from slamhive.tables.batches import CHANGES, RESULT_CHANGES, BatchReader
from slamhive.tables.helping import read_all
from slamhive.tables.marks import RunMarks
from slamhive.tables.snapshots import Loaded, derived
from slamhive.tables.uncollected import uncollected

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sqlalchemy import Connection, Engine, Select

    from slamhive.analysis.flattening import Part
    from slamhive.model.leftout import LeftOut

_STREAMED = 10_000


def change_mark(engine: Engine, held: Connection) -> object:
    """Return a value that differs after anything was written to the database, at next to no cost.

    Args:
        engine: the database.
        held: a connection that is kept for this: SQLite counts what others wrote since it was opened.
    """
    if engine.dialect.name == "postgresql":
        with reading(engine) as connection:
            return connection.execute(text("SELECT pg_current_snapshot()::text")).scalar()
    mark = held.exec_driver_sql("PRAGMA data_version").scalar()
    held.rollback()  # inside a transaction nothing new would ever be seen
    return mark


def load(
    engine: Engine, before: Loaded | None = None, stamp: tuple[int, ...] | None = None, *, newer: bool = False
) -> Loaded:
    """Return the archive as it is now.

    Args:
        engine: the database.
        before: an earlier moment: what has not changed since is taken from there.
        stamp: what the database's files looked like before it was connected to: where that is as it was,
            runs are not looked through for changes.
        newer: whether to read the runs alone that were stored since: all others stay as they were, until they
            are looked through again.

    Raises:
        SystemFault: the database doesn't answer.
    """
    before = before or Loaded()
    with reading(engine) as connection, uncollected():
        known = before.marks
        same = stamp is not None and stamp == before.stamp
        seen = known if newer else RunMarks.joined([])
        marks = known if same else _marks(connection, seen) if len(known) else None
        sweeps, odd = _sweeps(connection)
        declared, more = _declared(connection)
        odd += more
        if marks is not None and marks.same_as(known):
            found_now = before if sweeps == before.sweeps else derived(before, sweeps)
            runs = [one for one in before.left_out if one.number is not None]
            if declared != found_now.frame.declared:
                found_now = replace(found_now, frame=found_now.frame.declaring(declared))
            return replace(found_now, stamp=stamp, left_out=(*runs, *odd))
        changed = None if marks is None else marks.changed_since(known)
        reader = BatchReader(connection)
        batches = read_all(connection, reader) if changed is None else list(reader.some(changed))
    found = RunMarks.joined([one.marks for one in batches]) if marks is None else marks
    stays = np.empty(0) if changed is None else np.setdiff1d(found.ids, changed)
    runs = [one for one in before.left_out if one.number in stays]
    runs += [one for batch in batches for one in batch.left_out]
    frame = _merge(before.frame, stays, [one.part for one in batches], sweeps).declaring(declared)
    del batches
    return_memory()
    return Loaded(frame, found, sweeps, stamp, (*runs, *odd))


def _sweeps(connection: Connection) -> tuple[tuple[SweepVersion, ...], list[LeftOut]]:
    columns = schema.sweeps.c
    query = select(
        columns.uid, columns.name, columns.cluster, columns.namespace, columns.created, columns.spec
    )
    found, left_out = read_rows(connection, query.order_by(columns.uid), schema.sweeps, _version)
    return tuple(found), left_out


def _version(row: dict[str, Any]) -> SweepVersion:
    created, search = row["created"], choosing_method(row.pop("spec"))
    return SweepVersion(**{**row, "created": created and created.timestamp(), "search": search})


def _declared(connection: Connection) -> tuple[dict[str, dict[str, str]], list[LeftOut]]:
    """Return the units of the parameters' columns by algorithm, as its latest manifest says them."""
    columns = schema.algorithms.c
    query = select(columns.name, columns.spec).order_by(columns.stored, columns.content_hash)
    found, left_out = read_rows(
        connection,
        query,
        schema.algorithms,
        lambda row: (
            row["name"],
            {
                f"parameters.{key}": str(one.get("unit") or "")
                for key, one in (row["spec"].get("parameters") or {}).items()
            },
        ),
    )
    return dict(found), left_out


def _marks(connection: Connection, seen: RunMarks) -> RunMarks:
    """Return a short mark of each run's look: those seen as they were, and those of the runs behind them."""
    last = int(seen.ids[-1]) if len(seen) else -1
    runs, results = schema.runs.c, schema.results.c
    asked_for = [raw(connection, runs[name]) for name in ("id", *CHANGES)]
    query = select(*asked_for).where(runs.id > last).order_by(runs.id)
    found = RunMarks.joined([seen, *(RunMarks.of(part, ()) for part in _streamed(connection, query))])
    measured = select(*(results[name] for name in RESULT_CHANGES)).where(results.run_id > last)
    for part in _streamed(connection, measured):
        found = found.with_results(part)
    return found


def _streamed(connection: Connection, query: Select[Any]) -> Iterator[list[Column]]:
    for rows in connection.execute(query.execution_options(yield_per=_STREAMED)).partitions():
        yield [Column.of(values) for values in zip(*rows, strict=True)]


def _merge(before: Frame, stays: Any, fresh: list[Part], sweeps: tuple[SweepVersion, ...]) -> Frame:
    """Return the rows that stay, by the ids of their runs, with fresh ones."""
    parts = list(fresh)
    if len(before):
        inside = np.isin(before.column("id").numbers, stays)
        kept = before if inside.all() else before.select(inside)
        parts.insert(0, ({name: kept.column(name) for name in kept.stored}, len(kept)))
    bound(parts, before.stored, MAX_COLUMNS)
    columns, length = stack([part for part in parts if part[1]])
    if not length:
        return Frame({}, 0)
    ids = columns["id"].numbers
    if not (ids[1:] >= ids[:-1]).all():
        order = np.argsort(ids, kind="stable")
        columns = {name: column.take(order) for name, column in columns.items()}
    return with_derived(columns, length, sweeps)
