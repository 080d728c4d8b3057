# SPDX-License-Identifier: Apache-2.0
"""Translation between MappingRuns as the API holds them and the records of the archive. Pure."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from slamhive.analysis.measuring import intended_evaluations
from slamhive.archive.remarks import Remarks
from slamhive.kube.api.kinds import Kind, Label, annotations_of, labels_of, owners_of
from slamhive.kube.status import result_of
from slamhive.model.base import GROUP
from slamhive.model.results import NOT_EVALUATED, Phase, Reason, RunRecord
from slamhive.model.sensors import SensorMode
from slamhive.model.status import MappingRunStatus

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.model.dataset import Dataset
    from slamhive.model.evaluation import EvaluationSettings

NOT_EVALUABLE = f"{GROUP}/not-evaluable"
"""Annotation of a run that says of each Evaluation, by its name, why the run could not be measured by it."""

_TAKEN = ("attempts", "usage", "frames", "metrics", "trajectory", "provenance", "folder", "log_tail")


def record_of(
    run: Mapping[str, Any], spec: Mapping[str, Any] | None = None, attributes: Mapping[str, Any] | None = None
) -> RunRecord:
    """Return the record of a MappingRun.

    Args:
        run: the object.
        spec: its spec with all defaults; default: as it stands in the object.
        attributes: the free attributes of its Dataset.
    """
    meta, status = run["metadata"], MappingRunStatus.of(run)
    labels = labels_of(run)
    point = labels.get(Label.POINT)
    taken = {name: getattr(status, name) for name in _TAKEN}
    said = Remarks.of_annotations(annotations_of(run))
    return RunRecord.model_validate(
        {name: value for name, value in taken.items() if value is not None}
        | {
            "uid": meta["uid"],
            "name": meta["name"],
            "sweep": labels.get(Label.SWEEP),
            "sweepUid": (sweep_of(run) or {}).get("uid"),
            "namespace": meta.get("namespace"),
            # Labels can be edited by anybody.
            "index": int(point) if point is not None and point.isdecimal() else None,
            "labels": labels,
            "spec": dict(spec or run["spec"]),
            "attributes": dict(attributes or {}),
            "phase": status.phase or Phase.PENDING,
            "message": status.message or _why_not_measured(run, status),
            "reason": status.reason if status.reason in set(Reason) else None,
            "created": meta.get("creationTimestamp"),
            "started": status.start_time,
            "finished": status.completion_time,
            "results": [result_of(entry.as_json()) for entry in status.results],
            "note": said.note,
            "tags": list(said.tags),
        }
    )


def with_evaluations(
    record: RunRecord, settings: EvaluationSettings | None, dataset: Dataset | None
) -> RunRecord:
    """Return a record with its run's intended evaluations.

    Args:
        record: the run.
        settings: how its Sweep, or it alone, is measured; None when that isn't known any more.
        dataset: its Dataset; None likewise.
    """
    sensors = record.spec.get("sensors")
    if settings is None or not record.spec.get("evaluate", True) or sensors not in set(SensorMode):
        return record
    given = dataset.spec if dataset else None
    return record.replace(evaluations=intended_evaluations(settings, SensorMode(sensors), given))


def problems_noted(run: Mapping[str, Any]) -> dict[str, Any]:
    """Return the notes on why a run could not be measured, by the Evaluation's name; empty for its own."""
    try:
        found = json.loads(annotations_of(run).get(NOT_EVALUABLE, "{}"))
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _why_not_measured(run: Mapping[str, Any], status: MappingRunStatus) -> str | None:
    """Return a workstation's message on such a run; None of one that was measured."""
    found = None if status.results else problems_noted(run).get("")
    return f"{NOT_EVALUATED}{found.get('why')}" if isinstance(found, dict) else None


def sweep_of(run: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the reference to the Sweep that made a run; None where none did."""
    # Not the label: a Sweep that was deleted and made anew has the same name.
    return next((owner for owner in owners_of(run) if owner.get("kind") == Kind.SWEEP), None)
