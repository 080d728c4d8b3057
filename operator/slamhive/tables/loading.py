# SPDX-License-Identifier: Apache-2.0
"""The archive as a table of columns, kept up to date by reading again only what changed.

The archive has no word for "changed since": so each look compares the short columns of all rows with those
of the last look, and reads the documents of those runs that differ. A look is only taken when the database
says that anything at all was written.

Runs that can't be read are left out, and named: those of which `archive.rows` can make no record. Rows are
only looked through for them where some can't be made columns of, or hold something of another type.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from sqlalchemy import select, text

from slamhive.analysis.columns import ColumnKind
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
from slamhive.analysis.shapes import is_divided, join, loads, names_of
from slamhive.analysis.texts import FACTOR, MARKS, numbers_of_texts, short
from slamhive.archive import documents, schema
from slamhive.archive.connection import reading, shown
from slamhive.archive.documents import UNREADABLE, raw
from slamhive.archive.rows import read_rows, read_runs, why
from slamhive.model.errors import InputError
from slamhive.model.results import Outcome, Phase
from slamhive.model.search import choosing_method
from slamhive.tables.snapshots import Loaded, derived
from slamhive.tables.uncollected import uncollected

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from collections.abc import Set as AbstractSet

    import numpy.typing as npt
    from sqlalchemy import Connection, Engine, Row

    from slamhive.analysis.flattening import Part
    from slamhive.analysis.shapes import Names
    from slamhive.model.leftout import LeftOut

BATCH = 2000
"""Runs read at a time: their documents are what loading needs memory for."""

_SOME = 500
_SAMPLE = 64
_STREAMED = 10_000
_NOTHING = int(np.array([None], dtype=np.float64).view(np.uint64)[0])
_CHANGES = (
    *("phase", "reason", "attempts", "sweep", "sweep_uid", "finished", "cpu_seconds", "wall_seconds"),
    *("cluster", "dataset", "note", "tags", "evaluations"),
)
_RESULT_CHANGES = (
    *("run_id", "evaluation", "outcome", "coverage", "alignment", "ate_rmse", "rpe_rmse", "scale"),
)
_RUN = ("id", *_CHANGES[:-1], *(name for name in OF_RUN.values() if name not in {"id", *_CHANGES}))
_AS_THEY_ARE = frozenset({"labels", "evaluations"})
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
        marks = known if same else _marks(connection) if known else None
        sweeps, odd = _sweeps(connection)
        declared, more = _declared(connection)
        odd += more
        if marks is not None and marks == known:
            found_now = before if sweeps == before.sweeps else derived(before, sweeps)
            runs = [one for one in before.left_out if one.number is not None]
            if declared != found_now.frame.declared:
                found_now = replace(found_now, frame=found_now.frame.declaring(declared))
            return replace(found_now, stamp=stamp, left_out=(*runs, *odd))
        changed = None if marks is None else [run for run, mark in marks.items() if known.get(run) != mark]
        again = set(changed or ())
        fresh, found = [], {} if marks is None else marks
        runs = [one for one in before.left_out if one.number in found and one.number not in again]
        shapes = _Shapes()
        for rows in _batches(connection, changed):
            measured = _results(connection, [row[0] for row in rows])
            columns, held = _turned(rows), _turned(measured)
            _add_marks(found, [*columns[: len(_CHANGES)], columns[-1]], runs=True)
            _add_marks(found, held[: len(_RESULT_CHANGES)], runs=False)
            try:
                part = _read(connection, columns, held, shapes)
                left_out: list[LeftOut] = []
            except UNREADABLE:
                part, left_out = _read_some(connection, rows, measured, shapes)
            fresh.append(part)
            runs += left_out
    frame = _merge(before.frame, again, found, fresh, sweeps).declaring(declared)
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


def _marks(connection: Connection) -> dict[int, int]:
    """Return a short mark of each run's look, by its id."""
    runs, results = schema.runs.c, schema.results.c
    asked_for = [raw(connection, runs[name]) for name in ("id", *_CHANGES)]
    query = select(*asked_for).order_by(runs.id)
    measured = select(*(results[name] for name in _RESULT_CHANGES))
    marks: dict[int, int] = {}
    for asked in (query, measured):
        for rows in connection.execute(asked.execution_options(yield_per=_STREAMED)).partitions():
            _add_marks(marks, list(zip(*rows, strict=True)), runs=asked is query)
    return marks


def _add_marks(marks: dict[int, int], columns: Sequence[Sequence[Any]], *, runs: bool) -> None:
    """Add the marks of runs, or those of results to their runs', by the values that count, ids first.

    They are the same in every process and whatever other rows there are.
    """
    if not columns:
        return
    found = _row_marks(columns)
    if runs:
        marks.update(zip(columns[0], found, strict=True))
        return
    for run, mark in zip(columns[0], found, strict=True):
        if run in marks:
            # A sum, as results come in no order.
            marks[run] = (marks[run] + mark) % MARKS


def _row_marks(columns: Sequence[Sequence[Any]]) -> list[int]:
    """Return a number for each row that differs when one of its values does.

    Column by column: each value's number is turned by an odd factor of the column's own and added.
    """
    total = np.zeros(len(columns[0]), dtype=np.uint64)
    for place, values in enumerate(columns):
        numbers = _numbers_of(values)
        total += (numbers ^ (numbers >> np.uint64(29))) * np.uint64(pow(FACTOR, 2 * place + 1, MARKS))
    marks: list[int] = (total ^ (total >> np.uint64(32))).tolist()
    return marks


