# SPDX-License-Identifier: Apache-2.0
"""Records of a run: phase, reason, usage, trajectory, results and provenance.

The same records are a MappingRun's status on a cluster and a row of the archive.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import ConfigDict, Field, model_validator

from slamhive.model.base import Choice, Model, Scalar, optional

NOT_EVALUATED = "not evaluated: "
"""Beginning of the sentence in a run's message on why it could not be measured; no other follows it."""

IMPORTED = "slam-hive"
"""Label `source` of runs of the original SLAM Hive, whose files stay where they were."""

TAG_SEPARATOR = ", "
"""Text between the tags of a run, where they are one text."""


class Phase(Choice):
    """Phases of a run, from waiting to its end; for printing, derived from what happened."""

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
    """Reasons for a run's phase, such as what made it fail."""

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
    DISRUPTED = "Disrupted"
    SYSTEM_FAULT = "SystemFault"
    CANCELLED = "Cancelled"

    @property
    def is_infrastructure(self) -> bool:
        """Tell whether the machine is to blame: such attempts are repeated and never reused."""
        return self in {
            Reason.NODE_LOST,
            Reason.DISRUPTED,
            Reason.SYSTEM_FAULT,
            Reason.IMAGE_PULL_FAILED,
            Reason.ALGORITHM_UNAVAILABLE,
            Reason.DATASET_MISSING,
            Reason.PREPARATION_FAILED,
        }

    @property
    def may_come_of_input(self) -> bool:
        """Tell whether the program ended so, of which its recording may be the cause."""
        return self in {
            Reason.ALGORITHM_FAILED,
            Reason.NO_TRAJECTORY,
            Reason.INVALID_TRAJECTORY,
            Reason.OUT_OF_MEMORY,
            Reason.DEADLINE_EXCEEDED,
            Reason.OUTPUT_TOO_LARGE,
        }


class Outcome(Choice):
    """Verdicts of an evaluation on a run that ended well, such as tracked or lost."""

    TRACKED = "Tracked"
    PARTIAL = "Partial"
    LOST = "Lost"
    DIVERGED = "Diverged"

    @property
    def has_lost_track(self) -> bool:
        """Tell whether the estimate has left the way, however small an error may come out."""
        return self in {Outcome.LOST, Outcome.DIVERGED}


class CpuUsage(Model):
    """CPU time of the algorithm alone."""

    model_config = ConfigDict(extra="ignore")
    mean_cores: float | None = optional("CPU seconds by second of wall time.")
    max_cores: float | None = optional("The most cores used in any window of 1 s.")
    seconds: float | None = optional("CPU time in s, reading of the recording taken out.")
    seconds_per_data_second: float | None = optional(
        "CPU seconds by second of recording; runs in Lockstep and Stepped are compared by it."
    )
    total_seconds: float | None = optional("CPU time in s, reading of the recording included.")


class MemoryKind(Choice):
    """Kinds of memory that peakBytes and meanBytes measure; different kinds can't be compared."""

    RESIDENT = "Resident"
    WORKING_SET = "WorkingSet"
    CONTAINER = "Container"


class MemoryUsage(Model):
    """Memory of the algorithm alone."""

    model_config = ConfigDict(extra="ignore")
    peak_bytes: int | None = optional("Peak of the resident memory of all processes in bytes; see kind.")
    mean_bytes: float | None = optional("Mean of the same over time in bytes.")
    kind: MemoryKind | None = None
    anonymous_peak_bytes: int | None = optional(
        "Peak of memory without a file behind it in bytes, of the samples."
    )
    working_set_peak_bytes: int | None = optional(
        "Peak of the working set in bytes: page cache in use counts."
    )
    kernel_peak_bytes: int | None = optional(
        "The kernel's own peak in bytes; a cgroup's counts page cache too."
    )


class Usage(Model):
    """CPU time, memory and wall time that a run took, and how they were measured."""

    model_config = ConfigDict(extra="ignore")
    cpu: CpuUsage = Field(default_factory=CpuUsage)
    memory: MemoryUsage = Field(default_factory=MemoryUsage)
    wall_seconds: float | None = optional(
        "Time from the start of the algorithm's first process to its end, in s."
    )
    throttled_seconds: float | None = optional(
        "Time for which its limit held it back, in s; absent where nothing counts it."
    )
    contended_seconds: float | None = optional(
        "CPU time that it waited for while others used its processors, in s."
    )
    processors: str | None = optional("Processors of its machine that it was pinned to, such as 0,1.")
    samples: int | None = optional("Number of samples that the figures rest on.")
    source: str | None = optional("Whose account it is: the container's cgroup, or its processes in /proc.")
    includes_reader: bool | None = optional(
        "Whether reading the recording is part of the figures and can't be told apart; absent where that "
        "isn't known."
    )
    max_includes_reader: bool | None = optional(
        "Whether maxCores includes the reading that was taken out elsewhere."
    )
    reader_cpu_seconds: float | None = optional("CPU time of reading the recording that was taken out, in s.")
    reader_share: float | None = optional("The part of all CPU seconds that this is.")
    suspect: str | None = optional(
        "Why these figures are to be doubted; absent where nothing speaks against them."
    )

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


def remark_of(usage: Usage | None, problem: str | None) -> str | None:
    """Return the remark on a run that ended well.

    Args:
        usage: what it cost.
        problem: what was wrong with its metrics.json.
    """
    doubt = f"UsageSuspect: {usage.suspect}" if usage and usage.suspect else None
    if problem and doubt and problem in doubt:
        return doubt
    return "; ".join(filter(None, (doubt, problem))) or None


