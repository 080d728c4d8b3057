# SPDX-License-Identifier: Apache-2.0
"""Live objects as the dashboard keeps them: flat rows of runs, sweeps in short, the catalog's specs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from pydantic import ValidationError

from slamhive.analysis.flattening import Results, columns_of_runs
from slamhive.analysis.measuring import intended_evaluations
from slamhive.archive.records import CatalogEntry, run_row
from slamhive.kube.records import record_of
from slamhive.model.dataset import DatasetSpec
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.sensors import SensorMode

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from slamhive.analysis.flattening import Part
    from slamhive.kube.api.kinds import Kind, Object
    from slamhive.model.results import Result


_PHASES = {"pending": "Pending", "running": "Running", "succeeded": "Succeeded", "failed": "Failed"}


@dataclass(frozen=True)
class LiveRun:
    """A MappingRun in short.

    Attributes:
        namespace, name, uid: which.
        version: the object's version.
        live: whether it has not finished.
        row: what the archive would hold of it.
        results: what was measured of it.
    """

    namespace: str
    name: str
    uid: str
    version: str
    live: bool
    row: dict[str, Any]
    results: tuple[Result, ...]

    @property
    def dataset(self) -> str:
        """Return the name of its Dataset, whose attributes it has."""
        return str(self.row["dataset"])


def narrow_run(obj: Object) -> LiveRun | None:
    """Return a MappingRun in short; None for one that does not follow the language."""
    try:
        record = record_of(obj)
        row = run_row(record) | {"folder": None}
    except (ValidationError, KeyError, TypeError, ValueError):
        return None
    metadata = obj["metadata"]
    return LiveRun(
        namespace=metadata.get("namespace", ""),
        name=record.name,
        uid=record.uid,
        version=str(metadata.get("resourceVersion", "")),
        live=not record.phase.is_finished,
        row=row,
        results=tuple(record.results),
    )


def narrow_other(obj: Object) -> Object:
    """Return an object without the parts that are not used here."""
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
        "settings": _settings(obj["spec"].get("evaluation") or {}),
        "created": metadata.get("creationTimestamp"),
        "live": not status.get("completionTime") and not obj["spec"].get("suspend"),
        "total": status.get("total"),
        "phases": {word: status[name] for name, word in _PHASES.items() if status.get(name)},
        "spec": obj["spec"],
        "conditions": status.get("conditions") or [],
        "best": status.get("best") or [],
        "search": status.get("search"),
        "share": status.get("share"),
    }


def _settings(evaluation: Object) -> EvaluationSettings | None:
    try:
        return EvaluationSettings.model_validate(evaluation)
    except ValidationError:
        return None


def catalog_entry(kind: Literal["Algorithm", "Dataset"], obj: Object) -> CatalogEntry:
    """Return an Algorithm or a Dataset as the archive would hold it."""
    return CatalogEntry(
        kind=kind,
        name=obj["metadata"]["name"],
        labels=obj["metadata"].get("labels") or {},
        attributes=obj["spec"].get("attributes") or {},
        spec=obj["spec"],
    )


def columns_of_live(
    runs: Iterable[LiveRun],
    numbers: Mapping[str, int],
    datasets: Mapping[tuple[str, str], Object],
    settings: Mapping[str, EvaluationSettings],
    cluster: str | None = None,
) -> Part:
    """Return live runs as columns, with their number of rows.

    Args:
        runs: the runs.
        numbers: the ``id`` of each by its UID.
        datasets: specs of Datasets by (namespace, name).
        settings: how Sweeps are measured, by their UIDs.
        cluster: what tells the cluster from others.
    """
    rows: list[dict[str, Any]] = []
    measured: list[tuple[int, Result]] = []
    intended = _Intended(datasets, settings)
    for run in runs:
        number = numbers[run.uid]
        spec = datasets.get((run.namespace, run.dataset), {})
        more = {"attributes": spec.get("attributes") or {}, "evaluations": intended.of(run)}
        rows.append({**run.row, "id": number, "cluster": cluster, **more})
        measured += [(number, result) for result in run.results]
    names = rows[0] if rows else {}
    return columns_of_runs({name: [row[name] for row in rows] for name in names}, Results.of(measured))


class _Intended:
    """The evaluations that live runs are meant to be measured by, found out once for runs that are alike."""

    def __init__(
        self, datasets: Mapping[tuple[str, str], Object], settings: Mapping[str, EvaluationSettings]
    ) -> None:
        self._datasets = datasets
        self._settings = settings
        self._known: dict[tuple[Any, ...], list[dict[str, Any]]] = {}

    def of(self, run: LiveRun) -> list[dict[str, Any]]:
        """Return them as the archive would hold them."""
        owner, sensors = run.row["sweep_uid"], run.row["sensors"]
        if not run.row["spec"].get("evaluate", True) or sensors not in set(SensorMode):
            return []
        key = (owner, sensors, run.namespace, run.dataset)
        if key not in self._known:
            settings = self._settings.get(owner) if owner else EvaluationSettings()
            mode, dataset = SensorMode(sensors), self._dataset(run)
            found = intended_evaluations(settings, mode, dataset) if settings else []
            self._known[key] = [one.as_json() for one in found]
        return self._known[key]

    def _dataset(self, run: LiveRun) -> DatasetSpec | None:
        try:
            return DatasetSpec.model_validate(self._datasets[run.namespace, run.dataset])
        except (KeyError, ValidationError):
            return None


@dataclass
class LiveObjects:
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
