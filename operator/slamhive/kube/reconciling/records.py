# SPDX-License-Identifier: Apache-2.0
"""Between MappingRuns as the API holds them and the records of the archive. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.analysis.measuring import intended_evaluations
from slamhive.kube.kinds import Kind, Label
from slamhive.kube.status import phase_of, result_of
from slamhive.model.results import Reason, RunRecord
from slamhive.model.sensors import SensorMode

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.model.dataset import Dataset
    from slamhive.model.evaluation import EvaluationSettings

_TAKEN = (
    "message",
    "attempts",
    "usage",
    "frames",
    "metrics",
    "trajectory",
    "provenance",
    "folder",
    "logTail",
)


def record_of(
    run: Mapping[str, Any], spec: Mapping[str, Any] | None = None, attributes: Mapping[str, Any] | None = None
) -> RunRecord:
    """Return the record of a MappingRun.

    Args:
        run: the object.
        spec: its spec with all defaults; default: as it stands in the object.
        attributes: the free attributes of its Dataset.
    """
    meta, status = run["metadata"], run.get("status") or {}
    labels = meta.get("labels") or {}
    point = labels.get(Label.POINT)
    reason = status.get("reason")
    return RunRecord.model_validate(
        {key: status[key] for key in _TAKEN if status.get(key) is not None}
        | {
            "uid": meta["uid"],
            "name": meta["name"],
            "sweep": labels.get(Label.SWEEP),
            "sweepUid": _owner(run),
            "namespace": meta.get("namespace"),
            "index": int(point) if point is not None and point.isdecimal() else None,
            "labels": labels,
            "spec": dict(spec or run["spec"]),
            "attributes": dict(attributes or {}),
            "phase": phase_of(status),
            "reason": reason if reason in set(Reason) else None,
            "created": meta.get("creationTimestamp"),
            "started": status.get("startTime"),
            "finished": status.get("completionTime"),
            "results": [result_of(item) for item in status.get("results") or ()],
        }
    )


def with_evaluations(
    record: RunRecord, settings: EvaluationSettings | None, dataset: Dataset | None
) -> RunRecord:
    """Return a record that says what its run was meant to be measured by.

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


def _owner(run: Mapping[str, Any]) -> str | None:
    """Return the UID of the Sweep that made a run."""
    owners = run["metadata"].get("ownerReferences") or ()
    return next((owner["uid"] for owner in owners if owner.get("kind") == Kind.SWEEP), None)


def image_digest(image_id: str) -> str:
    """Return the part of an imageID that names the image's content."""
    return image_id.rpartition("@")[2] if "@" in image_id else image_id


def pinned_digest(image: str) -> str | None:
    """Return the digest that an image's name carries, if it does."""
    name, at, digest = image.rpartition("@")
    return digest if at and name and digest.startswith("sha256:") else None
