# SPDX-License-Identifier: Apache-2.0
"""Translation between the language's records and rows of the tables."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self

from pydantic import Field

from slamhive.archive.remarks import Remarks, split
from slamhive.model.base import Model
from slamhive.model.canonical import digest
from slamhive.model.results import Outcome, Phase, Reason, Result, RunRecord
from slamhive.model.search import SearchRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from slamhive.model.algorithm import Algorithm
    from slamhive.model.dataset import Dataset


class SweepRecord(Model):
    """A version of a sweep as it was asked for.

    Attributes:
        evaluation: the settings its runs are measured by.
        created: when it was last asked for: of the sweeps of a name, the latest is the current one.
        namespace, cluster: where; None on a workstation.
        search: what it has tried so far; None where it is no search, or has not begun.
    """

    uid: str
    name: str
    labels: dict[str, str] = Field(default_factory=dict)
    spec: dict[str, Any]
    evaluation: dict[str, Any] | None = None
    created: datetime | None = None
    namespace: str | None = None
    cluster: str | None = None
    search: SearchRecord | None = None


class ReusableRun(NamedTuple):
    """A run that others may take over.

    Attributes:
        uid: its identity.
        spec: what it ran with.
    """

    uid: str
    spec: dict[str, Any]


class CatalogEntry(Model):
    """An Algorithm or Dataset as it was when a run used it."""

    kind: Literal["Algorithm", "Dataset"]
    name: str
    labels: dict[str, str] = Field(default_factory=dict)
    attributes: dict[str, Any] = Field(default_factory=dict)
    spec: dict[str, Any]

    @classmethod
    def of(cls, resource: Algorithm | Dataset) -> Self:
        """Return the snapshot of a catalog object."""
        return cls(
            kind=resource.kind,
            name=resource.name,
            labels=resource.metadata.labels,
            attributes=getattr(resource.spec, "attributes", {}),
            spec=resource.spec.model_dump(mode="json", by_alias=True),
        )

    @cached_property
    def content_hash(self) -> str:
        """Return the hash that tells this entry from others of its name."""
        return digest(clean([self.labels, self.attributes, self.spec]))


@dataclass(frozen=True)
class FinishedPoint:
    """End of a finished run of a sweep, with the number of its results, and its note and tags."""

    index: int | None
    phase: Phase
    reason: Reason | None
    results: int
    remarks: Remarks


@dataclass(frozen=True)
class EarlierRun:
    """A run of any version of a sweep, as far as it takes to tell what has changed since.

    Attributes:
        uid, sweep_uid: its identity, and that of the version of the sweep that it belongs to.
        index: its point in that version.
        phase, reason: how it ended.
        finished: when.
        wall_seconds: how long its program ran.
        content_hash: what tells it from other experiments.
        origin: what that was made from, by the names of the fields of the provenance.
    """

    uid: str
    sweep_uid: str
    index: int | None
    phase: Phase
    reason: Reason | None
    finished: datetime | None
    wall_seconds: float | None
    content_hash: str | None
    origin: dict[str, str | None]


class Cost(NamedTuple):
    """CPU, memory and time that a finished run took, with what they depend on; forecasts are made from these.

    Attributes:
        uid, algorithm, dataset, spec: which run.
        reason: why it failed; None: it didn't.
        cpu_seconds, wall_seconds, memory_bytes: what its program took.
        cpu_model: where.
        content_hash, algorithm_hash, dataset_sha256: what it was made from.
        folder: where its files were.
        prepared: what it was given of its recording, as its provenance has it.
        created, started: when it was begun, and its program; on a cluster only the latter.
        sweep_uid: identity of its sweep.
    """

    uid: str
    algorithm: str
    dataset: str
    spec: dict[str, Any]
    reason: str | None
    cpu_seconds: float | None
    wall_seconds: float | None
    memory_bytes: int | None
    cpu_model: str | None
    content_hash: str | None
    folder: str | None
    prepared: dict[str, Any] | None
    algorithm_hash: str | None
    dataset_sha256: str | None
    created: datetime | None
    started: datetime | None
    sweep_uid: str | None


class Totals(NamedTuple):
    """Sums over finished runs.

    Attributes:
        runs: their number.
        reused: those that took an equal run's result.
        evaluated: those with a result.
        cpu_seconds: CPU time of those that computed.
    """

    runs: int
    reused: int
    evaluated: int
    cpu_seconds: float


def clean(value: Any) -> Any:
    """Return a JSON value that every database takes: no NaN, no infinity, no NUL, no lone surrogate."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str):
        return clean_text(value)
    if isinstance(value, dict):
        return {clean_text(str(key)): clean(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [clean(item) for item in value]
    return value


def clean_text(text: str) -> str:
    """Return a text without the characters that databases refuse."""
    if text.isascii() and "\0" not in text:
        return text
    return text.replace("\0", "").encode("utf-8", "replace").decode("utf-8")


_SAME = ("uid", "name", "sweep", "sweep_uid", "namespace", "cluster")
_REFERENCES = ("algorithmRef", "datasetRef")
_ORIGIN, _SUBJECT = "origin", "subject"


def run_row(record: RunRecord) -> dict[str, Any]:
    """Return a run's columns, without those of its results and of the catalog."""
    spec, usage = record.spec, record.usage
    row: dict[str, Any] = {
        name: getattr(record, name)
        for name in (*_SAME, "message", "attempts", "created", "started", "finished")
    }
    row |= {
        "evaluations": [one.as_json() for one in record.evaluations],
        "point": record.index,
        "algorithm": _ref(spec, "algorithmRef"),
        "dataset": _ref(spec, "datasetRef"),
        "sensors": spec.get("sensors"),
        "pace": (spec.get("input") or {}).get("pace"),
        "repetition": spec.get("repetition"),
        "seed": spec.get("seed"),
        "phase": record.phase.value,
        "reason": record.reason.value if record.reason else None,
        "content_hash": record.provenance.content_hash,
        "reused_from": record.provenance.reused_from,
        "cpu_model": record.provenance.cpu_model,
        "cpu_mean_cores": usage.cpu.mean_cores if usage else None,
        "cpu_max_cores": usage.cpu.max_cores if usage else None,
        "cpu_seconds": usage.cpu.seconds if usage else None,
        "memory_peak_bytes": usage.memory.peak_bytes if usage else None,
        "wall_seconds": usage.wall_seconds if usage else None,
        "labels": record.labels,
        "spec": spec,
        "attributes": record.attributes,
        "metrics": record.metrics,
        "folder": record.folder,
        "log_tail": record.log_tail,
        "usage": usage.as_json() if usage else None,
        "frames": record.frames.as_json() if record.frames else None,
        "trajectory": record.trajectory.as_json() if record.trajectory else None,
        "provenance": record.provenance.as_json() | _origin_documents(record),
    }
    row |= Remarks.of(record).row
    return {key: clean(value) for key, value in row.items()}


def _origin_documents(record: RunRecord) -> dict[str, Any]:
    """Return the origin of a run as its provenance holds it: few runs have one, so it has no column."""
    if record.origin is None:
        return {}
    told = record.origin.as_json()
    # Apart, as tables show the rest of it.
    return {_SUBJECT: told.pop(_SUBJECT, None), _ORIGIN: told}


def _split_provenance(held: Any) -> dict[str, Any]:
    """Return the fields of a record that a row's provenance holds."""
    if not isinstance(held, dict) or _ORIGIN not in held:
        return {"provenance": held}
    provenance = dict(held)
    origin, subject = provenance.pop(_ORIGIN), provenance.pop(_SUBJECT, None)
    return {"provenance": provenance, "origin": {**origin, _SUBJECT: subject}}


def _ref(spec: Mapping[str, Any], field: str) -> str | None:
    reference = spec.get(field)
    return reference.get("name") if isinstance(reference, dict) else None


def result_row(run_id: int, result: Result) -> dict[str, Any]:
    """Return a result's columns."""
    values = result.values
    ate, rpe = values.get("ate"), values.get("rpe")
    first = rpe[0] if isinstance(rpe, list) and rpe else None
    row = {
        "run_id": run_id,
        "evaluation": result.evaluation,
        "outcome": result.outcome.value,
        "coverage": result.coverage,
        "alignment": values.get("alignment") if isinstance(values.get("alignment"), str) else None,
        "scale": _number(values.get("scale")),
        "ate_rmse": _number(ate.get("rmse")) if isinstance(ate, dict) else None,
        "rpe_rmse": _number(first.get("rmse")) if isinstance(first, dict) else None,
        "values": values,
    }
    return {key: clean(value) for key, value in row.items()}


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def to_record(run: Mapping[str, Any], results: Iterable[Result]) -> RunRecord:
    """Return the record of a row of ``runs``.

    Raises:
        ValueError: the row is none of a run.
    """
    require_parts(run["spec"])
    fields = (*_SAME, "message", "attempts", "created", "started", "finished", "evaluations")
    return RunRecord.model_validate(
        {name: run[name] for name in fields}
        | {
            name: run[name]
            for name in ("labels", "spec", "attributes", "phase", "reason", "usage", "frames", "metrics")
        }
        | {name: run[name] for name in ("trajectory", "folder", "log_tail")}
        | _split_provenance(run["provenance"])
        | {"index": run["point"], "results": list(results)}
        | {"note": run["note"], "tags": split(run["tags"]), "noted": run["noted"]}
    )


def require_parts(spec: Any) -> None:
    """Check the parts of a spec that everybody takes to be what they are.

    Raises:
        ValueError: one is something else.
    """
    for name in (*_REFERENCES, "parameters", "input", "resources"):
        part = spec.get(name) if isinstance(spec, dict) else None
        if part is not None and not isinstance(part, dict):
            raise ValueError(f"spec.{name}: expected an object, found {str(part)[:40]!r}")
        if part is not None and name in _REFERENCES and not isinstance(part.get("name"), str):
            raise ValueError(f"spec.{name}: expected a name, found {str(part.get('name'))[:40]!r}")


def to_result(row: Mapping[str, Any]) -> Result:
    """Return the record of a row of ``results``."""
    return Result(
        evaluation=row["evaluation"],
        outcome=Outcome(row["outcome"]),
        coverage=row["coverage"],
        values=row["values"],
    )


def catalog_row(entry: CatalogEntry) -> dict[str, Any]:
    """Return a catalog entry's columns."""
    return {
        "name": entry.name,
        "content_hash": entry.content_hash,
        "labels": clean(entry.labels),
        "attributes": clean(entry.attributes),
        "spec": clean(entry.spec),
        "stored": datetime.now(UTC),
    }
