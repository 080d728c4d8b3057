# SPDX-License-Identifier: Apache-2.0
"""Statuses of the five kinds: what the operator writes and reads; the CRDs' status schemas are made of them.

Every field may be absent: an object begins without a status, and earlier versions wrote fewer fields.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, ValidationError, WithJsonSchema, field_serializer

from slamhive.model.base import Choice, Model, optional
from slamhive.model.reported import MOST_RPE, ErrorFigures
from slamhive.model.results import Frames, Outcome, Phase, Provenance, TrajectoryInfo, Usage
from slamhive.model.search import MAX_TRIALS, Trial
from slamhive.model.sweep import MAX_POINTS

if TYPE_CHECKING:
    from collections.abc import Mapping

KEEP = "x-kubernetes-preserve-unknown-fields"
"""Mark of a value of which the API server keeps every field."""
MOST_RESULTS = 32
"""Evaluations whose results a MappingRun's status holds."""
LIST_BYTES = 2**20
"""Largest list of a status, in bytes of JSON: an object of more than 1.5 MiB is refused by etcd."""
BEST_LENGTH = 10
"""Runs that a Sweep's status shows as its best."""
MESSAGE_LENGTH = 4096
"""Longest sentence or log of a status, in characters."""

_Word = Annotated[str, Field(max_length=64)]
_Line = Annotated[str, Field(max_length=253)]
_Path = Annotated[str, Field(max_length=1024)]
_Text = Annotated[str, Field(max_length=MESSAGE_LENGTH)]
_Count = Annotated[int, Field(ge=0)]
# A text, because times are compared and written back as they were read.
_Time = Annotated[str, WithJsonSchema({"type": "string", "format": "date-time"})]
_Free = Annotated[dict[str, Any], Field(json_schema_extra={KEEP: True})]


def _map_by(key: str) -> dict[str, Any]:
    """Return the marks of a list whose items the API server tells apart by a field."""
    return {"x-kubernetes-list-type": "map", "x-kubernetes-list-map-keys": [key]}


class _Item(Model):
    """An item of a list: fields of later versions stay, as a patch replaces a list whole."""

    model_config = ConfigDict(extra="allow")


class Condition(_Item):
    """One aspect of the state, as all Kubernetes objects have them."""

    type: str = Field(max_length=316, description="Name of the aspect.")
    status: Literal["True", "False", "Unknown"] = Field(description="Whether it holds.")
    reason: str = Field(max_length=1024, description="Reason in one word.")
    message: str = Field(max_length=32768, description="Reason in a sentence.")
    observed_generation: _Count | None = optional("Generation of the spec that it was found for.")
    last_transition_time: _Time = Field(description="Time at which the status last changed.")


class Status(Model):
    """The fields that the statuses of all kinds have."""

    model_config = ConfigDict(extra="ignore")

    conditions: list[Condition] = Field(
        default_factory=list,
        max_length=16,
        description="The truth about the object, by aspect.",
        json_schema_extra=_map_by("type"),
    )
    observed_generation: _Count | None = optional("Generation of the spec that the status belongs to.")

    @classmethod
    def of(cls, body: Mapping[str, Any]) -> Self:
        """Return the status of an object as the API holds it; never raises.

        What can't be read, as another version may have written it, counts as absent: a field of a record
        and an item of a list alone, not all of it.
        """
        try:
            return cls.model_validate(body.get("status") or {})
        except ValidationError:
            return cls._readable(body["status"])

    @classmethod
    def _readable(cls, status: Any) -> Self:
        left = _copied(status) if isinstance(status, dict) else {}
        while True:
            try:
                return cls.model_validate(left)
            except ValidationError as error:
                found = error.errors(include_url=False, include_input=False)
                # From the end: the other items of a list keep their places.
                for way in sorted({_way(left, item["loc"]) for item in found}, reverse=True):
                    _remove(left, way)

    def __or__(self, later: Self) -> Self:
        """Return the status with the given fields of another in their places."""
        return self.replace(**{name: getattr(later, name) for name in later.model_fields_set})

    def as_patch(self) -> dict[str, Any]:
        """Return the fields that were given, as a merge patch has them: those that are None are removed."""
        values = self.as_json()
        fields = type(self).model_fields
        names = [fields[name].alias or name for name in fields if name in self.model_fields_set]
        return {name: values.get(name) for name in names}


