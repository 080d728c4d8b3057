# SPDX-License-Identifier: Apache-2.0
"""Live objects as the dashboard keeps them: flat rows of runs, sweeps in short, the catalog's specs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from pydantic import ValidationError

from slamhive.analysis import flatten
from slamhive.analysis.columns import Column, times
from slamhive.analysis.frame import LEFT_OUT
from slamhive.archive.records import CatalogEntry
from slamhive.kube.reconciling.records import record_of
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from slamhive.analysis.flattening import Row
    from slamhive.kube.kinds import Kind

Object = dict[str, Any]

_TIMES = frozenset({"created", "started", "finished"})
_PHASES = {"pending": "Pending", "running": "Running", "succeeded": "Succeeded", "failed": "Failed"}
_NO_COLUMNS = frozenset({"folder", *LEFT_OUT})


@dataclass(frozen=True)
class LiveRun:
    """A MappingRun in short.

    Attributes:
        namespace, name, uid: which.
        version: the object's version.
        dataset: name of its Dataset, whose attributes it has.
        live: whether it has not finished.
        rows: flat rows, one an evaluation.
    """

    namespace: str
    name: str
    uid: str
    version: str
    dataset: str | None
    live: bool
    rows: tuple[Row, ...]


def narrow_run(obj: Object) -> LiveRun | None:
    """Return a MappingRun in short; None for one that does not follow the language."""
    try:
        record = record_of(obj)
        rows = flatten(record)
    except (ValidationError, KeyError, TypeError, ValueError):
        return None
    kept = tuple(
        {
            name: value
            for name, value in row.items()
            if value is not None and not isinstance(value, dict) and name not in _NO_COLUMNS
        }
        for row in rows
    )
    metadata = obj["metadata"]
    return LiveRun(
        namespace=metadata.get("namespace", ""),
        name=record.name,
        uid=record.uid,
        version=str(metadata.get("resourceVersion", "")),
        dataset=kept[0].get("dataset"),
        live=not Phase(record.phase).is_finished,
        rows=kept,
    )


def narrow_other(obj: Object) -> Object:
    """Return another object without what nobody looks at."""
    metadata = obj.get("metadata") or {}
    status = {name: value for name, value in (obj.get("status") or {}).items() if name != "points"}
    names = ("name", "namespace", "uid", "resourceVersion", "creationTimestamp", "labels")
    kept = {name: metadata[name] for name in names if name in metadata}
    return {"metadata": kept, "spec": obj.get("spec") or {}, "status": status}


def sweep_in_short(obj: Object) -> dict[str, Any]:
    """Return a Sweep as the snapshot holds it."""
    status, metadata = obj["status"], obj["metadata"]
    return {
        "uid": metadata.get("uid"),
        "created": metadata.get("creationTimestamp"),
        "live": not status.get("completionTime") and not obj["spec"].get("suspend"),
        "total": status.get("total"),
        "phases": {word: status[name] for name, word in _PHASES.items() if status.get(name)},
        "spec": obj["spec"],
        "conditions": status.get("conditions") or [],
        "best": status.get("best") or [],
    }


def catalog_entry(kind: Literal["Algorithm", "Dataset"], obj: Object) -> CatalogEntry:
    """Return an Algorithm or a Dataset as the archive would hold it."""
    return CatalogEntry(
        kind=kind,
        name=obj["metadata"]["name"],
        labels=obj["metadata"].get("labels") or {},
        attributes=obj["spec"].get("attributes") or {},
        spec=obj["spec"],
    )


def columns_of_runs(
    runs: Iterable[LiveRun],
    numbers: Mapping[str, int],
    attributes: Mapping[tuple[str, str], Mapping[str, Any]],
) -> tuple[dict[str, Column], int]:
    """Return live runs as columns, with their number of rows.

    Args:
        runs: the runs.
        numbers: the ``id`` of each by its UID.
        attributes: of Datasets by (namespace, name).
    """
    rows: list[Row] = []
    for run in runs:
        found = attributes.get((run.namespace, run.dataset or ""), {})
        more = {f"dataset.attributes.{name}": value for name, value in found.items()}
        rows += [{"id": numbers[run.uid], **more, **row} for row in run.rows]
    names = dict.fromkeys(name for row in rows for name in row)
    columns = {}
    for name in names:
        values = [row.get(name) for row in rows]
        columns[name] = times([_naive(value) for value in values]) if name in _TIMES else Column.of(values)
    return columns, len(rows)


def _naive(text: str | None) -> str | None:
    """Return an ISO 8601 text in UTC without its zone, as numpy reads it."""
    return text.removesuffix("Z").removesuffix("+00:00") if text else None


@dataclass
class Cluster:
    """All live objects.

    Attributes:
        runs: by namespace, then UID.
        others: by kind and namespace, then name.
        changes: grows with each change.
        removed: whether runs went since it was last set to False.
    """

    runs: dict[str, dict[str, LiveRun]] = field(default_factory=dict)
    others: dict[tuple[Kind, str], dict[str, Object]] = field(default_factory=dict)
    changes: int = 0
    removed: bool = False

    def reset_runs(self, namespace: str, items: list[LiveRun | None]) -> None:
        """Take a full list of runs."""
        fresh = {item.uid: item for item in items if item is not None}
        before = self.runs.get(namespace, {})
        if {uid: run.version for uid, run in fresh.items()} != {
            uid: run.version for uid, run in before.items()
        }:
            self.changes += 1
        self.removed |= bool(before.keys() - fresh.keys())
        self.runs[namespace] = fresh

    def change_run(self, namespace: str, event: str, run: LiveRun | None) -> None:
        """Take a change of one run."""
        if run is None:
            return
        held = self.runs.setdefault(namespace, {})
        self.changes += 1
        if event == "DELETED":
            held.pop(run.uid, None)
            self.removed = True
        else:
            held[run.uid] = run

    def reset_others(self, kind: Kind, namespace: str, items: list[Object]) -> None:
        """Take a full list of another kind."""
        fresh = {item["metadata"]["name"]: item for item in items}
        if fresh != self.others.get((kind, namespace)):
            self.changes += 1
        self.others[kind, namespace] = fresh

    def change_other(self, kind: Kind, namespace: str, event: str, obj: Object) -> None:
        """Take a change of another kind."""
        held = self.others.setdefault((kind, namespace), {})
        self.changes += 1
        if event == "DELETED":
            held.pop(obj["metadata"]["name"], None)
        else:
            held[obj["metadata"]["name"]] = obj

    def of(self, kind: Kind) -> list[Object]:
        """Return all objects of another kind."""
        return [obj for (held, _), objects in self.others.items() if held is kind for obj in objects.values()]

    def all_runs(self) -> list[LiveRun]:
        """Return all runs."""
        return [run for held in self.runs.values() for run in held.values()]
