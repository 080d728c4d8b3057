# SPDX-License-Identifier: Apache-2.0
"""The archive as a table of columns, kept up to date by reading again only what changed.

The archive has no word for "changed since": so each look compares the short columns of all rows with those
of the last look, and reads the documents of those runs that differ. A look is only taken when the database
says that anything at all was written.

Runs that can't be read are left out, and named: those of which `archive.rows` can make no record. Rows are
only looked through for them where some can't be made columns of, or hold something of another type.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from sqlalchemy import func, select, text

from slamhive.analysis.columns import Column, ColumnKind
from slamhive.analysis.compact.shapes import is_divided, join, loads, names_of
from slamhive.analysis.derived import SweepVersion, with_derived
from slamhive.analysis.flattening import (
    LEFT_OUT,
    MAX_COLUMNS,
    OF_RUN,
    TIMES,
    Results,
    Spread,
    bound,
    columns_of_runs,
    stack,
)
from slamhive.analysis.frame import Frame
from slamhive.archive import documents, schema
from slamhive.archive.connection import reading, shown
from slamhive.archive.documents import UNREADABLE, raw
from slamhive.archive.rows import read_rows, read_runs, why
from slamhive.model.errors import InputError
from slamhive.model.results import Outcome, Phase
from slamhive.model.search import choosing_method
from slamhive.tables.marks import RunMarks
from slamhive.tables.snapshots import Loaded, derived
from slamhive.tables.uncollected import uncollected

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from collections.abc import Set as AbstractSet

    from sqlalchemy import Connection, Engine, Row, Select

    from slamhive.analysis.compact.shapes import Names
    from slamhive.analysis.flattening import Part
    from slamhive.model.leftout import LeftOut
    from slamhive.tables.marks import Ids

BATCH = 2000
"""Runs read at a time: their documents are what loading needs memory for."""

LEAST_HELPED = 10
"""Batches from which on another process helps: it takes half a second to begin."""

_SOME = 500
_SAMPLE = 64
_STREAMED = 10_000
_CHANGES = (
    *("phase", "reason", "attempts", "sweep", "sweep_uid", "finished", "cpu_seconds", "wall_seconds"),
    *("cluster", "dataset", "note", "tags", "evaluations"),
)
_RESULT_CHANGES = (
    *("run_id", "evaluation", "outcome", "coverage", "alignment", "ate_rmse", "rpe_rmse", "scale"),
)
_RUN = ("id", *_CHANGES[:-1], *(name for name in OF_RUN.values() if name not in {"id", *_CHANGES}))
_AS_THEY_ARE = frozenset({"labels", "evaluations"})
_AS_COLUMNS = frozenset(_RUN) - {"id", *TIMES} | {"alignment", "scale", "ate_rmse", "rpe_rmse"}
_TYPES: dict[ColumnKind, set[type]] = {
    ColumnKind.INTEGER: {int},
    ColumnKind.NUMBER: {float},
    ColumnKind.BOOLEAN: {bool},
}
_MAY_BE_MISSING = frozenset({"usage", "frames", "trajectory"})
_NONE = type(None)
_WRITTEN = "1970", "9"
_MOMENTS = datetime(1970, 1, 1), datetime(9000, 1, 1)  # noqa: DTZ001 - as the database has them
_DOCUMENTS = (
    *("spec", "attributes", "labels", "metrics", "usage", "frames", "trajectory", "provenance"),
    "evaluations",
)


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


def load(engine: Engine, before: Loaded | None = None, stamp: tuple[int, ...] | None = None) -> Loaded:
    """Return the archive as it is now.

    Args:
        engine: the database.
        before: an earlier moment: what has not changed since is taken from there.
        stamp: what the database's files looked like before it was connected to: where that is as it was,
            runs are not looked through for changes.

    Raises:
        SystemFault: the database doesn't answer.
    """
    before = before or Loaded()
    with reading(engine) as connection, uncollected():
        known = before.marks
        same = stamp is not None and stamp == before.stamp
        marks = known if same else _marks(connection) if len(known) else None
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
        batches = list(reader.all() if changed is None else reader.some(changed))
    found = RunMarks.joined([one.marks for one in batches]) if marks is None else marks
    stays = np.empty(0) if changed is None else np.setdiff1d(found.ids, changed)
    runs = [one for one in before.left_out if one.number in stays]
    runs += [one for batch in batches for one in batch.left_out]
    frame = _merge(before.frame, stays, [one.part for one in batches], sweeps).declaring(declared)
    return Loaded(frame, found, sweeps, stamp, (*runs, *odd))


def _sweeps(connection: Connection) -> tuple[tuple[SweepVersion, ...], list[LeftOut]]:
    columns = schema.sweeps.c
    query = select(
        columns.uid, columns.name, columns.cluster, columns.namespace, columns.created, columns.spec
    )
    found, left_out = read_rows(
        connection,
        query.order_by(columns.uid),
        schema.sweeps,
        _version,
    )
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


def _marks(connection: Connection) -> RunMarks:
    """Return a short mark of each run's look."""
    runs, results = schema.runs.c, schema.results.c
    asked_for = [raw(connection, runs[name]) for name in ("id", *_CHANGES)]
    query = select(*asked_for).order_by(runs.id)
    found = RunMarks.joined([RunMarks.of(part, ()) for part in _streamed(connection, query)])
    for part in _streamed(connection, select(*(results[name] for name in _RESULT_CHANGES))):
        found = found.with_results(part)
    return found