def _numbers_of(values: Sequence[Any]) -> npt.NDArray[np.uint64]:
    """Return a number for each value, the same in every process (``hash`` of a text is not)."""
    if set(map(type, values)) <= {int, float, type(None)}:
        return np.array(values, dtype=np.float64).view(np.uint64)
    different = list(dict.fromkeys(values))
    texts = np.array([short(str(value).encode("utf-8", "replace")) for value in different])
    numbers = dict(zip(different, numbers_of_texts(texts).tolist(), strict=True))
    numbers[None] = _NOTHING
    return np.fromiter(map(numbers.__getitem__, values), np.uint64, len(values))


def _batches(connection: Connection, changed: Sequence[int] | None) -> Iterator[Sequence[Row[Any]]]:
    """Go through runs by their ids, or through all of them."""
    runs = schema.runs.c
    columns = [raw(connection, runs[name]) for name in (*_RUN, *_DOCUMENTS)]
    if changed is not None:
        for start in range(0, len(changed), _SOME):
            wanted = changed[start : start + _SOME]
            yield connection.execute(select(*columns).where(runs.id.in_(wanted)).order_by(runs.id)).all()
        return
    last = 0
    while rows := connection.execute(
        select(*columns).where(runs.id > last).order_by(runs.id).limit(BATCH)
    ).all():
        yield rows
        last = rows[-1].id


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
        self._meet(connection, {item[0] for item in held if is_divided(item)})
        return Spread.of(held, self.names, left_out)

    def joined(self, connection: Connection, held: Sequence[Any]) -> list[Any]:
        """Return documents as they were."""
        self._meet(connection, {item[0] for item in held if is_divided(item)})
        return [join(self.parsed, item) for item in held]

    def _meet(self, connection: Connection, numbers: AbstractSet[int]) -> None:
        """Read the shapes that were not met before."""
        if new := numbers - self.parsed.keys():
            found = documents.read(connection, new)
            self.parsed.update(found)
            self.names.update({number: names_of(shape) for number, shape in found.items()})


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
        return (_read(connection, _turned(kept), _turned(of_kept), shapes) if kept else ({}, 0)), left_out
    except UNREADABLE as error:
        raise InputError(
            f"archive {shown(connection.engine.url)}: rows of it can't be read ({why(error)}); "
            "`slamhive archive check` says more"
        ) from error


def _turned(rows: Sequence[Row[Any]]) -> list[Sequence[Any]]:
    return list(zip(*rows, strict=True))


def _require_kinds(runs: dict[str, Any], measured: Sequence[Sequence[Any]]) -> None:
    """Check that columns hold what those of the tables are of: SQLite takes anything in any of them.

    Raises:
        TypeError, ValueError: one holds something else.
    """
    results = dict(zip(_RESULT_CHANGES, measured, strict=False))
    for columns, table in ((runs, schema.runs), (results, schema.results)):
        for name, wanted in documents.kinds(table):
            if isinstance(wanted, tuple) and not set(map(type, columns.get(name, ()))) <= {*wanted, _NONE}:
                raise TypeError(f"{name}: expected {wanted[0].__name__}")
    if not set(runs["phase"]) <= set(Phase) or not set(results.get("outcome", ())) <= set(Outcome):
        raise ValueError("a phase or an outcome that is none")
    for name in TIMES:
        held = [value for value in runs[name] if value is not None]
        first, behind = _WRITTEN if held and isinstance(held[0], str) else _MOMENTS
        if held and not first <= min(held) <= max(held) < behind:
            raise ValueError(f"{name}: a time that is none of a run")


def _require_documents(held: Sequence[Any], name: str) -> None:
    """Check that documents are objects, or lists for intended evaluations and what is divided.

    Raises:
        TypeError: one is something else.
    """
    wanted = {list} if name == "evaluations" else {dict} if name in _AS_THEY_ARE else {dict, list}
    if not set(map(type, held)) <= ({*wanted, _NONE} if name in _MAY_BE_MISSING else wanted):
        raise TypeError(f"{name}: a document that is none")


def _read(
    connection: Connection,
    columns: Sequence[Sequence[Any]],
    measured: Sequence[Sequence[Any]],
    shapes: _Shapes,
) -> Part:
    """Return the rows of some runs, with those of their results."""
    whole: dict[str, Any] = dict(zip((*_RUN, *_DOCUMENTS), columns, strict=True))
    _require_kinds(whole, measured)
    for name in _DOCUMENTS:
        if name in _AS_THEY_ARE:
            whole[name] = _parsed(whole[name], partial(shapes.joined, connection))
            _require_documents(whole[name], name)
        else:
            held = _parsed(whole[name])
            _require_documents(held, name)
            whole[name] = shapes.spread(connection, held)
    found = [list(column) for column in measured] or [[] for _ in range(5)]
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


def _merge(
    before: Frame,
    changed: set[int],
    marks: dict[int, int],
    fresh: list[Part],
    sweeps: tuple[SweepVersion, ...],
) -> Frame:
    parts = list(fresh)
    if len(before):
        ids = before.column("id").numbers
        stays = np.fromiter(marks.keys() - changed, dtype=np.float64)
        kept = before.select(np.isin(ids, stays))
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
