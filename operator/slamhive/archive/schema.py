# SPDX-License-Identifier: Apache-2.0
"""The archive's tables. What is asked for often has a column of its own, everything else is JSON.

::

    runs ──< results        one row a run (by uid), one a run and evaluation
    shapes                  what their documents have in common, once; documents name theirs by number
    sweeps                  what was asked for, one row a version of a sweep; runs name theirs by sweep_uid
    algorithms, datasets    the catalog as it was, by name and content hash; runs point to both
    slamhive_schema         one row: version of the tables, and the archive's own identity

Documents of runs and results are written and read by ``documents.py``.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Column,
    DateTime,
    Float,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    TypeDecorator,
)

if TYPE_CHECKING:
    from sqlalchemy import Dialect

VERSION = 6
"""Version of the tables below; a change to them adds one and a step to ``migrations.STEPS``."""

metadata = MetaData()
_Id = BigInteger().with_variant(Integer, "sqlite")


class JsonDocument(TypeDecorator[Any]):
    """A JSON document, kept as its text: JSONB takes twice the room, and nothing searches in documents."""

    impl = JSON(none_as_null=True)
    cache_ok = True


class UtcDateTime(TypeDecorator[datetime]):
    """An aware time, stored in UTC; SQLite knows no time zones."""

    impl = DateTime
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Drop the zone after moving to UTC; a time without one is taken as UTC."""
        if value is None or value.tzinfo is None:
            return value
        return value.astimezone(UTC).replace(tzinfo=None)

    def process_result_value(self, value: Any | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Put the zone back."""
        return None if value is None else value.replace(tzinfo=UTC)


schema_version = Table(
    "slamhive_schema",
    metadata,
    Column("version", Integer, nullable=False),
    # Tells this archive from every other one, whatever its URL: a UUID, new after a restore.
    Column("identity", String(36)),
    # While documents of an earlier version are being divided: the id of the last run that is. Otherwise none.
    Column("divided_to", BigInteger),
)

shapes = Table(
    "shapes",
    metadata,
    # What the text is known by in documents: bits of its hash, so that it is the same in every archive.
    Column("number", BigInteger, primary_key=True, autoincrement=False),
    Column("kind", String(32), nullable=False),
    Column("text", Text, nullable=False),
)


def _catalog(name: str) -> Table:
    return Table(
        name,
        metadata,
        Column("name", String(253), primary_key=True),
        Column("content_hash", String(64), primary_key=True),
        Column("labels", JsonDocument, nullable=False),
        Column("attributes", JsonDocument, nullable=False),
        Column("spec", JsonDocument, nullable=False),
        Column("stored", UtcDateTime, nullable=False),
    )


algorithms = _catalog("algorithms")
datasets = _catalog("datasets")

sweeps = Table(
    "sweeps",
    metadata,
    Column("uid", String(253), primary_key=True),
    Column("name", String(253), nullable=False, index=True),
    Column("labels", JsonDocument, nullable=False),
    Column("spec", JsonDocument, nullable=False),
    Column("evaluation", JsonDocument),
    Column("created", UtcDateTime),
    Column("namespace", String(253)),
    Column("cluster", String(253)),
    # What a search has tried so far; none for a grid.
    Column("search", JsonDocument),
)

runs = Table(
    "runs",
    metadata,
    # The order of first being stored: what iteration and paging go by.
    Column("id", _Id, primary_key=True, autoincrement=True),
    Column("uid", String(253), nullable=False, unique=True),
    Column("name", String(253), nullable=False, index=True),
    Column("sweep", String(253)),
    Column("point", Integer),
    Column("algorithm", String(253), index=True),
    Column("dataset", String(253), index=True),
    Column("sensors", String(32)),
    Column("pace", String(32)),
    Column("repetition", Integer),
    Column("seed", BigInteger),
    Column("phase", String(32), nullable=False),
    Column("reason", String(64)),
    Column("message", Text),
    Column("attempts", Integer, nullable=False),
    Column("created", UtcDateTime),
    Column("started", UtcDateTime),
    Column("finished", UtcDateTime),
    Column("content_hash", String(64), index=True),
    Column("reused_from", String(253)),
    Column("cpu_model", Text),
    Column("cpu_mean_cores", Float),
    Column("cpu_max_cores", Float),
    Column("cpu_seconds", Float),
    Column("memory_peak_bytes", BigInteger),
    Column("wall_seconds", Float),
    Column("algorithm_hash", String(64)),
    Column("dataset_hash", String(64)),
    Column("labels", JsonDocument, nullable=False),
    Column("spec", JsonDocument, nullable=False),
    Column("attributes", JsonDocument, nullable=False),
    Column("usage", JsonDocument),
    Column("frames", JsonDocument),
    Column("metrics", JsonDocument, nullable=False),
    Column("trajectory", JsonDocument),
    Column("provenance", JsonDocument, nullable=False),
    Column("folder", Text),
    Column("log_tail", Text),
    Column("sweep_uid", String(253)),
    Column("namespace", String(253)),
    Column("cluster", String(253)),
    Column("evaluations", JsonDocument, nullable=False, server_default="[]"),
    # Words of people, which may change at any time, unlike all else: `remarks`.
    Column("note", Text),
    Column("tags", Text),
    Column("noted", UtcDateTime),
    Index("runs_of_sweep", "sweep", "phase"),
    Index("runs_of_sweep_uid", "sweep_uid", "phase"),
    sqlite_autoincrement=True,
)

results = Table(
    "results",
    metadata,
    Column("run_id", _Id, ForeignKey("runs.id", ondelete="CASCADE"), primary_key=True),
    Column("evaluation", String(253), primary_key=True),
    Column("outcome", String(32), nullable=False),
    Column("coverage", Float),
    Column("alignment", String(32)),
    Column("scale", Float),
    Column("ate_rmse", Float),
    Column("rpe_rmse", Float),
    Column("values", JsonDocument, nullable=False),
)
