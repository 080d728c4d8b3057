# SPDX-License-Identifier: Apache-2.0
"""What is recorded of a run: phase, reason, usage, trajectory, results and provenance.

The same records are a MappingRun's status on a cluster and a row of the archive.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import ConfigDict, Field, model_validator

from slamhive.model.base import Choice, Model, Scalar


class Phase(Choice):
    """Where a run is; for printing, derived from what happened."""

    PENDING = "Pending"
    PREPARING = "Preparing"
    RUNNING = "Running"
    SUCCEEDED = "Succeeded"
    FAILED = "Failed"
    CANCELLED = "Cancelled"

    @property
    def is_finished(self) -> bool:
        """Tell whether nothing more will happen to the run."""
        return self in {Phase.SUCCEEDED, Phase.FAILED, Phase.CANCELLED}


class Reason(Choice):
    """Why a run is as it is."""

    INVALID_PARAMETERS = "InvalidParameters"
    DATASET_MISSING = "DatasetMissing"
    ALGORITHM_UNAVAILABLE = "AlgorithmUnavailable"
    PREPARATION_FAILED = "PreparationFailed"
    IMAGE_PULL_FAILED = "ImagePullFailed"
    OUT_OF_MEMORY = "OutOfMemory"
    DEADLINE_EXCEEDED = "DeadlineExceeded"
    ALGORITHM_FAILED = "AlgorithmFailed"
    OUTPUT_TOO_LARGE = "OutputTooLarge"
    NO_TRAJECTORY = "NoTrajectory"
    INVALID_TRAJECTORY = "InvalidTrajectory"
    NODE_LOST = "NodeLost"
    SYSTEM_FAULT = "SystemFault"
    CANCELLED = "Cancelled"

    @property
    def is_infrastructure(self) -> bool:
        """Tell whether the machine is to blame: such attempts are repeated and never reused."""
        return self in {
            Reason.NODE_LOST,
            Reason.SYSTEM_FAULT,
            Reason.IMAGE_PULL_FAILED,
            Reason.ALGORITHM_UNAVAILABLE,
            Reason.DATASET_MISSING,
            Reason.PREPARATION_FAILED,
        }


class Outcome(Choice):
    """What an evaluation found of a run that ended well."""

    TRACKED = "Tracked"
    PARTIAL = "Partial"
    LOST = "Lost"
    DIVERGED = "Diverged"


class CpuUsage(Model):
    """CPU time of the algorithm alone."""

    model_config = ConfigDict(extra="ignore")
    mean_cores: float | None = None
    max_cores: float | None = None
    seconds: float | None = None
    seconds_per_data_second: float | None = None


class MemoryKind(Choice):
    """What peakBytes and meanBytes are; those of different kinds can't be compared."""

    RESIDENT = "Resident"
    WORKING_SET = "WorkingSet"
    CONTAINER = "Container"


class MemoryUsage(Model):
    """Memory of the algorithm alone."""

    model_config = ConfigDict(extra="ignore")
    peak_bytes: int | None = None
    mean_bytes: float | None = None
    kind: MemoryKind | None = None
    anonymous_peak_bytes: int | None = None
    working_set_peak_bytes: int | None = None
    kernel_peak_bytes: int | None = None


class Usage(Model):
    """What a run cost."""

    model_config = ConfigDict(extra="ignore")
    cpu: CpuUsage = Field(default_factory=CpuUsage)
    memory: MemoryUsage = Field(default_factory=MemoryUsage)
    wall_seconds: float | None = None
    throttled_seconds: float | None = None
    contended_seconds: float | None = None
    samples: int | None = None
    source: str | None = None
    includes_reader: bool | None = None
    max_includes_reader: bool | None = None
    reader_cpu_seconds: float | None = None

    @model_validator(mode="before")
    @classmethod
    def _kind_of_earlier_records(cls, value: Any) -> Any:
        """Say what memory is in a record that doesn't: by cgroup it was the working set."""
        memory = value.get("memory") if isinstance(value, dict) else None
        if not isinstance(memory, dict) or "peakBytes" not in memory or "kind" in memory:
            return value
        match value.get("source"):
            case "cgroup-v1" | "cgroup-v2":
                told = {"kind": MemoryKind.WORKING_SET, "workingSetPeakBytes": memory["peakBytes"]}
            case "proc":
                told = {"kind": MemoryKind.RESIDENT}
            case None:
                return value
            case _:
                told = {"kind": MemoryKind.CONTAINER}
        return {**value, "memory": {**told, **memory}}


class Frames(Model):
    """Frames as the algorithm counted them."""

    offered: int | None = None
    processed: int | None = None
    dropped: int | None = None


class TrajectoryInfo(Model):
    """The estimated trajectory."""

    poses: int
    duration_seconds: float
    sha256: str
    path: str


class Prepared(Model):
    """What a run was given of its recording, counted in what was prepared of it."""

    model_config = ConfigDict(extra="ignore")
    frame_rate: float | None = None
    resolution: float | None = None
    duration_seconds: float | None = None
    frames: int | None = None
    recorded_frame_rate: float | None = None
    recorded_seconds: float | None = None


class Provenance(Model):
    """What exactly produced a result, and what was asked of the recording without effect."""

    content_hash: str | None = None
    spec_hash: str | None = None
    algorithm_hash: str | None = None
    environment: str | None = None
    image_id: str | None = Field(default=None, alias="imageID")
    dataset_sha256: str | None = None
    preparation: str | None = None
    variant: str | None = None
    node: str | None = None
    cpu_model: str | None = None
    slamhive_version: str | None = None
    reused_from: str | None = None
    asked: dict[str, Scalar] | None = None
    effective: dict[str, Scalar] | None = None
    prepared: Prepared | None = None


class Result(Model):
    """What one evaluation found of one run; ``values`` are the evaluator's own names."""

    evaluation: str
    outcome: Outcome
    coverage: float | None = None
    values: dict[str, Any] = Field(default_factory=dict)


class IntendedEvaluation(Model):
    """An evaluation that a run was meant to be measured by, whether it came to that or not.

    Attributes:
        evaluation: its name.
        alignment: as a result of it would name it; None when that isn't known.
        settings: hash of its settings.
    """

    evaluation: str
    alignment: str | None = None
    settings: str | None = None


class RunRecord(Model):
    """A run with all that is recorded of it.

    Attributes:
        sweep, sweep_uid: name and identity of its Sweep; versions of a Sweep share the name.
        namespace, cluster: where it ran; None on a workstation.
        evaluations: what it was meant to be measured by.
    """

    uid: str
    name: str
    sweep: str | None = None
    sweep_uid: str | None = None
    namespace: str | None = None
    cluster: str | None = None
    index: int | None = None
    labels: dict[str, str] = Field(default_factory=dict)
    spec: dict[str, Any]
    attributes: dict[str, Any] = Field(default_factory=dict)
    phase: Phase
    reason: Reason | None = None
    message: str | None = None
    attempts: int = 0
    created: datetime | None = None
    started: datetime | None = None
    finished: datetime | None = None
    usage: Usage | None = None
    frames: Frames | None = None
    metrics: dict[str, Any] = Field(default_factory=dict)
    trajectory: TrajectoryInfo | None = None
    evaluations: list[IntendedEvaluation] = Field(default_factory=list)
    results: list[Result] = Field(default_factory=list)
    provenance: Provenance = Field(default_factory=Provenance)
    folder: str | None = None
    log_tail: str | None = None