def _streamed(connection: Connection, query: Select[Any]) -> Iterator[list[Column]]:
    for rows in connection.execute(query.execution_options(yield_per=_STREAMED)).partitions():
        yield [Column.of(values) for values in zip(*rows, strict=True)]


class RunBatch(NamedTuple):
    """Rows of some runs, as columns.

    Attributes:
        part: their rows.
        marks: of the runs.
        left_out: those that can't be read.
    """

    part: Part
    marks: RunMarks
    left_out: list[LeftOut]


class BatchReader:
    """Reads runs of an archive some at a time.

    Args:
        connection: the database.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._shapes = _Shapes()
        self._runs = schema.runs.c
        names = (*_RUN, *_DOCUMENTS)
        self._query = select(*(raw(connection, self._runs[name]) for name in names)).order_by(self._runs.id)

    def all(self) -> list[RunBatch]:
        """Return all runs; of large archives with the help of another process."""
        ends = self._ends()
        pieces = [(first, behind - 1) for first, behind in pairwise(ends)]
        if len(pieces) < LEAST_HELPED or len(os.sched_getaffinity(0)) < 2:
            return [self.between(*piece) for piece in pieces]
        from slamhive.tables.helping import ReadingHelper  # noqa: PLC0415 - which reads by this module

        found: dict[int, RunBatch] = {}
        with ReadingHelper(self._connection.engine.url.render_as_string(hide_password=False)) as helper:
            while len(found) + len(helper.asked) < len(pieces):
                place = len(found) + len(helper.asked)
                if len(helper.asked) < helper.AHEAD:
                    helper.ask(place, *pieces[place])
                elif helper.is_ready():
                    found.update(helper.answers(self.between, pieces, 1))
                else:
                    found[place] = self.between(*pieces[place])
            found.update(helper.answers(self.between, pieces, len(helper.asked)))
        return [found[place] for place in range(len(pieces))]

    def some(self, ids: Ids) -> Iterator[RunBatch]:
        """Go through some runs."""
        for start in range(0, len(ids), _SOME):
            yield self._read(self._query.where(self._runs.id.in_(ids[start : start + _SOME].tolist())))

    def between(self, first: int, last: int) -> RunBatch:
        """Return the runs from one id to another."""
        return self._read(self._query.where(self._runs.id.between(first, last)))

    def _ends(self) -> list[int]:
        """Return the id that each batch begins with, and one behind the last."""
        numbered = select(self._runs.id, func.row_number().over(order_by=self._runs.id).label("n")).subquery()
        firsts = select(numbered.c.id).where((numbered.c.n - 1) % BATCH == 0).order_by(numbered.c.id)
        last = self._connection.execute(select(func.max(self._runs.id))).scalar()
        return [] if last is None else [*self._connection.execute(firsts).scalars(), last + 1]

    def _read(self, query: Select[Any]) -> RunBatch:
        connection, shapes = self._connection, self._shapes
        rows = connection.execute(query).all()
        if not rows:  # removed meanwhile
            return RunBatch(({}, 0), RunMarks.joined([]), [])
        measured = _results(connection, [row[0] for row in rows])
        runs = _columns(_turned(rows), (*_RUN, *_DOCUMENTS))
        results = _columns(_turned(measured), (*_RESULT_CHANGES, "values"))
        marks = RunMarks.of(
            [_column(runs[name]) for name in ("id", *_CHANGES)],
            [_column(results[name]) for name in _RESULT_CHANGES] if results else [],
        )
        try:
            return RunBatch(_read(connection, runs, results, shapes), marks, [])
        except UNREADABLE:
            part, left_out = _read_some(connection, rows, measured, shapes)
            return RunBatch(part, marks, left_out)


def _columns(columns: Sequence[Sequence[Any]], names: Sequence[str]) -> dict[str, Any]:
    """Return columns by name: what a table of runs has as it is there, all else as it was read."""
    return {
        name: Column.of(values) if name in _AS_COLUMNS else values
        for name, values in zip(names, columns, strict=bool(columns))
    }


def _column(values: Any) -> Column:
    return values if isinstance(values, Column) else Column.of(values)


def _results(connection: Connection, ids: Sequence[int]) -> Sequence[Any]:
    results = schema.results.c
    wanted = results.run_id.between(ids[0], ids[-1]) if len(ids) > _SOME else results.run_id.in_(ids)
    query = select(*(raw(connection, results[name]) for name in (*_RESULT_CHANGES, "values")))
    return connection.execute(query.where(wanted).order_by(results.run_id, results.evaluation)).all()


@dataclass(frozen=True)
class _Shapes:
    """Shapes of documents and their names, read as they are met.

    Attributes:
        parsed: the shapes by number.
        names: of their values.
    """

    parsed: dict[int, Any] = field(default_factory=dict)
    names: dict[int, Names] = field(default_factory=dict)

    def spread(
        self, connection: Connection, held: Sequence[Any], left_out: frozenset[str] = frozenset()
    ) -> Spread:
        """Return documents as columns."""
        self._meet(connection, _numbers(held))
        return Spread.of(held, self.names, left_out)

    def joined(self, connection: Connection, held: Sequence[Any]) -> list[Any]:
        """Return documents as they were."""
        self._meet(connection, _numbers(held))
        return [join(self.parsed, item) for item in held]

    def _meet(self, connection: Connection, numbers: AbstractSet[int]) -> None:
        """Read the shapes that were not met before."""
        if new := numbers - self.parsed.keys():
            found = documents.read(connection, new)
            self.parsed.update(found)
            self.names.update({number: names_of(shape) for number, shape in found.items()})


def _numbers(held: Sequence[Any]) -> set[int]:
    """Return the numbers of the shapes of what rows hold."""
    firsts = {item[0] for item in held if type(item) is list and item and type(item[0]) is int}
    return {number for number in firsts if is_divided([number])}


def _read_some(
    connection: Connection, rows: Sequence[Row[Any]], measured: Sequence[Row[Any]], shapes: _Shapes
) -> tuple[Part, list[LeftOut]]:
    """Return the rows of those runs that can be read, with those of their results, and the others."""
    left_out: list[LeftOut] = []
    for start in range(0, len(rows), _SOME):
        ids = [row[0] for row in rows[start : start + _SOME]]
        left_out += read_runs(connection, select(schema.runs).where(schema.runs.c.id.in_(ids))).left_out
    gone = {one.number for one in left_out}
    kept, of_kept = ([row for row in table if row[0] not in gone] for table in (rows, measured))
    try:
        if not kept:
            return ({}, 0), left_out
        runs = _columns(_turned(kept), (*_RUN, *_DOCUMENTS))
        return _read(
            connection, runs, _columns(_turned(of_kept), (*_RESULT_CHANGES, "values")), shapes
        ), left_out
    except UNREADABLE as error:
        raise InputError(
            f"archive {shown(connection.engine.url)}: rows of it can't be read ({why(error)}); "
            "`slamhive archive check` says more"
        ) from error


def _turned(rows: Sequence[Row[Any]]) -> list[Sequence[Any]]:
    return list(zip(*rows, strict=True))


def _require_kinds(runs: dict[str, Any], results: dict[str, Any]) -> None:
    """Check that columns hold what those of the tables are of: SQLite takes anything in any of them.

    Raises:
        TypeError, ValueError: one holds something else.
    """
    for columns, table in ((runs, schema.runs), (results, schema.results)):
        for name, wanted in documents.kinds(table):
            if isinstance(wanted, tuple) and not _types(columns.get(name, ())) <= {*wanted, _NONE}:
                raise TypeError(f"{name}: expected {wanted[0].__name__}")
    outcomes = set(results.get("outcome", ()))
    if not {*runs["phase"].values, None} <= {*Phase, None} or not outcomes <= set(Outcome):
        raise ValueError("a phase or an outcome that is none")
    for name in TIMES:
        held = [value for value in runs[name] if value is not None]
        first, behind = _WRITTEN if held and isinstance(held[0], str) else _MOMENTS
        if held and not first <= min(held) <= max(held) < behind:
            raise ValueError(f"{name}: a time that is none of a run")


def _types(values: Any) -> set[type]:
    """Return types that a column's values are of, or more of them than a table takes."""
    if not isinstance(values, Column):
        return set(map(type, values))
    if values.kind.is_numeric:
        return _TYPES[values.kind] if not values.is_empty else set()
    return {str} if values.kind is ColumnKind.TEXT else set(map(type, values.values))


