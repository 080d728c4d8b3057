# SPDX-License-Identifier: Apache-2.0
"""Columns that `kubectl get` prints of each kind."""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]


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
        _column("In-Flight", ".status.running", "integer"),
        _column("Share", ".status.share.fair", "number", 1),
        _column("Weight", ".spec.weight", "integer", 1),
        _column("Line", ".status.share.place", "integer"),
        _column("Begins", ".status.share.begin", priority=1),
        _column("Ends", ".status.share.end"),
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
