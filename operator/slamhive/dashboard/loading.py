# SPDX-License-Identifier: Apache-2.0
"""The archive as a table of columns, kept up to date by reading again only what changed.

The archive has no word for "changed since": so each look compares the short columns of all rows with those
of the last look, and reads the documents of those runs that differ. A look is only taken when the database
says that anything at all was written.
"""

from __future__ import annotations

import gc
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from sqlalchemy import Text, cast, select, text, type_coerce

from slamhive.analysis.columns import Column, times
from slamhive.analysis.frame import Frame, spread, with_derived
from slamhive.archive import schema
from slamhive.archive.connection import reading
from slamhive.dashboard.rows import PREFIXES, label_of_run

try:
    from orjson import loads
except ModuleNotFoundError:  # the extra is not installed: slower, the same
    from json import loads  # type: ignore[assignment]

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sqlalchemy import ColumnElement, Connection, Engine, Row

    from slamhive.analysis.columns import Indices

BATCH = 4000
"""Runs read at a time: their documents are what loading needs memory for."""

_RUN = ("id", "uid", "name", "sweep", "point", "algorithm", "dataset", "sensors", "repetition", "seed")
_RUN_MORE = ("phase", "reason", "message", "attempts", "created", "started", "finished")
_DOCUMENTS = ("spec", "attributes", "labels", "metrics", "usage", "frames", "trajectory", "provenance")
_TIMES = frozenset({"created", "started", "finished"})
_CHANGES = ("phase", "reason", "attempts", "sweep", "started", "finished", "cpu_seconds", "wall_seconds")
_RESULT_CHANGES = ("run_id", "evaluation", "outcome", "coverage", "alignment", "ate_rmse", "rpe_rmse")


class Results(NamedTuple):
    """Results, one an evaluation of a run.

    Attributes:
        evaluations: their names.
        outcomes: what became of the runs.
        coverages: shares of the ground truth's path.
        values: what the evaluator found.
    """

    evaluations: list[str]
    outcomes: list[str]
    coverages: list[float | None]
    values: list[Any]


@dataclass(frozen=True)
class Loaded:
    """The archive as it was at one moment.

    Attributes:
        frame: one row a run and evaluation, in the order of storing.
        marks: what each run looked like in short, by its id.
    """

    frame: Frame = field(default_factory=lambda: Frame({}, 0))
    marks: dict[int, int] = field(default_factory=dict)


def change_mark(engine: Engine, held: Connection) -> object:
    """Return a value that differs after anything was written to the database, at next to no cost.

    Args:
        engine: the database.
        held: a connection that is kept for this: SQLite counts what others wrote since it was opened.
    """
    if engine.dialect.name == "postgresql":
        with reading(engine) as connection:
            return connection.execute(text("SELECT pg_current_snapshot()::text")).scalar()
    return held.exec_driver_sql("PRAGMA data_version").scalar()


def load(engine: Engine, before: Loaded | None = None) -> Loaded:
    """Return the archive as it is now.

    Args:
        engine: the database.
        before: an earlier moment: what has not changed since is taken from there.

    Raises:
        SystemFault: the database doesn't answer.
    """
    before = before or Loaded()
    with reading(engine) as connection, _no_collections():
        marks = _marks(connection)
        changed = [run for run, mark in marks.items() if before.marks.get(run) != mark]
        if not changed and len(marks) == len(before.marks):
            return before
        fresh = [_read(connection, batch) for batch in _batches(connection, changed)]
    return Loaded(_merge(before.frame, set(changed), marks, fresh), marks)


def _marks(connection: Connection) -> dict[int, int]:
    runs, results = schema.runs.c, schema.results.c
    query = select(runs.id, *(runs[name] for name in _CHANGES)).order_by(runs.id)
    marks = {row[0]: hash(tuple(row)) for row in connection.execute(query)}
    size = "octet_length" if connection.dialect.name == "postgresql" else "length"
    sized = text(f"{size}(CAST({_quoted(connection)} AS TEXT))")
    measured = select(*(results[name] for name in _RESULT_CHANGES), sized)
    for row in connection.execute(measured):
        if row[0] in marks:
            # A sum, as results come in no order.
            marks[row[0]] += hash(tuple(row))
    return marks


def _quoted(connection: Connection) -> str:
    return connection.dialect.identifier_preparer.quote(schema.results.c["values"].name)


def _batches(connection: Connection, changed: Sequence[int]) -> Iterator[list[Row[Any]]]:
    runs = schema.runs.c
    columns = [
        *(runs[name] for name in (*_RUN, *_RUN_MORE)),
        *(_raw(connection, runs[name]) for name in _DOCUMENTS),
    ]
    for start in range(0, len(changed), BATCH):
        wanted = changed[start : start + BATCH]
        first, last = wanted[0], wanted[-1]
        query = select(*columns).where(runs.id.between(first, last)).order_by(runs.id)
        if last - first >= 2 * len(wanted):
            query = select(*columns).where(runs.id.in_(wanted)).order_by(runs.id)
        kept = set(wanted)
        yield [row for row in connection.execute(query) if row[0] in kept]