def _require_documents(held: Sequence[Any], name: str) -> None:
    """Check that documents are objects, or lists for intended evaluations and what is divided.

    Raises:
        TypeError: one is something else.
    """
    wanted = {list} if name == "evaluations" else {dict} if name in _AS_THEY_ARE else {dict, list}
    if not set(map(type, held)) <= ({*wanted, _NONE} if name in _MAY_BE_MISSING else wanted):
        raise TypeError(f"{name}: a document that is none")


def _read(connection: Connection, whole: dict[str, Any], measured: dict[str, Any], shapes: _Shapes) -> Part:
    """Return the rows of some runs, with those of their results."""
    _require_kinds(whole, measured)
    whole = dict(whole)
    for name in _DOCUMENTS:
        if name in _AS_THEY_ARE:
            whole[name] = _parsed(whole[name], partial(shapes.joined, connection))
            _require_documents(whole[name], name)
        else:
            held = _parsed(whole[name])
            _require_documents(held, name)
            whole[name] = shapes.spread(connection, held)
    found = [
        list(measured.get(name, ())) for name in ("run_id", "evaluation", "outcome", "coverage", "values")
    ]
    known = set(whole["id"])
    if not known.issuperset(found[0]):
        kept = [place for place, run in enumerate(found[0]) if run in known]
        found = [[column[place] for place in kept] for column in found]
    held = _parsed(found[-1])
    _require_documents(held, "values")
    values = shapes.spread(connection, held, LEFT_OUT)
    part = columns_of_runs(whole, Results(found[0], found[1], found[2], found[3], values))
    for column in part[0].values():
        for value in column.values if column.kind is ColumnKind.OTHER else ():
            if isinstance(value, list | dict):
                documents.require_shallow(value)
    return part