def _copied(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _copied(item) for key, item in value.items()}
    return [_copied(item) for item in value] if isinstance(value, list) else value


def _way(value: Any, place: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the part of an error's place that leads somewhere: it ends in missing fields and in unions."""
    way = []
    for step in place:
        if isinstance(value, list):
            leads = isinstance(step, int)
        else:
            leads = isinstance(value, dict) and step in value
        if not leads:
            break
        way.append(step)
        value = value[step]
    return tuple(way)


def _remove(value: Any, way: tuple[Any, ...]) -> None:
    """Remove what a way leads to; all of it where it leads nowhere, as where a record lacks a field."""
    if not way:
        value.clear()
        return
    for step in way[:-1]:
        value = value[step]
    del value[way[-1]]


class ResultFigures(ErrorFigures):
    """Statistics of an error."""

    model_config = ConfigDict(extra="allow", strict=False, json_schema_extra={KEEP: True})


class ResultEntry(_Item):
    """Result of a run in one evaluation: outcome, coverage, scale and errors."""

    model_config = ConfigDict(json_schema_extra={KEEP: True})

    evaluation: _Line = Field(description="Name of the Evaluation.")
    outcome: Outcome = Field(description="Verdict on the run, such as Tracked or Lost.")
    coverage: float | None = optional("Share of the ground truth's path that the estimate covers.")
    scale: float | None = optional("Scale of the alignment.")
    ate: ResultFigures | None = optional("Absolute trajectory error in m.")
    rpe: list[_Free] | None = optional(
        "Relative pose errors, in the order of the Evaluation.", max_length=MOST_RPE
    )


class RunDisplay(Model):
    """Figures as kubectl prints them."""

    model_config = ConfigDict(extra="ignore")

    ate: str | None = optional(
        "RMSE of the absolute trajectory error of the first evaluation.", max_length=32
    )
    cpu: str | None = optional("Mean number of cores.", max_length=32)
    memory: str | None = optional("Peak of memory.", max_length=32)


class MappingRunStatus(Status):
    """Status of a MappingRun: phase and reason, attempts, usage and results."""

    phase: Phase | None = optional("Where the run is, for printing.")
    reason: _Word | None = optional("Why it is there, in one word.")
    message: _Text | None = optional("Why it is there, in a sentence.")
    attempts: _Count | None = optional("Attempts made so far.")
    faults: _Count | None = optional("Faults of the machine that attempts met.")
    judged: _Count | None = optional("Number of the last attempt whose fault is counted.")
    disruptions: _Count | None = optional("Pods that evictions, preemptions, queues or lost nodes took.")
    disrupted_pod: _Line | None = optional(
        "UIDs of the last pods among them; of the Job, with the time, where nobody saw one go."
    )
    not_before: _Time | None = optional("When another attempt may begin.")
    variant: _Line | None = optional("Prepared form of the dataset that it reads.")
    folder: _Path | None = optional("Its folder on the results volume.")
    log_tail: _Text | None = optional("Last lines that the algorithm printed.")
    metrics: _Free | None = optional("The algorithm's own figures.")
    display: RunDisplay | None = optional("Figures as kubectl prints them.")
    usage: Usage | None = optional("What the algorithm alone took of the machine.")
    frames: Frames | None = optional("Frames as the algorithm counted them.")
    trajectory: TrajectoryInfo | None = optional("The estimated trajectory.")
    results: list[ResultEntry] = Field(
        default_factory=list,
        max_length=MOST_RESULTS,
        description="Results, one an evaluation.",
        json_schema_extra=_map_by("evaluation"),
    )
    provenance: Provenance = Field(
        default_factory=Provenance, description="Hashes, versions and machine that produced the result."
    )
    start_time: _Time | None = optional("When the first run or attempt started.")
    completion_time: _Time | None = optional("When it had finished.")


class SweepDisplay(Model):
    """Figures as kubectl prints them."""

    model_config = ConfigDict(extra="ignore")

    ate: str | None = optional("RMSE of the absolute trajectory error of the best run.", max_length=32)


class AxisSelection(_Item):
    """Catalog entries that the selector of one axis of a Sweep chose."""

    axis: _Count | None = optional("Index of the axis.")
    names: list[_Line] = Field(
        default_factory=list, max_length=MAX_POINTS, description="Names of catalog entries."
    )


class BestRun(_Item):
    """A run with a small error."""

    name: _Line = Field(description="Name of the run.")
    index: _Count | None = optional("Index of its point.")
    ate: float = Field(description="RMSE of its absolute trajectory error in m.")
    coverage: float | None = optional("Its coverage.")
    algorithm: _Line | None = optional("Its algorithm.")
    dataset: _Line | None = optional("Its dataset.")


class BestTrial(_Item):
    """A setting of a search that no other one betters in all that is asked."""

    number: _Count = Field(description="Its place in the list of trials.")
    values: list[Any] = Field(
        default_factory=list, max_length=32, description="Its value on each searched axis."
    )
    figures: list[float] = Field(
        default_factory=list, max_length=2, description="Its figure for each objective, over all its runs."
    )
    failed: float | None = optional("Share of its runs that failed.")


class SearchStatus(_Item):
    """Settings that a search has tried, and its progress."""

    trials: list[Trial] | None = optional(
        "Settings that are tried, by number; what stands here is never drawn anew.", max_length=MAX_TRIALS
    )
    asked: _Count | None = optional("Number of settings that are tried so far.")
    decided: _Count | None = optional("Number of settings that get no further runs.")
    most: _Count | None = optional("Number of settings at most.")
    spared: _Count | None = optional("Number of runs whose results were known before.")
    best: list[BestTrial] | None = optional(
        "Settings that no other one betters, the best of the first objective first.", max_length=BEST_LENGTH
    )
    message: _Text | None = optional("How it ended, or what keeps it from going on.")

    @field_serializer("trials")
    def _short(self, trials: list[Trial] | None) -> list[dict[str, Any]] | None:
        # Thousands of them are written and read again with each further one.
        return None if trials is None else [trial_field(trial) for trial in trials]


def trial_field(trial: Trial) -> dict[str, Any]:
    """Return a trial as an item of ``status.search.trials``, without what is as usual."""
    told = {"told": trial.told} if trial.told else {}
    return {"values": trial.values, **told, **({"origin": trial.origin.value} if trial.is_known else {})}


class SweepShare(_Item):
    """Share of a Sweep in the slots of the cluster, its place in the line, and its forecast in words."""

    fair: float | None = optional("Fair number of runs in flight.", ge=0)
    of: _Count | None = optional("Slots that are shared, where their number is known.")
    sweeps: _Count | None = optional("Sweeps that share them, this one too.")
    namespaces: _Count | None = optional("Namespaces of these.")
    priority: _Text | None = optional("Priority beside other Sweeps, by the PriorityClass of its pods.")
    place: _Count | None = optional("Place in the line for the next free slot, where it waits for one.")
    begin: str | None = optional("When its first run is expected to begin.", max_length=64)
    end: str | None = optional("When its last run is expected to end.", max_length=64)
    forecast: _Text | None = optional("Where the forecast comes from, or why there is none.")
    limit: _Text | None = optional("What keeps it from having more runs in flight.")
    sooner: _Text | None = optional("What would make it sooner.")


class SweepStatus(Status):
    """Status of a Sweep: phase, counts of its runs, and the best of them."""

    total: _Count | None = optional("Number of runs: total.")
    pending: _Count | None = optional("Number of runs: pending.")
    running: _Count | None = optional("Number of runs in flight: prepared, waiting for a node, or running.")
    succeeded: _Count | None = optional("Number of runs: succeeded.")
    failed: _Count | None = optional("Number of runs: failed.")
    reused: _Count | None = optional("Number of runs: reused.")
    evaluated: _Count | None = optional("Number of runs: evaluated.")
    deleted: _Count | None = optional("Number of runs that somebody deleted.")
    phase: str | None = optional("Where the Sweep stands, for printing.", max_length=32)
    progress: str | None = optional(
        "Runs that are done, of all; of a search the settings that are decided.", max_length=32
    )
    display: SweepDisplay | None = optional("Figures as kubectl prints them.")
    cpu_seconds: float | None = optional("CPU time of all finished runs in s.")
    selected: list[AxisSelection] = Field(
        default_factory=list,
        max_length=32,
        description="Names that each selector of the matrix chose when the Sweep began.",
    )
    best: list[BestRun] = Field(
        default_factory=list, max_length=BEST_LENGTH, description="Tracked runs with the smallest errors."
    )
    points: str | None = optional(
        "State of each point, two bits a point, in base64.",
        max_length=MAX_POINTS // 2,
        json_schema_extra={"format": "byte"},
    )
    search: SearchStatus | None = optional("What a search has tried, and how far it is.")
    share: SweepShare | None = optional("What it has of the cluster, and when it will be done.")
    start_time: _Time | None = optional("When the first run or attempt started.")
    completion_time: _Time | None = optional("When it had finished.")

    def as_patch(self) -> dict[str, Any]:
        """Return the fields that were given; of its share also those that are absent, which go."""
        patch = super().as_patch()
        if self.share is not None:
            patch["share"] = dict.fromkeys(SweepShare.model_fields) | patch["share"]
        return patch


class EvaluationStatus(Status):
    """Status of an Evaluation: counts of its runs, and figures over all of them."""

    runs: _Count | None = optional("Runs that it selects.")
    evaluated: _Count | None = optional("Runs evaluated.")
    failed: _Count | None = optional("Runs that could not be evaluated.")
    summary: _Free | None = optional("Figures over all runs.")


class VariantPhase(Choice):
    """Phases of a variant's preparation."""

    PENDING = "Pending"
    PREPARING = "Preparing"
    READY = "Ready"
    FAILED = "Failed"


class VariantEntry(_Item):
    """A prepared form of the recording."""

    name: _Line = Field(description="Name of the variant: its content hash.")
    phase: VariantPhase | None = optional("Whether it is ready.")
    reason: _Word | None = optional("Why it is not, in one word.")
    message: _Text | None = optional("Why it is not, in a sentence.")
    folder: _Path | None = optional("Its folder on the data volume.")
    description: _Free | None = optional("Window, rates and calibration after preparation.")
    changed_time: _Time | None = optional("When its phase last changed.")
    size_bytes: _Count | None = optional("Size on the volume.")
    last_used_time: _Time | None = optional("When a run last used it.")


class DatasetStatus(Status):
    """Status of a Dataset: the variants that are prepared of it."""

    variants: list[VariantEntry] = Field(
        default_factory=list,
        max_length=1000,
        description="Prepared forms, by name.",
        json_schema_extra=_map_by("name"),
    )


class AlgorithmStatus(Status):
    """State of the Algorithm."""

    image_id: _Path | None = optional("Image that its tag meant when a run last used it.", alias="imageID")


STATUSES: dict[str, type[Status]] = {
    "Algorithm": AlgorithmStatus,
    "Dataset": DatasetStatus,
    "Evaluation": EvaluationStatus,
    "MappingRun": MappingRunStatus,
    "Sweep": SweepStatus,
}
"""The model of each kind's status."""
