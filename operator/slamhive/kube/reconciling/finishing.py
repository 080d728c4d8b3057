# SPDX-License-Identifier: Apache-2.0
"""What is recorded of a run that has ended. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive import __version__
from slamhive.kube.reconciling.records import image_digest
from slamhive.kube.reconciling.sweep_runs import asked_of
from slamhive.kube.status import display, iso, result_field
from slamhive.model.results import Prepared, Provenance, TrajectoryInfo, Usage
from slamhive.model.sensors import SensorMode
from slamhive.plan import recording_fields

if TYPE_CHECKING:
    from slamhive.kube.observing import Attempted
    from slamhive.kube.reconciling.run import RunFacts
    from slamhive.model.results import RunRecord


def attempt_fields(uid: str, attempted: Attempted, now: float) -> dict[str, Any]:
    """Return what an attempt left: usage, frames, metrics, trajectory, folder and times.

    Args:
        uid: the run's uid.
        attempted: what is seen of the attempt.
        now: s since 1970, for an attempt that did not tell its own times.
    """
    report = attempted.report
    fields: dict[str, Any] = {
        "logTail": attempted.log_tail or None,
        "startTime": attempted.started or iso(now),
        "completionTime": attempted.finished or iso(now),
    }
    if attempted.pod_uid:
        fields["folder"] = f"runs/{uid}/{attempted.pod_uid}"
    if report is None:
        return fields
    usage = report.usage
    fields |= {
        "usage": usage.as_json() if usage else None,
        "frames": report.frames.as_json() if report.frames else None,
        "metrics": report.metrics or None,
        "display": display(usage, ()) or None,
    }
    if report.started_at and report.finished_at:
        fields |= {"startTime": report.started_at, "completionTime": report.finished_at}
    if report.trajectory is not None and attempted.pod_uid:
        found = report.trajectory
        fields["trajectory"] = TrajectoryInfo(
            poses=found.poses,
            duration_seconds=found.duration_seconds,
            sha256=found.sha256,
            path=f"{fields['folder']}/output/trajectory.txt",
        ).as_json()
    return fields


def provenance(
    attempted: Attempted, facts: RunFacts, *, algorithm_hash: str, content_hash: str | None
) -> dict[str, Any]:
    """Return what exactly produced a result.

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
        environment=image_digest(attempted.image_id) if attempted.image_id else None,
        image_id=attempted.image_id,
        dataset_sha256=known.get("datasetSha256"),
        variant=known.get("key"),
        node=attempted.node,
        cpu_model=attempted.report.cpu_model if attempted.report else None,
        slamhive_version=__version__,
        **_recording(facts),
    ).as_json()


def _recording(facts: RunFacts) -> dict[str, Any]:
    """Return what a run was given of its recording, and what was asked of it in vain."""
    prepared = Prepared.model_validate(facts.variant.description) if facts.variant.description else None
    mode = facts.algorithm.spec.mode(SensorMode(facts.spec["sensors"]))
    return recording_fields(facts.spec["input"], asked_of(facts.body), facts.dataset, mode, prepared)


def twin_fields(twin: RunRecord, facts: RunFacts) -> dict[str, Any]:
    """Return what a run takes over from an equal one."""
    record = twin.as_json()
    taken = {
        key: record.get(key) for key in ("usage", "frames", "metrics", "trajectory", "folder", "logTail")
    }
    results = [result_field(result) for result in twin.results]
    origin = twin.provenance.replace(
        reused_from=twin.provenance.reused_from or twin.name, **_recording(facts)
    )
    return taken | {
        "results": results or None,
        "provenance": origin.as_json(),
        "display": display(twin.usage, results) or None,
        "startTime": record.get("started"),
        "completionTime": record.get("finished"),
    }


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
