# SPDX-License-Identifier: Apache-2.0
"""Batches of runs, read from the archive as columns.

Runs that can't be read are left out, and named: those of which `archive.rows` can make no record. Rows are
only looked through for them where some can't be made columns of, or hold something of another type.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

from sqlalchemy import func, select

from slamhive.analysis.columns import Column, ColumnKind
from slamhive.analysis.compact.shapes import is_divided, join, loads, names_of
from slamhive.analysis.flattening import LEFT_OUT, OF_RUN, TIMES, Results, Spread, columns_of_runs, stack
from slamhive.archive import documents, schema
from slamhive.archive.connection import shown
from slamhive.archive.documents import UNREADABLE, raw
from slamhive.archive.rows import read_runs, why
from slamhive.model.errors import InputError
from slamhive.model.results import Outcome, Phase
from slamhive.tables.marks import RunMarks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from collections.abc import Set as AbstractSet

    from sqlalchemy import Connection, Row, Select

    from slamhive.analysis.compact.shapes import Names
    from slamhive.analysis.flattening import Part
    from slamhive.model.leftout import LeftOut
    from slamhive.tables.marks import Ids

BATCH = 2000
"""Runs read at a time: their documents are what loading needs memory for."""

_SOME = 500
_SAMPLE = 64
CHANGES = (
    *("phase", "reason", "attempts", "sweep", "sweep_uid", "finished", "cpu_seconds", "wall_seconds"),
    *("cluster", "dataset", "note", "tags", "evaluations"),
)
RESULT_CHANGES = (
    *("run_id", "evaluation", "outcome", "coverage", "alignment", "ate_rmse", "rpe_rmse", "scale"),
)
_RUN = ("id", *CHANGES[:-1], *(name for name in OF_RUN.values() if name not in {"id", *CHANGES}))
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


def joined(batches: Sequence[RunBatch]) -> RunBatch:
    """Return batches as one; takes their parts to pieces to save memory."""
    return RunBatch(
        stack([one.part for one in batches]),
        RunMarks.joined([one.marks for one in batches]),
        [left for one in batches for left in one.left_out],
    )


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

    def some(self, ids: Ids) -> Iterator[RunBatch]:
        """Go through some runs."""
        for start in range(0, len(ids), _SOME):
            yield self._read(self._query.where(self._runs.id.in_(ids[start : start + _SOME].tolist())))

    def between(self, first: int, last: int) -> RunBatch:
        """Return the runs from one id to another."""
        return self._read(self._query.where(self._runs.id.between(first, last)))

    def pieces(self) -> list[tuple[int, int]]:
        """Return the first and the last id of each batch of all runs."""
        numbered = select(self._runs.id, func.row_number().over(order_by=self._runs.id).label("n")).subquery()
        firsts = select(numbered.c.id).where((numbered.c.n - 1) % BATCH == 0).order_by(numbered.c.id)
        last = self._connection.execute(select(func.max(self._runs.id))).scalar()
        ends = [] if last is None else [*self._connection.execute(firsts).scalars(), last + 1]
        return [(first, behind - 1) for first, behind in pairwise(ends)]

    def _read(self, query: Select[Any]) -> RunBatch:
        connection, shapes = self._connection, self._shapes
        rows = connection.execute(query).all()
        if not rows:  # removed meanwhile
            return RunBatch(({}, 0), RunMarks.joined([]), [])
        measured = _results(connection, [row[0] for row in rows])
        runs = _columns(_turned(rows), (*_RUN, *_DOCUMENTS))
        results = _columns(_turned(measured), (*RESULT_CHANGES, "values"))
        marks = RunMarks.of(
            [Column.of(runs[name]) for name in ("id", *CHANGES)],
            [Column.of(results[name]) for name in RESULT_CHANGES] if results else [],
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


def _results(connection: Connection, ids: Sequence[int]) -> Sequence[Any]:
    results = schema.results.c
    wanted = results.run_id.between(ids[0], ids[-1]) if len(ids) > _SOME else results.run_id.in_(ids)
    query = select(*(raw(connection, results[name]) for name in (*RESULT_CHANGES, "values")))
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
            connection, runs, _columns(_turned(of_kept), (*RESULT_CHANGES, "values")), shapes
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
