# SPDX-License-Identifier: Apache-2.0
"""The status of each kind, and the columns that `kubectl get` prints of it.

Statuses are written by the operator alone, so they carry types and bounds but no rules.
"""

from __future__ import annotations

from typing import Any

from slamhive.model.reported import MOST_RPE, ErrorFigures
from slamhive.model.results import Frames, Outcome, Phase, Provenance, TrajectoryInfo, Usage
from slamhive.model.sweep import MAX_POINTS

Schema = dict[str, Any]

_NAME_LENGTH = 253
_TEXT_LENGTH = 4096
MOST_RESULTS = 32
"""Evaluations whose results a MappingRun's status holds."""
BEST_LENGTH = 10
"""Runs that a Sweep's status shows as its best."""


def _object(description: str, /, *required: str, **properties: Schema) -> Schema:
    body: Schema = {"type": "object", "description": description, "properties": properties}
    return body | ({"required": [*required]} if required else {})


def _text(description: str, length: int = _NAME_LENGTH, **more: Any) -> Schema:
    return {"type": "string", "description": description, "maxLength": length, **more}


def _count(description: str) -> Schema:
    return {"type": "integer", "format": "int64", "minimum": 0, "description": description}


def _number(description: str) -> Schema:
    return {"type": "number", "description": description}


def _time(description: str) -> Schema:
    return {"type": "string", "format": "date-time", "description": description}


_CONDITION = _object(
    "One aspect of the state, as all Kubernetes objects have them.",
    "type",
    "status",
    "lastTransitionTime",
    "reason",
    "message",
    type=_text("Name of the aspect.", 316),
    status=_text("Whether it holds.", 16, enum=["True", "False", "Unknown"]),
    reason=_text("Why, in one word.", 1024),
    message=_text("Why, in a sentence.", 32768),
    observedGeneration=_count("Generation of the spec that it was found for."),
    lastTransitionTime=_time("When the status last changed."),
)
_CONDITIONS: Schema = {
    "type": "array",
    "maxItems": 16,
    "description": "The truth about the object, by aspect.",
    "items": _CONDITION,
    "x-kubernetes-list-type": "map",
    "x-kubernetes-list-map-keys": ["type"],
}
_COMMON: dict[str, Schema] = {
    "conditions": _CONDITIONS,
    "observedGeneration": _count("Generation of the spec that the status belongs to."),
}
_ERROR = _object(
    "Statistics of an error.",
    **{name: _number(f"{name} of the error.") for name in ErrorFigures.model_fields},
) | {"x-kubernetes-preserve-unknown-fields": True}
_RESULT = _object(
    "What one evaluation found.",
    "evaluation",
    "outcome",
    evaluation=_text("Name of the Evaluation."),
    outcome=_text("What became of the run.", 16, enum=[str(word) for word in Outcome]),
    coverage=_number("Share of the ground truth's path that the estimate covers."),
    scale=_number("Scale of the alignment."),
    ate=_ERROR | {"description": "Absolute trajectory error in m."},
    rpe={
        "type": "array",
        "maxItems": MOST_RPE,
        "description": "Relative pose errors, in the order of the Evaluation.",
        "items": {"type": "object", "x-kubernetes-preserve-unknown-fields": True},
    },
) | {"x-kubernetes-preserve-unknown-fields": True}


