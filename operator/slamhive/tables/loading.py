# SPDX-License-Identifier: Apache-2.0
"""The archive as a table of columns, kept up to date by reading again only what changed.

The archive has no word for "changed since": so each look compares the short columns of all rows with those
of the last look, and reads the documents of those runs that differ. A look is only taken when the database
says that anything at all was written.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from sqlalchemy import DateTime, String, Text, cast, select, text, type_coerce

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
from slamhive.analysis.shapes import is_divided, join, names_of
from slamhive.archive import documents, schema
from slamhive.archive.connection import reading
from slamhive.model.uncollected import uncollected
from slamhive.tables.snapshots import Loaded, derived, loads

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from collections.abc import Set as AbstractSet

    import numpy.typing as npt
    from sqlalchemy import ColumnElement, Connection, Engine, Row

    from slamhive.analysis.flattening import Part
    from slamhive.analysis.shapes import Names

BATCH = 2000
"""Runs read at a time: their documents are what loading needs memory for."""

_SOME = 500
_SAMPLE = 64
_STREAMED = 10_000
_MARKS = 2**64
_NOTHING = int(np.array([None], dtype=np.float64).view(np.uint64)[0])
_FACTOR = 0x9E3779B97F4A7C15
_CHANGES = (
    *("phase", "reason", "attempts", "sweep", "sweep_uid", "finished", "cpu_seconds", "wall_seconds"),
    *("cluster", "dataset", "evaluations"),
)
_RESULT_CHANGES = (
    *("run_id", "evaluation", "outcome", "coverage", "alignment", "ate_rmse", "rpe_rmse", "scale"),
)
_RUN = ("id", *_CHANGES[:-1], *(name for name in OF_RUN.values() if name not in {"id", *_CHANGES}))
_AS_THEY_ARE = frozenset({"labels", "evaluations"})
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
        sweeps, declared = _sweeps(connection), _declared(connection)
        if marks is not None and marks == known:
            found_now = before if sweeps == before.sweeps else derived(before, sweeps)
            if declared != found_now.frame.declared:
                found_now = replace(found_now, frame=found_now.frame.declaring(declared))
            return replace(found_now, stamp=stamp)
        changed = None if marks is None else [run for run, mark in marks.items() if known.get(run) != mark]
        fresh, found = [], {} if marks is None else marks
        shapes = _Shapes()
        for rows in _batches(connection, changed):
            columns = list(zip(*rows, strict=True))
            measured = list(zip(*_results(connection, columns[0]), strict=True))
            _add_marks(found, [*columns[: len(_CHANGES)], columns[-1]], runs=True)
            _add_marks(found, measured[: len(_RESULT_CHANGES)], runs=False)
            fresh.append(_read(connection, columns, measured, shapes))
    frame = _merge(before.frame, set(changed or ()), found, fresh, sweeps).declaring(declared)
    return Loaded(frame, found, sweeps, stamp)


def _sweeps(connection: Connection) -> tuple[SweepVersion, ...]:
    columns = schema.sweeps.c
    query = select(columns.uid, columns.name, columns.cluster, columns.namespace, columns.created)
    return tuple(
        SweepVersion(row.uid, row.name, row.cluster, row.namespace, row.created and row.created.timestamp())
        for row in connection.execute(query.order_by(columns.uid))
    )


def _declared(connection: Connection) -> dict[str, dict[str, str]]:
    """Return the units of the parameters' columns by algorithm, as its latest manifest says them."""
    columns = schema.algorithms.c
    query = select(columns.name, columns.spec).order_by(columns.stored, columns.content_hash)
    return {
        name: {
            f"parameters.{key}": str(one.get("unit") or "")
            for key, one in (spec.get("parameters") or {}).items()
        }
        for name, spec in connection.execute(query)
    }


def _marks(connection: Connection) -> dict[int, int]:
    """Return a short mark of each run's look, by its id."""
    runs, results = schema.runs.c, schema.results.c
    asked_for = [_cheap(connection, runs[name]) for name in ("id", *_CHANGES[:-1])]
    query = select(*asked_for, _raw(connection, runs.evaluations)).order_by(runs.id)
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
            marks[run] = (marks[run] + mark) % _MARKS


