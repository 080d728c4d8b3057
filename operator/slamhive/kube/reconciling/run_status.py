# SPDX-License-Identifier: Apache-2.0
"""Status fields of a run that has ended: usage, trajectory, provenance.

The run's reconciler writes them. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive import __version__
from slamhive.engine import AttemptState, LoadConditions, taken_over
from slamhive.kube.api.encoding import encode
from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.reconciling.disruptions import NO_DISRUPTIONS, Disruptions
from slamhive.kube.reconciling.sweep_runs import asked_of
from slamhive.kube.status import condition, display, iso, result_field
from slamhive.model.results import Phase, Prepared, Provenance, TrajectoryInfo, Usage
from slamhive.model.sensors import SensorMode
from slamhive.model.status import LIST_BYTES, MESSAGE_LENGTH, MOST_RESULTS, MappingRunStatus, ResultEntry
from slamhive.plan import image_digest, recording_fields

if TYPE_CHECKING:
    from collections.abc import Collection

    from slamhive.kube.observing import Attempted
    from slamhive.kube.reconciling.variants import VariantSeen, Wanted
    from slamhive.model.algorithm import Algorithm
    from slamhive.model.dataset import Dataset
    from slamhive.model.results import RunRecord


@dataclass(frozen=True)
class RunFacts:
    """A run with all that bears on what happens next.

    Attributes:
        key: its address.
        body: the object.
        spec: its spec with all defaults.
        spec_hash: the hash of it.
        algorithm: its Algorithm.
        dataset: its Dataset.
        wanted: the variant that it reads.
        variant: what is known of that.
        attempted: what is seen of its newest attempt.
        job: the newest attempt's Job.
        disruptions: how often its pods were taken by what is no fault of theirs.
    """

    key: Key
    body: dict[str, Any]
    spec: dict[str, Any]
    spec_hash: str
    algorithm: Algorithm
    dataset: Dataset
    wanted: Wanted
    variant: VariantSeen
    attempted: Attempted
    job: dict[str, Any] | None
    disruptions: Disruptions = NO_DISRUPTIONS

    @property
    def uid(self) -> str:
        """Return its uid."""
        return str(self.body["metadata"]["uid"])

    @property
    def is_lost(self) -> bool:
        """Tell whether neither Job nor pod of an attempt that ran is seen any more."""
        return self.job is None and self.attempted.state is AttemptState.ENDED and self.attempted.pod is None

    @property
    def is_cancelled(self) -> bool:
        """Tell whether it is to end."""
        return bool(self.body["spec"].get("cancel"))

    @property
    def dataset_key(self) -> Key:
        """Return the address of its Dataset."""
        return Key(Kind.DATASET, self.key.namespace, self.dataset.name)


def attempt_fields(uid: str, attempted: Attempted, now: float) -> MappingRunStatus:
    """Return the remains of an attempt: usage, frames, metrics, trajectory, folder and times.

    Args:
        uid: the run's uid.
        attempted: what is seen of the attempt.
        now: s since 1970, for an attempt that did not tell its own times.
    """
    report = attempted.report
    status = MappingRunStatus(
        log_tail=attempted.log_tail or None,
        start_time=attempted.started or iso(now),
        completion_time=attempted.finished or iso(now),
    )
    if attempted.pod_uid:
        status |= MappingRunStatus(folder=f"runs/{uid}/{attempted.pod_uid}")
    if report is None:
        return status
    status |= MappingRunStatus(
        usage=report.usage,
        frames=report.frames,
        metrics=report.metrics or None,
        display=display(report.usage, ()),
    )
    # The monitor saw the algorithm's own processes; the kubelet's times are the container's, in whole
    # seconds.
    if report.started_at and report.finished_at:
        status |= MappingRunStatus(start_time=report.started_at, completion_time=report.finished_at)
    if report.trajectory is not None and attempted.pod_uid:
        found = report.trajectory
        trajectory = TrajectoryInfo(
            poses=found.poses,
            duration_seconds=found.duration_seconds,
            sha256=found.sha256,
            # Made here, not taken from the report: a forged path would have other files read.
            path=f"{status.folder}/output/trajectory.txt",
        )
        status |= MappingRunStatus(trajectory=trajectory)
    return status


def provenance(
    attempted: Attempted, facts: RunFacts, *, algorithm_hash: str, content_hash: str | None
) -> Provenance:
    """Return the exact origin of a result.

    Args:
        attempted: what is seen of the attempt.
        facts: the run.
        algorithm_hash: hash of what its Algorithm says of its program.
        content_hash: hash of all that the result depends on.
    """
    known = facts.variant.description or {}
    preparation = known.get("preparationVersion")
    return Provenance(
        content_hash=content_hash,
        spec_hash=facts.spec_hash,
        algorithm_hash=algorithm_hash,
        preparation=None if preparation is None else str(preparation),
        prepared_by=known.get("preparedBy"),
        environment=image_digest(attempted.image_id) if attempted.image_id else None,
        image_id=attempted.image_id,
        dataset_sha256=known.get("datasetSha256"),
        variant=known.get("key"),
        node=attempted.node,
        cpu_model=attempted.report.cpu_model if attempted.report else None,
        machine=attempted.report.machine if attempted.report else None,
        slamhive_version=__version__,
        **_recording(facts),
    )


def _recording(facts: RunFacts) -> dict[str, Any]:
    """Return the recording that a run was given, and the options that had no effect."""
    prepared = Prepared.model_validate(facts.variant.description) if facts.variant.description else None
    mode = facts.algorithm.spec.mode(SensorMode(facts.spec["sensors"]))
    return recording_fields(facts.spec["input"], asked_of(facts.body), facts.dataset, mode, prepared)


def reused_fields(
    equal: RunRecord, facts: RunFacts, conditions: Collection[LoadConditions]
) -> MappingRunStatus:
    """Return the fields that a run takes over from an equal one.

    Args:
        equal: the equal run.
        facts: the run.
        conditions: those that the cluster's runs are measured under, as far as runs told of them.
    """
    return _recorded(equal.replace(**taken_over(equal, _recording(facts), conditions)))


def archived_status(record: RunRecord) -> tuple[MappingRunStatus, list[dict[str, Any]]]:
    """Return the status that an archived run had, as far as the archive has it, and its conditions."""
    word = str(record.reason or record.phase)
    told = [condition("Complete", True, word, record.message or "")]
    if record.phase is Phase.SUCCEEDED and not record.results:
        told.append(condition("Evaluated", False, "NotEvaluable", record.message or ""))
    state = MappingRunStatus(
        phase=record.phase,
        reason=record.reason,
        message=(record.message or "")[:MESSAGE_LENGTH] or None,
        attempts=record.attempts,
    )
    return _recorded(record) | state, told


def _recorded(record: RunRecord) -> MappingRunStatus:
    """Return the fields of a run's status that its record has too."""
    # An archive holds a run's results of any number of evaluations.
    results = [result_field(result) for result in record.results[:MOST_RESULTS]]
    while len(encode(results)) > LIST_BYTES:
        results.pop()
    return MappingRunStatus(
        usage=record.usage,
        frames=record.frames,
        metrics=record.metrics,
        trajectory=record.trajectory,
        folder=record.folder,
        log_tail=record.log_tail,
        provenance=record.provenance,
        results=[ResultEntry.model_validate(result) for result in results],
        display=display(record.usage, results),
        start_time=iso(record.started.timestamp()) if record.started else None,
        completion_time=iso(record.finished.timestamp()) if record.finished else None,
    )


def usage_suspect(usage: Usage | None, seen_cores: float | None, seen_bytes: float | None) -> str | None:
    """Say how a run's own figures contradict those of the metrics API, if they do.

    The metrics API averages over 15 s, so a run's maxima must reach what it showed, within a tenth.
    Its memory is the working set.

    Args:
        usage: the sidecar's figures.
        seen_cores: the most cores that the metrics API showed.
        seen_bytes: the most memory that it showed, bytes.
    """
    if usage is None:
        return None
    most_cores, most_bytes = usage.cpu.max_cores, usage.memory.working_set_peak_bytes
    if seen_cores is not None and most_cores is not None and seen_cores > 1.1 * most_cores + 0.05:
        return f"the metrics API showed {seen_cores:.2f} cores, the sidecar {most_cores:.2f} at most"
    if seen_bytes is not None and most_bytes is not None and seen_bytes > 1.1 * most_bytes + 2**24:
        seen, most = seen_bytes / 2**20, most_bytes / 2**20
        return f"the metrics API showed {seen:.0f} MiB, the sidecar {most:.0f} MiB at most"
    return None
