# SPDX-License-Identifier: Apache-2.0
"""The Jobs that measure finished runs, by our evaluator or another, and that read what a monitor left."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from slamhive.kube.api.kinds import Kind, reference
from slamhive.kube.builders.common import (
    ANNOTATION_LIMIT,
    Manifest,
    claim,
    container,
    equal_resources,
    label,
    mount,
    pod_spec,
    scratch,
    segment,
    variables,
)
from slamhive.kube.builders.request import ENVIRONMENT, KEPT_SECONDS, REQUEST, TMP, module, request_job
from slamhive.model.canonical import digest

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from slamhive.kube.settings import Settings
    from slamhive.model.evaluation import Evaluator

EVALUATE = "evaluate"
LINKS = "links"
EVALUATOR = "evaluator"
REPORT = "report"
READ = "read"

_HASH_LENGTH = 20
_DEADLINE_SECONDS = 2 * 3600
_READ_SECONDS = 600
_SCRATCH = "2Gi"
_HEAD = 4096


def batches(runs: Iterable[Mapping[str, Any]], size: int) -> Iterator[list[Mapping[str, Any]]]:
    """Split runs so that each batch has at most so many and its request fits into an object.

    Args:
        runs: as they stand in requests.
        size: most runs of a batch.
    """
    batch: list[Mapping[str, Any]] = []
    # A request is an annotation of the pod, and the API server bounds those.
    room = ANNOTATION_LIMIT - _HEAD
    used = 0
    for run in runs:
        length = len(json.dumps(run, ensure_ascii=False, separators=(",", ":")).encode()) + 1
        if batch and (len(batch) == size or used + length > room):
            yield batch
            batch, used = [], 0
        batch.append(run)
        used += length
    if batch:
        yield batch


def evaluator_job_name(namespace: str, request: Mapping[str, Any], settings_hash: str, attempt: int) -> str:
    """Return the name of the Job that measures a batch: the same batch has the same name."""
    parts = {
        "namespace": namespace,
        "evaluation": request.get("evaluation"),
        "runs": sorted(run["uid"] for run in request["runs"]),
        "settings": settings_hash,
        # With the attempt: a batch that failed is tried again under a name that is free.
        "attempt": attempt,
    }
    return f"{EVALUATE}-{digest(parts)[:_HASH_LENGTH]}"


def evaluator_job(
    namespace: str,
    request: Mapping[str, Any],
    *,
    settings_hash: str,
    attempt: int,
    labels: Mapping[str, str],
    owners: Sequence[Manifest],
    settings: Settings,
    evaluator: Evaluator | None = None,
    notes: Mapping[str, str] | None = None,
) -> Manifest:
    """Return the Job that measures a batch of runs.

    Args:
        namespace: of the runs.
        request: ``evaluation``, ``settings`` and ``runs`` as the evaluator reads them.
        settings_hash: of how is measured.
        attempt: number of the attempt at this batch, from 1.
        labels: labels by which its end leads back to who waits for it.
        owners: references to what it goes with; without, it goes an hour after its end.
        settings: the operator's.
        evaluator: a container that measures in the place of ours.
        notes: annotations of the Job.

    Raises:
        InputError: the request doesn't fit into an object, or an identity in it is no segment of a path.
    """
    for run in request["runs"]:
        segment(run["uid"], "the uid")
    name = evaluator_job_name(namespace, request, settings_hash, attempt)
    output = f"evaluations/{name}"
    return request_job(
        namespace,
        name,
        pod_spec(settings),
        role=EVALUATE,
        containers=_custom(evaluator, output, settings) if evaluator else [_ours(output, settings)],
        claims=[claim("results", settings.volumes.results.claim), claim("data", settings.volumes.data.claim)],
        deadline_seconds=_DEADLINE_SECONDS,
        request=request,
        volumes=[scratch("runs", "64Mi")] if evaluator else [],
        scratch_size=_SCRATCH,
        labels=labels,
        owners=owners,
        notes=notes,
        ttl_seconds=None if owners else KEPT_SECONDS,
    )


def _mounts(output: str, *, writable: bool = True) -> list[Manifest]:
    return [
        REQUEST,
        mount("results", "/slamhive/results", read_only=True),
        mount("results", "/slamhive/output", read_only=not writable, subPath=output),
        mount("data", "/slamhive/groundtruth", read_only=True, subPath="groundtruth"),
        TMP,
    ]


def _container(
    name: str, image: str, command: Sequence[str], mounts: Iterable[Manifest], settings: Settings
) -> Manifest:
    wanted = settings.evaluation
    return container(
        name,
        image,
        settings.image_pull_policy,
        command=command,
        env=variables({"HOME": "/tmp", "TMPDIR": "/tmp", "LANG": "C.UTF-8"}),  # noqa: S108
        mounts=mounts,
        resources=equal_resources(wanted.cpu, wanted.memory, logs="4Gi"),
    )


def _ours(output: str, settings: Settings) -> Manifest:
    return _container(EVALUATE, settings.measuring_image, module("evaluate"), _mounts(output), settings)


def _custom(evaluator: Evaluator, output: str, settings: Settings) -> list[Manifest]:
    image, seen = settings.measuring_image, _mounts(output, writable=False)
    links = mount("runs", "/slamhive/runs")
    theirs = [*_mounts(output), mount("runs", "/slamhive/runs", read_only=True)]
    # The foreign evaluator comes before the last container, so that our own reads what it left after it has
    # ended.
    return [
        _container(LINKS, image, module("evaluate", "--links"), [*seen, links], settings),
        _container(EVALUATOR, evaluator.image, evaluator.command, theirs, settings),
        _container(REPORT, image, module("report"), seen, settings),
    ]


def read_job(
    *, run: Mapping[str, Any], pod_uid: str | None, attempt: int | None, settings: Settings
) -> Manifest:
    """Return the Job that reads the summary of an attempt whose monitor left no last words.

    Args:
        run: the MappingRun as the API server returned it; it owns the Job.
        pod_uid: identity of the attempt's pod; None: the run's last one, which is found on the volume.
        attempt: number of the attempt.
        settings: the operator's.

    Raises:
        InputError: an identity is no segment of a path.
    """
    metadata = run["metadata"]
    path = f"runs/{segment(metadata['uid'], 'the uid')}"
    if pod_uid is not None:
        path += f"/{segment(pod_uid, 'the uid')}/summary.json"
    body = container(
        READ,
        settings.image,
        settings.image_pull_policy,
        command=module("read"),
        env=variables(ENVIRONMENT),
        mounts=[mount("results", "/slamhive/results", read_only=True), REQUEST, TMP],
        resources=equal_resources("100m", "128Mi", logs="64Mi"),
    )
    return request_job(
        metadata["namespace"],
        f"{READ}-{digest({'path': path, 'attempt': attempt})[:_HASH_LENGTH]}",
        pod_spec(settings),
        role=READ,
        containers=[body],
        claims=[claim("results", settings.volumes.results.claim)],
        deadline_seconds=_READ_SECONDS,
        request={"path": path},
        labels={label("run"): metadata["name"]},
        owners=[reference(Kind.MAPPING_RUN, run)],
    )