def _raw(connection: Connection, column: ColumnElement[Any]) -> ColumnElement[str]:
    """Return a JSON column as the text that it is, without SQLAlchemy reading it."""
    return cast(column, Text) if connection.dialect.name == "postgresql" else type_coerce(column, Text)


def _read(connection: Connection, rows: Sequence[Row[Any]]) -> Frame:
    """Return the rows of some runs, with those of their results."""
    names = (*_RUN, *_RUN_MORE, *_DOCUMENTS)
    whole = dict(zip(names, zip(*rows, strict=True), strict=True)) if rows else dict.fromkeys(names, ())
    documents = {name: _parsed(whole[name]) for name in _DOCUMENTS}
    found: dict[str, list[Any]] = {}
    for prefix, document, key in PREFIXES:
        held = documents[document]
        spread(found, prefix, [item and item.get(key) for item in held] if key else held)
    columns = {name: Column.of(values) for name, values in found.items()}
    for name in (*_RUN, *_RUN_MORE):
        values = list(whole[name])
        columns["index" if name == "point" else name] = times(values) if name in _TIMES else Column.of(values)
    columns["run"] = Column.of(
        [label_of_run(labels, name) for labels, name in zip(documents["labels"], whole["name"], strict=True)]
    )
    return _with_results(connection, columns, list(whole["id"]))


def _with_results(connection: Connection, columns: dict[str, Column], ids: list[int]) -> Frame:
    results = schema.results.c
    wanted = results.run_id.between(ids[0], ids[-1]) if len(ids) > 500 else results.run_id.in_(ids)
    query = (
        select(
            *(results.run_id, results.evaluation, results.outcome, results.coverage),
            _raw(connection, results["values"]),
        )
        .where(wanted)
        .order_by(results.run_id, results.evaluation)
    )
    places = {run: place for place, run in enumerate(ids)}
    rows = [row for row in connection.execute(query) if row[0] in places]
    have = np.array([places[row[0]] for row in rows], dtype=np.intp)
    without = np.setdiff1d(np.arange(len(ids)), have)
    return join_results(
        columns,
        np.concatenate([have, without]),
        Results(
            [row[1] for row in rows],
            [row[2] for row in rows],
            [row[3] for row in rows],
            _parsed([row[4] for row in rows]),
        ),
    )


def join_results(
    columns: dict[str, Column],
    places: Indices,
    results: Results,
) -> Frame:
    """Return rows of runs beside those of their results.

    Args:
        columns: of the runs.
        places: the run of each row, (n,): first the rows with results, then those of runs without.
        results: of the first rows.
    """
    evaluations, outcomes, coverages, values = results
    left = len(places) - len(evaluations)
    padding = [None] * left
    found: dict[str, list[Any]] = {}
    spread(found, "", values)
    joined = {name: column.take(places) for name, column in columns.items()}
    messages = [item or None for item in found.pop("message", ())]
    for name, items in found.items():
        if name in _KEPT:
            continue
        column = Column.of([*items, *padding])
        joined[name] = _first(column, joined[name]) if name in joined else column
    if any(messages):
        joined["message"] = _first(joined["message"], Column.of([*messages, *padding]))
    joined["evaluation"] = Column.of([*evaluations, *padding])
    joined["outcome"] = Column.of([*outcomes, *padding])
    joined["coverage"] = Column.of([*coverages, *padding])
    order = np.argsort(places, kind="stable")
    return Frame({name: column.take(order) for name, column in joined.items()}, len(places))


_KEPT = frozenset({"id", "uid", "name", "evaluation", "outcome", "coverage"})
"""What an evaluator's own names never replace."""


def _first(column: Column, other: Column) -> Column:
    """Return a column's values, another one's where it has none."""
    if other.is_empty:
        return column
    pairs = zip(column.tolist(), other.tolist(), strict=True)
    return Column.of([second if first is None else first for first, second in pairs])


def _merge(before: Frame, changed: set[int], marks: dict[int, int], fresh: list[Frame]) -> Frame:
    parts = []
    if len(before):
        ids = before.column("id").numbers
        now = np.fromiter(marks.keys() - changed, dtype=np.float64)
        parts.append(before.select(np.isin(ids, now)))
    frame = Frame.concatenate([*parts, *fresh])
    if not len(frame):
        return Frame({}, 0)
    if parts and len(parts[0]):
        frame = frame.select(np.argsort(frame.column("id").numbers, kind="stable"))
    return with_derived({name: frame.column(name) for name in frame.stored}, len(frame))


def _parsed(texts: Sequence[str | None]) -> list[Any]:
    """Return JSON documents; parsed in one go, as calls cost more than characters."""
    found: list[Any] = loads("[" + ",".join([item or "null" for item in texts]) + "]")
    return found


@contextmanager
def _no_collections() -> Iterator[None]:
    """Keep the garbage collector from going through millions of short-lived values."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()