class Frames(Model):
    """Frames as the algorithm counted them."""

    offered: int | None = optional("Frames that the algorithm was given.")
    processed: int | None = optional("Frames that it took in.")
    dropped: int | None = optional("Frames that it left out.")


class TrajectoryInfo(Model):
    """The estimated trajectory."""

    poses: int = Field(description="Number of poses.")
    duration_seconds: float = Field(description="Time from the first pose to the last, in s.")
    sha256: str = Field(description="Checksum of the file.")
    path: str = Field(description="The file, below the run's folder.")


class Prepared(Model):
    """Frame rate, resolution and length of what a run was given of its recording, counted in its variant."""

    model_config = ConfigDict(extra="ignore")
    frame_rate: float | None = optional("Rate of the sensor whose frames are counted, in Hz.")
    resolution: float | None = optional("Scale of images in each direction.")
    duration_seconds: float | None = optional("Time from the first frame to the last, in s.")
    frames: int | None = optional("Number of frames.")
    recorded_frame_rate: float | None = optional(
        "Rate of the fastest sensor before any frame was left out, in Hz."
    )
    recorded_seconds: float | None = optional(
        "Time from the first frame of the whole recording to its last, in s."
    )
    findings: list[str] | None = optional(
        "Codes of errors and warnings that were known of it, and of the ground truth, when it was prepared."
    )


class Machine(Model):
    """Machine of a run as far as its kernel told: what can't be read is absent."""

    model_config = ConfigDict(extra="ignore")
    cores: int | None = optional("Number of cores, threads of one core counted once.", ge=1)
    smt: bool | None = optional("Whether cores run several threads at a time.")
    governor: str | None = optional("Governor of the processors' clock; several, by commas.", max_length=200)
    turbo: bool | None = optional("Whether the clock may go beyond the processor's base.")
    exclusive_cores: bool | None = optional(
        "Whether a kubelet's static CPU manager kept all other containers off the run's processors."
    )


class Provenance(Model):
    """Origin of a result: hashes, versions and machine, and input options that had no effect."""

    content_hash: str | None = optional(
        "Hash of everything that decides the result: equal hashes, equal runs."
    )
    spec_hash: str | None = optional("Hash of the spec as far as it decides the result.")
    algorithm_hash: str | None = optional("Hash of what the Algorithm says of its program.")
    environment: str | None = optional("Hash of the program and what it links to.")
    image_id: str | None = optional("Digest of the image that ran.", alias="imageID")
    dataset_sha256: str | None = optional("Checksum of the recording that the variant was made of.")
    preparation: str | None = optional("Version of the preparation of recordings.")
    prepared_by: str | None = optional("Digest of the program that made the frames of the recording.")
    variant: str | None = optional("Name of the prepared form of the dataset.")
    node: str | None = optional("Machine that it ran on.")
    cpu_model: str | None = optional("Model of that machine's processor.")
    machine: Machine | None = optional("What else is known of that machine.")
    slamhive_version: str | None = optional("Version of SLAM Hive that measured it.")
    reused_from: str | None = optional("Run whose result was taken, as all that decides it is equal.")
    asked: dict[str, Scalar] | None = optional(
        "Input options that were asked for and have no effect on the recording."
    )
    effective: dict[str, Scalar] | None = optional(
        "What took effect in their places; absent where nothing did."
    )
    prepared: Prepared | None = None


class OriginKind(Choice):
    """Ways in which a run of somebody else came here: with its study, or as a trajectory alone."""

    BUNDLE = "Bundle"
    TRAJECTORY = "Trajectory"


class Origin(Model):
    """Origin of a run that somebody else made: whose it is, and what it takes to measure it here.

    Attributes:
        kind: how it came here.
        label: what its algorithm's name is followed by here, so that it is never pooled with own runs.
        source: where it is from: the address that was given, or the study's title.
        sha256: of the study, or of the file of poses as it was.
        algorithm: name of its algorithm there.
        content_hash: what its content hash is there; here it has none, as nobody takes over its result.
        subject: the evaluator's inputs, as `analysis.subjects.SubjectItem` has them.
    """

    kind: OriginKind
    label: str
    source: str
    sha256: str
    algorithm: str
    content_hash: str | None = None
    subject: dict[str, Any] | None = None


class Result(Model):
    """Outcome, coverage and errors of a run in one evaluation; ``values`` has the evaluator's own names."""

    evaluation: str
    outcome: Outcome
    coverage: float | None = None
    values: dict[str, Any] = Field(default_factory=dict)


class IntendedEvaluation(Model):
    """An evaluation that a run was meant to have, whether it got a result or not.

    Attributes:
        evaluation: its name.
        alignment: as a result of it would name it; None when that isn't known.
        settings: hash of its settings.
        problem: why it can't be measured so where that was tried, and isn't tried again.
    """

    evaluation: str
    alignment: str | None = None
    settings: str | None = None
    problem: str | None = None


class RunRecord(Model):
    """A run with all that is recorded of it.

    Attributes:
        sweep, sweep_uid: name and identity of its Sweep; versions of a Sweep share the name.
        namespace, cluster: where it ran; None on a workstation.
        evaluations: what it was meant to be measured by.
        note, tags, noted: words of people on it, and when they were written: `archive.remarks`.
        origin: whose it is, where somebody else made it.
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
    note: str | None = None
    tags: list[str] = Field(default_factory=list)
    noted: datetime | None = None
    origin: Origin | None = None
