# SPDX-License-Identifier: Apache-2.0
"""Steps that bring the tables of an earlier version of the archive to those of the next."""

from __future__ import annotations

import uuid
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError
from sqlalchemy import bindparam, select, text, update

from slamhive.analysis.measuring import intended_evaluations
from slamhive.archive import schema
from slamhive.model.algorithm import AlgorithmSpec
from slamhive.model.dataset import DatasetSpec
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.results import Usage
from slamhive.model.sensors import SensorMode
from slamhive.plan.hashes import algorithm_hash

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from sqlalchemy import Connection, Select

_BATCH = 1000
_PREFIX = 16
_CHANGED = ("sweep", "sweep_uid", "evaluations", "provenance", "usage")
_COLUMNS = (
    ("sweeps", "namespace", "VARCHAR(253)"),
    ("sweeps", "cluster", "VARCHAR(253)"),
    ("runs", "sweep_uid", "VARCHAR(253)"),
    ("runs", "namespace", "VARCHAR(253)"),
    ("runs", "cluster", "VARCHAR(253)"),
)


def _identities(connection: Connection) -> None:
    """Tell versions of a sweep apart by identity, and note what each run was meant to be measured by.

    Version 1 knew a sweep by its name alone; runs of its earlier versions, and of edited algorithms, had
    the sweep ``NAME@`` and 8 digits.
    """
    json = "JSONB" if connection.dialect.name == "postgresql" else "JSON"
    for table, column, kind in _COLUMNS:
        connection.execute(text(f"ALTER TABLE {table} ADD COLUMN {column} {kind}"))
    connection.execute(text(f"ALTER TABLE runs ADD COLUMN evaluations {json} NOT NULL DEFAULT '[]'"))
    connection.execute(text("CREATE INDEX runs_of_sweep_uid ON runs (sweep_uid, phase)"))
    sweeps = _Sweeps(connection)
    algorithms, datasets = _algorithm_hashes(connection), _datasets(connection)
    runs = schema.runs.c
    asked = select(
        *(runs.id, runs.uid, runs.sweep, runs.sensors, runs.dataset, runs.spec, runs.provenance),
        *(runs.algorithm_hash, runs.dataset_hash, runs.usage),
    ).order_by(runs.id)
    change = (
        update(schema.runs)
        .where(runs.id == bindparam("of_run"))
        .values({name: bindparam(f"to_{name}") for name in _CHANGED})
    )
    last = 0
    while rows := _some(connection, asked.where(runs.id > last).limit(_BATCH)):
        changes = []
        for row in rows:
            uid = sweeps.uid_of(row["uid"], row["sweep"])
            hashed = algorithms.get(row["algorithm_hash"])
            known = {"algorithmHash": hashed} if hashed else {}
            intended = _intended(row, sweeps.settings.get(uid), datasets)
            changes.append(
                {
                    "of_run": row["id"],
                    "to_sweep": _name(row["sweep"]),
                    "to_sweep_uid": uid,
                    "to_evaluations": intended,
                    "to_provenance": known | row["provenance"],
                    "to_usage": _usage(row["usage"]),
                }
            )
        connection.execute(change, changes)
        last = rows[-1]["id"]
    sweeps.rename(connection)


def _identity(connection: Connection) -> None:
    """Give the archive an identity of its own."""
    connection.execute(text("ALTER TABLE slamhive_schema ADD COLUMN identity VARCHAR(36)"))
    connection.execute(update(schema.schema_version).values(identity=str(uuid.uuid4())))


def _shapes(connection: Connection) -> None:
    """Make the table of shapes, and let documents name them; ``upgrading`` divides those there are."""
    schema.shapes.create(connection)
    connection.execute(text("ALTER TABLE slamhive_schema ADD COLUMN divided_to BIGINT"))
    connection.execute(update(schema.schema_version).values(divided_to=0))
    for name in ("ix_runs_finished", "ix_results_outcome"):  # nothing asks by them
        connection.execute(text(f"DROP INDEX IF EXISTS {name}"))
    if connection.dialect.name != "postgresql":
        return
    connection.execute(text("ALTER TABLE runs ALTER COLUMN evaluations DROP DEFAULT"))
    for table in (schema.algorithms, schema.datasets, schema.sweeps, schema.runs, schema.results):
        changes = ", ".join(
            f'ALTER COLUMN "{column.name}" TYPE JSON USING "{column.name}"::text::json'
            for column in table.columns
            # That of searches is made by a later step.
            if isinstance(column.type, schema.JsonDocument) and column is not schema.sweeps.c.search
        )
        connection.execute(text(f"ALTER TABLE {table.name} {changes}"))
    connection.execute(text("ALTER TABLE runs ALTER COLUMN evaluations SET DEFAULT '[]'"))