def statuses(convert: Any) -> dict[str, Schema]:
    """Return the schema of each kind's status.

    Args:
        convert: function from a model to a structural schema.
    """
    times = {
        "startTime": _time("When the first run or attempt started."),
        "completionTime": _time("When it had finished."),
    }
    run = _object(
        "What happened to the run.",
        **_COMMON,
        phase=_text("Where the run is, for printing.", 16, enum=[str(word) for word in Phase]),
        reason=_text("Why it is there, in one word.", 64),
        message=_text("Why it is there, in a sentence.", _TEXT_LENGTH),
        attempts=_count("Attempts made so far."),
        faults=_count("Faults of the machine that attempts met."),
        judged=_count("Number of the last attempt whose fault is counted."),
        notBefore=_time("When another attempt may begin."),
        variant=_text("Prepared form of the dataset that it reads."),
        folder=_text("Its folder on the results volume.", 1024),
        logTail=_text("Last lines that the algorithm printed.", _TEXT_LENGTH),
        metrics={
            "type": "object",
            "description": "The algorithm's own figures.",
            "x-kubernetes-preserve-unknown-fields": True,
        },
        display=_object(
            "Figures as kubectl prints them.",
            ate=_text("RMSE of the absolute trajectory error of the first evaluation.", 32),
            cpu=_text("Mean number of cores.", 32),
            memory=_text("Peak of memory.", 32),
        ),
        usage=convert(Usage) | {"description": "What the algorithm alone took of the machine."},
        frames=convert(Frames) | {"description": "Frames as the algorithm counted them."},
        trajectory=convert(TrajectoryInfo) | {"description": "The estimated trajectory."},
        results={
            "type": "array",
            "maxItems": MOST_RESULTS,
            "description": "What evaluations found, by evaluation.",
            "items": _RESULT,
            "x-kubernetes-list-type": "map",
            "x-kubernetes-list-map-keys": ["evaluation"],
        },
        provenance=convert(Provenance) | {"description": "What exactly produced the result."},
        **times,
    )
    counts = ("total", "pending", "running", "succeeded", "failed", "reused", "evaluated")
    best = _object(
        "A run with a small error.",
        "name",
        name=_text("Name of the run."),
        index=_count("Index of its point."),
        ate=_number("RMSE of its absolute trajectory error in m."),
        coverage=_number("Its coverage."),
        algorithm=_text("Its algorithm."),
        dataset=_text("Its dataset."),
    )
    sweep = _object(
        "How far the Sweep is.",
        **_COMMON,
        **{name: _count(f"Number of runs: {name}.") for name in counts},
        phase=_text("Where the Sweep stands, for printing.", 32),
        progress=_text("Runs that are done, of all.", 32),
        display=_object(
            "Figures as kubectl prints them.",
            ate=_text("RMSE of the absolute trajectory error of the best run.", 32),
        ),
        cpuSeconds=_number("CPU time of all finished runs in s."),
        selected={
            "type": "array",
            "maxItems": 32,
            "description": "What each selector of the matrix chose when the Sweep began.",
            "items": _object(
                "What one axis runs over.",
                axis=_count("Index of the axis."),
                names={
                    "type": "array",
                    "maxItems": MAX_POINTS,
                    "description": "Names of catalog entries.",
                    "items": _text("Name of an entry."),
                },
            ),
        },
        best={
            "type": "array",
            "maxItems": BEST_LENGTH,
            "description": "Tracked runs with the smallest errors.",
            "items": best,
        },
        points=_text("State of each point, two bits a point, in base64.", MAX_POINTS // 2, format="byte"),
        **times,
    )
    evaluation = _object(
        "How far the Evaluation is.",
        **_COMMON,
        runs=_count("Runs that it selects."),
        evaluated=_count("Runs evaluated."),
        failed=_count("Runs that could not be evaluated."),
        summary={
            "type": "object",
            "description": "Figures over all runs.",
            "x-kubernetes-preserve-unknown-fields": True,
        },
    )
    variant = _object(
        "A prepared form of the recording.",
        "name",
        name=_text("Name of the variant: its content hash."),
        phase=_text("Whether it is ready.", 16, enum=["Pending", "Preparing", "Ready", "Failed"]),
        message=_text("Why it is not.", _TEXT_LENGTH),
        folder=_text("Its folder on the data volume.", 1024),
        description={
            "type": "object",
            "description": "Window, rates and calibration after preparation.",
            "x-kubernetes-preserve-unknown-fields": True,
        },
        changedTime=_time("When its phase last changed."),
        sizeBytes=_count("Size on the volume."),
        lastUsedTime=_time("When a run last used it."),
    )
    dataset = _object(
        "What is prepared of the dataset.",
        **_COMMON,
        variants={
            "type": "array",
            "maxItems": 1000,
            "description": "Prepared forms, by name.",
            "items": variant,
            "x-kubernetes-list-type": "map",
            "x-kubernetes-list-map-keys": ["name"],
        },
    )
    return {
        "Algorithm": _object(
            "State of the Algorithm.",
            **_COMMON,
            imageID=_text("Image that its tag meant when a run last used it.", 1024),
        ),
        "Dataset": dataset,
        "Evaluation": evaluation,
        "MappingRun": run,
        "Sweep": sweep,
    }


def _column(name: str, path: str, kind: str = "string", priority: int = 0) -> Schema:
    column: Schema = {"name": name, "type": kind, "jsonPath": path}
    return column | ({"priority": priority} if priority else {})


_AGE = _column("Age", ".metadata.creationTimestamp", "date")
_STATUS_OF_RUN = [
    _column("Phase", ".status.phase"),
    _column("Algorithm", ".spec.algorithmRef.name"),
    _column("Dataset", ".spec.datasetRef.name"),
    _column("Outcome", ".status.results[0].outcome"),
    _column("ATE", ".status.display.ate"),
    _column("CPU", ".status.display.cpu"),
    _column("Memory", ".status.display.memory"),
    _column("Coverage", ".status.results[0].coverage", "number", 1),
    _column("Reason", ".status.reason", priority=1),
    _AGE,
]
COLUMNS: dict[str, list[Schema]] = {
    "Algorithm": [
        _column("Version", ".spec.version"),
        _column("Deterministic", ".spec.deterministic"),
        _column("Image", ".spec.image", priority=1),
        _AGE,
    ],
    "Dataset": [
        _column("Format", ".spec.recording.format"),
        _column("GravityAligned", ".spec.gravityAligned", "boolean", 1),
        _column("Description", ".spec.description", priority=1),
        _AGE,
    ],
    "Evaluation": [
        _column("Alignment", ".spec.alignment"),
        _column("Runs", ".status.runs", "integer"),
        _column("Evaluated", ".status.evaluated", "integer"),
        _column("Failed", ".status.failed", "integer"),
        _AGE,
    ],
    "MappingRun": _STATUS_OF_RUN,
    "Sweep": [
        _column("Phase", ".status.phase"),
        _column("Done", ".status.progress"),
        _column("Running", ".status.running", "integer"),
        _column("Failed", ".status.failed", "integer"),
        _column("Succeeded", ".status.succeeded", "integer", 1),
        _column("Reused", ".status.reused", "integer", 1),
        _column("Evaluated", ".status.evaluated", "integer", 1),
        _column("Best", ".status.best[0].name"),
        _column("ATE", ".status.display.ate"),
        _AGE,
    ],
}
"""Columns of each kind; no path leads through a map, whose order varies."""