def _merge(before: Frame, stays: Any, fresh: list[Part], sweeps: tuple[SweepVersion, ...]) -> Frame:
    """Return the rows that stay, by the ids of their runs, with fresh ones."""
    parts = list(fresh)
    if len(before):
        kept = before.select(np.isin(before.column("id").numbers, stays))
        parts.insert(0, ({name: kept.column(name) for name in kept.stored}, len(kept)))
    bound(parts, before.stored, MAX_COLUMNS)
    columns, length = stack([part for part in parts if part[1]])
    if not length:
        return Frame({}, 0)
    if len(before):
        order = np.argsort(columns["id"].numbers, kind="stable")
        columns = {name: column.take(order) for name, column in columns.items()}
    return with_derived(columns, length, sweeps)


def _parsed(texts: Sequence[str | None], then: Callable[[list[Any]], list[Any]] = list) -> list[Any]:
    """Return JSON documents, equal ones as one; parsed in one go, as calls cost more than characters.

    Args:
        texts: the documents.
        then: makes of different ones what is returned of them.
    """
    asked: Sequence[str | None] = texts
    if 2 * len(set(texts[:_SAMPLE])) <= len(texts[:_SAMPLE]):  # counting all of them takes long
        different = dict.fromkeys(texts)
        asked = list(different) if 2 * len(different) < len(texts) else texts
    parsed = loads("[" + ",".join([item or "null" for item in asked]) + "]")
    if len(parsed) != len(asked):
        raise ValueError("a document that is several")
    found = then(parsed)
    if asked is texts:
        return found
    return list(map(dict(zip(asked, found, strict=True)).__getitem__, texts))