def _row_marks(columns: Sequence[Sequence[Any]]) -> list[int]:
    """Return a number for each row that differs when one of its values does.

    Column by column: each value's number is turned by an odd factor of the column's own and added.
    """
    total = np.zeros(len(columns[0]), dtype=np.uint64)
    for place, values in enumerate(columns):
        numbers = _numbers_of(values)
        total += (numbers ^ (numbers >> np.uint64(29))) * np.uint64(pow(_FACTOR, 2 * place + 1, _MARKS))
    marks: list[int] = (total ^ (total >> np.uint64(32))).tolist()
    return marks


def _numbers_of(values: Sequence[Any]) -> npt.NDArray[np.uint64]:
    """Return a number for each value, the same in every process (``hash`` of a text is not)."""
    if set(map(type, values)) <= {int, float, type(None)}:
        return np.array(values, dtype=np.float64).view(np.uint64)
    different = list(dict.fromkeys(values))
    texts = [str(value).encode("utf-8", "replace") for value in different]
    numbers = dict(zip(different, _numbers_of_texts(texts).tolist(), strict=True))
    numbers[None] = _NOTHING
    return np.fromiter(map(numbers.__getitem__, values), np.uint64, len(values))


def _numbers_of_texts(texts: Sequence[bytes]) -> npt.NDArray[np.uint64]:
    """Return a number for each text, of its words of 8 bytes: those of many texts at once."""
    width = -(-max(map(len, texts), default=0) // 8) or 1
    words = np.array(texts, dtype=f"S{8 * width}").view(np.uint64).reshape(len(texts), width)
    total = np.fromiter(map(len, texts), np.uint64, len(texts))
    for place in range(width):
        turned = (words[:, place] ^ (words[:, place] >> np.uint64(31))) * np.uint64(_FACTOR)
        total += turned * np.uint64(pow(_FACTOR, 2 * place + 1, _MARKS))
    return total ^ (total >> np.uint64(29))


def _batches(connection: Connection, changed: Sequence[int] | None) -> Iterator[Sequence[Row[Any]]]:
    """Go through runs by their ids, or through all of them."""
    runs = schema.runs.c
    columns = [
        *(_cheap(connection, runs[name]) for name in _RUN),
        *(_raw(connection, runs[name]) for name in _DOCUMENTS),
    ]
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
    query = select(*(results[name] for name in _RESULT_CHANGES), _raw(connection, results["values"]))
    return connection.execute(query.where(wanted).order_by(results.run_id, results.evaluation)).all()


def _cheap(connection: Connection, column: ColumnElement[Any]) -> ColumnElement[Any]:
    """Return a time as the database holds it, without SQLAlchemy reading it."""
    if column.name not in TIMES:
        return column
    return type_coerce(column, String if connection.dialect.name == "sqlite" else DateTime)


def _raw(connection: Connection, column: ColumnElement[Any]) -> ColumnElement[str]:
    """Return a JSON column as the text that it is, without SQLAlchemy reading it."""
    return cast(column, Text) if connection.dialect.name == "postgresql" else type_coerce(column, Text)


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
        self._meet(connection, {item[0] for item in held if type(item) is list})
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


def _read(
    connection: Connection,
    columns: Sequence[Sequence[Any]],
    measured: Sequence[Sequence[Any]],
    shapes: _Shapes,
) -> Part:
    """Return the rows of some runs, with those of their results."""
    whole: dict[str, Any] = dict(zip((*_RUN, *_DOCUMENTS), columns, strict=True))
    for name in _DOCUMENTS:
        if name in _AS_THEY_ARE:
            whole[name] = _parsed(whole[name], partial(shapes.joined, connection))
        else:
            whole[name] = shapes.spread(connection, _parsed(whole[name]))
    found = [list(column) for column in measured] or [[] for _ in range(5)]
    known = set(whole["id"])
    if not known.issuperset(found[0]):
        kept = [place for place, run in enumerate(found[0]) if run in known]
        found = [[column[place] for place in kept] for column in found]
    values = shapes.spread(connection, _parsed(found[-1]), LEFT_OUT)
    return columns_of_runs(whole, Results(found[0], found[1], found[2], found[3], values))


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
    found = then(loads("[" + ",".join([item or "null" for item in asked]) + "]"))
    if asked is texts:
        return found
    return list(map(dict(zip(asked, found, strict=True)).__getitem__, texts))