def _remarks(connection: Connection) -> None:
    """Make room for notes and tags on runs."""
    moment = "TIMESTAMP" if connection.dialect.name == "postgresql" else "DATETIME"
    for column, kind in (("note", "TEXT"), ("tags", "TEXT"), ("noted", moment)):
        connection.execute(text(f"ALTER TABLE runs ADD COLUMN {column} {kind}"))


def _searches(connection: Connection) -> None:
    """Make room for what searches tried."""
    connection.execute(text("ALTER TABLE sweeps ADD COLUMN search JSON"))


STEPS: dict[int, Callable[[Connection], None]] = {
    1: _identities,
    2: _identity,
    3: _shapes,
    4: _remarks,
    5: _searches,
}
"""By version: how tables of that version become those of the next."""


class _Sweeps:
    """The sweeps of an archive of version 1."""

    def __init__(self, connection: Connection) -> None:
        columns = schema.sweeps.c
        query = select(columns.uid, columns.name, columns.evaluation)
        rows = connection.execute(query.order_by(columns.created.asc().nulls_first(), columns.uid)).all()
        self.settings: dict[str | None, Mapping[str, Any] | None] = {row.uid: row.evaluation for row in rows}
        self._by_name: dict[str, str] = {row.name: row.uid for row in rows}
        self._by_prefix: dict[str, str] = {row.uid[:_PREFIX]: row.uid for row in rows}
        self._names: dict[str, str] = {row.uid: row.name for row in rows}

    def uid_of(self, run: str, sweep: str | None) -> str | None:
        """Return the identity of a run's sweep: what its own begins with, else that of the sweep's name."""
        if sweep is None:
            return None
        if run[_PREFIX : _PREFIX + 1] == "-" and run[:_PREFIX].isalnum():  # on a workstation: UID-POINT
            return self._by_prefix.get(run[:_PREFIX], run[:_PREFIX])
        _, at, digits = sweep.partition("@")
        aside = next((uid for uid in self._names if at and uid.startswith(digits)), None)
        return aside or self._by_name.get(sweep)

    def rename(self, connection: Connection) -> None:
        """Give sweeps that were set aside their own names again."""
        for uid, name in self._names.items():
            if name != _name(name):
                change = update(schema.sweeps).where(schema.sweeps.c.uid == uid)
                connection.execute(change.values(name=_name(name)))


def _name(sweep: str | None) -> str | None:
    return sweep.partition("@")[0] if sweep is not None else None


def _algorithm_hashes(connection: Connection) -> dict[str, str]:
    hashes = {}
    for entry in _catalog(connection, schema.algorithms):
        try:
            hashes[entry["content_hash"]] = algorithm_hash(AlgorithmSpec.model_validate(entry["spec"]))
        except ValidationError:
            continue  # an imported one, which says little of its program
    return hashes


def _datasets(connection: Connection) -> dict[str, DatasetSpec]:
    specs = {}
    for entry in _catalog(connection, schema.datasets):
        try:
            specs[entry["content_hash"]] = DatasetSpec.model_validate(entry["spec"])
        except ValidationError:
            continue
    return specs


def _catalog(connection: Connection, table: Any) -> Iterable[Mapping[str, Any]]:
    return _some(connection, select(table.c.content_hash, table.c.spec))


def _usage(usage: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the usage of a run, with what its memory is: records of version 1 did not say."""
    try:
        return usage and Usage.model_validate(usage).as_json()
    except ValidationError:
        return usage


def _some(connection: Connection, query: Select[Any]) -> list[dict[str, Any]]:
    return [dict(row) for row in connection.execute(query).mappings()]


def _intended(
    row: Mapping[str, Any], settings: Mapping[str, Any] | None, datasets: Mapping[str, DatasetSpec]
) -> list[dict[str, Any]]:
    if settings is None or not row["spec"].get("evaluate", True):
        return []
    try:
        mode = SensorMode(row["sensors"])
        found = intended_evaluations(
            EvaluationSettings.model_validate(settings), mode, datasets.get(row["dataset_hash"])
        )
    except ValueError:
        return []
    return [one.as_json() for one in found]
